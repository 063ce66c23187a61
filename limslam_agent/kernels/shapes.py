"""Tests for the shape of a wall: whether readings near a line have a kink, a curve, or ends that bend away."""

import numpy as np

from limslam_agent.kernels.algebra import dot, leave_beside, orthonormalise, quantile, whiten
from limslam_agent.kernels.compilation import algebra, entry
from limslam_env.geometry import BoolArray, FloatArray

FEWEST_FOR_SHAPE = 10
"""Least number of readings that are tested for a kink or a curve."""

KINKS_AT = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Quantiles of the readings' positions at which a kink is tested for."""

LEAST_GAIN = 1e-9
"""Least squared norm of a shape that is divided by."""


@algebra
def bend(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    kink_gate: float, min_kink: float, curve_gate: float,
) -> tuple[bool, float]:  # fmt: skip
    """Whether a kinked or curved line explains readings much better, and the position of the best kink, m.

    Parameters
    ----------
    along, cosines, left
        Positions of the readings along the line (n,), m, cosines between the beams and the line's normal (n,), and
        whitened residuals (n,).
    basis, factor
        Orthonormal whitened derivatives of the ranges by the line (n, 2), and the Cholesky factor of the readings'
        covariance (n, n).
    kink_gate, min_kink, curve_gate
        Least gain in chi-square by a kink, least angle of a kink, rad, and least gain by a curve.
    """
    count = len(along)
    ordered = np.sort(along)
    reach, kinks = ordered[count - 1] - ordered[0], len(KINKS_AT)
    if count < FEWEST_FOR_SHAPE or reach <= 0.0:
        return False, 0.0
    shapes, places = np.empty((count, kinks + 3)), np.empty(kinks)
    for k in range(kinks):
        places[k] = quantile(ordered, count, KINKS_AT[k])
    for i in range(count):
        for k in range(kinks):
            shapes[i, k] = max(along[i] - places[k], 0.0) / cosines[i]
        scaled = 2.0 * (along[i] - ordered[0]) / reach - 1.0
        for k in range(3):
            shapes[i, kinks + k] = scaled ** (2 + k) / cosines[i]
    whiten(factor, shapes, count, kinks + 3)
    leave_beside(shapes, 0, kinks + 3, basis, count)
    most, best, angle = strongest_kink(shapes, left, kinks)
    orthonormalise(shapes, kinks, kinks + 3, count)
    curved = 0.0
    for k in range(3):
        product = 0.0
        for i in range(count):
            product += left[i] * shapes[i, kinks + k]
        curved += product * product
    is_kinked = most > kink_gate and abs(angle) > min_kink
    return bool(is_kinked or curved > curve_gate), float(places[best])


@algebra
def strongest_kink(shapes: FloatArray, left: FloatArray, kinks: int) -> tuple[float, int, float]:
    """Largest chi-square that a kink gains, the index of that kink, and its angle, rad."""
    most, best, angle = -1.0, 0, 0.0
    for k in range(kinks):
        square, product = 0.0, 0.0
        for i in range(len(left)):
            square += shapes[i, k] * shapes[i, k]
            product += left[i] * shapes[i, k]
        square = max(square, LEAST_GAIN)
        gain = (product / square) ** 2 * square
        if gain > most:
            most, best, angle = gain, k, product / square
    return most, best, angle


@algebra
def mark_loose_ends(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    zone: float, gate: float, loose: BoolArray,
) -> None:  # fmt: skip
    """Mark readings at either end that all lie on one side of the line: they belong to another object.

    Parameters
    ----------
    along, cosines, left, basis, factor
        As of :func:`bend`.
    zone, gate
        Length of an end, m, and least gain in chi-square if the end is moved.
    loose
        Is set where a reading is loose (n,).
    """
    count, shape = len(along), np.empty((len(along), 1))
    for end in (along.min(), along.max()):
        inside = 0
        for i in range(count):
            is_in = abs(along[i] - end) < zone
            inside += is_in
            shape[i, 0] = (1.0 if is_in else 0.0) / cosines[i]
        whiten(factor, shape, count, 1)
        leave_beside(shape, 0, 1, basis, count)
        square, product = dot(shape, 0, 0, count), 0.0
        for i in range(count):
            product += left[i] * shape[i, 0]
        if inside < count and square > LEAST_GAIN and product * product > gate * square:
            for i in range(count):
                if abs(along[i] - end) < zone:
                    loose[i] = True


@entry
def shape_of(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray, gates: FloatArray,
    loose: BoolArray,
) -> tuple[bool, float]:  # fmt: skip
    """What :func:`bend` and :func:`mark_loose_ends` say; ``gates`` (5,) are the last parameters of both, in order."""
    mark_loose_ends(along, cosines, left, basis, factor, gates[3], gates[4], loose)
    return bend(along, cosines, left, basis, factor, gates[0], gates[1], gates[2])
