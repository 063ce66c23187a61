"""Explains why a wall segment was or was not compared with a landmark. Only diagnostics use this."""

import numpy as np

from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.segmentation import WallSegment
from limslam_agent.slam.consistent.wall_map import WallMap
from limslam_agent.slam.core.diagnostics import CandidateTest
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import direction, normal


def segment_ends(segment: WallSegment) -> FloatArray:
    """End points (2, 2), m, of a wall segment in the world."""
    tangent = direction(np.array([0.0, segment.theta]))
    along = (segment.points - segment.middle) @ tangent
    return np.asarray(segment.middle + np.array([along.min(), along.max()])[:, None] * tangent)


def tested(
    belief: CloneEKF,
    walls: WallMap,
    segment: WallSegment,
    index: int,
    distance: float,
    limits: tuple[float, float, float, float],
) -> CandidateTest:
    """The tests of one landmark for a wall segment.

    Parameters
    ----------
    belief, walls
        The lines of the landmarks, and their extents.
    segment, index
        The segment, and the landmark.
    distance
        Squared Mahalanobis distance of the two; NaN if it was not computed.
    limits
        Largest difference of direction, rad, offset, m, gap along the wall, m, and distance.
    """
    line = belief.anchored[index]
    angle = abs((float(line[1]) - segment.theta + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
    offset = abs(float((segment.middle - belief.anchors[index]) @ normal(line) - line[0]))
    along, (low, high) = walls.along(index, segment.points), walls[index].extent.ends
    gap = max(float(along.min()) - high, low - float(along.max()))
    values = (angle, offset, gap, distance)
    failed = (name for name, value, most in zip(NAMES, values, limits, strict=True) if value > most)
    excluded = next(failed, "beams" if np.isnan(distance) else "")
    return CandidateTest(walls[index].number, excluded, angle, offset, gap, distance)


NAMES = ("direction", "offset", "ends", "gate")
"""The tests of a landmark in their order."""
