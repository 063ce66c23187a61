"""Readings that are pending: they are kept until the wall that they show is known.

Readings are collected by side of the robot. Each is stored with the number of the clone of the pose
that it was taken from, so that it can correct that pose later.

All is stored in arrays, and the functions are plain: a single estimator calls them as they are, and
the batch compiles them. For each robot, ``travel`` (7,) has the places that are named below, and
for each of its sides, ``pending`` (most, 5) has a row for each reading, and ``fill`` (2,) says how
many of its rows are used and how many of these are fresh.
"""

import numpy as np

from limslam_agent.kernels.tables import ANGLE, CLONES, FROM_X, FROM_Y, Filter
from limslam_agent.slam.consistent.limits import WALL_END
from limslam_agent.slam.consistent.step_settings import StepSettings
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec, Side

SIDES: tuple[Side, ...] = ("left", "right", "none")
"""Beams to the left, beams to the right, and beams that point ahead or behind."""

AHEAD = SIDES.index("none")
"""Index in ``SIDES`` of the beams that point ahead or behind."""

CLONE, BEAM, RANGE, DRIVEN_THEN, TAKEN_AT = range(5)
"""Columns of ``pending``: clone, beam, range (m), the distance driven until then (m), and the
step.
"""

WAITING, FRESH = range(2)
"""Places in ``fill``: readings that are pending, and those that were collected since their side was
last processed.
"""

DRIVEN, TURNED, DRIVEN_AT, TURNED_AT, LAST_HIT = range(5)
"""Places in ``travel``: distance driven (m) and angle turned (rad), now and at the last collection,
and the distance driven at the last hit of the first side, which is followed by those of the other
sides.
"""


def sides_of(robot: RobotSpec, most: int) -> IntArray:
    """The side (n_beams,) of each beam that is used, as an index in ``SIDES``; -1 for a beam that
    is not used.

    Of each side, at most ``most`` beams are used. More are thinned out evenly.
    """
    sides = np.full(len(robot.beams), -1)
    for number, side in enumerate(SIDES):
        beams = np.flatnonzero([beam.side == side for beam in robot.beams])
        sides[beams[np.linspace(0, len(beams) - 1, min(most, len(beams))).round().astype(int)]] = (
            number
        )
    return sides


def most_clones(batch: int, max_clones: int, robots: int) -> int:
    """Largest number of clones that can be needed at a time.

    A side with ``batch`` fresh readings is processed, and then at most ``max_clones`` clones
    remain. Each clone since then has brought a fresh reading to a side, and no side has ``batch``
    of them.
    """
    return max_clones + robots * (len(SIDES) * (batch - 1) + 1)


def is_due(travel: FloatArray, hits: BoolArray, sides: IntArray, settings: StepSettings) -> bool:
    """Whether there are new hits (b,), and the robot has moved far enough since the last
    collection.
    """
    is_seen = False
    for beam in range(len(hits)):
        if hits[beam] and sides[beam] >= 0:
            travel[LAST_HIT + sides[beam]] = travel[DRIVEN]
            is_seen = True
    has_driven = travel[DRIVEN] - travel[DRIVEN_AT] >= settings.min_distance
    return bool(is_seen and (has_driven or travel[TURNED] - travel[TURNED_AT] >= settings.min_turn))


def collect(
    travel: FloatArray,
    pending: FloatArray,
    fill: IntArray,
    step: int,
    ranges: FloatArray,
    hits: BoolArray,
    sides: IntArray,
    clone: int,
) -> None:
    """Add a robot's new hits (b,), which were taken from the pose of a clone, to its sides (3,
    most, 5).
    """
    travel[DRIVEN_AT], travel[TURNED_AT] = travel[DRIVEN], travel[TURNED]
    for beam in range(len(hits)):
        if hits[beam] and sides[beam] >= 0:
            side = sides[beam]
            reading = pending[side, fill[side, WAITING]]
            reading[CLONE] = clone
            reading[BEAM] = beam
            reading[RANGE] = ranges[beam]
            reading[DRIVEN_THEN] = travel[DRIVEN]
            reading[TAKEN_AT] = step
            fill[side, WAITING] += 1
            fill[side, FRESH] += 1


def has_ended(travel: FloatArray, fill: IntArray, side: int) -> bool:
    """Whether a side has pending readings, but has had no hit for so long that the wall there has
    ended.
    """
    return bool(fill[side, WAITING] > 0 and travel[DRIVEN] - travel[LAST_HIT + side] > WALL_END)


def places_of(ekf: Filter, clones: FloatArray) -> IntArray:
    """Places (n,) of clones (n,) in the state."""
    return np.searchsorted(ekf.clones[: ekf.counts[CLONES]], clones.astype(np.int64))


def readings_of(
    ekf: Filter, waiting: FloatArray, beams: FloatArray, settings: StepSettings
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Pending readings (n, 5) as the filter takes them: places of their clones (n,), beams and
    ranges, and variances.

    Beams and ranges (n, 6) are those of ``kernels.beams``, and the number of the beam.
    """
    numbers = waiting[:, BEAM].astype(np.int64)
    readings = np.empty((len(waiting), 6))
    readings[:, 0] = beams[:, FROM_X][numbers]
    readings[:, 1] = beams[:, FROM_Y][numbers]
    readings[:, 2] = beams[:, ANGLE][numbers]
    readings[:, 3] = waiting[:, RANGE]
    readings[:, 4] = settings.cone
    readings[:, 5] = waiting[:, BEAM]
    variances = settings.std**2 + (settings.growth * readings[:, 3] ** 2) ** 2
    return places_of(ekf, waiting[:, CLONE]), readings, variances
