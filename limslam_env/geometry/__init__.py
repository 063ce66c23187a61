"""Plane geometry that the world and the agent share: numpy in, numpy out, nothing else.

``se2`` holds poses ``(x, y, theta)``, ``line`` the lines ``x cos(theta) + y sin(theta) = r``,
``segment`` the pieces of them that walls are made of. The names in ``__all__`` are public.
"""

from limslam_env.geometry import line, se2, segment
from limslam_env.geometry.arrays import BoolArray, FloatArray, IntArray, ReadingArray, no_rows

__all__ = [
    "BoolArray",
    "FloatArray",
    "IntArray",
    "ReadingArray",
    "line",
    "no_rows",
    "se2",
    "segment",
]
