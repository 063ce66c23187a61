"""Tests whether readings show one straight piece of wall, with the covariance of the poses that
they were taken from.

The tests are generalised least squares with the joint covariance of the poses that the readings
were taken from. So a bend that comes from the odometry's error is not taken for a corner, and two
sides of a rounded obstacle are not taken for one wall. Readings, ``places`` and the state are those
of :mod:`~limslam_agent.kernels.beams`.
"""

import math

import numpy as np

from limslam_agent.kernels.algebra import (
    dot,
    factorise,
    leave_beside,
    orthonormalise,
    quantile,
    sort_with,
    whiten,
)
from limslam_agent.kernels.beams import end_on_wall, line_about, predict_ranges
from limslam_agent.kernels.compilation import compiled, entry
from limslam_agent.kernels.covariance import dense_block
from limslam_agent.kernels.lines import fit_line
from limslam_agent.kernels.tables import (
    ANGLE_STD,
    AROUND_KINK,
    BEND_AT,
    BENT,
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
)
from limslam_agent.kernels.updates import covariance_of, gathered, involved
from limslam_env.geometry import BoolArray, FloatArray, IntArray


@compiled
def fit_segment(
    x: FloatArray,
    start: int,
    block: FloatArray,
    begins: IntArray,
    places: IntArray,
    readings: FloatArray,
    points: FloatArray,
    members: IntArray,
    line: tuple[float, float],
    std: float,
    variances: FloatArray,
    segment: FloatArray,
    along: FloatArray,
    loose: BoolArray,
) -> tuple[FloatArray, IntArray]:
    """Fit a line to readings by generalised least squares, and test whether they are straight.

    The fit of the ``members`` (n,) of all readings begins at a ``line`` (r, theta). ``block`` is
    the covariance of the clones that they were taken from, in which the clone of each begins at
    ``begins`` (n,); ``variances`` (n,) are those of their ranges, m^2, and ``std`` is the standard
    deviation of a short range, m. Filled are the ``segment`` (7,), the position of each member
    ``along`` it (n,), m, and which of them are ``loose`` ends (n,).

    Returned are residuals (k,), in standard deviations, and the members (k,) that they belong to:
    those that do not graze the line. If there are too few, none, and nothing is filled.
    """
    count = 0
    clear = np.empty(len(members), dtype=np.int64)
    chosen = np.empty(len(members), dtype=np.int64)
    firsts = np.empty(len(members), dtype=np.int64)
    own_variances = np.empty(len(members))
    d = 0.0
    theta = line[1]
    foot = foot_of(points, members, line[0], theta)
    expected = np.empty((len(members), 7))
    predict_ranges(x, start, places, readings, members, line_about(d, theta, foot), expected)
    for i in range(len(members)):
        if abs(expected[i, 6]) > GRAZING:
            clear[count] = i
            chosen[count] = members[i]
            firsts[count] = begins[i]
            own_variances[count] = variances[i]
            for k in range(7):
                expected[count, k] = expected[i, k]
            count += 1
    if count < FEWEST - 1:
        return np.empty(0), clear[:0]
    factor = covariance_of(block, firsts[:count], expected, own_variances)
    factorise(factor, count)
    values = np.empty((count, 3))
    basis = np.empty((count, 2))
    left = np.empty(count)
    for iteration in range(2):
        if iteration:
            predict_ranges(
                x, start, places, readings, chosen[:count], line_about(d, theta, foot), expected
            )
        for i in range(count):
            values[i, 0] = readings[chosen[i], 3] - expected[i, 0]
            values[i, 1] = expected[i, 4]
            values[i, 2] = expected[i, 5]
        whiten(factor, values, count, 3)
        step, turn = solve_line(values, basis, count)
        d = d + step
        theta = theta + turn
    leave_beside(values, 0, 1, basis, count)
    for i in range(count):
        left[i] = values[i, 0]
    place_along(x, start, places, readings, members, theta, foot, expected, clear[:count], along)
    own = np.empty(count)
    ordered = np.empty(count)
    for i in range(count):
        own[i] = ordered[i] = along[clear[i]]
    sort_with(ordered, chosen, count)
    describe(along, len(members), own, foot, theta, std, segment)
    segment[BENT] = bend(own, ordered, expected, left, basis, factor, segment)
    mark_loose_ends(own, ordered, expected, left, basis, factor, clear, len(members), loose)
    return left, clear[:count]


