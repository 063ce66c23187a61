"""The landmarks without their lines: compiled counterpart of ``consistent.wall_map``."""

import math

import numpy as np

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
from limslam_agent.slam.consistent.beam_model import GRAZING
from limslam_agent.slam.core.ekf import POSE
from limslam_env.geometry import BoolArray, FloatArray


@compiled
def add(walls: Walls, index: int) -> None:
    """Clear the arrays of a landmark that has just been added."""
    walls.table[index] = 0
    walls.counted[index] = 0
    walls.reached[index, LEAST] = np.inf
    walls.reached[index, MOST] = -np.inf


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
def grow(ekf: Filter, walls: Walls, index: int, points: FloatArray) -> None:
    """Count beams that ended on a landmark at points (n, 2), m, and that have corrected the filter."""
    for along in along_line(ekf, index, points):
        hit(walls, ekf.counts, index, along)
    walls.table[index, GROUPS] += 1
    walls.table[index, READINGS] += len(points)


@compiled
def merge(ekf: Filter, walls: Walls, older: int, younger: int, factor: float, shift: float) -> None:
    """Merge two landmarks into the older one, after the filter has merged their lines; ``absorb`` says the rest."""
    for column in (GROUPS, READINGS):
        walls.table[older, column] += walls.table[younger, column]
    absorb(walls, ekf.counts, older, younger, factor, shift)
    for place in range(younger, ekf.counts[LINES]):
        walls.table[place] = walls.table[place + 1]
        walls.counted[place] = walls.counted[place + 1]
        walls.reached[place] = walls.reached[place + 1]


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
