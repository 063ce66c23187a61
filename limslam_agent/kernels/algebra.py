"""Angles and small linear algebra for compiled functions."""

import math

import numpy as np

from limslam_agent.kernels.compilation import compiled
from limslam_env.geometry import FloatArray, IntArray


@compiled
def wrapped(angle: float) -> float:
    """The angle in (-pi, pi], rad."""
    if -math.pi < angle <= math.pi:
        return angle
    result = math.pi - (math.pi - angle) % (2.0 * math.pi)
    return result if result > -math.pi else math.pi


@compiled
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


@compiled
def whiten(factor: FloatArray, values: FloatArray, size: int, width: int) -> None:
    """Replace the first ``size`` rows and ``width`` columns of V by L^-1 V, with the Cholesky
    factor L.
    """
    for i in range(size):
        for k in range(i):
            share = factor[i, k]
            for j in range(width):
                values[i, j] -= share * values[k, j]
        inverse = 1.0 / factor[i, i]
        for j in range(width):
            values[i, j] *= inverse


@compiled
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


@compiled
def dot(values: FloatArray, first: int, second: int, size: int) -> float:
    """Scalar product of two columns of ``values``."""
    total = 0.0
    for i in range(size):
        total += values[i, first] * values[i, second]
    return total


@compiled
def orthonormalise(values: FloatArray, first: int, last: int, size: int) -> None:
    """Make the columns from ``first`` up to ``last`` orthonormal, in place (Gram-Schmidt,
    twice).
    """
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


@compiled
def leave_beside(values: FloatArray, first: int, last: int, basis: FloatArray, size: int) -> None:
    """Subtract from the columns from ``first`` up to ``last`` their projections on two orthonormal
    columns.
    """
    for column in range(first, last):
        a = 0.0
        b = 0.0
        for i in range(size):
            a += values[i, column] * basis[i, 0]
            b += values[i, column] * basis[i, 1]
        for i in range(size):
            values[i, column] -= a * basis[i, 0] + b * basis[i, 1]


@compiled
def order_of(values: FloatArray) -> IntArray:
    """Indices (n,) that sort numbers, of which equal ones stay in their order (Shell's sort)."""
    count = len(values)
    order = np.empty(count, dtype=np.int64)
    for i in range(count):
        order[i] = i
    gap = count // 2
    while gap:
        for i in range(gap, count):
            own = order[i]
            to = i
            while to >= gap:
                other = order[to - gap]
                step = values[own] - values[other]
                if step > 0.0 or (step == 0.0 and own > other):
                    break
                order[to] = other
                to -= gap
            order[to] = own
        gap //= 2
    return order


@compiled
def quantile(ordered: FloatArray, size: int, share: float) -> float:
    """Quantile of sorted numbers, with numpy's linear interpolation."""
    place = share * (size - 1)
    low = math.floor(place)
    high = min(low + 1, size - 1)
    part = place - low
    step = float(ordered[high] - ordered[low])
    return (
        float(ordered[high]) - step * (1.0 - part)
        if part >= 0.5
        else float(ordered[low]) + step * part
    )
