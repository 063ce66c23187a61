"""Where lines come from and go to: a serial port, or a UDP socket."""

import select
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from ipaddress import IPv4Address
from typing import TYPE_CHECKING, TypeAlias

from limslam_agent.live.protocol import (
    LONGEST_LINE,
    NAME_RULE,
    OLDEST,
    BadLineError,
    Hello,
    Message,
    decode,
    is_name,
)

if TYPE_CHECKING:
    import serial

REOPEN_AFTER = 0.5
"""Time between two attempts to open a serial port that was unplugged, s."""

SILENT_AFTER = 1.0
"""Time after which a robot is no longer heard, so that it may come back from another address, s."""

LAST_PORT = 65535

THIS_COMPUTER = "127.0.0.1"
"""The address that only programs on this computer reach."""

Address: TypeAlias = tuple[str, int]
"""Address and port of a sender."""

_MOST_BYTES = 65536
_MOST_DATAGRAMS = 500  # that are read at once; a robot sends one in each period
_LINES_OF_DATAGRAM = 4  # that are searched for a hello; a robot sends a hello and a measurement
_MOST_REFUSALS = 20  # that are said in a session


class LineBuffer:
    """Cuts a stream of bytes into lines. A line that is too long is cut, so that noise cannot fill
    the memory.
    """

    def __init__(self) -> None:
        self._rest = b""

    def add(self, data: bytes) -> list[bytes]:
        """The lines, without their ends, that are complete with these bytes. Empty lines are left
        out.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-LONGEST_LINE:]
        return [line.rstrip(b"\r") for line in lines if line.strip()]


def datagrams(source: socket.socket, timeout: float) -> list[tuple[bytes, Address]]:
    """The datagrams that have arrived, each ended as a line, and their senders. Waits at most
    ``timeout`` s.

    They are not more than a flood of them fills in a moment, so that their reader goes on.
    """
    select.select([source], [], [], timeout)
    found = list[tuple[bytes, Address]]()
    # On Windows, a datagram that could not be delivered is reported by the next read.
    with suppress(BlockingIOError, ConnectionError):
        while len(found) < _MOST_DATAGRAMS:
            data, sender = source.recvfrom(_MOST_BYTES)
            found.append((data + b"\n", sender))
    return found


class Seat:
    """Which sender of datagrams is the robot of a session.

    The first robot that says hello is the one that is driven, and its name holds until the session
    ends. While it is heard, no other sender is. After a second of silence a robot of the same name
    may speak from another address, because it was switched on again. With a ``token``, only a hello
    with that token counts. A robot of version 1 has no token, and is believed if it runs on this
    computer.

    ``report`` gets a line in words for each robot that is refused.
    """

    def __init__(self, token: str | None, report: Callable[[str], None]) -> None:
        if token is not None and not is_name(token):
            raise ValueError(f"the token {token!r} is not {NAME_RULE}")
        self._token = token
        self._report = report
        self._name: str | None = None
        self._silence = 0.0  # s, that the host has listened without hearing the robot
        self._refusals = set[str]()
        self.robot: Address | None = None

    def listened(self, seconds: float) -> None:
        """Note how long the host has listened. A host that computes hears nobody, and the robot
        keeps its seat meanwhile.
        """
        self._silence += seconds

    def admits(self, lines: list[bytes], sender: Address) -> bool:
        """Whether lines that have come from a sender are the robot's."""
        for hello in _hellos(lines):
            self._decide(hello, sender)
        if sender != self.robot:
            return False
        self._silence = 0.0
        return True

    def _decide(self, hello: Hello, sender: Address) -> None:
        """Give the seat to a robot that has said hello, or refuse it."""
        is_local_old = hello.version == OLDEST and sender[0].startswith("127.")
        if hello.version == OLDEST and not is_local_old:
            self._refuse(hello, sender, "a robot in a network needs version 2 of the protocol")
        elif self._token not in {None, hello.token} and not is_local_old:
            self._refuse(hello, sender, "it has not said the token of --token")
        elif self._name not in {None, hello.name}:
            self._refuse(hello, sender, f"the session is with the robot {self._name}")
        elif self.robot not in {None, sender} and self._silence <= SILENT_AFTER:
            self._refuse(hello, sender, "a robot of this name is heard from another address")
        else:
            self._name = hello.name
            self.robot = sender

    def _refuse(self, hello: Hello, sender: Address, why: str) -> None:
        if sender == self.robot:
            self.robot = None
        line = f"the robot {hello.name} at {sender[0]} is not driven: {why}"
        if line not in self._refusals and len(self._refusals) < _MOST_REFUSALS:
            self._refusals.add(line)
            self._report(line)


