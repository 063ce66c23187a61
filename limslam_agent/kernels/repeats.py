"""Which beams repeat their readings, and which readings are repeated.

A loop that is faster than its sensors reports each reading in several rows. A new reading of a
moving robot is seldom equal to the one before: noise is wider than the resolution, or the distance
has changed. What changes by more than the resolution at each change, and stands in several rows
between the changes, is repeated.

How often chance makes readings equal is seen in how often they change by the resolution alone. Let
c be the share of such changes. A smooth distribution has half as many zeros as ones of either sign.
A narrow one has more, up to all where c is 1, as for a slow robot with a coarse sensor. The chance
is taken to be (c + c^3) / 2, and a little more for what is not random. The readings of a robot that
stands still say nothing.
"""

import math

from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.tables import (
    AT_SHORTEST,
    BETWEEN,
    HOLD,
    LONG_CHANGES,
    LONG_ROWS,
    MOVED,
    PREVIOUS,
    RESOLUTION,
    ROWS,
    SHORTEST,
    SINGLE,
    UNUSED,
    WALL_CHANGES,
)
from limslam_env.geometry import BoolArray, FloatArray

# What a reading was before it is known: no reading of a wall, the first one of a wall, or one after
# another reading of a wall, so that its first row is known.
_NO_WALL = 0.0
_FIRST = 1.0
_CHANGED = 2.0
# m: how far a robot moves at least and at most while a reading that says something is repeated. One
# that moves farther drives along a wall, with a sensor without noise.
_LEAST_MOVED = 2e-3
_MOST_MOVED = 0.3
_BY_CHANCE = 0.05
# How many changes a beam needs at least, and by how many standard deviations more of its readings
# must be repeated than chance explains: without other beams that repeat theirs, and with one.
_FEWEST = (16, 6)
_SIGMAS = (5.0, 3.0)
# A change is one by the resolution if it is smaller than this many times the smallest one.
_ONE_STEP = 1.5
# An equal reading of a sensor that is not exactly periodic is new after so many times the usual
# number of rows.
_LATEST = 1.5


@compiled
def find_hold(repeats: FloatArray, beam: int) -> None:
    """Set for how many rows an equal reading of a beam counts as repeated, if the table of
    ``repeats`` (b, 13) says that the beam repeats its readings.
    """
    known = repeats[beam]
    others = 0
    for other in range(len(repeats)):
        if repeats[other, HOLD] > 0.0:
            others = 1
    changes = known[WALL_CHANGES]
    repeated = known[LONG_CHANGES]
    if changes < _FEWEST[others]:
        return
    single = known[SINGLE] / changes
    expected = changes * min(_BY_CHANCE + 0.5 * (single + single**3), 1.0)
    if repeated <= expected + _SIGMAS[others] * math.sqrt(expected):
        return
    is_periodic = 2.0 * known[AT_SHORTEST] > repeated
    usual = known[LONG_ROWS] / repeated
    known[HOLD] = known[SHORTEST] if is_periodic else math.ceil(_LATEST * usual)


@compiled
def _note_change(known: FloatArray, change: float) -> None:
    """Note that a reading of a wall has changed to another one by ``change``, m."""
    rows = known[ROWS]
    moved = known[MOVED]
    if rows > 1.0 and not _LEAST_MOVED <= moved <= _MOST_MOVED:
        return
    if known[RESOLUTION] == 0.0 or change * _ONE_STEP < known[RESOLUTION]:
        known[RESOLUTION] = change
        known[SINGLE] = 0.0
    known[WALL_CHANGES] += 1.0
    if change < _ONE_STEP * known[RESOLUTION]:
        known[SINGLE] += 1.0
    if rows > 1.0:
        known[LONG_CHANGES] += 1.0
        known[LONG_ROWS] += rows
        if known[SHORTEST] == 0.0 or rows < known[SHORTEST]:
            known[SHORTEST] = rows
            known[AT_SHORTEST] = 0.0
        if rows == known[SHORTEST]:
            known[AT_SHORTEST] += 1.0


@compiled
def is_new(
    repeats: FloatArray, beam: int, reading: float, is_wall: bool, moved: float, is_due: bool
) -> bool:
    """Whether a beam's reading, m, of a row is new, which the table of ``repeats`` (b, 13) notes.

    The robot has ``moved``, m, since the row before. A beam that is not due has no new reading.
    """
    known = repeats[beam]
    known[MOVED] += moved
    if not is_due:
        return False
    known[UNUSED] += 1.0
    if reading == known[PREVIOUS]:
        known[ROWS] += 1.0
        if known[UNUSED] < known[HOLD]:
            return False
        known[UNUSED] = 0.0
        return True
    before = known[BETWEEN]
    if before == _CHANGED and is_wall:
        _note_change(known, abs(reading - known[PREVIOUS]))
        if known[HOLD] == 0.0:
            find_hold(repeats, beam)
    changed = _FIRST if before == _NO_WALL else _CHANGED
    known[BETWEEN] = changed if is_wall else _NO_WALL
    known[PREVIOUS] = reading
    known[ROWS] = 1.0
    known[MOVED] = known[UNUSED] = 0.0
    return True


@lean_entry
def find_holds(repeats: FloatArray) -> None:
    """Set for how many rows an equal reading counts as repeated, by all rows in the table of
    ``repeats`` (b, 13).
    """
    repeats[:, HOLD] = 0.0
    for _ in range(2):  # a beam that certainly repeats its readings makes others likely to
        for beam in range(len(repeats)):
            find_hold(repeats, beam)


@lean_entry
def mark_repeats(
    readings: FloatArray,
    walls: BoolArray,
    due: BoolArray,
    moved: FloatArray,
    repeats: FloatArray,
    repeated: BoolArray,
) -> None:
    """Mark which readings (n, b), m, are ``repeated``, and note all rows in the table of
    ``repeats`` (b, 13).

    ``walls`` and ``due`` say which of them show a wall, and which beams measure in a row at all;
    the robot has ``moved`` (n,), m, in each row.
    """
    for row in range(len(readings)):
        for beam in range(readings.shape[1]):
            is_due = due[row, beam]
            is_fresh = is_new(
                repeats, beam, readings[row, beam], walls[row, beam], moved[row], is_due
            )
            repeated[row, beam] = is_due and not is_fresh
