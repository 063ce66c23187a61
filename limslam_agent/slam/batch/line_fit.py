"""A line through points by total least squares: compiled counterpart of ``core.line_fit``."""

import math

import numpy as np

from limslam_agent.slam.batch.algebra import wrapped
from limslam_agent.slam.batch.compilation import compiled
from limslam_env.geometry import FloatArray, IntArray


@compiled
def fit_line(points: FloatArray, members: IntArray, ends: FloatArray) -> tuple[float, float]:
    """(r, theta), normalised, of the line through some points by total least squares; fills its ends (2, 2), m."""
    middle_x, middle_y, number = 0.0, 0.0, len(members)
    for i in members:
        middle_x += points[i, 0]
        middle_y += points[i, 1]
    middle_x, middle_y = middle_x / number, middle_y / number
    xx, yy, xy = 0.0, 0.0, 0.0
    for i in members:
        x, y = points[i, 0] - middle_x, points[i, 1] - middle_y
        xx, yy, xy = xx + x * x, yy + y * y, xy + x * y
    axis = 0.5 * math.atan2(2.0 * xy, xx - yy)
    cos, sin, theta = math.cos(axis), math.sin(axis), axis + 0.5 * math.pi
    r = middle_x * math.cos(theta) + middle_y * math.sin(theta)
    least, most = np.inf, -np.inf
    for i in members:
        along = (points[i, 0] - middle_x) * cos + (points[i, 1] - middle_y) * sin
        least, most = min(least, along), max(most, along)
    ends[0, 0], ends[0, 1] = middle_x + least * cos, middle_y + least * sin
    ends[1, 0], ends[1, 1] = middle_x + most * cos, middle_y + most * sin
    return (-r, wrapped(theta + math.pi)) if r < 0.0 else (r, wrapped(theta))
