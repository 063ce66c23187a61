"""How far a robot has come, and which of its readings wait until it is clear which wall they show."""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.config.consistent import PendingReadingsConfig
from limslam_agent.slam.consistent.beam_model import Readings
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec, Side

SIDES: tuple[Side, ...] = ("left", "right", "none")
"""The beams to the left, to the right, and those ahead or behind."""


class Pending(NamedTuple):
    """One reading that waits: its clone, step, beam, range (m), and how far the robot had driven (m)."""

    clone: int
    step: int
    beam: int
    distance: float
    driven: float


class Track:
    """One robot's way and its readings that wait, by side.

    Parameters
    ----------
    robot
        Body and beams.
    config
        How far the robot must move between two readings.
    most
        At most so many beams of a side are used, evenly thinned out.

    Attributes
    ----------
    driven
        How far it has come, m.
    waiting
        What waits, by side.
    fresh
        How many of them have come since they were last looked through, by side.
    """

    def __init__(self, robot: RobotSpec, config: PendingReadingsConfig, most: int) -> None:
        self._robot, self._config = robot, config
        self._beams = {side: thinned([beam.side == side for beam in robot.beams], most) for side in SIDES}
        self.driven = self._turned = 0.0
        self._read_at = (-math.inf, -math.inf)
        self.waiting: dict[Side, list[Pending]] = {side: [] for side in SIDES}
        self.fresh: dict[Side, int] = dict.fromkeys(SIDES, 0)
        self._last_hit: dict[Side, float] = dict.fromkeys(SIDES, 0.0)

    def move(self, increment: FloatArray) -> None:
        """The robot has moved (3,), m and rad."""
        self.driven += math.hypot(float(increment[0]), float(increment[1]))
        self._turned += abs(float(increment[2]))

    def wants(self, front: FrontEnd) -> bool:
        """Whether there are new hits, and the robot has moved enough since the last ones that were kept."""
        for side, beams in self._beams.items():
            if front.hits[beams].any():
                self._last_hit[side] = self.driven
        driven, turned = self._read_at
        has_moved = self.driven - driven >= self._config.min_distance or self._turned - turned >= self._config.min_turn
        return has_moved and any(front.hits[beams].any() for beams in self._beams.values())

    def collect(self, front: FrontEnd, clone: int) -> None:
        """Let the new hits wait, with the clone of the pose they were read from."""
        self._read_at = self.driven, self._turned
        for side, beams in self._beams.items():
            for beam in beams[front.hits[beams]].tolist():
                self.waiting[side].append(Pending(clone, front.step, beam, float(front.ranges[beam]), self.driven))
                self.fresh[side] += 1

    def has_ended(self, side: Side, gap: float) -> bool:
        """Whether nothing was seen on a side for ``gap`` (m), so that the wall there has ended."""
        return bool(self.waiting[side]) and self.driven - self._last_hit[side] > gap

    def readings(self, side: Side) -> Readings:
        """What waits on a side, for the filter."""
        rows = np.array(self.waiting[side], dtype=float).reshape(-1, len(Pending._fields))
        clones, steps, beams = rows[:, :3].T.astype(int)
        return Readings(
            clones, self._robot.beam_origins[beams], self._robot.beam_angles[beams], rows[:, 3],
            np.column_stack((steps, beams)),
        )  # fmt: skip


def thinned(chosen: list[bool], most: int) -> IntArray:
    """The chosen beams, or ``most`` of them evenly spread."""
    beams = np.flatnonzero(np.array(chosen))
    places = np.unique(np.linspace(0, len(beams) - 1, min(most, len(beams))).round().astype(int))
    return np.asarray(beams[places])
