"""What the ranges of one step mean, how likely it is that readings changed as they did, and how
many missed a wall.

``limslam_agent.readings``, ``limslam_agent.status.sudden_changes`` and ``limslam_agent.dropouts``
explain them.
"""

import math

from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.repeats import is_new
from limslam_agent.kernels.tables import (
    FARTHEST,
    LEAST_TURNED,
    MOST_TURNED,
    NOTHING,
    READING,
    TIMES,
    TOO_FAR,
    TOO_NEAR,
    TURN,
    TURNED,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_SAME_WALL = 0.1
"""Two readings of a beam whose difference is smaller than this, m, ended at one wall."""

_WELL_WITHIN = 0.9
"""Share of a beam's longest range up to which a wall is not near the end of the range."""


_LONGEST_TURN = 0.4  # rad, between two readings of a beam
_LEAST_STD = 0.01  # m
# How much a reading changes with the distance driven, and with the angle turned times the range:
# standard deviations of two kinds of walls, those that face the beam and those at a grazing angle,
# and the shares of both.
_DRIVE = (1.0, 2.0)
_SPIN = (0.7, 2.0)
_SHARES = (0.75, 0.25)
# A beam that turns along a straight wall goes on as its last two readings say: from this angle on,
# rad, and with this standard deviation, m and m for each metre and radian.
_SWEEPS = 0.05
_BENT = (0.03, 0.2)
_ON_LINE = 0.6
# A beam meets an edge with this likelihood in a step, and with so much more for each radian of the
# turn.
_EDGES = 0.01
_EDGES_PER_TURN = 0.4
_FASTEST = 0.2
_APPEARS = 0.04  # likelihood that a wall comes into reach in a step
_LIMITS = -1.5, 4.5  # of a single reading


@lean_entry
def sort_readings(
    values: FloatArray,
    limits: FloatArray,
    moved: float,
    repeats: FloatArray,
    readings: FloatArray,
    measured: BoolArray,
    hits: BoolArray,
) -> int:
    """Turn what a sensor reports into readings; the number of values that are no readings.

    The ``values``, m, become ``readings`` (b,) as ``limslam_agent.readings.as_readings`` does it.
    The ``limits`` (4, b), m, are the shortest and the longest reading of each beam, and those up to
    which something is near and from which on nothing is seen. ``measured`` (b,) holds the beams
    that take a new measurement in this step, of which those without a reading are removed, and
    those that repeat one, as the table of ``repeats`` (b, 13) says, in which the step is noted; the
    robot has ``moved``, m, in it. ``hits`` is set to those that show a wall.
    """
    refused = 0
    for beam in range(len(values)):
        value = values[beam]
        is_reading = value >= 0.0
        reading = min(max(value, limits[0, beam]), limits[1, beam]) if is_reading else math.nan
        readings[beam] = reading
        refused += not is_reading
        is_wall = limits[2, beam] < reading < limits[3, beam]
        is_due = measured[beam]
        measured[beam] = is_new(repeats, beam, reading, is_wall, moved, is_due) and is_reading
        hits[beam] = measured[beam] and is_wall
    return refused


@lean_entry
def compare_with_before(
    ranges: FloatArray, too_far: FloatArray, limit: float, turn: float, steady: FloatArray
) -> None:
    """Note in the table ``steady`` (6, b) which of the ranges (b,), m, are those from before,
    within a ``limit``, m. The robot has turned by ``turn``, rad.

    A beam without a reading says nothing. What the robot turns meanwhile counts up to a limit: a
    beam may see the same distance again where it looks after the turn.
    """
    for beam in range(len(ranges)):
        steady[TURN, beam] += turn
        reading = ranges[beam]
        before = steady[READING, beam]
        if math.isnan(reading):
            continue
        turned = min(max(steady[TURN, beam], -_LONGEST_TURN), _LONGEST_TURN)
        steady[TURNED, beam] += turned
        steady[TURN, beam] = 0.0
        sees_alike = (reading >= too_far[beam]) == (before >= too_far[beam])
        if sees_alike and abs(reading - before) < limit:
            steady[TIMES, beam] += 1.0
            steady[LEAST_TURNED, beam] = min(steady[LEAST_TURNED, beam], steady[TURNED, beam])
            steady[MOST_TURNED, beam] = max(steady[MOST_TURNED, beam], steady[TURNED, beam])
            continue
        steady[READING, beam] = reading
        steady[TIMES, beam] = 0.0
        steady[LEAST_TURNED, beam] = steady[MOST_TURNED, beam] = steady[TURNED, beam]


@compiled
def normal_density(off: float, std: float) -> float:
    """Density of a normal distribution."""
    return math.exp(-0.5 * (off / std) ** 2) / (std * math.sqrt(2.0 * math.pi))


@compiled
def reading_evidence(
    ranges: tuple[float, float, float],
    nothing: tuple[bool, bool, bool],
    motion: tuple[float, float, float],
    reach: float,
    std: float,
    growth: float,
) -> float:
    """The evidence of a reading that the robot was carried away before its step.

    ``ranges`` are the reading, the one before, and the one before that, m; ``nothing`` says whether
    the beam saw nothing. ``motion`` is the distance and the turn before the reading, and the turn
    before the reading before, without signs.
    """
    (now, before, earlier), (travel, turn, turn_before) = ranges, motion
    if nothing[0] and nothing[1]:
        return math.log(NOTHING)
    shorter = min(now, before)
    variance = std**2 + (growth * shorter**2) ** 2
    edges = _EDGES + _EDGES_PER_TURN * min(turn, _FASTEST)
    here = 0.0
    for kind in range(len(_SHARES)):
        spread = math.sqrt(
            2.0 * variance
            + _LEAST_STD**2
            + (_DRIVE[kind] * travel) ** 2
            + (_SPIN[kind] * turn * shorter) ** 2
        )
        if nothing[0]:  # the wall is out of reach now
            here += _SHARES[kind] * 0.5 * math.erfc((reach - before) / (spread * math.sqrt(2.0)))
        else:
            here += _SHARES[kind] * normal_density((reach if nothing[1] else before) - now, spread)
    if nothing[0]:
        return math.log(NOTHING / ((1.0 - edges) * here + NOTHING * edges))
    if nothing[1]:
        here *= 2.0 * _APPEARS * (1.0 + 3.0 * (turn > 0.5 * _FASTEST))
        return math.log((1.0 - NOTHING) / reach / (here + edges / reach))
    if min(turn, turn_before) > _SWEEPS and not nothing[2] and not math.isnan(earlier):
        bend = math.sqrt(6.0 * variance + _BENT[0] ** 2 + (_BENT[1] * turn * shorter) ** 2)
        here = max(here, _ON_LINE * normal_density(now - 2.0 * before + earlier, bend))
    return math.log((1.0 - NOTHING) / reach / ((1.0 - edges) * here + edges / reach))


@lean_entry
def weigh_changes(
    ranges: FloatArray,
    usable: BoolArray,
    motions: FloatArray,
    beams: FloatArray,
    std: float,
    growth: float,
    evidence: FloatArray,
) -> None:
    """Find the evidence of each reading that the robot was carried away before its step.

    Given are readings of m + 2 steps, a mask of those that count, both (m + 2, b), and length and
    angle of the motion before each of the steps (m + 2, 2), m and rad, without signs. ``beams`` is
    ``RobotSpec.beam_table``. Set is the evidence (m, b) for the steps but the first two; 0 where a
    reading does not count.
    """
    for row in range(evidence.shape[0]):
        for beam in range(evidence.shape[1]):
            evidence[row, beam] = 0.0
            if not (usable[row + 2, beam] and usable[row + 1, beam]):
                continue
            reach = beams[beam, FARTHEST]
            far = beams[beam, TOO_FAR]
            now = ranges[row + 2, beam]
            before = ranges[row + 1, beam]
            earlier = ranges[row, beam]
            found = reading_evidence(
                (min(now, reach), min(before, reach), min(earlier, reach)),
                (now >= far, before >= far, earlier >= far),
                (motions[row + 2, 0], motions[row + 2, 1], motions[row + 1, 1]),
                reach,
                std,
                growth,
            )
            if found < _LIMITS[0] or found > _LIMITS[1]:
                found = _LIMITS[0] if found < _LIMITS[0] else _LIMITS[1]
            evidence[row, beam] = found


@lean_entry
def count_misses(
    ranges: FloatArray,
    measured: BoolArray,
    beams: FloatArray,
    last: FloatArray,
    in_a_row: IntArray,
    counts: IntArray,
) -> None:
    """Count readings that saw nothing, and among them those between two readings of the same wall.

    Changed are the ``last`` two new readings of each beam (2, b), m, NaN where there is none, how
    many new readings of each beam ``in_a_row`` (b,) saw nothing, and ``counts`` (2,): readings
    between two of the same wall, and those among them that saw nothing.
    """
    for beam in range(len(ranges)):
        if not measured[beam]:
            continue
        before = last[0, beam]
        between = last[1, beam]
        reading = ranges[beam]
        near = beams[beam, TOO_NEAR]
        far = beams[beam, TOO_FAR]
        limit = _WELL_WITHIN * beams[beam, FARTHEST]
        if near < before < limit and near < reading < limit and abs(before - reading) < _SAME_WALL:
            counts[0] += 1
            counts[1] += between >= far
        in_a_row[beam] = in_a_row[beam] + 1 if reading >= far else 0
        last[0, beam] = between
        last[1, beam] = reading
