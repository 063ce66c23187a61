"""The landmarks without their lines: compiled counterpart of ``consistent.wall_map``."""

import math

import numpy as np

from limslam_agent.kernels.tables import GRAZING
from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.batch.state import (
    ANGLE,
    FARTHEST,
    FROM_X,
    FROM_Y,
    GROUPS,
    LEAST,
    LINES,
    MOST,
    READINGS,
    TOO_NEAR,
    Filter,
    Settings,
    Walls,
)
from limslam_agent.slam.batch.wall_extent import absorb, hit, pass_at
from limslam_agent.slam.consistent.limits import THROUGH_SIGMAS, THROUGH_SLACK
from limslam_agent.slam.core.ekf import POSE
from limslam_env.geometry import BoolArray, FloatArray


@compiled
def add(walls: Walls, index: int) -> None:
    """Clear the arrays of a landmark that has just been added."""
    walls.table[index] = 0
    walls.counted[index] = 0
    walls.reached[index, LEAST] = np.inf
    walls.reached[index, MOST] = -np.inf
    walls.seen[index, :, 0], walls.seen[index, :, 1], walls.behind[index] = np.inf, -np.inf, 0.0


@compiled
def along_line(ekf: Filter, index: int, points: FloatArray) -> FloatArray:
    """Positions (n,) of points (n, 2) along a landmark, m from its anchor."""
    theta, along = ekf.x[POSE + 2 * index + 1], np.empty(len(points))
    cos, sin, x, y = math.cos(theta), math.sin(theta), ekf.anchors[index, 0], ekf.anchors[index, 1]
    for i in range(len(points)):
        along[i] = (points[i, 0] - x) * -sin + (points[i, 1] - y) * cos
    return along


@compiled
def along_point(ekf: Filter, index: int, x: float, y: float) -> float:
    """Position of one point along a landmark, m from its anchor."""
    theta = ekf.x[POSE + 2 * index + 1]
    return (x - ekf.anchors[index, 0]) * -math.sin(theta) + (y - ekf.anchors[index, 1]) * math.cos(theta)


@compiled
def grow(ekf: Filter, walls: Walls, index: int, points: FloatArray, side: int) -> None:
    """Count beams that ended on a landmark at points (n, 2), m, from a side, and that have corrected the filter."""
    seen = walls.seen[index, side]
    for along in along_line(ekf, index, points):
        hit(walls, ekf.counts, index, along)
        seen[0], seen[1] = min(seen[0], along), max(seen[1], along)
    walls.table[index, GROUPS] += 1
    walls.table[index, READINGS] += len(points)


@compiled
def merge(ekf: Filter, walls: Walls, older: int, younger: int, factor: float, shift: float) -> None:
    """Merge two landmarks into the older one, after the filter has merged their lines; ``absorb`` says the rest."""
    for column in (GROUPS, READINGS):
        walls.table[older, column] += walls.table[younger, column]
    absorb(walls, ekf.counts, older, younger, factor, shift)
    own, other = walls.seen[older], moved_along(walls.seen[younger], factor, shift)
    for side in range(2):
        own[side, 0], own[side, 1] = min(own[side, 0], other[side, 0]), max(own[side, 1], other[side, 1])
    walls.behind[older] = max(walls.behind[older], walls.behind[younger])
    for place in range(younger, ekf.counts[LINES]):
        walls.table[place] = walls.table[place + 1]
        walls.counted[place] = walls.counted[place + 1]
        walls.reached[place] = walls.reached[place + 1]
        walls.seen[place] = walls.seen[place + 1]
        walls.behind[place] = walls.behind[place + 1]


@compiled
def moved_along(seen: FloatArray, factor: float, shift: float) -> FloatArray:
    """The outermost hits from each side (2, 2), m, of a line whose position s is ``factor`` (1 or -1) s + ``shift``."""
    moved = np.empty((2, 2))
    for side in range(2):
        if factor > 0.0:
            moved[side, 0], moved[side, 1] = seen[side, 0] + shift, seen[side, 1] + shift
        else:
            moved[1 - side, 0], moved[1 - side, 1] = shift - seen[side, 1], shift - seen[side, 0]
    return moved


@compiled
def shared(first: FloatArray, second: FloatArray) -> float:
    """Length of the stretch between the outermost hits (2,) of two lines, m; below 0 if there is none."""
    return min(first[1], second[1]) - max(first[0], second[0])


@compiled
def kinds(ekf: Filter, walls: Walls) -> tuple[float, float]:
    """Length of the landmarks that are boards, and of the walls that have two faces, m."""
    boards, behind = 0.0, 0.0
    for index in range(ekf.counts[LINES]):
        boards += max(shared(walls.seen[index, 0], walls.seen[index, 1]), 0.0)
        behind += walls.behind[index]
    return boards, 0.5 * behind


@compiled
def clear_along_beams(
    ekf: Filter, walls: Walls, ranges: FloatArray, measured: BoolArray, settings: Settings, beams: FloatArray
) -> None:
    """Count the places of landmarks that new beams with ranges (b,), m, have passed through."""
    state, anchors, number = ekf.x, ekf.anchors, ekf.counts[LINES]
    x, y, heading, (cos, sin) = state[0], state[1], state[2], (math.cos(state[2]), math.sin(state[2]))
    shift, turn = ekf.top[0, 0] + ekf.top[1, 1], ekf.top[2, 2]
    rays = np.empty((len(ranges), 6))
    for beam in range(len(ranges)):
        far = min(ranges[beam], beams[beam, FARTHEST])
        rays[beam, 0] = x + cos * beams[beam, FROM_X] - sin * beams[beam, FROM_Y]
        rays[beam, 1] = y + sin * beams[beam, FROM_X] + cos * beams[beam, FROM_Y]
        rays[beam, 2], rays[beam, 3] = math.cos(heading + beams[beam, ANGLE]), math.sin(heading + beams[beam, ANGLE])
        rays[beam, 4] = far if measured[beam] and ranges[beam] > beams[beam, TOO_NEAR] else 0.0
        rays[beam, 5] = THROUGH_SIGMAS * math.sqrt(settings.std**2 + shift + turn * far**2)
    for index in range(number):
        d, theta = state[POSE + 2 * index], state[POSE + 2 * index + 1]
        nx, ny, anchor_x, anchor_y = math.cos(theta), math.sin(theta), anchors[index, 0], anchors[index, 1]
        for beam in range(len(ranges)):
            from_x, from_y, ux, uy = rays[beam, 0], rays[beam, 1], rays[beam, 2], rays[beam, 3]
            cosine = ux * nx + uy * ny
            if abs(cosine) <= GRAZING:
                continue
            ahead = (d + (anchor_x - from_x) * nx + (anchor_y - from_y) * ny) / cosine
            if ahead > 0.0 and ahead + rays[beam, 5] / abs(cosine) + THROUGH_SLACK < rays[beam, 4]:
                to_x, to_y = from_x + ahead * ux - anchor_x, from_y + ahead * uy - anchor_y
                pass_at(walls, index, to_x * -ny + to_y * nx)
