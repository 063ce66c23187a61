"""Tests whether readings show one straight piece of wall, with the covariance of the poses that
they were taken from.

The tests are generalised least squares with the joint covariance of the poses that the readings
were taken from. So a bend that comes from the odometry's error is not taken for a corner, and two
sides of a rounded obstacle are not taken for one wall. The filter is that of
:mod:`~limslam_agent.kernels.covariance`.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.algebra import (
    dot,
    factorise,
    leave_beside,
    order_of,
    orthonormalise,
    quantile,
    whiten,
)
from limslam_agent.kernels.beams import end_on_wall, line_about, predict_ranges
from limslam_agent.kernels.compilation import compiled, entry
from limslam_agent.kernels.covariance import clones_from, dense_block
from limslam_agent.kernels.lines import fit_line
from limslam_agent.kernels.tables import (
    ANGLE_STD,
    AROUND_KINK,
    CURVE_GATE,
    DEEPEST,
    END_GATE,
    END_ZONE,
    EXTENT,
    FEWEST,
    FEWEST_FOR_SHAPE,
    GRAZING,
    KINK_GATE,
    KINKS_AT,
    LEAST_DIVISOR,
    MIDDLE_X,
    MIDDLE_Y,
    MIN_KINK,
    POSE,
    THETA,
    Filter,
    Readings,
)
from limslam_agent.kernels.updates import covariance_of, involved
from limslam_env.geometry import BoolArray, FloatArray, IntArray


class Fit(NamedTuple):
    """A line that was fitted to n readings by generalised least squares; k of them do not graze it.

    Attributes
    ----------
    clear
        Which readings (k,) these are.
    along, ordered
        Positions of all readings (n,) along the line from its foot, m, and of the k ones, sorted.
    left, cosines
        Of the k ones: residuals (k,), whitened, and cosines (k,) between beam and normal.
    factor, basis
        What whitens: the Cholesky factor (k, k) of the covariance of the ranges. And two
        orthonormal columns (k, 2): what another line would change of the whitened ranges.
    theta, foot_x, foot_y
        The line: direction of its normal, rad, and a point of it, m.
    """

    clear: IntArray
    along: FloatArray
    ordered: FloatArray
    left: FloatArray
    cosines: FloatArray
    factor: FloatArray
    basis: FloatArray
    theta: float
    foot_x: float
    foot_y: float


@compiled
def fit_segment(
    ekf: Filter,
    readings: Readings,
    points: FloatArray,
    own: IntArray,
    block: FloatArray,
    begins: IntArray,
    r: float,
    theta: float,
) -> Fit:
    """Fit a line to the own ones (n,) of all readings, which end at points, m; the fit begins at a
    line (r, theta).

    ``block`` is the covariance of the clones that they were taken from, in which the clone of each
    begins at ``begins``. If too few readings do not graze the line, there are none in the result.
    """
    start = clones_from(ekf.counts)
    x = ekf.x
    places = readings.places
    rows = readings.rows
    size = len(own)
    d = 0.0
    foot = foot_of(points, own, r, theta)
    expected = np.empty((size, 7))
    predict_ranges(x, start, places, rows, own, line_about(d, theta, foot), expected)
    clear = keep_clear(expected)
    count = len(clear)
    left = np.empty(count)
    values = np.empty((count, 3))
    basis = np.empty((count, 2))
    along = np.empty(size)
    if count < FEWEST - 1:
        return Fit(clear[:0], along, left, left, left, basis, basis, theta, foot[0], foot[1])
    chosen = np.empty(count, dtype=np.int64)
    from_clones = np.empty(count, dtype=np.int64)
    variances = np.empty(count)
    for i in range(count):
        chosen[i] = own[clear[i]]
        from_clones[i] = begins[chosen[i]]
        variances[i] = readings.variances[chosen[i]]
    factor = covariance_of(block, from_clones, expected, variances)
    factorise(factor, count)
    for iteration in range(2):
        if iteration:
            line = line_about(d, theta, foot)
            predict_ranges(x, start, places, rows, chosen, line, expected)
        for i in range(count):
            values[i, 0] = rows[chosen[i], 3] - expected[i, 0]
            values[i, 1] = expected[i, 4]
            values[i, 2] = expected[i, 5]
        whiten(factor, values, count, 3)
        step, turn = solve_line(values, basis, count)
        d = d + step
        theta = theta + turn
    leave_beside(values, 0, 1, basis, count)
    # The error of a slanted beam's range moves its end point along the wall. Positions from end
    # points would therefore show a bend at the end of every noisy wall; positions where the beams
    # meet the line do not contain that error.
    cos = math.cos(theta)
    sin = math.sin(theta)
    for i in range(size):
        along[i] = rows[own[i], 3]
    for i in range(count):
        along[clear[i]] = expected[i, 0]
    for i in range(size):
        at = start + POSE * places[own[i]]
        pose = (x[at], x[at + 1], x[at + 2])
        hit_x, hit_y = end_on_wall(pose, rows[own[i]], (cos, sin), along[i])
        along[i] = (hit_x - foot[0]) * -sin + (hit_y - foot[1]) * cos
    cosines = np.empty(count)
    clear_along = np.empty(count)
    for i in range(count):
        left[i] = values[i, 0]
        cosines[i] = expected[i, 6]
        clear_along[i] = along[clear[i]]
    ordered = sorted_copy(clear_along)
    return Fit(clear, along, ordered, left, cosines, factor, basis, theta, foot[0], foot[1])


@compiled
def sorted_copy(values: FloatArray) -> FloatArray:
    """Numbers (n,) in order."""
    order = order_of(values)
    ordered = np.empty(len(values))
    for i in range(len(values)):
        ordered[i] = values[order[i]]
    return ordered


@compiled
def keep_clear(expected: FloatArray) -> IntArray:
    """Move those rows of what ``predict_ranges`` has filled (n, 7) to the front that do not graze
    their line, and return which they were (k,).
    """
    clear = np.empty(len(expected), dtype=np.int64)
    count = 0
    for i in range(len(expected)):
        if abs(expected[i, 6]) > GRAZING:
            for k in range(7):
                expected[count, k] = expected[i, k]
            clear[count] = i
            count += 1
    return clear[:count]


@compiled
def describe(fit: Fit, std: float, segment: FloatArray) -> None:
    """Fill a segment (5,) from a fit; ``std`` is the standard deviation of a short range, m."""
    middle = 0.0
    spread = 0.0
    for i in fit.clear:
        middle += fit.along[i]
    middle /= len(fit.clear)
    for i in fit.clear:
        spread += (fit.along[i] - middle) * (fit.along[i] - middle)
    # The length leaves out the outermost reading at either end.
    ends = sorted_copy(fit.along)
    segment[THETA] = fit.theta
    segment[MIDDLE_X] = fit.foot_x
    segment[MIDDLE_Y] = fit.foot_y
    segment[EXTENT] = ends[-2] - ends[1]
    segment[ANGLE_STD] = std / max(math.sqrt(spread), LEAST_DIVISOR)


@compiled
def foot_of(points: FloatArray, own: IntArray, r: float, theta: float) -> tuple[float, float]:
    """Projection, m, of the mean of some points on a line."""
    cos = math.cos(theta)
    sin = math.sin(theta)
    along = 0.0
    for i in own:
        along += -sin * points[i, 0] + cos * points[i, 1]
    along /= len(own)
    return r * cos - along * sin, r * sin + along * cos


@compiled
def solve_line(values: FloatArray, basis: FloatArray, count: int) -> tuple[float, float]:
    """Least-squares solution of the first of three columns by the other two, which are made
    orthonormal: ``basis``.
    """
    for i in range(count):
        basis[i, 0] = values[i, 1]
        basis[i, 1] = values[i, 2]
    orthonormalise(values, 1, 3, count)
    a = 0.0
    b = 0.0
    c = 0.0
    for i in range(count):
        a += values[i, 1] * basis[i, 0]
        b += values[i, 1] * basis[i, 1]
        c += values[i, 2] * basis[i, 1]
        basis[i, 0] = values[i, 1]
        basis[i, 1] = values[i, 2]
    second = dot(values, 2, 0, count) / c
    return (dot(values, 1, 0, count) - b * second) / a, second


@compiled
def bend_of(fit: Fit) -> float:
    """Where along a line there is the best kink, m, if a kinked or curved line explains the
    readings much better; NaN otherwise.
    """
    count = len(fit.clear)
    reach = fit.ordered[count - 1] - fit.ordered[0]
    kinks = len(KINKS_AT)
    if count < FEWEST_FOR_SHAPE or reach <= 0.0:
        return math.nan
    shapes = np.empty((count, kinks + 3))
    places = np.empty(kinks)
    for k in range(kinks):
        places[k] = quantile(fit.ordered, count, KINKS_AT[k])
    for i in range(count):
        along = fit.along[fit.clear[i]]
        for k in range(kinks):
            shapes[i, k] = max(along - places[k], 0.0) / fit.cosines[i]
        scaled = 2.0 * (along - fit.ordered[0]) / reach - 1.0
        for k in range(3):
            shapes[i, kinks + k] = scaled ** (2 + k) / fit.cosines[i]
    whiten(fit.factor, shapes, count, kinks + 3)
    leave_beside(shapes, 0, kinks + 3, fit.basis, count)
    most, best, angle = strongest_kink(shapes, fit.left, kinks)
    orthonormalise(shapes, kinks, kinks + 3, count)
    curved = 0.0
    for k in range(3):
        product = 0.0
        for i in range(count):
            product += fit.left[i] * shapes[i, kinks + k]
        curved += product * product
    is_kinked = most > KINK_GATE and abs(angle) > MIN_KINK
    return places[best] if is_kinked or curved > CURVE_GATE else math.nan


@compiled
def strongest_kink(shapes: FloatArray, left: FloatArray, kinks: int) -> tuple[float, int, float]:
    """Largest chi-square that a kink gains, the index of that kink, and its angle, rad."""
    most = -1.0
    best = 0
    angle = 0.0
    for k in range(kinks):
        square = 0.0
        product = 0.0
        for i in range(len(left)):
            square += shapes[i, k] * shapes[i, k]
            product += left[i] * shapes[i, k]
        square = max(square, LEAST_DIVISOR)
        gain = (product / square) ** 2 * square
        if gain > most:
            most = gain
            best = k
            angle = product / square
    return most, best, angle


@compiled
def firm_readings(fit: Fit) -> BoolArray:
    """Which readings (n,) belong to the line: not those at either end that all lie on one side of
    it, and belong to another object.
    """
    count = len(fit.clear)
    shape = np.empty((count, 1))
    is_firm = np.ones(len(fit.along), dtype=np.bool_)
    for end in (fit.ordered[0], fit.ordered[count - 1]):
        inside = 0
        for i in range(count):
            is_in = abs(fit.along[fit.clear[i]] - end) < END_ZONE
            shape[i, 0] = (1.0 if is_in else 0.0) / fit.cosines[i]
            inside += is_in
        whiten(fit.factor, shape, count, 1)
        leave_beside(shape, 0, 1, fit.basis, count)
        square = dot(shape, 0, 0, count)
        product = 0.0
        for i in range(count):
            product += fit.left[i] * shape[i, 0]
        if inside < count and square > LEAST_DIVISOR and product * product > END_GATE * square:
            for i in fit.clear:
                if abs(fit.along[i] - end) < END_ZONE:
                    is_firm[i] = False
    return is_firm


@compiled
def fill_part(
    own: IntArray, along: FloatArray, is_firm: BoolArray, bend: float, side: int, part: IntArray
) -> IntArray:
    """Fill a part of a line, and return it: the readings (n,) on one side of a bend, or the firm
    ones if the bend is NaN.
    """
    size = 0
    for i in range(len(own)):
        is_in = is_firm[i]
        if not math.isnan(bend):
            is_in = along[i] < bend - AROUND_KINK if side else along[i] > bend + AROUND_KINK
        if is_in:
            part[size] = own[i]
            size += 1
    return part[:size]


@entry
def cut_at_bends(
    ekf: Filter, readings: Readings, points: FloatArray, line: FloatArray, std: float
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Cut readings near one line into straight segments: at bends, and at ends that bend away.

    Parameters
    ----------
    ekf
        The filter with the clones that the readings were taken from.
    readings, points
        The readings (n,) near one line, and their end points (n, 2), m.
    line
        This line (2,) as (r, theta), as the Hough transform found it.
    std
        Standard deviation of a short range, m.

    Returns
    -------
    segments
        The segments (k, 5), in order along the line.
    owner
        The segment of each reading (n,); -1 for none.
    residuals
        Residuals of the readings (n,), in standard deviations; infinite where a reading grazes its
        segment.
    """
    columns, begins = involved(ekf, readings.places, -1)
    block = dense_block(ekf.P, columns)
    size = len(points)
    segments = np.empty((2**DEEPEST, 5))
    owner = np.full(size, -1)
    residuals = np.full(size, math.inf)
    ends = np.empty((2, 2))
    count = 0
    # Parts that wait, of which each has at most two: their readings, how many, how often they were
    # cut, and the line (r, theta) that their fit begins at
    members = np.empty((DEEPEST + 2, size), dtype=np.int64)
    waiting = np.empty((DEEPEST + 2, 2), dtype=np.int64)
    lines = np.empty((DEEPEST + 2, 2))
    for i in range(size):
        members[0, i] = i
    waiting[0, 0] = size
    waiting[0, 1] = 0
    lines[0, 0] = line[0]
    lines[0, 1] = line[1]
    number = 1
    while number:
        number -= 1
        own = members[number, : waiting[number, 0]].copy()
        depth = waiting[number, 1]
        if len(own) < FEWEST:
            continue
        r = lines[number, 0]
        theta = lines[number, 1]
        fit = fit_segment(ekf, readings, points, own, block, begins, r, theta)
        if not len(fit.clear):
            continue
        bend = bend_of(fit)
        is_firm = firm_readings(fit)
        if depth < DEEPEST and not (math.isnan(bend) and is_firm.all()):
            # The last part is the first one that is processed.
            for side in range(1 if math.isnan(bend) else 2):
                rest = fill_part(own, fit.along, is_firm, bend, side, members[number])
                if len(rest) >= FEWEST:
                    waiting[number, 0] = len(rest)
                    waiting[number, 1] = depth + 1
                    lines[number, 0], lines[number, 1] = fit_line(points, rest, ends)
                    number += 1
            continue
        describe(fit, std, segments[count])
        for i in range(len(own)):
            owner[own[i]] = count
        for i in range(len(fit.clear)):
            residuals[own[fit.clear[i]]] = fit.left[i]
        count += 1
    return segments[:count], owner, residuals
