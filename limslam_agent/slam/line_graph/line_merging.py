"""Merging of lines that may be one wall, and which walls are thin boards: compiled.

Lines are (d, alpha) about one anchor each, as in :mod:`limslam_agent.slam.line_graph.chain_kernels`. A place along a
line is its distance from the anchor, m.
"""

import math

import numpy as np

from limslam_agent.slam.core import wall_faces
from limslam_agent.slam.core.carried_anchors import KNOWN_PLACE
from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE, SURE
from limslam_agent.slam.line_graph.compilation import compiled, entry
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_REGULAR = (1e-6, 1e-8)  # added to the covariance of the difference of two lines, m^2 and rad^2
_board_evidence, _board_odds = compiled(wall_faces.board_evidence), compiled(wall_faces.board_odds)
_is_wall = compiled(wall_faces.is_wall)


@entry
def merge_lines(
    lines: FloatArray,
    anchors: FloatArray,
    ends: FloatArray,
    seen: FloatArray,
    covariance: FloatArray,
    limits: FloatArray,
    kinds: FloatArray,
    most_moved: FloatArray,
    merged_into: IntArray,
) -> int:
    """Merge lines that may be one wall, in the order of likelihood; return the number of merges.

    Every merged pair is a constraint that updates all other lines through their joint covariance. The pair with the
    greatest likelihood is merged first. A pair with a large covariance passes the chi-square test easily. This is weak
    evidence, so it has a limit of its own. Two lines that were read from opposite sides only are merged if they are a
    board.

    Parameters
    ----------
    lines, anchors, ends, seen, covariance
        (m, 2), (m, 2), (m, 2), (m, 2, 2) and (2 m, 2 m), or (3 m, 3 m) with the places of the anchors along the lines:
        ``seen`` has the ends of the part that was read from each side. All but the anchors are changed.
    limits, kinds
        The largest chi-square, offset (m) and angle (rad), the least overlap (m), and the largest sum of chi-square and
        the logarithm of the determinant of the difference's covariance. Lengths of the known boards and walls, m.
    most_moved
        Merging stops when the change of a line exceeds this, m and rad, and one standard deviation: the problem must
        then be linearised again.
    merged_into
        Output array (m,): for each line, the line that it was merged into, or the line itself if it was not merged.
    """
    begin, work, count = lines.copy(), np.zeros((2, 8)), 0
    spread = np.sqrt(np.diag(covariance))[: 2 * len(lines)].reshape(-1, 2)
    for line in range(len(lines)):
        merged_into[line] = line
    loose = np.array([limits[0], limits[1] + 0.3, limits[2] + 0.1, limits[3] - 0.3])
    pairs = near_pairs(lines, anchors, ends, loose)
    while True:
        best, chosen = np.inf, -1
        for k in range(len(pairs)):
            first, second = pairs[k]
            if merged_into[first] != first or merged_into[second] != second:
                continue
            if not _is_near(first, second, lines, anchors, ends, limits):
                continue
            squared, volume = _agreement(first, second, lines, anchors, covariance, work)
            is_better = squared < limits[0] and squared + volume < min(best, limits[4])
            if is_better and _is_one_line(first, second, lines, anchors, seen, limits[3], kinds, work):
                best, chosen = squared + volume, k
        if chosen < 0:
            return count
        first, second = pairs[chosen]
        _agreement(first, second, lines, anchors, covariance, work)
        _constrain(first, second, lines, covariance, work)
        _unite_ends(first, second, lines, anchors, ends)
        seen_there = seen_along(first, second, lines, anchors, seen)
        for side in range(2):
            seen[first, side, 0] = min(seen[first, side, 0], seen_there[side, 0])
            seen[first, side, 1] = max(seen[first, side, 1], seen_there[side, 1])
        merged_into[second] = first
        count += 1
        if _has_moved(lines - begin, spread, merged_into, most_moved):
            return count


@entry
def wall_kinds(
    lines: FloatArray,
    anchors: FloatArray,
    ends: FloatArray,
    seen: FloatArray,
    covariance: FloatArray,
    limits: FloatArray,
) -> tuple[float, float]:
    """Length of the lines that are boards, and length of the walls with two faces, m.

    The other parameters are as in :func:`merge_lines`.
    """
    boards, behind, work = 0.0, np.zeros(len(lines)), np.zeros((2, 8))
    for line in range(len(lines)):
        boards += max(seen[line, :, 1].min() - seen[line, :, 0].max(), 0.0)
    pairs = near_pairs(lines, anchors, ends, limits)
    for k in range(len(pairs)):
        first, second = pairs[k]
        length = _opposite(first, second, lines, anchors, seen)[1]
        if length > 0.0:
            _agreement(first, second, lines, anchors, covariance, work)
            evidence, distance = _compared(first, second, lines, anchors, seen, work)
            if _is_wall(evidence, distance):
                behind[first], behind[second] = max(behind[first], length), max(behind[second], length)
    return boards, 0.5 * behind.sum()


