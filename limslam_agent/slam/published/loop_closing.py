"""Loop closing as published (step 7): two landmarks that turn out to be one wall.

Around a loop a wall that comes into view again is at first a new landmark: the robot has drifted, and the old
one does not fit. Later observations fit the young landmark best and, once the two have come close enough, the old
one second. If these two agree, they are the same wall.
"""

from collections.abc import Sequence

import numpy as np

from limslam_agent.config.published import LoopClosingConfig
from limslam_agent.slam.published.association import alike, near_ends
from limslam_env.geometry import FloatArray


def closing_pair(landmarks: Sequence[int]) -> tuple[int, int] | None:
    """Of the landmarks that an observation may be, nearest first, the first two as (older, younger); else None."""
    if len(landmarks) < 2:
        return None
    # Landmarks are numbered as they come.
    return min(landmarks[:2]), max(landmarks[:2])


def agree(
    older: int, younger: int, lines: FloatArray, segments: FloatArray, distance: float, config: LoopClosingConfig
) -> bool:
    """Whether two landmarks can be one wall.

    Parameters
    ----------
    older, younger
        The landmarks.
    lines, segments
        All landmarks: (N, 2), and with their end points (N, 4), m.
    distance
        Squared Mahalanobis distance between the two.
    config
        Thresholds.
    """
    if distance > config.gate:
        return False
    ends, other = segments[younger].reshape(2, 2), slice(older, older + 1)
    return bool(
        near_ends(ends, lines[other], segments[other], -config.min_overlap)[0]
        and alike(lines[younger], ends, lines[other], config.max_angle, config.max_distance)[0]
    )


def squared_distance(difference: FloatArray, covariance: FloatArray, floor: FloatArray) -> float:
    """Squared Mahalanobis distance of a difference (2,); ``floor`` (2,) are the least standard deviations, m and rad.

    Two landmarks that were seen together all the time have a difference that is known better than any wall is straight.
    """
    return float(difference @ np.linalg.solve(covariance + np.diag(floor**2), difference))


def offset(line: FloatArray, segment: FloatArray) -> float:
    """How far the middle of a segment (4,) lies from a line (r, theta), m."""
    middle = segment.reshape(2, 2).mean(axis=0)
    return abs(float(np.cos(line[1]) * middle[0] + np.sin(line[1]) * middle[1] - line[0]))
