"""Readings of one robot that are pending: they are kept until the wall that they show is known.

Readings are collected by side of the robot. Each is stored with the number of the clone of the pose that it was taken
from, so that it can correct that pose later.
"""

import copy
import math
from itertools import chain
from typing import Any, NamedTuple, Self

import numpy as np

from limslam_agent.config.consistent import PendingReadingsConfig
from limslam_agent.slam.consistent.beam_model import Readings
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec, Side

SIDES: tuple[Side, ...] = ("left", "right", "none")
"""Beams to the left, beams to the right, and beams that point ahead or behind."""

AHEAD = SIDES.index("none")
"""Index in ``SIDES`` of the beams that point ahead or behind."""


class PendingReading(NamedTuple):
    """One pending reading: its clone, step, beam, range (m), and the distance driven until then (m)."""

    clone: int
    step: int
    beam: int
    distance: float
    driven: float


class PendingReadings:
    """The distance that one robot has driven, and its pending readings by side.

    Parameters
    ----------
    robot
        Body and beams.
    config
        Distance and turn that the robot must move between two collections.
    most
        Largest number of beams of one side that are used; more are thinned out evenly.

    Attributes
    ----------
    driven
        Distance driven so far, m.
    by_side
        The pending readings of each side, oldest first.
    fresh
        Number of readings of each side that were collected since that side was last processed.
    """

    def __init__(self, robot: RobotSpec, config: PendingReadingsConfig, most: int) -> None:
        self._robot, self._config = robot, config
        self._beams = {side: thinned([beam.side == side for beam in robot.beams], most).tolist() for side in SIDES}
        self.driven = self._turned = 0.0
        self._collected_at = (-math.inf, -math.inf)
        self.by_side: dict[Side, list[PendingReading]] = {side: [] for side in SIDES}
        self.fresh: dict[Side, int] = dict.fromkeys(SIDES, 0)
        self._last_hit: dict[Side, float] = dict.fromkeys(SIDES, 0.0)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        other = copy.copy(self)
        other.by_side = {side: list(readings) for side, readings in self.by_side.items()}
        for name in ("fresh", "_last_hit"):
            setattr(other, name, dict(getattr(self, name)))
        return other

    def move(self, increment: FloatArray) -> None:
        """Count a motion of the robot (3,), m and rad."""
        self.driven += math.hypot(float(increment[0]), float(increment[1]))
        self._turned += abs(float(increment[2]))

    def is_due(self, front: FrontEnd) -> bool:
        """Whether there are new hits, and the robot has moved far enough since the last collection."""
        hits = front.hits.tolist()
        hit = [side for side, beams in self._beams.items() if any(hits[beam] for beam in beams)]
        for side in hit:
            self._last_hit[side] = self.driven
        driven, turned = self._collected_at
        has_moved = self.driven - driven >= self._config.min_distance or self._turned - turned >= self._config.min_turn
        return has_moved and bool(hit)

    def collect(self, front: FrontEnd, clone: int) -> None:
        """Add the new hits, which were taken from the pose of a clone."""
        self._collected_at = self.driven, self._turned
        hits, ranges = front.hits.tolist(), front.ranges.tolist()
        for side, beams in self._beams.items():
            for beam in beams:
                if hits[beam]:
                    self.by_side[side].append(PendingReading(clone, front.step, beam, ranges[beam], self.driven))
                    self.fresh[side] += 1

    def forget(self) -> None:
        """Discard all pending readings."""
        for side in SIDES:
            self.by_side[side], self.fresh[side] = [], 0

    def has_ended(self, side: Side, gap: float) -> bool:
        """Whether a side has pending readings but no hit within the last ``gap`` (m): the wall there has ended."""
        return bool(self.by_side[side]) and self.driven - self._last_hit[side] > gap

    def readings(self, side: Side) -> Readings:
        """The pending readings of a side, as the filter takes them."""
        numbers = chain.from_iterable(self.by_side[side])
        rows = np.fromiter(numbers, dtype=float).reshape(-1, len(PendingReading._fields))
        clones, steps, beams = rows[:, :3].T.astype(int)
        return Readings(
            clones, self._robot.beam_origins[beams], self._robot.beam_angles[beams], rows[:, 3],
            np.column_stack((steps, beams)),
        )  # fmt: skip


def thinned(chosen: list[bool], most: int) -> IntArray:
    """Indices of the chosen beams, or of ``most`` of them that are evenly spread."""
    beams = np.flatnonzero(np.array(chosen))
    places = np.unique(np.linspace(0, len(beams) - 1, min(most, len(beams))).round().astype(int))
    return np.asarray(beams[places])
