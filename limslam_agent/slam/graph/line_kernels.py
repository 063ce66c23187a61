"""Compiled parts of the association of readings with lines: fits, ends, best lines, pairs that are one wall, crossings.

Lines are (d, alpha) about an anchor each, as in :mod:`limslam_agent.slam.graph.chain_kernels`. A place along a line
counts from its anchor, m.
"""

import math

import numpy as np

from limslam_agent.slam.batch.compilation import compiled, entry
from limslam_agent.slam.consistent.wall_extent import BIN
from limslam_agent.slam.graph.chain_kernels import COLUMNS, COSINE, RANGE, expected_reading
from limslam_env.geometry import FloatArray, IntArray

GRAZING = 0.2
_TRIED_ANGLES = 180
_FITTED = 80  # readings of a line at most, from which it is fitted
_FAR = 1e9
_OUTLIER = 25.0  # what explains a reading worse, in variances, is no worse than this
_REGULAR = (1e-6, 1e-8)  # added to the covariance of the difference of two lines, m^2 and rad^2


@compiled
def ray(pose: FloatArray, beam: FloatArray) -> tuple[float, float, float, float]:
    """Where a beam begins, m, and its direction, in the world."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + cos * beam[0] - sin * beam[1], pose[1] + sin * beam[0] + cos * beam[1]
    return x, y, math.cos(pose[2] + beam[2]), math.sin(pose[2] + beam[2])


@entry
def hit_points(
    poses: FloatArray, places: IntArray, beams: FloatArray, distances: FloatArray, points: FloatArray
) -> None:
    """Where readings end: rows x, y, m, and the beam's direction, rad, in ``points`` (k, 3)."""
    for k in range(len(places)):
        x, y, ux, uy = ray(poses[places[k]], beams[k])
        points[k, 0], points[k, 1] = x + distances[k] * ux, y + distances[k] * uy
        points[k, 2] = poses[places[k], 2] + beams[k, 2]


@entry
def fit_lines(points: FloatArray, firsts: IntArray, std: float, lines: FloatArray, anchors: FloatArray) -> None:
    """Lines (m, 2) and anchors (m, 2) through points (k, 3), which are grouped: group i begins at ``firsts[i]``.

    Of many angles, the one that explains most readings. Total least squares of the points would take the noise along
    the beams for the line where points are crowded together.
    """
    for group in range(len(lines)):
        first, end = firsts[group], firsts[group + 1]
        stride = 1 + (end - first - 1) // _FITTED
        anchors[group, 0], anchors[group, 1] = points[first:end, 0].mean(), points[first:end, 1].mean()
        best = np.inf
        for number in range(_TRIED_ANGLES):
            angle = number * math.pi / _TRIED_ANGLES
            cost, offset = _fit_at(points[first:end:stride], anchors[group], angle, std)
            if cost < best:
                best, lines[group, 0], lines[group, 1] = cost, offset, angle


@compiled
def _fit_at(points: FloatArray, anchor: FloatArray, angle: float, std: float) -> tuple[float, float]:
    """Cost and offset of the best line with a given angle."""
    nx, ny = math.cos(angle), math.sin(angle)
    total, weights = 0.0, 0.0
    for k in range(len(points)):
        # A point is farther from the line by the cosine than along the beam.
        weight = max(abs(math.cos(angle - points[k, 2])), GRAZING) ** -2.0
        total += weight * ((points[k, 0] - anchor[0]) * nx + (points[k, 1] - anchor[1]) * ny)
        weights += weight
    offset, cost = total / weights, 0.0
    for k in range(len(points)):
        cosine = max(abs(math.cos(angle - points[k, 2])), GRAZING)
        away = (points[k, 0] - anchor[0]) * nx + (points[k, 1] - anchor[1]) * ny - offset
        cost += min((away / (cosine * std)) ** 2, _OUTLIER)
    return cost, offset