def _hellos(lines: list[bytes]) -> Iterator[Hello]:
    """The hellos of a datagram. It has room for a few lines."""
    for line in lines[:_LINES_OF_DATAGRAM]:
        if isinstance(message := _message(line), Hello):
            yield message


def _message(line: bytes) -> Message | None:
    """The message of a line; None if it is none."""
    with suppress(BadLineError):
        return decode(line)
    return None


class UdpTransport:
    """A UDP socket on which the host listens. The robot finds the host, and says hello.

    A :class:`Seat` decides which sender is the robot. Datagrams of other senders are ignored. The
    port 0 chooses a free one.

    Parameters
    ----------
    port
        Number of the port.
    listen
        Address of this computer, IPv4. ``127.0.0.1`` hears programs on this computer only, and
        ``0.0.0.0`` everybody in its networks.
    token, report
        As in :class:`Seat`.

    Raises
    ------
    ValueError
        If an argument is no port, no address or no token.
    OSError
        If the port cannot be used.
    """

    def __init__(
        self,
        port: int,
        listen: str = THIS_COMPUTER,
        token: str | None = None,
        report: Callable[[str], None] = lambda _: None,
    ) -> None:
        if not 0 <= port <= LAST_PORT:
            raise ValueError(f"a UDP port is a number up to {LAST_PORT}, not {port}")
        try:
            address = str(IPv4Address(listen))
        except ValueError:
            raise ValueError(f"{listen!r} is not an IPv4 address such as 0.0.0.0") from None
        self._seat = Seat(token, report)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((address, port))
        except OSError as error:
            self._socket.close()
            place = f"{address}, UDP port {port}"
            raise OSError(error.errno, error.strerror, place) from error
        self._socket.setblocking(False)  # noqa: FBT003 (the name says it)
        self.port: int = self._socket.getsockname()[1]

    def receive(self, timeout: float) -> list[bytes]:
        """The lines of all datagrams that the robot has sent; without a robot, those of anybody
        that are no messages.
        """
        begin = time.monotonic()
        arrived = datagrams(self._socket, timeout)
        self._seat.listened(time.monotonic() - begin)
        found = []
        for data, sender in arrived:
            lines = LineBuffer().add(data)
            if self._seat.admits(lines, sender):
                found += lines
            elif self._seat.robot is None:  # so that it can be said what is wrong with them
                found += [each for each in lines[:_LINES_OF_DATAGRAM] if _message(each) is None]
        return found

    def send(self, line: bytes) -> None:
        """Send a line to the robot, if one has said hello."""
        with suppress(OSError):  # the network may be away
            if self._seat.robot is not None:
                self._socket.sendto(line, self._seat.robot)

    def close(self) -> None:
        """Free the port."""
        self._socket.close()


class SerialTransport:
    """A serial port, like ``/dev/ttyUSB0`` or ``COM3``. If it is unplugged, it is opened again as
    soon as it is back. Raises a ValueError if pyserial is not installed, or the port cannot be
    opened.
    """

    def __init__(self, port: str, baud: int) -> None:
        try:
            import serial
        except ImportError:
            raise ValueError('a serial port needs pyserial: pip install "limslam[live]"') from None
        self._serial = serial
        self._name = port
        self._baud = baud
        self._lines = LineBuffer()
        self._next_attempt = 0.0
        try:
            self._port: serial.Serial | None = self._opened()
        except (OSError, ValueError) as error:
            raise ValueError(f"{port}: cannot be opened: {error}") from error

    def receive(self, timeout: float) -> list[bytes]:
        """The lines that have arrived."""
        if self._port is None and not self._is_back(timeout):
            return []
        assert self._port is not None  # noqa: S101 (it is back)
        try:
            self._port.timeout = timeout
            data = self._port.read(1)
            return self._lines.add(data + self._port.read(self._port.in_waiting))
        except OSError:  # pyserial's own errors are of this kind
            self.close()
            return []

    def send(self, line: bytes) -> None:
        """Send a line, if the port is open."""
        try:
            if self._port is not None:
                self._port.write(line)
        except OSError:
            self.close()

    def close(self) -> None:
        """Free the port."""
        if self._port is not None:
            with suppress(OSError):
                self._port.close()
        self._port = None
        self._lines = LineBuffer()

    def _opened(self) -> "serial.Serial":
        return self._serial.Serial(self._name, self._baud, timeout=0.0, write_timeout=0.2)

    def _is_back(self, timeout: float) -> bool:
        """Try to open the port again, at most twice a second."""
        if time.monotonic() >= self._next_attempt:
            self._next_attempt = time.monotonic() + REOPEN_AFTER
            with suppress(OSError, ValueError):
                self._port = self._opened()
                return True
        time.sleep(timeout)
        return False


Transport: TypeAlias = UdpTransport | SerialTransport
"""A connection to a robot. A lost connection is no error: nothing arrives until it is back."""
