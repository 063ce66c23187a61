"""Tests whether readings show one straight piece of wall, with the covariance of the poses that they were taken from.

``slam.consistent.segmentation`` explains the tests. Readings, ``places`` and the state are those of
:mod:`~limslam_agent.kernels.measurement`.
"""

import math

import numpy as np

from limslam_agent.kernels.algebra import dot, factorise, leave_beside, orthonormalise, quantile, whiten
from limslam_agent.kernels.compilation import algebra, entry
from limslam_agent.kernels.measurement import hit_points, predict_ranges, towards
from limslam_agent.kernels.tables import (
    FEWEST,
    FEWEST_FOR_SHAPE,
    GRAZING,
    KINKS_AT,
    LEAST_GAIN,
    LEAST_SPREAD,
)
from limslam_agent.kernels.updates import covariance_of, dense_block, involved
from limslam_env.geometry import BoolArray, FloatArray, IntArray

THETA, MIDDLE_X, MIDDLE_Y, EXTENT, ANGLE_STD, R, BENT, BEND_AT = range(8)
"""Columns of a segment: the wall's direction, its middle, its length and the direction's standard deviation; then what
splits it: r about the world's origin, whether it is bent, and where."""


@algebra
def fit_segment(
    x: FloatArray, start: int, block: FloatArray, begins: IntArray, places: IntArray, readings: FloatArray,
    points: FloatArray, members: IntArray, line: tuple[float, float], std: float, variances: FloatArray,
    limits: tuple[float, float, float, float, float], segment: FloatArray, along: FloatArray, loose: BoolArray,
) -> tuple[FloatArray, IntArray]:  # fmt: skip
    """Fit a line to readings by generalised least squares, and test whether they are straight.

    Parameters
    ----------
    x, start, places, readings
        All readings, as of :mod:`~limslam_agent.kernels.measurement`.
    block, begins
        Covariance of the clones that the members were taken from, and where each member's clone begins in it (n,).
    points, members
        End points of all readings, m, and the indices (n,) of those that are fitted.
    line
        (r, theta) that the fit begins at.
    std, variances
        Standard deviation of a short range, m, and the variances of the members' ranges (n,), m^2.
    limits
        ``kink_gate``, ``min_kink``, ``curve_gate``, ``end_zone`` and ``end_gate`` of the settings.
    segment, along, loose
        Filled: the segment (8,), the position of each member along it (n,), m, and which of them are loose ends (n,).

    Returns
    -------
    residuals, clear
        Residuals (k,), in standard deviations, and which members (k,) they belong to: those that do not graze the line.
        If there are too few, none, and nothing is filled.
    """
    number, step = len(members), np.empty(2)
    d, theta = 0.0, line[1]
    foot, expected = foot_of(points, members, line[0], theta), np.empty((number, 7))
    predict_ranges(x, start, places, readings, members, (d, theta), foot, expected)
    clear, count = np.empty(number, dtype=np.int64), 0
    for i in range(number):
        if abs(expected[i, 6]) > GRAZING:
            clear[count] = i
            count += 1
    if count < FEWEST - 1:
        return np.empty(0), clear[:0]
    clear = clear[:count]
    factor = covariance_of(block, begins[clear], expected[clear], variances[clear])
    factorise(factor, count)
    values = np.empty((count, 3))
    for iteration in range(2):
        if iteration:
            predict_ranges(x, start, places, readings, members, (d, theta), foot, expected)
        for i in range(count):
            seen = expected[clear[i]]
            values[i, 0] = readings[members[clear[i]], 3] - seen[0]
            values[i, 1], values[i, 2] = seen[4], seen[5]
        whiten(factor, values, count, 3)
        solve_line(values, count, step)
        d, theta = d + step[0], theta + step[1]
    basis = values[:, 1:3].copy()
    leave_beside(values, 0, 1, basis, count)
    left = values[:, 0].copy()
    place_along(x, start, places, readings, members, theta, foot, expected, clear, along)
    own, cosines = along[clear], expected[clear, 6]
    describe(along[:number], own, foot, theta, std, segment)
    segment[BENT] = bend(own, cosines, left, basis, factor, limits, segment)
    loose[:number] = False
    loose_ends(own, cosines, left, basis, factor, limits, clear, loose)
    return left, clear


