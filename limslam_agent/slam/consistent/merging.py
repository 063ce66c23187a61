"""Landmarks that are one wall: when two of them are merged, and the geometry that the decisions of
a step share.

These functions are plain, as those of ``step`` are.
"""

import math
from typing import TYPE_CHECKING

from limslam_agent.kernels.extents import merge_walls
from limslam_agent.kernels.tables import LEAST, MOST, NUMBER, Filter
from limslam_agent.slam.consistent import limits
from limslam_agent.slam.consistent.clone_filter import (
    anchor_of,
    difference,
    line_of,
    lines_near,
    merge,
    num_lines,
)
from limslam_agent.slam.consistent.pending_readings import Belief
from limslam_agent.slam.consistent.step_settings import StepSettings
from limslam_env.geometry import FloatArray

if TYPE_CHECKING:
    from limslam_agent.slam.consistent.reports import StepReports


def close_loops_of(
    belief: Belief, index: int, settings: StepSettings, listener: "StepReports | None"
) -> None:
    """Merge a landmark that has just changed with all landmarks that are the same wall."""
    ekf = belief.ekf
    found = settings.closes_loops
    while found:
        found = False
        x, y = anchor_of(ekf, index)
        for other in lines_near(ekf, line_of(ekf, index)[1], x, y, 2.0 * limits.MAX_OFFSET):
            older = min(index, other)
            younger = max(index, other)
            if other != index and are_one_wall(belief, older, younger):
                merge_landmarks(belief, older, younger, listener)
                # The younger landmark is removed. If that is this one, there is nothing left to
                # compare.
                if younger == index:
                    return
                found = True
                break


def are_one_wall(belief: Belief, older: int, younger: int) -> bool:
    """Whether two landmarks are one wall."""
    overlap, offset = separation(belief, older, younger)
    if overlap < limits.MIN_OVERLAP or offset > limits.MAX_OFFSET:
        return False
    off, covariance = difference(belief.ekf, older, younger)
    is_turned = abs(off[1]) > limits.MAX_ANGLE
    return not is_turned and squared_difference(off, covariance) <= limits.ONE_WALL_GATE


def merge_landmarks(
    belief: Belief, older: int, younger: int, listener: "StepReports | None"
) -> None:
    """Merge two landmarks, and remove the younger one."""
    ekf = belief.ekf
    walls = belief.walls
    theta = line_of(ekf, younger)[1]
    x, y = anchor_of(ekf, younger)
    count = num_lines(ekf)
    if listener is not None:
        off, covariance = difference(ekf, older, younger)
        squared = squared_difference(off, covariance)
        offset = separation(belief, older, younger)[1]
        listener.merged(walls.table[older, NUMBER], walls.table[younger, NUMBER], squared, offset)
    merge(ekf, older, younger, listener)
    factor = 1.0 if math.cos(theta - line_of(ekf, older)[1]) > 0.0 else -1.0
    merge_walls(walls, older, younger, factor, along_point(ekf, older, x, y), count)


def separation(belief: Belief, older: int, younger: int) -> tuple[float, float]:
    """Length, m, that two landmarks share along the older one, and the distance, m, of the
    younger's middle from it.
    """
    ekf = belief.ekf
    d, theta = line_of(ekf, younger)
    x, y = anchor_of(ekf, younger)
    cos = math.cos(theta)
    sin = math.sin(theta)
    x = x + d * cos
    y = y + d * sin
    ends = belief.walls.ends[older]
    low = belief.walls.ends[younger, LEAST]
    high = belief.walls.ends[younger, MOST]
    one = along_point(ekf, older, x - low * sin, y + low * cos)
    two = along_point(ekf, older, x - high * sin, y + high * cos)
    overlap = min(max(one, two), ends[MOST]) - max(min(one, two), ends[LEAST])
    middle = 0.5 * (low + high)
    d, theta = line_of(ekf, older)
    anchor_x, anchor_y = anchor_of(ekf, older)
    across_x = x - middle * sin - anchor_x
    across_y = y + middle * cos - anchor_y
    return overlap, abs(across_x * math.cos(theta) + across_y * math.sin(theta) - d)


def squared_difference(off: FloatArray, covariance: FloatArray) -> float:
    """Squared Mahalanobis distance of two landmarks by their difference (2,), m and rad, with its
    covariance (2, 2).
    """
    a = covariance[0, 0] + limits.STRAIGHTNESS[0]
    b = covariance[0, 1]
    c = covariance[1, 1] + limits.STRAIGHTNESS[1]
    return float((c * off[0] ** 2 - 2.0 * b * off[0] * off[1] + a * off[1] ** 2) / (a * c - b * b))


def along_line(ekf: Filter, index: int, points: FloatArray) -> FloatArray:
    """Positions (n,) of points (n, 2) along a landmark, m from its anchor."""
    (x, y), theta = anchor_of(ekf, index), line_of(ekf, index)[1]
    return (points[:, 1] - y) * math.cos(theta) - (points[:, 0] - x) * math.sin(theta)


def along_point(ekf: Filter, index: int, x: float, y: float) -> float:
    """Position of one point along a landmark, m from its anchor."""
    (from_x, from_y), theta = anchor_of(ekf, index), line_of(ekf, index)[1]
    return (y - from_y) * math.cos(theta) - (x - from_x) * math.sin(theta)
