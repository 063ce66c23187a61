"""From where to where walls go: `wall_extent` and `wall_map` once more, for kernels, in a fixed number of bins."""

import math

import numpy as np

from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.batch.state import (
    ANGLE,
    FARTHEST,
    FROM_X,
    FROM_Y,
    GROUPS,
    HITS,
    LEAST,
    LENGTH,
    LINES,
    LOW,
    MISSES,
    MOST,
    NO_PLACE,
    POSE,
    READINGS,
    TOO_NEAR,
    Filter,
    Settings,
    Walls,
)
from limslam_agent.slam.batch.update import GRAZING
from limslam_env.geometry import BoolArray, FloatArray, IntArray

BIN = 0.05


@compiled
def forget_wall(walls: Walls, index: int) -> None:
    """Nothing is known of this wall."""
    walls.table[index] = 0
    walls.counted[index] = 0
    walls.reached[index, LEAST] = np.inf
    walls.reached[index, MOST] = -np.inf


@compiled
def ends_of(walls: Walls, index: int) -> tuple[float, float]:
    """The outermost hits, m along the line."""
    length = walls.table[index, LENGTH]
    if not length:
        return np.inf, -np.inf
    return walls.reached[index, LEAST, :length].min(), walls.reached[index, MOST, :length].max()


@compiled
def along_all(mind: Filter, index: int, points: FloatArray) -> FloatArray:
    """Where points (n, 2) fall along a line (n,), m from its anchor."""
    theta, along = mind.x[POSE + 2 * index + 1], np.empty(len(points))
    cos, sin, x, y = math.cos(theta), math.sin(theta), mind.anchors[index, 0], mind.anchors[index, 1]
    for i in range(len(points)):
        along[i] = (points[i, 0] - x) * -sin + (points[i, 1] - y) * cos
    return along


@compiled
def along_of(mind: Filter, index: int, x: float, y: float) -> float:
    """Where a point falls along a line, m from its anchor."""
    theta = mind.x[POSE + 2 * index + 1]
    return (x - mind.anchors[index, 0]) * -math.sin(theta) + (y - mind.anchors[index, 1]) * math.cos(theta)


@compiled
def reach(walls: Walls, counts: IntArray, index: int, place: int) -> int:
    """Make room for a bin, and say which it is; -1 if there is no room."""
    wall, counted, reached = walls.table[index], walls.counted[index], walls.reached[index]
    length = wall[LENGTH]
    if not length:
        wall[LOW], length = place, 1
    before, most = max(0, wall[LOW] - place), counted.shape[1]
    length = max(length + before, place - wall[LOW] + 1)
    if length > most:
        counts[NO_PLACE] += 1
        return -1
    if before:
        wall[LOW] -= before
        for row in range(2):
            counted[row, before:length] = counted[row, : length - before].copy()
            counted[row, :before] = 0
            reached[row, before:length] = reached[row, : length - before].copy()
            reached[row, :before] = np.inf if row == LEAST else -np.inf
    wall[LENGTH] = length
    return place - wall[LOW]


@compiled
def hit(walls: Walls, counts: IntArray, index: int, along: float) -> None:
    """A beam ended at this place, m along the line."""
    place = reach(walls, counts, index, math.floor(along / BIN))
    if place >= 0:
        walls.counted[index, HITS, place] += 1
        walls.reached[index, LEAST, place] = min(walls.reached[index, LEAST, place], along)
        walls.reached[index, MOST, place] = max(walls.reached[index, MOST, place], along)


@compiled
def absorb(walls: Walls, counts: IntArray, older: int, younger: int, factor: float, shift: float) -> None:
    """Take over another wall's counts: its place s is ``factor`` (1 or -1) times s plus ``shift`` (m) here."""
    for row in (GROUPS, READINGS):
        walls.table[older, row] += walls.table[younger, row]
    for other in range(walls.table[younger, LENGTH]):
        middle = factor * BIN * (walls.table[younger, LOW] + other + 0.5) + shift
        place = reach(walls, counts, older, math.floor(middle / BIN))
        if place < 0:
            continue
        for row in range(2):
            walls.counted[older, row, place] += walls.counted[younger, row, other]
        if walls.counted[younger, HITS, other]:
            first = factor * walls.reached[younger, LEAST, other] + shift
            last = factor * walls.reached[younger, MOST, other] + shift
            walls.reached[older, LEAST, place] = min(walls.reached[older, LEAST, place], first, last)
            walls.reached[older, MOST, place] = max(walls.reached[older, MOST, place], first, last)


@compiled
def remove_wall(walls: Walls, index: int, number: int) -> None:
    """Close the gap that one of a number of walls leaves."""
    for place in range(index, number - 1):
        walls.table[place] = walls.table[place + 1]
        walls.counted[place] = walls.counted[place + 1]
        walls.reached[place] = walls.reached[place + 1]


@compiled
def see_through(
    mind: Filter, walls: Walls, ranges: FloatArray, measured: BoolArray, settings: Settings, beams: FloatArray
) -> None:
    """Take back what beams have gone through: `consistent._see_through`."""
    state, anchors, number = mind.x, mind.anchors, mind.counts[LINES]
    x, y, heading, (cos, sin) = state[0], state[1], state[2], (math.cos(state[2]), math.sin(state[2]))
    shift, turn = mind.top[0, 0] + mind.top[1, 1], mind.top[2, 2]
    rays = np.empty((len(ranges), 6))
    for beam in range(len(ranges)):
        far = min(ranges[beam], beams[beam, FARTHEST])
        rays[beam, 0] = x + cos * beams[beam, FROM_X] - sin * beams[beam, FROM_Y]
        rays[beam, 1] = y + sin * beams[beam, FROM_X] + cos * beams[beam, FROM_Y]
        rays[beam, 2], rays[beam, 3] = math.cos(heading + beams[beam, ANGLE]), math.sin(heading + beams[beam, ANGLE])
        rays[beam, 4] = far if measured[beam] and ranges[beam] > beams[beam, TOO_NEAR] else 0.0
        rays[beam, 5] = settings.through_sigmas * math.sqrt(settings.std**2 + shift + turn * far**2)
    for index in range(number):
        d, theta = state[POSE + 2 * index], state[POSE + 2 * index + 1]
        nx, ny, anchor_x, anchor_y = math.cos(theta), math.sin(theta), anchors[index, 0], anchors[index, 1]
        for beam in range(len(ranges)):
            from_x, from_y, ux, uy = rays[beam, 0], rays[beam, 1], rays[beam, 2], rays[beam, 3]
            cosine = ux * nx + uy * ny
            if abs(cosine) <= GRAZING:
                continue
            ahead = (d + (anchor_x - from_x) * nx + (anchor_y - from_y) * ny) / cosine
            if ahead > 0.0 and ahead + rays[beam, 5] / abs(cosine) + settings.through_slack < rays[beam, 4]:
                to_x, to_y = from_x + ahead * ux - anchor_x, from_y + ahead * uy - anchor_y
                pass_at(walls, index, to_x * -ny + to_y * nx)


@compiled
def pass_at(walls: Walls, index: int, along: float) -> None:
    """A beam went through at a place, m; between the wall's ends that says something."""
    low, high = ends_of(walls, index)
    if low < along < high:
        place = math.floor(along / BIN) - walls.table[index, LOW]
        walls.counted[index, MISSES, min(max(place, 0), walls.table[index, LENGTH] - 1)] += 1
