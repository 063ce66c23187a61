"""Linear algebra with a covariance P (s, s) of which only one half is stored.

``top`` (3, s) holds its first three rows, and ``rest`` (s (s + 1) / 2) its lower triangle row by row, in which row i
begins at i (i + 1) / 2.
"""

import numpy as np

from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.core.ekf import POSE
from limslam_env.geometry import FloatArray, IntArray


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
