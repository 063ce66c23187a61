"""Segmentation of readings into straight wall segments: compiled counterpart of ``consistent.segmentation``.

A wall segment is a row of numbers, whose columns are named here.
"""

import math

import numpy as np

from limslam_agent.slam.batch.algebra import block_of, dot, factorise, leave_beside, orthonormalise, quantile, whiten
from limslam_agent.slam.batch.beam_model import expected_ranges, hit_points, towards
from limslam_agent.slam.batch.clone_ekf import clones_from, covariance_of, involved
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.batch.state import Filter, Settings
from limslam_agent.slam.consistent.beam_model import GRAZING
from limslam_agent.slam.consistent.segmentation import (
    AROUND_KINK,
    DEEPEST,
    FEWEST,
    FEWEST_FOR_SHAPE,
    KINKS_AT,
    LEAST_GAIN,
    LEAST_SPREAD,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray

MOST_SEGMENTS = 2**DEEPEST

# Columns of a wall segment.
THETA, MIDDLE_X, MIDDLE_Y, EXTENT, ANGLE_STD = 0, 1, 2, 3, 4
# Further columns, which only this module uses: r, whether the segment is bent, and where.
_R, _BENT, _BEND_AT = 5, 6, 7


@algebra
def wall_segments(
    ekf: Filter, places: IntArray, readings: FloatArray, points: FloatArray, members: IntArray, line: FloatArray,
    settings: Settings,
) -> tuple[FloatArray, list[IntArray]]:  # fmt: skip
    """Split readings near one line where they bend, and remove ends that bend away.

    Returns the wall segments (k, 8) and the indices of the readings of each.
    """
    segments, own = np.empty((MOST_SEGMENTS, 8)), [members[:0]]
    todo, lines, depths = [members], [line], [DEEPEST]
    along, loose = np.empty(len(members)), np.empty(len(members), dtype=np.bool_)
    while todo:
        these, this, depth = todo.pop(), lines.pop(), depths.pop()
        if len(these) < FEWEST:
            continue
        segment = segments[len(own) - 1]
        if not fit_segment(ekf, places, readings, points, these, this, settings, segment, along, loose):
            continue
        here, is_loose = along[: len(these)], loose[: len(these)]
        if depth and segment[_BENT] > 0.0:
            # The first half is processed first.
            for half in (these[here > segment[_BEND_AT] + AROUND_KINK], these[here < segment[_BEND_AT] - AROUND_KINK]):
                if len(half) >= FEWEST:
                    todo.append(half)
                    lines.append(principal_line(points, half))
                    depths.append(depth - 1)
        elif depth and is_loose.any():
            todo.append(these[~is_loose])
            lines.append(np.array([segment[_R], segment[THETA]]))
            depths.append(depth - 1)
        else:
            own.append(these)
    return segments, own[1:]


@algebra
def fit_segment(
    ekf: Filter, places: IntArray, readings: FloatArray, points: FloatArray, members: IntArray, line: FloatArray,
    settings: Settings, segment: FloatArray, along: FloatArray, loose: BoolArray,
) -> bool:  # fmt: skip
    """Fit a line to readings by generalised least squares, and test whether they are straight; False if too few.

    Fills the wall segment (8,), the position of each reading along it (n,), m, and which readings are ``loose`` (n,).
    """
    number, start = len(members), clones_from(ekf)
    anchor, state, step = anchor_of(points, members, line[0], line[1]), np.array([0.0, line[1]]), np.empty(2)
    foot, expected = (anchor[0], anchor[1]), np.empty((number, 7))
    expected_ranges(ekf.x, start, places, readings, members, (0.0, line[1]), foot, expected)
    clear, count = np.empty(number, dtype=np.int64), 0
    for i in range(number):
        if abs(expected[i, 6]) > GRAZING:
            clear[count] = i
            count += 1
    if count < FEWEST - 1:
        return False
    clear = clear[:count]
    columns, begins = involved(ekf, places, members[clear], -1)
    factor = covariance_of(block_of(ekf.top, ekf.rest, columns), begins, expected[clear], settings.std**2)
    factorise(factor, count)
    values = np.empty((count, 3))
    for iteration in range(2):
        if iteration:
            expected_ranges(ekf.x, start, places, readings, members, (state[0], state[1]), foot, expected)
        for i in range(count):
            seen = expected[clear[i]]
            values[i, 0] = readings[members[clear[i]], 3] - seen[0]
            values[i, 1], values[i, 2] = seen[4], seen[5]
        whiten(factor, values, count, 3)
        solve_line(values, count, step)
        state = state + step
    basis = values[:, 1:3].copy()
    leave_beside(values, 0, 1, basis, count)
    cos, sin = math.cos(state[1]), math.sin(state[1])
    own_reads = readings[members]
    met = own_reads[:, 3].copy()
    met[clear] = expected[clear, 0]
    rays = towards(ekf.x, start, places[members], own_reads, state[1])
    where = hit_points(ekf.x, start, places[members], rays, met)
    for i in range(number):
        along[i] = (where[i, 0] - anchor[0]) * -sin + (where[i, 1] - anchor[1]) * cos
    own, cosines, left = along[clear], expected[clear, 6], values[:, 0].copy()
    spread = own - own.mean()
    ordered = np.sort(along[:number])
    segment[THETA], segment[MIDDLE_X], segment[MIDDLE_Y] = state[1], anchor[0], anchor[1]
    segment[EXTENT] = ordered[number - 2] - ordered[1]
    segment[ANGLE_STD] = settings.std / max(math.sqrt((spread * spread).sum()), LEAST_SPREAD)
    segment[_R] = segment[MIDDLE_X] * cos + segment[MIDDLE_Y] * sin
    segment[_BENT] = bend(own, cosines, left, basis, factor, settings, segment)
    loose[:number] = False
    loose_ends(own, cosines, left, basis, factor, settings, clear, loose)
    return True


@algebra
def solve_line(values: FloatArray, count: int, solution: FloatArray) -> FloatArray:
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
    return values[:count, 1:3]


@algebra
def anchor_of(points: FloatArray, members: IntArray, r: float, theta: float) -> FloatArray:
    """Projection (2,), m, of the points' mean on a line."""
    cos, sin, along = math.cos(theta), math.sin(theta), 0.0
    for i in range(len(members)):
        along += -sin * points[members[i], 0] + cos * points[members[i], 1]
    along /= len(members)
    return np.array([r * cos - along * sin, r * sin + along * cos])


@algebra
def bend(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    settings: Settings, segment: FloatArray,
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
    segment[_BEND_AT] = places[best]
    is_kinked = most > settings.kink_gate and abs(angle) > settings.min_kink
    return 1.0 if is_kinked or curved > settings.curve_gate else 0.0


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
    settings: Settings, clear: IntArray, loose: BoolArray,
) -> None:  # fmt: skip
    """Mark readings at either end that all lie on one side of the line: they belong to another object."""
    count, shape = len(along), np.empty((len(along), 1))
    for end in (along.min(), along.max()):
        inside = 0
        for i in range(count):
            is_in = abs(along[i] - end) < settings.end_zone
            inside += is_in
            shape[i, 0] = (1.0 if is_in else 0.0) / cosines[i]
        whiten(factor, shape, count, 1)
        leave_beside(shape, 0, 1, basis, count)
        square, product = dot(shape, 0, 0, count), 0.0
        for i in range(count):
            product += left[i] * shape[i, 0]
        if inside < count and square > LEAST_GAIN and product * product > settings.end_gate * square:
            for i in range(count):
                if abs(along[i] - end) < settings.end_zone:
                    loose[clear[i]] = True


@algebra
def hole(points: FloatArray, theta: float) -> float:
    """Largest distance between neighbouring points (n, 2) along a wall whose normal has the direction theta, m."""
    cos, sin, along = math.cos(theta), math.sin(theta), np.empty(len(points))
    for i in range(len(points)):
        along[i] = -sin * points[i, 0] + cos * points[i, 1]
    return np.diff(np.sort(along)).max()


@algebra
def principal_line(points: FloatArray, members: IntArray) -> FloatArray:
    """(r, theta), not normalised, of the line through some points by total least squares."""
    own = points[members]
    middle = np.array([own[:, 0].mean(), own[:, 1].mean()])
    across = np.linalg.svd(own - middle, False)[2][1]  # noqa: FBT003 (numba knows it as a positional argument only)
    return np.array([middle[0] * across[0] + middle[1] * across[1], math.atan2(across[1], across[0])])
