"""A line through points by total least squares, with its covariance."""

import math
from dataclasses import dataclass

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import normalise


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
    """Fit a line to points (n, 2), n >= 2, each off it by noise of ``std`` (m).

    The direction is the principal axis of the points. Along that axis, s being the distance
    from the centroid, the offset has variance ``std^2 / n`` and the angle
    ``std^2 / sum(s^2)``, and the two are independent; (r, theta) follow to first order.
    """
    centroid = points.mean(axis=0)
    centred = points - centroid
    xx, yy = float(centred[:, 0] @ centred[:, 0]), float(centred[:, 1] @ centred[:, 1])
    xy = float(centred[:, 0] @ centred[:, 1])
    # Angle of the principal axis of a 2 x 2 scatter matrix, in closed form.
    axis = 0.5 * math.atan2(2.0 * xy, xx - yy)
    tangent = np.array([math.cos(axis), math.sin(axis)])
    theta = axis + 0.5 * math.pi
    r = centroid[0] * math.cos(theta) + centroid[1] * math.sin(theta)
    along = centred @ tangent
    variance_offset = std**2 / len(points)
    variance_angle = std**2 / max(float(along @ along), 1e-9)
    # Turning the line about the centroid moves the foot of the origin's perpendicular. Here the
    # tangent is minus the direction of increasing theta.
    lever = -float(centroid @ tangent)
    line = normalise(np.array([r, theta]))
    if r < 0.0:
        lever = -lever
    by_parts = np.array([[1.0, lever], [0.0, 1.0]])
    covariance = (by_parts * np.array([variance_offset, variance_angle])) @ by_parts.T
    ends = centroid + np.outer([along.min(), along.max()], tangent)
    return LineFit(line, covariance, ends)