@compiled
def meet(
    pose: FloatArray, beam: FloatArray, line: FloatArray, anchor: FloatArray
) -> tuple[float, float, float]:
    """How far a beam goes to a line, m, at which place of the line, m, and the cosine between beam and normal.

    The distance is negative where the beam does not meet the line or grazes it.
    """
    x, y, ux, uy = ray(pose, beam)
    nx, ny = math.cos(line[1]), math.sin(line[1])
    cosine = nx * ux + ny * uy
    if abs(cosine) < GRAZING:
        return -1.0, 0.0, cosine
    distance = (line[0] - nx * (x - anchor[0]) - ny * (y - anchor[1])) / cosine
    hit_x, hit_y = x + distance * ux - anchor[0], y + distance * uy - anchor[1]
    return distance, nx * hit_y - ny * hit_x, cosine


@entry
def places_along(
    poses: FloatArray,
    places: IntArray,
    beams: FloatArray,
    label: IntArray,
    lines: FloatArray,
    anchors: FloatArray,
    along: FloatArray,
) -> None:
    """Where beams should meet the lines that they are given to, (k,), m; readings of no line are left out."""
    row = np.zeros(COLUMNS)
    for k in range(len(places)):
        if label[k] < 0:
            continue
        line, anchor = lines[label[k]], anchors[label[k]]
        expected_reading(poses[places[k]], beams[k], line, anchor, row)
        x, y, ux, uy = ray(poses[places[k]], beams[k])
        nx, ny = math.cos(line[1]), math.sin(line[1])
        hit_x, hit_y = x + row[RANGE] * ux - anchor[0], y + row[RANGE] * uy - anchor[1]
        along[k] = nx * hit_y - ny * hit_x


@entry
def best_lines(
    poses: FloatArray,
    places: IntArray,
    beams: FloatArray,
    distances: FloatArray,
    lines: FloatArray,
    anchors: FloatArray,
    ends: FloatArray,
    beyond: float,
    best: IntArray,
    misfits: FloatArray,
) -> None:
    """For each reading, the line (k,) that predicts it best among those that the beam meets near enough.

    Parameters
    ----------
    ends, beyond
        (m, 2), m, from where to where each line was read, and how far beyond it may be met.
    best, misfits
        To be filled: the line or -1, and how far the reading is from the best and from the second one (k, 2), m.
    """
    for k in range(len(places)):
        best[k], misfits[k, 0], misfits[k, 1] = -1, _FAR, _FAR
        for line in range(len(lines)):
            distance, along, _ = meet(poses[places[k]], beams[k], lines[line], anchors[line])
            if distance <= 0.0 or along < ends[line, 0] - beyond or along > ends[line, 1] + beyond:
                continue
            misfit = abs(distance - distances[k])
            if misfit < misfits[k, 0]:
                misfits[k, 1], misfits[k, 0], best[k] = misfits[k, 0], misfit, line
            elif misfit < misfits[k, 1]:
                misfits[k, 1] = misfit


@compiled
def _difference(
    first: int, second: int, lines: FloatArray, anchors: FloatArray, jacobian: FloatArray
) -> tuple[float, float]:
    """The first line about the second one's anchor, less the second: offset and angle; and the derivatives (2, 4)."""
    turn = lines[first, 1] - lines[second, 1]
    angle = (turn + 0.5 * math.pi) % math.pi - 0.5 * math.pi
    sign = -1.0 if math.cos(turn) < 0.0 else 1.0
    nx, ny = math.cos(lines[first, 1]), math.sin(lines[first, 1])
    x, y = anchors[second, 0] - anchors[first, 0], anchors[second, 1] - anchors[first, 1]
    jacobian[:] = 0.0
    jacobian[0, 0], jacobian[0, 1], jacobian[0, 2] = sign, sign * (x * ny - y * nx), -1.0
    jacobian[1, 1], jacobian[1, 3] = 1.0, -1.0
    return sign * (lines[first, 0] - x * nx - y * ny) - lines[second, 0], angle


