"""Readings that are pending: they are kept until the wall that they show is known.

Readings are collected by side of the robot. Each is stored with the number of the clone of the pose
that it was taken from, so that it can correct that pose later.

All is stored in arrays, and the functions are plain: a single estimator calls them as they are, and
the batch compiles them.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import ANGLE, CLONES, FROM_X, FROM_Y, Filter, Readings, Walls
from limslam_agent.slam.consistent.limits import WALL_END
from limslam_agent.slam.consistent.step_settings import StepSettings
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec, Side

SIDES: tuple[Side, ...] = ("left", "right", "none")
"""Beams to the left, beams to the right, and beams that point ahead or behind."""

AHEAD = SIDES.index("none")
"""Index in ``SIDES`` of the beams that point ahead or behind."""

CLONE, BEAM, RANGE, DRIVEN_THEN, TAKEN_AT = range(5)
"""Columns of ``Pending.rows``: clone, beam, range (m), the distance driven until then (m), and the
step.
"""

WAITING, FRESH = range(2)
"""Columns of ``Pending.fill``: readings that are pending, and those that were collected since their
side was last processed.
"""

DRIVEN, TURNED, DRIVEN_AT, TURNED_AT, LAST_HIT = range(5)
"""Columns of ``Pending.travel``: distance driven (m) and angle turned (rad), now and at the last
collection, and the distance driven at the last hit of the first side, which is followed by those of
the other sides.
"""


class Pending(NamedTuple):
    """The pending readings of n robots, which have three sides each.

    Attributes
    ----------
    travel
        Of each robot (n, 7), whose columns are named above.
    rows
        A row for each reading of each side (3 n, most, 5), whose columns are named above.
    fill
        How many of the rows of each side are used, and how many of these are fresh (3 n, 2).
    """

    travel: FloatArray
    rows: FloatArray
    fill: IntArray


class Scan(NamedTuple):
    """What the beams of a robot read in a step.

    Attributes
    ----------
    step
        Its number.
    ranges, measured, hits
        Readings (b,), m, which of them are new, and which of these show a wall.
    jitter
        Covariance (3, 3) of the robot's pose about the sum of what its encoders have reported:
        ``encoder_ticks.jitter_of``.
    """

    step: int
    ranges: FloatArray
    measured: BoolArray
    hits: BoolArray
    jitter: FloatArray


class Piece(NamedTuple):
    """Readings of one straight piece of wall.

    Attributes
    ----------
    readings, points
        The readings, and their end points (n, 2), m, where the clones are estimated to be.
    segment
        The fitted piece (5,), whose columns ``kernels.tables`` names.
    is_complete
        Whether no more readings of it will come.
    """

    readings: Readings
    points: FloatArray
    segment: FloatArray
    is_complete: bool


class Belief(NamedTuple):
    """All that is estimated: the lines of the landmarks, in a filter, where along them there is
    wall, and readings that still wait for a landmark.
    """

    ekf: Filter
    walls: Walls
    pending: Pending


class Setup(NamedTuple):
    """What is the same in each step: settings, ``RobotSpec.beam_table``, and :func:`sides_of`."""

    settings: StepSettings
    table: FloatArray
    sides: IntArray


def pending_of(robots: int, room: int) -> Pending:
    """No readings, with room for so many of each side."""
    travel = np.zeros((robots, LAST_HIT + len(SIDES)))
    travel[:, DRIVEN_AT] = -np.inf
    travel[:, TURNED_AT] = -np.inf
    sides = robots * len(SIDES)
    return Pending(travel, np.zeros((sides, room, 5)), np.zeros((sides, 2), dtype=np.int64))


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


def note_motion(pending: Pending, robot: int, increment: FloatArray) -> None:
    """Note that a robot has moved by an increment (3,), m, m, rad."""
    pending.travel[robot, DRIVEN] += math.hypot(increment[0], increment[1])
    pending.travel[robot, TURNED] += abs(increment[2])


def is_due(pending: Pending, robot: int, scan: Scan, setup: Setup) -> bool:
    """Whether there are new hits, and the robot has moved far enough since the last collection."""
    travel = pending.travel[robot]
    settings = setup.settings
    is_seen = False
    for beam in range(len(scan.hits)):
        if scan.hits[beam] and setup.sides[beam] >= 0:
            travel[LAST_HIT + setup.sides[beam]] = travel[DRIVEN]
            is_seen = True
    has_driven = travel[DRIVEN] - travel[DRIVEN_AT] >= settings.min_distance
    return bool(is_seen and (has_driven or travel[TURNED] - travel[TURNED_AT] >= settings.min_turn))


def collect(pending: Pending, robot: int, scan: Scan, sides: IntArray, clone: int) -> None:
    """Add a robot's new hits, which were taken from the pose of a clone, to its sides."""
    travel = pending.travel[robot]
    travel[DRIVEN_AT] = travel[DRIVEN]
    travel[TURNED_AT] = travel[TURNED]
    for beam in range(len(sides)):
        if scan.hits[beam] and sides[beam] >= 0:
            row = robot * len(SIDES) + sides[beam]
            reading = pending.rows[row, pending.fill[row, WAITING]]
            reading[CLONE] = clone
            reading[BEAM] = beam
            reading[RANGE] = scan.ranges[beam]
            reading[DRIVEN_THEN] = travel[DRIVEN]
            reading[TAKEN_AT] = scan.step
            pending.fill[row] += 1


def has_ended(pending: Pending, robot: int, side: int) -> bool:
    """Whether a side has pending readings, but has had no hit for so long that the wall there has
    ended.
    """
    travel = pending.travel[robot]
    waiting = pending.fill[robot * len(SIDES) + side, WAITING]
    return bool(waiting > 0 and travel[DRIVEN] - travel[LAST_HIT + side] > WALL_END)


def discard(pending: Pending, row: int, is_kept: BoolArray) -> None:
    """Keep only some of the pending readings (n,) of a side."""
    kept = pending.rows[row][np.flatnonzero(is_kept)]
    pending.rows[row, : len(kept)] = kept
    pending.fill[row, WAITING] = len(kept)


def places_of(ekf: Filter, clones: FloatArray) -> IntArray:
    """Places (n,) of clones (n,) in the state."""
    return np.searchsorted(ekf.clones[: ekf.counts[CLONES]], clones.astype(np.int64))


def readings_of(ekf: Filter, waiting: FloatArray, setup: Setup) -> Readings:
    """Pending readings (n, 5) as the filter takes them."""
    settings = setup.settings
    table = setup.table
    numbers = waiting[:, BEAM].astype(np.int64)
    rows = np.empty((len(waiting), 6))
    rows[:, 0] = table[:, FROM_X][numbers]
    rows[:, 1] = table[:, FROM_Y][numbers]
    rows[:, 2] = table[:, ANGLE][numbers]
    rows[:, 3] = waiting[:, RANGE]
    rows[:, 4] = settings.cone
    rows[:, 5] = waiting[:, BEAM]
    variances = settings.std**2 + (settings.growth * rows[:, 3] ** 2) ** 2
    return Readings(places_of(ekf, waiting[:, CLONE]), rows, variances)
