"""What runs on the robot: it says hello, obeys commands, sends telemetry, and stops the wheels when
nothing comes.

``examples/live/limslam_link.c`` is the same in C, and tests compare the two.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.live.protocol import (
    NOTHING_SEEN,
    BadLineError,
    Greeting,
    Hello,
    Speeds,
    Stop,
    Telemetry,
    decode,
    difference,
    encode,
)
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

NM_PER_TICK = 100_000
"""Wheel travel for each tick of simulated encoders, nm."""

HELLO_EVERY = 500
"""Time between two hellos of a robot without a host, ms."""

HOST_LOST_AFTER = 3000
"""Time without a line from the host after which the robot looks for a host again, ms."""

_SPAN = 1 << 32


class Firmware:
    """The robot's side of the protocol.

    ``has_host``: it has been greeted, and has heard the host since. ``awaits_answer``: the host has
    not yet answered its latest telemetry.
    """

    def __init__(self, hello: Hello) -> None:
        self.hello = hello
        self.has_host = False
        self.awaits_answer = False
        self._seq = self._ack = self._heard = 0
        self._left = self._right = 0
        self._is_stopped = False
        self._owes_hello = True
        self._next_hello = 0

    def hear(self, line: bytes, now: int) -> bool:
        """Take a line of the host at the time ``now``, ms. Whether it was a command."""
        try:
            message = decode(line)
        except BadLineError:
            return False
        if isinstance(message, Hello | Telemetry):
            return False
        if isinstance(message, Greeting):
            self._left = self._right = 0
            self.has_host = self._owes_hello = True
            self._ack = message.seq
            self._heard = now
            return True
        is_new = self.has_host and difference(message.seq, self._ack) > 0
        if isinstance(message, Stop):
            self._left = self._right = 0
        if isinstance(message, Stop) or (
            isinstance(message, Speeds) and difference(message.answers, self._seq) >= -1
        ):
            self.awaits_answer = False
        if is_new:
            self._ack = message.seq
            self._heard = now
            if isinstance(message, Speeds):
                self._left = message.left
                self._right = message.right
                self._is_stopped = False
        return True

    def speeds(self, now: int) -> tuple[int, int]:
        """Left and right wheel speed at the time ``now`` (ms), mm/s. The watchdog stops the wheels
        here.
        """
        silence = difference(now, self._heard)
        if silence > self.hello.watchdog_ms and (self._left or self._right):
            self._left = self._right = 0
            self._is_stopped = True
        if silence > HOST_LOST_AFTER:
            self.has_host = False
        return self._left, self._right

    def say(
        self,
        now: int,
        ticks: tuple[int, int],
        ranges: tuple[int | None, ...],
        yaw: int | None = None,
    ) -> list[bytes]:
        """The lines to send at the time ``now``, ms, once in each period."""
        lines = []
        if self._owes_hello or (not self.has_host and difference(now, self._next_hello) >= 0):
            self._owes_hello = False
            self._next_hello = (now + HELLO_EVERY) % _SPAN
            lines.append(encode(self.hello))
        if self.has_host:
            left, right = (difference(each % _SPAN, 0) for each in ticks)
            measured = Telemetry(
                self._seq, now % _SPAN, left, right, self._ack, int(self._is_stopped), ranges, yaw
            )
            lines.append(encode(measured))
            self._seq = (self._seq + 1) % _SPAN
        self.awaits_answer = self.has_host
        return lines


def ticks(travel: FloatArray) -> tuple[int, int]:
    """Ticks of simulated encoders after a travel (2,) of the wheels, m."""
    left, right = (int(round(1e9 * each) // NM_PER_TICK) for each in travel.tolist())
    return left, right


def ranges_in_mm(ranges: NDArray[np.floating[Any]], robot: RobotSpec) -> tuple[int, ...]:
    """Ranges (n_beams,), m, as telemetry has them."""
    metres = ranges.astype(float)
    mm = np.minimum(np.round(1e3 * metres), NOTHING_SEEN - 1)
    mm = np.where(
        metres >= robot.too_far, NOTHING_SEEN, np.where(metres <= robot.too_near, 0.0, mm)
    )
    return tuple(int(each) for each in mm)
