"""Counts of beams that ended on landmarks, and of beams that passed through them, in
``tables.Walls``.

A landmark's extent consists of bins along its line. A bin where more beams passed than ended is not
drawn as wall. So a doorway that was drawn as wall by mistake is removed again, and so is a wall
that never existed.

All but the clearing along beams is rare and therefore plain; the batch compiles these functions.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.beams import Ray, line_about, meeting, passes
from limslam_agent.kernels.compilation import compiled, entry
from limslam_agent.kernels.tables import (
    ANGLE,
    BIN,
    CHANGES,
    CLOSURES,
    FARTHEST,
    FROM_X,
    FROM_Y,
    GROUPS,
    HITS,
    LEAST,
    LENGTH,
    LINES,
    LINES_FROM,
    LOW,
    MISSES,
    MOST,
    NEXT_NUMBER,
    NUMBER,
    OVERFLOWS,
    READINGS,
    THROUGH_SIGMAS,
    THROUGH_SLACK,
    TOO_NEAR,
    Filter,
    Walls,
)
from limslam_env.geometry import BoolArray, FloatArray


class Looks(NamedTuple):
    """What the beams of a robot read in a step.

    Attributes
    ----------
    ranges, measured
        Readings (b,), m, and which of them (b,) are new.
    beams
        ``RobotSpec.beam_table``.
    std, growth
        Standard deviation of a short range, m, and ``RangeSensor.growth``.
    """

    ranges: FloatArray
    measured: BoolArray
    beams: FloatArray
    std: float
    growth: float


_FARTHEST_BIN = 1 << 40  # a bin farther along a line comes from a place that has overflowed


def add_wall(walls: Walls, index: int) -> None:
    """Clear the arrays of a landmark that has just been added, and number it."""
    walls.table[index] = 0
    walls.table[index, NUMBER] = walls.tally[NEXT_NUMBER]
    walls.tally[NEXT_NUMBER] += 1
    walls.counted[index] = 0
    walls.reached[index, LEAST] = walls.ends[index, LEAST] = np.inf
    walls.reached[index, MOST] = walls.ends[index, MOST] = -np.inf


def reach(walls: Walls, index: int, place: int) -> int:
    """Extend a landmark's bins to hold one more, and return its index; -1 if there is no room."""
    wall = walls.table[index]
    counted = walls.counted[index]
    reached = walls.reached[index]
    if not -_FARTHEST_BIN < place < _FARTHEST_BIN:
        walls.tally[OVERFLOWS] += 1
        return -1
    length = wall[LENGTH]
    if not length:
        wall[LOW] = place
        length = 1
    before = max(0, wall[LOW] - place)
    most = counted.shape[1]
    length = max(length + before, place - wall[LOW] + 1)
    if length > most:
        walls.tally[OVERFLOWS] += 1
        return -1
    if before:
        wall[LOW] -= before
        for row in range(2):
            counted[row, before:length] = counted[row, : length - before].copy()
            counted[row, :before] = 0
            reached[row, before:length] = reached[row, : length - before].copy()
            reached[row, :before] = np.inf if row == LEAST else -np.inf
    wall[LENGTH] = length
    return int(place - wall[LOW])


def note_hit(walls: Walls, index: int, place: int, first: float, last: float) -> None:
    """Note that the hits in a bin lie between two positions, m along the line, and perhaps farther
    apart.
    """
    reached = walls.reached[index]
    ends = walls.ends[index]
    reached[LEAST, place] = min(reached[LEAST, place], first)
    reached[MOST, place] = max(reached[MOST, place], last)
    ends[LEAST], ends[MOST] = min(ends[LEAST], first), max(ends[MOST], last)


def count_hits(walls: Walls, index: int, along: FloatArray) -> None:
    """Count beams that ended on a landmark at positions (n,), m along the line, and that corrected
    the filter.
    """
    for position in along:
        place = reach(walls, index, math.floor(position / BIN))
        if place >= 0:
            walls.counted[index, HITS, place] += 1
            note_hit(walls, index, place, position, position)
    walls.table[index, GROUPS] += 1
    walls.table[index, READINGS] += len(along)
    walls.table[index, CHANGES] += 1


