"""A line through points by total least squares, with its covariance."""

from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import FloatArray
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

    line, ends = np.empty(2), np.empty((2, 2))
    line[:] = lines.fit_line(points, np.arange(len(points)), ends)
    along = points @ direction(line)
    # Turning the line about the centroid moves the foot of the origin's perpendicular.
    lever = float(along.mean())
    of_angle = std**2 / max(float(((along - lever) ** 2).sum()), 1e-9)
    crossed = lever * of_angle
    return LineFit(line, np.array([[std**2 / len(points) + lever * crossed, crossed], [crossed, of_angle]]), ends)
