"""Explains why a wall segment was or was not taken for a landmark. Only diagnostics use this."""

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from limslam_agent.slam.consistent.beam_model import Readings
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.limits import MAX_ANGLE, MAX_END_GAP, MAX_OFFSET
from limslam_agent.slam.consistent.segmentation import WallSegment
from limslam_agent.slam.consistent.wall_map import WallMap
from limslam_agent.slam.core.diagnostics import CandidateTest, Comparison
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import angle_between, direction, normal


def comparison(
    robot: int,
    step: int,
    readings: Readings,
    segment: WallSegment,
    distances: Mapping[int, float],
    other_side: Collection[int],
    belief: CloneEKF,
    walls: WallMap,
    gate: float,
) -> Comparison:
    """A wall segment and all landmarks, with the test that threw each of them out.

    Parameters
    ----------
    robot, step, readings, segment
        The segment, and where its readings are from.
    distances
        Squared Mahalanobis distances of the landmarks that it was compared with, by their indices.
    other_side
        Indices of the landmarks that were only seen from the other side, and are no boards.
    belief, walls
        The lines of the landmarks, and their extents.
    gate
        Largest squared Mahalanobis distance at which the segment is taken for a landmark.
    """
    tests = [
        _tested(index, distances.get(index, math.nan), segment, belief, walls, gate) for index in range(len(walls))
    ]
    for index in other_side:
        tests[index] = replace(tests[index], excluded="side")
    return Comparison(robot, step, _ends(segment), readings.sources, tuple(tests))


def _tested(
    index: int,
    squared: float,
    segment: WallSegment,
    belief: CloneEKF,
    walls: WallMap,
    gate: float,
) -> CandidateTest:
    line = belief.anchored[index]
    angle = abs(angle_between(float(line[1]) - segment.theta))
    offset = abs(float((segment.middle - belief.anchors[index]) @ normal(line) - line[0]))
    along, (low, high) = walls.along(index, segment.points), walls[index].extent.ends
    gap = max(float(along.min()) - high, low - float(along.max()))
    tests = {
        "direction": angle > MAX_ANGLE, "offset": offset > MAX_OFFSET, "ends": gap > MAX_END_GAP, "beams": True,
    }  # fmt: skip
    # A short segment may turn farther than the limit, because its direction is uncertain.
    was_compared = not math.isnan(squared)
    excluded = "gate" * (squared > gate) if was_compared else next(name for name in tests if tests[name])
    return CandidateTest(walls[index].number, excluded, angle, offset, gap, squared)


def _ends(segment: WallSegment) -> FloatArray:
    """End points (2, 2), m, of a wall segment in the world."""
    tangent = direction(np.array([0.0, segment.theta]))
    along = (segment.points - segment.middle) @ tangent
    return np.asarray(segment.middle + np.array([along.min(), along.max()])[:, None] * tangent)