@compiled
def seen_along(first: int, second: int, lines: FloatArray, anchors: FloatArray, seen: FloatArray) -> FloatArray:
    """Ends (2, 2) of the part of the second line that was read from each side, as places and sides of the first, m."""
    nx, ny = math.cos(lines[second, 1]), math.sin(lines[second, 1])
    mx, my = math.cos(lines[first, 1]), math.sin(lines[first, 1])
    x = anchors[second, 0] + lines[second, 0] * nx - anchors[first, 0]
    y = anchors[second, 1] + lines[second, 0] * ny - anchors[first, 1]
    middle, result = mx * y - my * x, np.empty((2, 2))
    is_turned = mx * nx + my * ny < 0.0
    for side in range(2):
        low, high = seen[second, side]
        if is_turned:
            result[1 - side, 0], result[1 - side, 1] = middle - high, middle - low
        else:
            result[side, 0], result[side, 1] = middle + low, middle + high
    return result


@compiled
def _shared(first: FloatArray, second: FloatArray) -> float:
    """Length of the stretch that two parts of a line share, m; below 0 if they share none."""
    return float(min(first[1], second[1]) - max(first[0], second[0]))


@compiled
def _opposite(
    first: int, second: int, lines: FloatArray, anchors: FloatArray, seen: FloatArray
) -> tuple[float, float, int]:
    """Longest stretches that two lines share, m: read from the same side, and from opposite sides.

    The third number is the side of the second line that the latter was read from.
    """
    other = seen_along(second, first, lines, anchors, seen)
    own = max(_shared(other[0], seen[second, 0]), _shared(other[1], seen[second, 1]))
    lengths = (_shared(other[1], seen[second, 0]), _shared(other[0], seen[second, 1]))
    side = POSITIVE if lengths[0] >= lengths[1] else NEGATIVE
    return own, lengths[side], side


@compiled
def _compared(
    first: int, second: int, lines: FloatArray, anchors: FloatArray, seen: FloatArray, work: FloatArray
) -> tuple[float, float]:
    """Evidence of a board in two lines that were read from opposite sides, and how far behind the first one lies, m.

    ``work`` is as :func:`_agreement` leaves it. The two lines are taken to be parallel.
    """
    side = _opposite(first, second, lines, anchors, seen)[2]
    offset = work[0, 4] + work[0, 6] / work[0, 5] * work[1, 4]
    behind = -offset if side == POSITIVE else offset
    return _board_evidence(behind, 1.0 / work[0, 5]), behind


@entry
def share_side(pairs: IntArray, lines: FloatArray, anchors: FloatArray, seen: FloatArray) -> BoolArray:
    """Which of the pairs of lines (k, 2) share a stretch that was read from one side."""
    result = np.empty(len(pairs), dtype=np.bool_)
    for k in range(len(pairs)):
        result[k] = _opposite(pairs[k, 0], pairs[k, 1], lines, anchors, seen)[0] > 0.0
    return result


@compiled
def _is_one_line(
    first: int, second: int, lines: FloatArray, anchors: FloatArray, seen: FloatArray, least: float, kinds: FloatArray,
    work: FloatArray,
) -> bool:  # fmt: skip
    """Whether two lines share a stretch that was read from one side, or are a board."""
    own, opposite, _ = _opposite(first, second, lines, anchors, seen)
    if own >= min(least, opposite):
        return True
    evidence, _ = _compared(first, second, lines, anchors, seen, work)
    return bool(_board_odds(evidence, kinds[0], kinds[1]) > SURE)


