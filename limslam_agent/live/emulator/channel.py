"""A connection that loses, delays, doubles and damages lines."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Faults:
    """What a connection does to lines. All probabilities are those of a single line.

    Attributes
    ----------
    loss
        Probability that a line is lost.
    delay
        Time that each line takes, s.
    late
        Probability that a line takes longer, by ``late_by`` s. Later lines then overtake it.
    late_by
        By how much such a line is late, s.
    double
        Probability that a line arrives twice.
    damage
        Probability that a byte of the line is changed.

    Raises
    ------
    ValueError
        If a probability is not one, or a time is negative.
    """

    loss: float = 0.0
    delay: float = 0.0
    late: float = 0.0
    late_by: float = 0.2
    double: float = 0.0
    damage: float = 0.0

    def __post_init__(self) -> None:
        for name in ("loss", "late", "double", "damage"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ValueError(f"{name} must be a probability from 0 to 1, not {getattr(self, name):g}")
        for name in ("delay", "late_by"):
            if not 0.0 <= getattr(self, name) <= 60.0:
                raise ValueError(f"{name} must be a time from 0 to 60 s, not {getattr(self, name):g}")


class Channel:
    """One direction of a connection, in the robot's time.

    Parameters
    ----------
    faults
        What happens to lines.
    random
        Generator that decides which lines are hit.
    """

    def __init__(self, faults: Faults, random: np.random.Generator) -> None:
        self._faults, self._random = faults, random
        self._waiting: list[tuple[float, int, bytes]] = []
        self._count = 0

    def push(self, line: bytes, now: float) -> None:
        """Send a line at the time ``now``, s."""
        faults = self._faults
        lost, late, double, damaged = self._random.random(4) < (faults.loss, faults.late, faults.double, faults.damage)
        if lost:
            return
        due = now + faults.delay + (faults.late_by if late else 0.0)
        if damaged:
            place = int(self._random.integers(len(line) - 1))  # the newline stays
            line = line[:place] + bytes([line[place] ^ 1]) + line[place + 1 :]
        for _ in range(2 if double else 1):
            self._waiting.append((due, self._count, line))
            self._count += 1

    def due(self, now: float) -> list[bytes]:
        """The lines that arrive up to the time ``now``, s, in the order of their arrival."""
        # Times are sums of periods: rounding must not make a line late.
        arrived = sorted(each for each in self._waiting if each[0] <= now + 1e-9)
        self._waiting = [each for each in self._waiting if each[0] > now + 1e-9]
        return [line for _, _, line in arrived]