@compiled
def _agreement(
    first: int, second: int, lines: FloatArray, anchors: FloatArray, covariance: FloatArray, jacobian: FloatArray
) -> float:
    """Squared Mahalanobis distance of two lines, with their joint covariance."""
    offset, angle = _difference(first, second, lines, anchors, jacobian)
    a, b, c = _REGULAR[0], 0.0, _REGULAR[1]
    for i in range(4):
        row = 2 * (first if i < 2 else second) + i % 2
        for j in range(4):
            value = covariance[row, 2 * (first if j < 2 else second) + j % 2]
            a += jacobian[0, i] * value * jacobian[0, j]
            b += jacobian[0, i] * value * jacobian[1, j]
            c += jacobian[1, i] * value * jacobian[1, j]
    return (c * offset * offset - 2.0 * b * offset * angle + a * angle * angle) / max(a * c - b * b, 1e-300)


@compiled
def _apart(first: int, second: int, lines: FloatArray, anchors: FloatArray, ends: FloatArray) -> tuple[float, float]:
    """How far the middle of the second line lies from the first one, m, and the length that both cover, m."""
    nx, ny = math.cos(lines[second, 1]), math.sin(lines[second, 1])
    mx, my = math.cos(lines[first, 1]), math.sin(lines[first, 1])
    low, high, off = np.inf, -np.inf, 0.0
    for end in range(2):
        x = anchors[second, 0] + lines[second, 0] * nx - ends[second, end] * ny - anchors[first, 0]
        y = anchors[second, 1] + lines[second, 0] * ny + ends[second, end] * nx - anchors[first, 1]
        along = mx * y - my * x
        low, high = min(low, along), max(high, along)
        off += 0.5 * (mx * x + my * y - lines[first, 0])
    return abs(off), min(high, ends[first, 1]) - max(low, ends[first, 0])


@entry
def one_wall_pairs(
    lines: FloatArray,
    anchors: FloatArray,
    ends: FloatArray,
    covariance: FloatArray,
    limits: FloatArray,
    pairs: FloatArray,
) -> int:
    """Pairs of lines that may be one wall, as rows (chi-square, first, second) of ``pairs``; returns how many.

    ``limits`` are the largest chi-square, offset (m) and angle (rad), and the least overlap (m).
    """
    count, jacobian = 0, np.zeros((2, 4))
    for first in range(len(lines)):
        for second in range(first + 1, len(lines)):
            if count == len(pairs):
                return count
            turn = (lines[first, 1] - lines[second, 1] + 0.5 * math.pi) % math.pi - 0.5 * math.pi
            if abs(turn) > limits[2]:
                continue
            off, overlap = _apart(first, second, lines, anchors, ends)
            if off > limits[1] or overlap < limits[3]:
                continue
            squared = _agreement(first, second, lines, anchors, covariance, jacobian)
            if squared < limits[0]:
                pairs[count, 0], pairs[count, 1], pairs[count, 2] = squared, first, second
                count += 1
    return count


@entry
def crossings(
    poses: FloatArray,
    places: IntArray,
    beams: FloatArray,
    reached: FloatArray,
    lines: FloatArray,
    anchors: FloatArray,
    ends: FloatArray,
    sigmas: float,
    std: float,
    slack: float,
    found: FloatArray,
) -> int:
    """Where beams went through lines between their ends, as rows (reading, line, place along it); returns how many.

    A beam has gone through when it ``reached`` (k,) farther, m, than ``sigmas`` times the standard deviation, and
    ``slack`` (m), both along the normal, beyond the line.
    """
    count = 0
    for k in range(len(places)):
        for line in range(len(lines)):
            distance, along, cosine = meet(poses[places[k]], beams[k], lines[line], anchors[line])
            if distance <= 0.0 or along < ends[line, 0] or along > ends[line, 1]:
                continue
            if distance + (sigmas * std + slack) / abs(cosine) < reached[k]:
                if count == len(found):
                    return count
                found[count, 0], found[count, 1], found[count, 2] = k, line, along
                count += 1
    return count


@compiled
def bin_of(along: float) -> int:
    """The bin of a place along a line."""
    return int(math.floor(along / BIN))