@compiled
def place_along(
    x: FloatArray,
    start: int,
    places: IntArray,
    readings: FloatArray,
    members: IntArray,
    theta: float,
    foot: tuple[float, float],
    expected: FloatArray,
    clear: IntArray,
    along: FloatArray,
) -> None:
    """Positions (n,) of readings along a line with its normal at ``theta``, rad, from its foot, m.

    The error of a slanted beam's range moves its end point along the wall. Positions from end
    points would therefore show a bend at the end of every noisy wall; positions where the beams
    meet the line do not contain that error.
    """
    cos = math.cos(theta)
    sin = math.sin(theta)
    done = 0
    for i in range(len(members)):
        read = members[i]
        at = start + POSE * places[read]
        reach = readings[read, 3]
        if done < len(clear) and clear[done] == i:
            reach = expected[done, 0]
            done = done + 1
        hit_x, hit_y = end_on_wall((x[at], x[at + 1], x[at + 2]), readings[read], (cos, sin), reach)
        along[i] = (hit_x - foot[0]) * -sin + (hit_y - foot[1]) * cos


@compiled
def describe(
    along: FloatArray,
    number: int,
    own: FloatArray,
    foot: tuple[float, float],
    theta: float,
    std: float,
    segment: FloatArray,
) -> None:
    """Fill the first columns of a segment from the positions of all its readings, and of those that
    do not graze it.
    """
    middle = 0.0
    spread = 0.0
    for i in range(len(own)):
        middle += own[i]
    middle /= len(own)
    for i in range(len(own)):
        spread += (own[i] - middle) * (own[i] - middle)
    # The length leaves out the outermost reading at either end.
    least = math.inf
    low = math.inf
    high = -math.inf
    most = -math.inf
    for i in range(number):
        low = min(low, max(least, along[i]))
        high = max(high, min(most, along[i]))
        least = min(least, along[i])
        most = max(most, along[i])
    segment[THETA] = theta
    segment[MIDDLE_X] = foot[0]
    segment[MIDDLE_Y] = foot[1]
    segment[EXTENT] = high - low
    segment[ANGLE_STD] = std / max(math.sqrt(spread), LEAST_DIVISOR)


@compiled
def foot_of(points: FloatArray, members: IntArray, r: float, theta: float) -> tuple[float, float]:
    """Projection, m, of the points' mean on a line."""
    cos = math.cos(theta)
    sin = math.sin(theta)
    along = 0.0
    for i in range(len(members)):
        along += -sin * points[members[i], 0] + cos * points[members[i], 1]
    along /= len(members)
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
def bend(
    along: FloatArray,
    ordered: FloatArray,
    expected: FloatArray,
    left: FloatArray,
    basis: FloatArray,
    factor: FloatArray,
    segment: FloatArray,
) -> float:
    """Whether (1 or 0) a kinked or curved line explains readings much better; fills the position of
    the best kink.
    """
    count = len(along)
    reach = ordered[count - 1] - ordered[0]
    kinks = len(KINKS_AT)
    if count < FEWEST_FOR_SHAPE or reach <= 0.0:
        return 0.0
    shapes = np.empty((count, kinks + 3))
    places = np.empty(kinks)
    for k in range(kinks):
        places[k] = quantile(ordered, count, KINKS_AT[k])
    for i in range(count):
        for k in range(kinks):
            shapes[i, k] = max(along[i] - places[k], 0.0) / expected[i, 6]
        scaled = 2.0 * (along[i] - ordered[0]) / reach - 1.0
        for k in range(3):
            shapes[i, kinks + k] = scaled ** (2 + k) / expected[i, 6]
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
    is_kinked = most > KINK_GATE and abs(angle) > MIN_KINK
    return 1.0 if is_kinked or curved > CURVE_GATE else 0.0


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
def mark_loose_ends(
    along: FloatArray,
    ordered: FloatArray,
    expected: FloatArray,
    left: FloatArray,
    basis: FloatArray,
    factor: FloatArray,
    clear: IntArray,
    number: int,
    loose: BoolArray,
) -> None:
    """Mark readings at either end that all lie on one side of the line: they belong to another
    object.
    """
    count = len(along)
    shape = np.empty((len(along), 1))
    for i in range(number):
        loose[i] = False
    for end in (ordered[0], ordered[count - 1]):
        inside = 0
        for i in range(count):
            is_in = abs(along[i] - end) < END_ZONE
            inside += is_in
            shape[i, 0] = (1.0 if is_in else 0.0) / expected[i, 6]
        whiten(factor, shape, count, 1)
        leave_beside(shape, 0, 1, basis, count)
        square = dot(shape, 0, 0, count)
        product = 0.0
        for i in range(count):
            product += left[i] * shape[i, 0]
        if inside < count and square > LEAST_DIVISOR and product * product > END_GATE * square:
            for i in range(count):
                if abs(along[i] - end) < END_ZONE:
                    loose[clear[i]] = True


