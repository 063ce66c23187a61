"""Counts of beams that ended on landmarks, and of beams that passed through them, in
``tables.Walls``.

A landmark's extent consists of bins along its line. A bin where more beams passed than ended is not
drawn as wall. So a doorway that was drawn as wall by mistake is removed again, and so is a wall
that never existed.

All but the clearing along beams is rare and therefore plain; the batch compiles these functions.
"""

import math

import numpy as np

from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.tables import (
    ANGLE,
    BIN,
    CHANGES,
    CLOSURES,
    FARTHEST,
    FROM_X,
    FROM_Y,
    GRAZING,
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
    POSE,
    READINGS,
    THROUGH_SIGMAS,
    THROUGH_SLACK,
    TOO_NEAR,
    Walls,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray

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


@lean_entry
def clear_along_beams(
    walls: Walls,
    x: FloatArray,
    covariance: FloatArray,
    counts: IntArray,
    anchors: FloatArray,
    at: int,
    ranges: FloatArray,
    measured: BoolArray,
    beams: FloatArray,
    noise: tuple[float, float],
    rays: FloatArray,
) -> None:
    """Count the places of landmarks that a robot's new beams have passed through.

    The lines and the robot's pose, which begins at the index ``at``, are those of a ``Filter``.
    ``beams`` is ``RobotSpec.beam_table``, and ``noise`` the standard deviation of a short range, m,
    and the growth of ``RangeSensor``. ``rays`` (b, 6) is scratch: origin, direction, length, m, and
    margin, m, of the beams that count.
    """
    pose = x[at : at + POSE]
    unsure = covariance[at, at] + covariance[at + 1, at + 1]
    turned = covariance[at + 2, at + 2]
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    count = 0
    for beam in range(len(ranges)):
        if measured[beam] and ranges[beam] > beams[beam, TOO_NEAR]:
            far = min(ranges[beam], beams[beam, FARTHEST])
            heading = pose[2] + beams[beam, ANGLE]
            rays[count, 0] = pose[0] + cos * beams[beam, FROM_X] - sin * beams[beam, FROM_Y]
            rays[count, 1] = pose[1] + sin * beams[beam, FROM_X] + cos * beams[beam, FROM_Y]
            rays[count, 2], rays[count, 3], grown = (
                math.cos(heading),
                math.sin(heading),
                noise[1] * far * far,
            )
            margin = THROUGH_SIGMAS * math.sqrt(noise[0] ** 2 + grown**2 + unsure + turned * far**2)
            rays[count, 4] = far - THROUGH_SLACK
            rays[count, 5] = margin
            count = count + 1
    for index in range(counts[LINES]):
        line = counts[LINES_FROM] + 2 * index
        low = walls.ends[index, LEAST]
        high = walls.ends[index, MOST]
        nx = math.cos(x[line + 1])
        ny = math.sin(x[line + 1])
        for ray in range(count):
            ux = rays[ray, 2]
            uy = rays[ray, 3]
            cosine = ux * nx + uy * ny
            if abs(cosine) <= GRAZING:
                continue
            off_x = rays[ray, 0] - anchors[index, 0]
            off_y = rays[ray, 1] - anchors[index, 1]
            ahead = (x[line] - off_x * nx - off_y * ny) / cosine
            if ahead > 0.0 and ahead + rays[ray, 5] / abs(cosine) < rays[ray, 4]:
                position = (off_y + ahead * uy) * nx - (off_x + ahead * ux) * ny
                if low < position < high:
                    pass_at(walls, index, position)
