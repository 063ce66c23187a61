"""Small linear algebra for kernels: Cholesky factors, triangular systems, and what is left beside a few columns."""

import math

import numpy as np

from limslam_agent.slam.batch.compilation import algebra
from limslam_env.geometry import FloatArray


@algebra
def factorise(matrix: FloatArray, size: int) -> None:
    """Put the Cholesky factor of the first ``size`` rows and columns in the place of their lower triangle."""
    for i in range(size):
        for j in range(i):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total / matrix[j, j]
        total = matrix[i, i]
        for k in range(i):
            total -= matrix[i, k] * matrix[i, k]
        matrix[i, i] = math.sqrt(total)


@algebra
def whiten(factor: FloatArray, values: FloatArray, size: int, width: int) -> None:
    """Put L^-1 V in the place of the first ``size`` rows and ``width`` columns of V."""
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
    """Put the solution y of L L^T y = v in the place of v (size,)."""
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
    """Product of two columns."""
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
    """Take out of the columns from ``first`` up to ``last`` what two orthonormal columns of a basis explain."""
    for column in range(first, last):
        a, b = 0.0, 0.0
        for i in range(size):
            a += values[i, column] * basis[i, 0]
            b += values[i, column] * basis[i, 1]
        for i in range(size):
            values[i, column] -= a * basis[i, 0] + b * basis[i, 1]


@algebra
def add_products(rest: FloatArray, left: FloatArray, right: FloatArray, rank: int, first: int, size: int) -> None:
    """To a triangle that is kept row after row, add left^T right, both (rank, size); rank is a multiple of four."""
    for i in range(first, size):
        base = i * (i + 1) // 2
        row = rest[base : base + i + 1]
        for k in range(0, rank, 4):
            a, b, c, d = left[k, i], left[k + 1, i], left[k + 2, i], left[k + 3, i]
            for j in range(i + 1):
                row[j] += a * right[k, j] + b * right[k + 1, j] + c * right[k + 2, j] + d * right[k + 3, j]


@algebra
def quantile(ordered: FloatArray, size: int, share: float) -> float:
    """A quantile of sorted numbers, interpolated as numpy does."""
    place = share * (size - 1)
    low = math.floor(place)
    high, part = min(low + 1, size - 1), place - low
    step = ordered[high] - ordered[low]
    return ordered[high] - step * (1.0 - part) if part >= 0.5 else ordered[low] + step * part


@algebra
def wrapped(angle: float) -> float:
    """The angle in (-pi, pi], rad."""
    if -math.pi < angle <= math.pi:
        return angle
    result = math.pi - (math.pi - angle) % (2.0 * math.pi)
    return result if result > -math.pi else math.pi


@algebra
def sort_with(keys: FloatArray, follow: np.ndarray, size: int) -> None:
    """Sort a few keys in place, stably, and carry along what belongs to them."""
    for i in range(1, size):
        key, other = keys[i], follow[i]
        j = i
        while j > 0 and keys[j - 1] > key:
            keys[j], follow[j] = keys[j - 1], follow[j - 1]
            j -= 1
        keys[j], follow[j] = key, other
