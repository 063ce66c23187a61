"""Small linear algebra for compiled functions.

A covariance P (s, s) is stored without its redundant half: ``top`` (3, s) holds its first three rows, and ``rest``
(s (s + 1) / 2) its lower triangle row by row, in which row i begins at i (i + 1) / 2.
"""

import math

import numpy as np

from limslam_agent.kernels.algebra import sort_with, wrapped
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.core.ekf import POSE
from limslam_env.geometry import FloatArray, IntArray

__all__ = ["sort_with", "wrapped"]


@algebra
def factorise(matrix: FloatArray, size: int) -> None:
    """Replace the lower triangle of the first ``size`` rows and columns by its Cholesky factor."""
    # Column by column: the rows of a column do not wait for each other.
    for j in range(size):
        total = matrix[j, j]
        for k in range(j):
            total -= matrix[j, k] * matrix[j, k]
        matrix[j, j] = math.sqrt(total)
        for i in range(j + 1, size):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total / matrix[j, j]


@algebra
def whiten(factor: FloatArray, values: FloatArray, size: int, width: int) -> None:
    """Replace the first ``size`` rows and ``width`` columns of V by L^-1 V, with the Cholesky factor L."""
    for i in range(size):
        for k in range(i):
            share = factor[i, k]
            for j in range(width):
                values[i, j] -= share * values[k, j]
        inverse = 1.0 / factor[i, i]
        for j in range(width):
            values[i, j] *= inverse


@algebra
def solve_factored(factor: FloatArray, values: FloatArray, size: int) -> None:
    """Replace v (size,) by the solution y of L L^T y = v."""
    for i in range(size):
        total = values[i]
        for k in range(i):
            total -= factor[i, k] * values[k]
        values[i] = total / factor[i, i]
    for i in range(size - 1, -1, -1):
        total = values[i]
        for k in range(i + 1, size):
            total -= factor[k, i] * values[k]
        values[i] = total / factor[i, i]


@algebra
def dot(values: FloatArray, first: int, second: int, size: int) -> float:
    """Scalar product of two columns of ``values``."""
    total = 0.0
    for i in range(size):
        total += values[i, first] * values[i, second]
    return total


@algebra
def orthonormalise(values: FloatArray, first: int, last: int, size: int) -> None:
    """Make the columns from ``first`` up to ``last`` orthonormal, in place (Gram-Schmidt, twice)."""
    for column in range(first, last):
        for _ in range(2):
            for other in range(first, column):
                share = dot(values, column, other, size)
                for i in range(size):
                    values[i, column] -= share * values[i, other]
        length = math.sqrt(dot(values, column, column, size))
        if length > 0.0:
            for i in range(size):
                values[i, column] /= length


@algebra
def leave_beside(values: FloatArray, first: int, last: int, basis: FloatArray, size: int) -> None:
    """Subtract from the columns from ``first`` up to ``last`` their projections on two orthonormal columns."""
    for column in range(first, last):
        a, b = 0.0, 0.0
        for i in range(size):
            a += values[i, column] * basis[i, 0]
            b += values[i, column] * basis[i, 1]
        for i in range(size):
            values[i, column] -= a * basis[i, 0] + b * basis[i, 1]


@algebra
def add_products(rest: FloatArray, left: FloatArray, right: FloatArray, rank: int, first: int, size: int) -> None:
    """Add left^T right, both (rank, size), to a packed lower triangle; ``rank`` is a multiple of four."""
    for i in range(first, size):
        base = i * (i + 1) // 2
        row = rest[base : base + i + 1]
        for k in range(0, rank, 4):
            a, b, c, d = left[k, i], left[k + 1, i], left[k + 2, i], left[k + 3, i]
            for j in range(i + 1):
                row[j] += a * right[k, j] + b * right[k + 1, j] + c * right[k + 2, j] + d * right[k + 3, j]


@algebra
def quantile(ordered: FloatArray, size: int, share: float) -> float:
    """Quantile of sorted numbers, with numpy's linear interpolation."""
    place = share * (size - 1)
    low = math.floor(place)
    high, part = min(low + 1, size - 1), place - low
    step = ordered[high] - ordered[low]
    return ordered[high] - step * (1.0 - part) if part >= 0.5 else ordered[low] + step * part


@algebra
def gather_rows(top: FloatArray, rest: FloatArray, columns: IntArray, size: int) -> FloatArray:
    """Full rows (k, size) of a covariance, none of them among the first three."""
    rows = np.empty((len(columns), size))
    for i in range(len(columns)):
        column = columns[i]
        base = column * (column + 1) // 2
        for j in range(POSE):
            rows[i, j] = top[j, column]
        for j in range(POSE, column + 1):
            rows[i, j] = rest[base + j]
        base += column
        for j in range(column + 1, size):
            base += j
            rows[i, j] = rest[base]
    return rows


@algebra
def block_of(top: FloatArray, rest: FloatArray, columns: IntArray) -> FloatArray:
    """Block (k, k) of a covariance: its rows and columns ``columns`` (k,)."""
    size = len(columns)
    part = np.empty((size, size))
    # No function is called for an entry: the counting of references to its arrays would take most of the time.
    for i in range(size):
        for j in range(i + 1):
            low, high = min(columns[i], columns[j]), max(columns[i], columns[j])
            part[i, j] = part[j, i] = top[low, high] if low < POSE else rest[high * (high + 1) // 2 + low]
    return part


@algebra
def squared_distance(covariance: FloatArray, off: FloatArray, more: tuple[float, float]) -> float:
    """Squared Mahalanobis distance of an offset (2,) by a covariance (2, 2) plus variances (2,)."""
    a, b, c = covariance[0, 0] + more[0], 0.5 * (covariance[0, 1] + covariance[1, 0]), covariance[1, 1] + more[1]
    return (c * off[0] ** 2 - 2.0 * b * off[0] * off[1] + a * off[1] ** 2) / (a * c - b * b)
