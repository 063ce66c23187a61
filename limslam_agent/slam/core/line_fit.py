"""Lines in points: the Hough transform finds them, and total least squares refines them, with their
covariance.
"""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.shared import HoughConfig
from limslam_agent.kernels.tables import LineRules
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import direction


@dataclass(frozen=True, eq=False)
class LineFit:
    """A fitted line.

    Attributes
    ----------
    line
        (r, theta), normalised, in the points' frame.
    covariance
        Of (r, theta), (2, 2).
    ends
        The outermost points, projected on the line, (2, 2), m.
    """

    line: FloatArray
    covariance: FloatArray
    ends: FloatArray

    @property
    def length(self) -> float:
        """Distance between the ends, m."""
        return float(np.hypot(*(self.ends[1] - self.ends[0])))


def fit_line(points: FloatArray, std: float) -> LineFit:
    """Fit a line to points (n, 2), n >= 2, m, each off it by noise of ``std`` (m).

    The direction is the principal axis of the points. Along that axis, s being the distance
    from the centroid, the offset has variance ``std^2 / n`` and the angle
    ``std^2 / sum(s^2)``, and the two are independent; (r, theta) follow to first order.
    """
    from limslam_agent.kernels import lines

    line = np.empty(2)
    ends = np.empty((2, 2))
    line[:] = lines.fit_line(points, np.arange(len(points)), ends)
    along = points @ direction(line)
    # Turning the line about the centroid moves the foot of the origin's perpendicular.
    lever = float(along.mean())
    of_angle = std**2 / max(float(((along - lever) ** 2).sum()), 1e-9)
    crossed = lever * of_angle
    return LineFit(
        line,
        np.array([[std**2 / len(points) + lever * crossed, crossed], [crossed, of_angle]]),
        ends,
    )


def bin_size(config: HoughConfig, std: float) -> float:
    """Size of a bin of r, m, for points with noise ``std``, m."""
    return max(config.r_step, 3.0 * std)


def max_distance(config: HoughConfig, std: float) -> float:
    """Largest distance of a point from its line, m, for points with noise ``std``, m."""
    return max(config.max_offset, 2.5 * std)


def extract_lines(
    points: FloatArray, config: HoughConfig, std: float
) -> list[tuple[LineFit, IntArray]]:
    """All lines in points (n, 2), m, whose ranges have noise ``std`` (m), best first, and the
    indices of the points on each of them.
    """
    from limslam_agent.kernels import lines

    rules = LineRules(
        float(config.max_gap),
        float(max_distance(config, std)),
        float(config.min_length),
        config.min_votes,
        float(bin_size(config, std)),
        float(config.theta_step),
        config.only_best,
    )
    owner, found, _ = lines.extract_lines(points, rules)
    parts = [np.flatnonzero(owner == line) for line in range(len(found))]
    return [(fit_line(points[part], std), part) for part in parts]
