"""The connection of a session to a robot: messages instead of the lines of a transport."""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable

from limslam_agent.live.protocol import (
    OLDEST,
    VERSION,
    BadLineError,
    Command,
    Greeting,
    Hello,
    Message,
    decode,
    encode,
)
from limslam_agent.live.transports import Transport
from limslam_env.messages import counted, described

POLL = 0.02
"""Longest wait for a message before something else is done, s."""

_ASK_AGAIN = 0.5  # s, between two greetings to a robot that is not heard


class NoRobotError(ValueError):
    """No robot that can be driven has answered."""


class Connection(ABC):
    """A connection to a robot, for a session.

    Attributes
    ----------
    clock
        The host's clock, s.
    bad_lines
        Number of lines, or messages, that could not be read.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.clock = clock
        self.bad_lines = 0
        self._seq = 0
        self._newest_bad: tuple[bytes, BadLineError] | None = None

    @property
    def late(self) -> int:
        """Number of measurements that the connection itself has left out, because they came late or
        twice. Those of lines are found by their sequence numbers, in the recording.
        """
        return 0

    @property
    def trouble(self) -> str:
        """How many lines were not readable, with the newest one and what is wrong with it, in words
        that follow an error; empty if there are none.
        """
        if self._newest_bad is None:
            return ""
        line, why = self._newest_bad
        lines = counted(self.bad_lines, "line")
        return f"; {lines} not readable, at last {described(line.decode('latin-1'))}: {why}"

    @abstractmethod
    def first_hello(self, patience: float) -> Hello:
        """Wait for the robot. Raises a :class:`NoRobotError` if there is none after ``patience``
        s.
        """

    @abstractmethod
    def receive(self, timeout: float) -> list[Message]:
        """The messages that have arrived. Waits for the first one, at most ``timeout`` s."""

    def next_seq(self) -> int:
        """A sequence number for the next command."""
        self._seq = (self._seq + 1) % (1 << 32)
        return self._seq

    @abstractmethod
    def send(self, command: Command) -> None:
        """Send a command. It is lost if there is no connection."""

    @abstractmethod
    def greet(self) -> None:
        """Ask the robot to say hello."""


class Link(Connection):
    """A connection of lines over a transport."""

    def __init__(self, transport: Transport, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__(clock)
        self.transport = transport
        self._greeted = -math.inf

    def receive(self, timeout: float) -> list[Message]:
        """The messages that have arrived. Lines that are no messages are counted."""
        messages = []
        for line in self.transport.receive(timeout):
            try:
                messages.append(decode(line))
            except BadLineError as error:
                self.bad_lines += 1
                self._newest_bad = line, error
        return messages

    def send(self, command: Command) -> None:
        """Send a command."""
        self.transport.send(encode(command))

    def greet(self) -> None:
        """Ask the robot to say hello and to send telemetry, at most twice a second."""
        if self.clock() - self._greeted >= _ASK_AGAIN:
            self._greeted = self.clock()
            self.send(Greeting(VERSION, self._seq))

    def first_hello(self, patience: float) -> Hello:
        """Wait for the robot. Raises a NoRobotError if none has said hello after ``patience`` s, or
        if it speaks another version of the protocol.
        """
        begin = self.clock()
        while self.clock() - begin <= patience:
            self.greet()
            for message in self.receive(POLL):
                if isinstance(message, Hello):
                    return _checked(message)
        raise NoRobotError(f"no robot has answered within {patience:g} s{self.trouble}")


def _checked(hello: Hello) -> Hello:
    if not OLDEST <= hello.version <= VERSION:
        raise NoRobotError(
            f"the robot {hello.name} speaks version {hello.version} of the protocol, and this "
            f"program versions {OLDEST} to {VERSION}"
        )
    return hello