@algebra
def place_along(
    x: FloatArray, start: int, places: IntArray, readings: FloatArray, members: IntArray, theta: float,
    foot: tuple[float, float], expected: FloatArray, clear: IntArray, along: FloatArray,
) -> None:  # fmt: skip
    """Positions (n,) of readings along a line with its normal at ``theta``, rad, from its foot, m.

    The error of a slanted beam's range moves its end point along the wall. Positions from end points would therefore
    show a bend at the end of every noisy wall; positions where the beams meet the line do not contain that error.
    """
    cos, sin, own = math.cos(theta), math.sin(theta), readings[members]
    met = own[:, 3].copy()
    met[clear] = expected[clear, 0]
    where = hit_points(x, start, places[members], towards(x, start, places[members], own, theta), met)
    for i in range(len(members)):
        along[i] = (where[i, 0] - foot[0]) * -sin + (where[i, 1] - foot[1]) * cos


@algebra
def describe(
    along: FloatArray, own: FloatArray, foot: tuple[float, float], theta: float, std: float, segment: FloatArray
) -> None:
    """Fill the first columns of a segment from the positions of all its readings, and of those that do not graze it."""
    spread, ordered = own - own.mean(), np.sort(along)
    segment[THETA], segment[MIDDLE_X], segment[MIDDLE_Y] = theta, foot[0], foot[1]
    segment[EXTENT] = ordered[len(along) - 2] - ordered[1]
    segment[ANGLE_STD] = std / max(math.sqrt((spread * spread).sum()), LEAST_SPREAD)
    segment[R] = foot[0] * math.cos(theta) + foot[1] * math.sin(theta)


@algebra
def foot_of(points: FloatArray, members: IntArray, r: float, theta: float) -> tuple[float, float]:
    """Projection, m, of the points' mean on a line."""
    cos, sin, along = math.cos(theta), math.sin(theta), 0.0
    for i in range(len(members)):
        along += -sin * points[members[i], 0] + cos * points[members[i], 1]
    along /= len(members)
    return r * cos - along * sin, r * sin + along * cos


@algebra
def solve_line(values: FloatArray, count: int, solution: FloatArray) -> None:
    """Least-squares solution (2,) of the first of three columns by the other two, which are made orthonormal."""
    before = values[:count, 1:3].copy()
    orthonormalise(values, 1, 3, count)
    a, b, c = 0.0, 0.0, 0.0
    for i in range(count):
        a += values[i, 1] * before[i, 0]
        b += values[i, 1] * before[i, 1]
        c += values[i, 2] * before[i, 1]
    solution[1] = dot(values, 2, 0, count) / c
    solution[0] = (dot(values, 1, 0, count) - b * solution[1]) / a


@algebra
def bend(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    limits: tuple[float, float, float, float, float], segment: FloatArray,
) -> float:  # fmt: skip
    """Whether (1 or 0) a kinked or curved line explains readings much better; fills the position of the best kink."""
    count = len(along)
    ordered = np.sort(along)
    reach, kinks = ordered[count - 1] - ordered[0], len(KINKS_AT)
    if count < FEWEST_FOR_SHAPE or reach <= 0.0:
        return 0.0
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
    segment[BEND_AT] = places[best]
    is_kinked = most > limits[0] and abs(angle) > limits[1]
    return 1.0 if is_kinked or curved > limits[2] else 0.0


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
def loose_ends(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    limits: tuple[float, float, float, float, float], clear: IntArray, loose: BoolArray,
) -> None:  # fmt: skip
    """Mark readings at either end that all lie on one side of the line: they belong to another object."""
    count, shape, (zone, gate) = len(along), np.empty((len(along), 1)), limits[3:]
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
                    loose[clear[i]] = True


@entry
def fit_readings(
    x: FloatArray, P: FloatArray, start: int, places: IntArray, readings: FloatArray, points: FloatArray,
    members: IntArray, line: tuple[float, float], std: float, variances: FloatArray,
    limits: tuple[float, float, float, float, float],
) -> tuple[FloatArray, FloatArray, BoolArray, FloatArray, IntArray]:  # fmt: skip
    """:func:`fit_segment` with a whole covariance P, as Python calls it; what that fills, and what it returns."""
    columns, begins = involved(places, members, (len(x) - start) // 3, start, -1)
    segment, along, loose = np.empty(8), np.empty(len(members)), np.empty(len(members), dtype=np.bool_)
    left, clear = fit_segment(
        x, start, dense_block(P, columns), begins, places, readings, points, members, line, std, variances, limits,
        segment, along, loose,
    )  # fmt: skip
    return segment, along, loose, left, clear
