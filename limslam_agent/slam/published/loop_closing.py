"""Loop closing of the published method (step 7): detects two landmarks that are one wall.

After a loop, a wall that is observed again first becomes a new landmark, because the drift of the pose keeps it from
being associated with the old one. Later observations fit the new landmark best, and the old landmark second best if
the two are close enough. If the two landmarks agree, they are the same wall.
"""

import numpy as np

from limslam_agent.config.published import LoopClosingConfig
from limslam_agent.slam.published.association import alike, near_ends
from limslam_env.geometry import FloatArray


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

    Without the floor, the difference of two landmarks that were always seen together would be known more exactly than
    any wall is straight.
    """
    return float(difference @ np.linalg.solve(covariance + np.diag(floor**2), difference))


def offset(line: FloatArray, segment: FloatArray) -> float:
    """Distance, m, of the middle of a segment (4,) from a line (r, theta)."""
    middle = segment.reshape(2, 2).mean(axis=0)
    return abs(float(np.cos(line[1]) * middle[0] + np.sin(line[1]) * middle[1] - line[0]))