@compiled
def pass_at(walls: Walls, index: int, position: float) -> None:
    """Count a beam that passed at a position, m; only positions between the ends count."""
    if walls.ends[index, LEAST] < position < walls.ends[index, MOST]:
        # Bins that were taken over from another wall may lie up to half a bin outside the exact
        # ends.
        place = math.floor(position / BIN) - walls.table[index, LOW]
        walls.counted[index, MISSES, min(max(place, 0), walls.table[index, LENGTH] - 1)] += 1
        walls.table[index, CHANGES] += 1


def merge_walls(
    walls: Walls, older: int, younger: int, factor: float, shift: float, count: int
) -> None:
    """Merge two of ``count`` landmarks into the older one, and remove the younger one.

    A position s along the younger one is ``factor`` (1 or -1) times s plus ``shift``, m, along the
    older one.
    """
    for column in (GROUPS, READINGS):
        walls.table[older, column] += walls.table[younger, column]
    walls.table[older, CHANGES] += 1
    for other in range(walls.table[younger, LENGTH]):
        middle = factor * BIN * (walls.table[younger, LOW] + other + 0.5) + shift
        place = reach(walls, older, math.floor(middle / BIN))
        if place < 0:
            continue
        for row in range(2):
            walls.counted[older, row, place] += walls.counted[younger, row, other]
        if walls.counted[younger, HITS, other]:
            first = factor * walls.reached[younger, LEAST, other] + shift
            last = factor * walls.reached[younger, MOST, other] + shift
            note_hit(walls, older, place, min(first, last), max(first, last))
    for place in range(younger, count - 1):
        walls.table[place] = walls.table[place + 1]
        walls.counted[place] = walls.counted[place + 1]
        walls.reached[place] = walls.reached[place + 1]
        walls.ends[place] = walls.ends[place + 1]
    walls.tally[CLOSURES] += 1


@entry
def clear_along_beams(walls: Walls, ekf: Filter, at: int, looks: Looks) -> None:
    """Count the places of landmarks that a robot's new beams have passed through. Its pose begins
    in the filter's state at the index ``at``.
    """
    x = ekf.x
    anchors = ekf.anchors
    unsure = ekf.P[at, at] + ekf.P[at + 1, at + 1]
    turned = ekf.P[at + 2, at + 2]
    cos = math.cos(x[at + 2])
    sin = math.sin(x[at + 2])
    count = 0
    # Origin and direction of the beams that count, their free lengths, m, and margins, m.
    rays = np.empty((len(looks.ranges), 6))
    for beam in range(len(looks.ranges)):
        own = looks.beams[beam]
        if looks.measured[beam] and looks.ranges[beam] > own[TOO_NEAR]:
            far = min(looks.ranges[beam], own[FARTHEST])
            heading = x[at + 2] + own[ANGLE]
            rays[count, 0] = x[at] + cos * own[FROM_X] - sin * own[FROM_Y]
            rays[count, 1] = x[at + 1] + sin * own[FROM_X] + cos * own[FROM_Y]
            rays[count, 2] = math.cos(heading)
            rays[count, 3] = math.sin(heading)
            grown = looks.growth * far * far
            rays[count, 4] = far - THROUGH_SLACK
            rays[count, 5] = THROUGH_SIGMAS * math.sqrt(
                looks.std**2 + grown**2 + unsure + turned * far**2
            )
            count += 1
    for index in range(ekf.counts[LINES]):
        at_line = ekf.counts[LINES_FROM] + 2 * index
        line = line_about(x[at_line], x[at_line + 1], (anchors[index, 0], anchors[index, 1]))
        for number in range(count):
            ray = Ray(rays[number, 0], rays[number, 1], rays[number, 2], rays[number, 3])
            distance, along, cosine = meeting(ray, line)
            if passes(distance, cosine, rays[number, 4], rays[number, 5]):
                pass_at(walls, index, along)