@compiled
def cut_part(
    order: IntArray,
    first: int,
    number: int,
    segment: FloatArray,
    along: FloatArray,
    loose: BoolArray,
    rest: IntArray,
) -> int:
    """Cut a part of ``order`` where it is bent, or cut off its loose ends; into how many parts, 0
    if it is straight.

    Fills where these parts begin in ``order``, and their lengths: ``rest`` (2, 2). The last one is
    to be processed first.
    """
    part = order[first : first + number].copy()
    before = 0
    behind = 0
    firm = 0
    if segment[BENT] > 0.0:
        for i in range(number):
            if along[i] < segment[BEND_AT] - AROUND_KINK:
                order[first + before] = part[i]
                before += 1
        for i in range(number):
            if along[i] > segment[BEND_AT] + AROUND_KINK:
                order[first + before + behind] = part[i]
                behind += 1
        rest[0, 0] = first + before
        rest[0, 1] = behind
        rest[1, 0] = first
        rest[1, 1] = before
        return 2
    for i in range(number):
        if not loose[i]:
            order[first + firm] = part[i]
            firm += 1
    rest[0, 0] = first
    rest[0, 1] = firm
    return 1 if firm < number else 0


@entry
def cut_at_bends(
    x: FloatArray,
    P: FloatArray,
    start: int,
    places: IntArray,
    readings: FloatArray,
    points: FloatArray,
    members: IntArray,
    line: FloatArray,
    std: float,
    variances: FloatArray,
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Cut readings near one line into straight segments: at bends, and at ends that bend away.

    Parameters
    ----------
    x, P
        The state and its covariance.
    start, places, readings, points
        As of :func:`fit_segment`.
    members, line
        Indices (n,) of the readings, and the line (2,) as (r, theta), as the Hough transform found
        it.
    std, variances
        Standard deviation of a short range, m, and the variances of all ranges, m^2.

    Returns
    -------
    segments
        The segments (k, 7), in order along the line.
    owner
        The segment of each member (n,); -1 for none.
    residuals
        Residuals of the members (n,), in standard deviations; infinite where a member grazes its
        segment.
    """
    columns, begins = involved(places, members, (len(x) - start) // POSE, start, -1)
    block = dense_block(P, columns)
    size = len(members)
    segments = np.empty((2**DEEPEST, 7))
    ends = np.empty((2, 2))
    owner = np.full(size, -1)
    residuals = np.full(size, math.inf)
    along = np.empty(size)
    loose = np.empty(size, dtype=np.bool_)
    order = np.arange(size)
    rest = np.empty((2, 2), dtype=np.int64)
    # Parts that wait: where they begin in ``order``, their lengths, how often they may be cut, and
    # their lines.
    parts = np.empty((DEEPEST + 1, 3), dtype=np.int64)
    lines = np.empty((DEEPEST + 1, 2))
    parts[0, 0] = 0
    parts[0, 1] = size
    parts[0, 2] = DEEPEST
    lines[0, 0] = line[0]
    lines[0, 1] = line[1]
    count = 0
    waiting = int(size >= FEWEST)
    while waiting:
        waiting -= 1
        first = parts[waiting, 0]
        number = parts[waiting, 1]
        depth = parts[waiting, 2]
        segment = segments[count]
        these = order[first : first + number]
        read = gathered(members, these)
        left, clear = fit_segment(
            x,
            start,
            block,
            gathered(begins, these),
            places,
            readings,
            points,
            read,
            (lines[waiting, 0], lines[waiting, 1]),
            std,
            gathered(variances, read),
            segment,
            along,
            loose,
        )
        if not len(clear):
            continue
        shorter = cut_part(order, first, number, segment, along, loose, rest) if depth else 0
        for k in range(shorter):
            begin = rest[k, 0]
            length = rest[k, 1]
            if length >= FEWEST:
                r, theta = fit_line(points, gathered(members, order[begin : begin + length]), ends)
                parts[waiting, 0] = begin
                parts[waiting, 1] = length
                parts[waiting, 2] = depth - 1
                lines[waiting, 0] = r
                lines[waiting, 1] = theta
                waiting += 1
        if not shorter:
            for i in range(number):
                owner[these[i]] = count
            for i in range(len(clear)):
                residuals[these[clear[i]]] = left[i]
            count += 1
    return segments[:count], owner, residuals
