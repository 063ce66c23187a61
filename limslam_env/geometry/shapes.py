"""Shapes that pictures are drawn with."""

import math

import numpy as np

from limslam_env.geometry.arrays import FloatArray

_CHI2_95 = 5.991  # 95 % quantile of the chi-square distribution with two degrees of freedom


def ellipse(covariance: FloatArray, corners: int) -> FloatArray:
    """The ellipse (corners, 2), m, around the origin that holds 95 % of a normal distribution.

    ``covariance`` (2, 2) is that of a position, m^2. The half axes are 2.45 standard deviations.
    """
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    angles = np.linspace(0.0, 2.0 * math.pi, corners, endpoint=False)
    # Rounding can make a variance of nothing negative.
    half_axes = np.sqrt(_CHI2_95 * np.maximum(values, 0.0))
    return np.asarray(np.column_stack((np.cos(angles), np.sin(angles))) * half_axes @ vectors.T)


def thinned(path: FloatArray, most: int) -> FloatArray:
    """A path (k, 2) reduced to about ``most`` points and its last point, so that long paths are
    drawn quickly.
    """
    every = -(-len(path) // most)
    return path if every <= 1 else np.vstack((path[:-1:every], path[-1:]))


def places_around(size: int, cell: float) -> FloatArray:
    """Middles (size * size, 2), m, of the cells of a square picture around a robot, in the robot's
    frame.

    The picture looks up: row 0 lies ahead, column 0 to the left; x of the robot's frame is ahead, y
    left. ``cell`` is the side of a cell, m.
    """
    offsets = (0.5 * (size - 1) - np.arange(size)) * cell
    ahead, left = np.meshgrid(offsets, offsets, indexing="ij")
    return np.column_stack((ahead.ravel(), left.ravel()))