@entry
def near_pairs(lines: FloatArray, anchors: FloatArray, ends: FloatArray, limits: FloatArray) -> IntArray:
    """Pairs of lines (k, 2) within limits of offset (m), angle (rad) and overlap (m): ``limits[1:]``."""
    count, pairs = 0, np.empty((len(lines) * (len(lines) - 1) // 2, 2), dtype=np.int64)
    for first in range(len(lines)):
        for second in range(first + 1, len(lines)):
            if _is_near(first, second, lines, anchors, ends, limits):
                pairs[count, 0], pairs[count, 1] = first, second
                count += 1
    return pairs[:count].copy()


@compiled
def _is_near(
    first: int, second: int, lines: FloatArray, anchors: FloatArray, ends: FloatArray, limits: FloatArray
) -> bool:
    turn = (lines[first, 1] - lines[second, 1] + 0.5 * math.pi) % math.pi - 0.5 * math.pi
    if abs(turn) > limits[2]:
        return False
    off, overlap = _apart(first, second, lines, anchors, ends)
    return bool(off <= limits[1] and overlap >= limits[3])


@compiled
def _constrain(first: int, second: int, lines: FloatArray, covariance: FloatArray, work: FloatArray) -> None:
    """Constrain two lines to be equal: a Kalman update of all lines with their difference, which is zero."""
    size = len(covariance)
    gain, crossed = np.zeros((size, 2)), np.zeros((size, 2))
    for row in range(size):
        for j in range(2):
            for i in range(4):
                column = 2 * (first if i < 2 else second) + i % 2
                crossed[row, j] += covariance[row, column] * work[j, i]
        if work[0, 7] != 0.0:
            crossed[row, 0] += covariance[row, 2 * len(lines) + second] * work[0, 7]
        gain[row, 0] = crossed[row, 0] * work[0, 5] + crossed[row, 1] * work[1, 5]
        gain[row, 1] = crossed[row, 0] * work[0, 6] + crossed[row, 1] * work[1, 6]
    for row in range(size):
        if row < 2 * len(lines):
            lines[row // 2, row % 2] -= gain[row, 0] * work[0, 4] + gain[row, 1] * work[1, 4]
        for column in range(size):
            covariance[row, column] -= gain[row, 0] * crossed[column, 0] + gain[row, 1] * crossed[column, 1]


@compiled
def _unite_ends(first: int, second: int, lines: FloatArray, anchors: FloatArray, ends: FloatArray) -> None:
    """Extend the first line to the ends of the second line."""
    nx, ny = math.cos(lines[second, 1]), math.sin(lines[second, 1])
    mx, my = math.cos(lines[first, 1]), math.sin(lines[first, 1])
    for end in range(2):
        x = anchors[second, 0] + lines[second, 0] * nx - ends[second, end] * ny - anchors[first, 0]
        y = anchors[second, 1] + lines[second, 0] * ny + ends[second, end] * nx - anchors[first, 1]
        along = mx * y - my * x
        ends[first, 0], ends[first, 1] = min(ends[first, 0], along), max(ends[first, 1], along)


@compiled
def _has_moved(moves: FloatArray, spread: FloatArray, merged_into: IntArray, most_moved: FloatArray) -> bool:
    for line in range(len(moves)):
        if merged_into[line] == line:
            for part in range(2):
                if abs(moves[line, part]) > most_moved[part] + spread[line, part]:
                    return True
    return False


@compiled
def _difference(
    first: int, second: int, lines: FloatArray, anchors: FloatArray, jacobian: FloatArray
) -> tuple[float, float]:
    """Offset and angle of the first line about the second line's anchor, minus the second line; derivatives (2, 4)."""
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
    first: int, second: int, lines: FloatArray, anchors: FloatArray, covariance: FloatArray, work: FloatArray
) -> tuple[float, float]:
    """Squared Mahalanobis distance of two lines, and the logarithm of the determinant of their difference's covariance.

    On return, ``work`` (2, 8) holds the Jacobian, the difference's offset and angle, its information matrix, and the
    derivative of the offset by the place of the second line's anchor.
    """
    work[0, 4], work[1, 4] = _difference(first, second, lines, anchors, work[:, :4])
    a, b, c = _REGULAR[0], 0.0, _REGULAR[1]
    work[0, 7], place = 0.0, 2 * len(lines) + second
    if len(covariance) > 2 * len(lines):
        by_place = -work[0, 0] * math.sin(lines[first, 1] - lines[second, 1])
        variance = by_place * by_place * covariance[place, place]
        if variance >= KNOWN_PLACE:
            work[0, 7] = by_place
            a += variance
            for i in range(4):
                value = covariance[place, 2 * (first if i < 2 else second) + i % 2]
                a += 2.0 * by_place * value * work[0, i]
                b += by_place * value * work[1, i]
    for i in range(4):
        row = 2 * (first if i < 2 else second) + i % 2
        for j in range(4):
            value = covariance[row, 2 * (first if j < 2 else second) + j % 2]
            a += work[0, i] * value * work[0, j]
            b += work[0, i] * value * work[1, j]
            c += work[1, i] * value * work[1, j]
    determinant = max(a * c - b * b, 1e-30)
    work[0, 5], work[0, 6] = c / determinant, -b / determinant
    work[1, 5], work[1, 6] = -b / determinant, a / determinant
    offset, angle = work[0, 4], work[1, 4]
    squared = (c * offset * offset - 2.0 * b * offset * angle + a * angle * angle) / determinant
    return squared, math.log(determinant)


@compiled
def _apart(first: int, second: int, lines: FloatArray, anchors: FloatArray, ends: FloatArray) -> tuple[float, float]:
    """Distance of the middle of the second line from the first line, m, and the length of their overlap, m."""
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
