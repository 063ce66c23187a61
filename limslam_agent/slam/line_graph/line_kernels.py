"""Compiled parts of data association: line fits, line ends, best lines, merges of lines, and crossings of walls.

Lines are (d, alpha) about one anchor each, as in :mod:`limslam_agent.slam.line_graph.chain_kernels`. A place along a
line is its distance from the anchor, m.
"""

import math

import numpy as np

from limslam_agent.slam.consistent.wall_extent import BIN
from limslam_agent.slam.line_graph.beam_width import read_share
from limslam_agent.slam.line_graph.chain_kernels import COLUMNS, RANGE, expected_reading
from limslam_agent.slam.line_graph.compilation import compiled, entry
from limslam_env.geometry import BoolArray, FloatArray, IntArray

GRAZING = 0.2
_TRIED_ANGLES = 90
_FITTED = 40  # largest number of a line's readings that are used to fit it
_FAR = 1e9
_OUTLIER = 25.0  # largest squared residual of a reading, divided by the variance; larger residuals are clipped
_REGULAR = (1e-6, 1e-8)  # added to the covariance of the difference of two lines, m^2 and rad^2


@compiled
def ray(pose: FloatArray, beam: FloatArray) -> tuple[float, float, float, float]:
    """Origin of a beam, m, and its direction, in the world frame."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + cos * beam[0] - sin * beam[1], pose[1] + sin * beam[0] + cos * beam[1]
    return x, y, math.cos(pose[2] + beam[2]), math.sin(pose[2] + beam[2])


@entry
def hit_points(
    poses: FloatArray, places: IntArray, beams: FloatArray, distances: FloatArray, points: FloatArray
) -> None:
    """End points of readings, m, and the unit vectors of their beams, as rows of ``points`` (k, 4)."""
    for k in range(len(places)):
        x, y, ux, uy = ray(poses[places[k]], beams[k])
        points[k, 0], points[k, 1] = x + distances[k] * ux, y + distances[k] * uy
        points[k, 2], points[k, 3] = ux, uy


@entry
def fit_lines(points: FloatArray, firsts: IntArray, std: float, lines: FloatArray, anchors: FloatArray) -> None:
    """Fit lines (m, 2) and anchors (m, 2) to points (k, 4) in groups; group i begins at ``firsts[i]``.

    Of many angles, the angle that explains most readings is chosen. Where points lie close together, total least
    squares would fit the noise along the beams instead of the line.
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
        # The distance from the line is the residual along the beam times the cosine.
        weight = 1.0 / max(abs(nx * points[k, 2] + ny * points[k, 3]), GRAZING) ** 2
        total += weight * ((points[k, 0] - anchor[0]) * nx + (points[k, 1] - anchor[1]) * ny)
        weights += weight
    offset, cost = total / weights, 0.0
    for k in range(len(points)):
        cosine = max(abs(nx * points[k, 2] + ny * points[k, 3]), GRAZING)
        away = (points[k, 0] - anchor[0]) * nx + (points[k, 1] - anchor[1]) * ny - offset
        cost += min((away / (cosine * std)) ** 2, _OUTLIER)
    return cost, offset


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
    """Places (k,) where beams should meet their associated lines, m; readings without a line are left out."""
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
    width: float,
    best: IntArray,
    misfits: FloatArray,
) -> None:
    """For each reading, the line (k,) that predicts it best, among the lines that the beam meets near enough.

    Parameters
    ----------
    ends, beyond, width
        Ends (m, 2) of the part of each line that was read, m, the distance beyond the ends at which a beam may meet it,
        and half the opening angle of the beams, rad.
    best, misfits
        Output arrays: the line or -1, and the misfits of the reading to the best and the second line (k, 2), m.
    """
    normals = _normals(lines, anchors)
    for k in range(len(places)):
        best[k], misfits[k, 0], misfits[k, 1] = -1, _FAR, _FAR
        x, y, ux, uy = ray(poses[places[k]], beams[k])
        for line in range(len(lines)):
            nx, ny = normals[line, 0], normals[line, 1]
            cosine, height = nx * ux + ny * uy, normals[line, 2] - nx * x - ny * y
            distance = height / cosine
            if abs(cosine) < GRAZING or distance <= 0.0:
                continue
            along = nx * (y + distance * uy) - ny * (x + distance * ux) - normals[line, 3]
            misfit = abs(distance * read_share(cosine, width) - distances[k])
            if misfit >= misfits[k, 1] or along < ends[line, 0] - beyond or along > ends[line, 1] + beyond:
                continue
            if misfit < misfits[k, 0]:
                misfits[k, 1], misfits[k, 0], best[k] = misfits[k, 0], misfit, line
            else:
                misfits[k, 1] = misfit


@compiled
def _normals(lines: FloatArray, anchors: FloatArray) -> FloatArray:
    """For each line, its normal, and the coordinates of the line and its anchor along normal and direction (m, 4)."""
    result = np.empty((len(lines), 4))
    for line in range(len(lines)):
        nx, ny = math.cos(lines[line, 1]), math.sin(lines[line, 1])
        x, y = anchors[line, 0], anchors[line, 1]
        result[line, 0], result[line, 1] = nx, ny
        result[line, 2], result[line, 3] = lines[line, 0] + nx * x + ny * y, nx * y - ny * x
    return result


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

    On return, ``work`` (2, 8) holds the Jacobian, the difference's offset and angle, and its information matrix.
    """
    work[0, 4], work[1, 4] = _difference(first, second, lines, anchors, work[:, :4])
    a, b, c = _REGULAR[0], 0.0, _REGULAR[1]
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


@entry
def merge_lines(
    lines: FloatArray,
    anchors: FloatArray,
    ends: FloatArray,
    covariance: FloatArray,
    limits: FloatArray,
    most_moved: FloatArray,
    merged_into: IntArray,
) -> int:
    """Merge lines that may be one wall, in the order of likelihood; return the number of merges.

    Every merged pair is a constraint that updates all other lines through their joint covariance. The pair with the
    greatest likelihood is merged first. A pair with a large covariance passes the chi-square test easily, and this is
    weak evidence.

    Parameters
    ----------
    lines, anchors, ends, covariance
        (m, 2), (m, 2), (m, 2) and (2 m, 2 m); lines, ends and covariance are changed.
    limits
        The largest chi-square, offset (m) and angle (rad), and the least overlap (m).
    most_moved
        Merging stops when the change of a line exceeds this, m and rad, and one standard deviation: the problem must
        then be linearised again.
    merged_into
        Output array (m,): for each line, the line that it was merged into, or the line itself if it was not merged.
    """
    begin, work, count = lines.copy(), np.zeros((2, 8)), 0
    spread = np.sqrt(np.diag(covariance)).reshape(-1, 2)
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
            if squared < limits[0] and squared + volume < best:
                best, chosen = squared + volume, k
        if chosen < 0:
            return count
        first, second = pairs[chosen]
        _agreement(first, second, lines, anchors, covariance, work)
        _constrain(first, second, lines, covariance, work)
        _unite_ends(first, second, lines, anchors, ends)
        merged_into[second] = first
        count += 1
        if _has_moved(lines - begin, spread, merged_into, most_moved):
            return count


@entry
def one_sided_runs(misfits: FloatArray, firsts: IntArray, gate: float, longest: int, found: BoolArray) -> None:
    """Find the readings whose residuals have too large a sum for independent errors.

    Parameters
    ----------
    misfits, firsts
        Residuals (k,) in standard deviations, in runs; run i begins at ``firsts[i]``, and the last number is k.
    gate, longest
        Parts of a run with 2 to ``longest`` readings are found whose sum, divided by the root of their number, exceeds
        the gate, the largest first.
    found
        Output array (k,), false at first.
    """
    for run in range(len(firsts) - 1):
        begin, end = firsts[run], firsts[run + 1]
        while True:
            first, last = _largest_sum(misfits[begin:end], found[begin:end], gate, longest)
            if last <= first:
                break
            found[begin + first : begin + last + 1] = True


@compiled
def _largest_sum(misfits: FloatArray, found: BoolArray, gate: float, longest: int) -> tuple[int, int]:
    """First and last reading of the part of a run with the largest sum above a gate; (0, 0) if there is none."""
    best, result = gate, (0, 0)
    for first in range(len(misfits)):
        total = 0.0
        for last in range(first, min(first + longest, len(misfits))):
            if found[last]:
                break
            total += misfits[last]
            size = abs(total) / math.sqrt(last - first + 1.0)
            if last > first and size > best:
                best, result = size, (first, last)
    return result


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
        gain[row, 0] = crossed[row, 0] * work[0, 5] + crossed[row, 1] * work[1, 5]
        gain[row, 1] = crossed[row, 0] * work[0, 6] + crossed[row, 1] * work[1, 6]
    for row in range(size):
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


@entry
def count_crossings(
    poses: FloatArray,
    places: IntArray,
    beams: FloatArray,
    reached: FloatArray,
    lines: FloatArray,
    anchors: FloatArray,
    low: IntArray,
    hits: IntArray,
    margin: float,
    misses: IntArray,
    against: IntArray,
) -> int:
    """Count the beams that passed through lines; return the number of beams that passed through a wall.

    A beam passed through a line if it reached more than ``margin`` beyond it, m along the line's normal. It passed
    through a wall, counted at most once, if other beams ended in that bin of the line and close to the bin on both
    sides.

    Parameters
    ----------
    reached
        Length of the free path of each beam (k,), m.
    low, hits
        First bin (m,) of each line, and the number of beams that ended in each bin (m, b), 0 beyond a line's last bin.
    misses, against
        Counts that are increased: beams that passed through each bin (m, b), and walls of each line (m,) that were
        passed through.
    """
    count, normals = 0, _normals(lines, anchors)
    for k in range(len(places)):
        is_against = False
        x, y, ux, uy = ray(poses[places[k]], beams[k])
        for line in range(len(lines)):
            nx, ny = normals[line, 0], normals[line, 1]
            cosine = nx * ux + ny * uy
            distance = (normals[line, 2] - nx * x - ny * y) / cosine
            if abs(cosine) < GRAZING or distance <= 0.0 or distance + margin / abs(cosine) >= reached[k]:
                continue
            along = nx * (y + distance * uy) - ny * (x + distance * ux) - normals[line, 3]
            place = math.floor(along / BIN) - low[line]
            if place < 0 or place >= hits.shape[1]:
                continue
            misses[line, place] += 1
            if _is_wall(hits[line], place):
                against[line] += 1
                is_against = True
        count += is_against
    return count


@compiled
def _is_wall(hits: IntArray, place: int) -> bool:
    """Whether beams ended in a bin, and in at least one of the two adjacent bins on each side of it."""
    if place < 2 or place >= len(hits) - 2 or hits[place] == 0:
        return False
    return bool(hits[place - 1] + hits[place - 2] > 0 and hits[place + 1] + hits[place + 2] > 0)


@entry
def explain_looks(
    poses: FloatArray,
    places: IntArray,
    beams: FloatArray,
    reached: FloatArray,
    has_hit: BoolArray,
    lines: FloatArray,
    anchors: FloatArray,
    low: IntArray,
    hits: IntArray,
    margin: float,
    width: float,
    misfits: FloatArray,
    best: IntArray,
) -> None:
    """The residual of each look to the walls that its beam meets (k,), m, and the line (k,) that explains it, or -1.

    A beam ends at the first wall that it certainly meets, or before that at the end of a wall that it may just meet.
    Two walls close behind each other therefore explain no more looks than the first of them. A look that met no wall
    has no residual, unless it passed through a wall by more than ``margin``, m along the normal.
    """
    normals = _normals(lines, anchors)
    for k in range(len(places)):
        ray_of_beam = ray(poses[places[k]], beams[k])
        first, line, cosine = _first_sure(ray_of_beam, normals, low, hits)
        if has_hit[k]:
            misfits[k], best[k] = _nearest_before(ray_of_beam, reached[k], first, width, normals, low, hits)
        else:
            went = first + margin / max(cosine, GRAZING) < reached[k]
            misfits[k], best[k] = (_FAR, line) if went else (0.0, -1)


@compiled
def _first_sure(
    beam: tuple[float, float, float, float], normals: FloatArray, low: IntArray, hits: IntArray
) -> tuple[float, int, float]:
    """The distance to the first wall that a beam certainly meets, m, the wall's line, and the cosine."""
    x, y, ux, uy = beam
    first, found, its_cosine = _FAR, -1, 1.0
    for line in range(len(normals)):
        nx, ny = normals[line, 0], normals[line, 1]
        cosine = nx * ux + ny * uy
        distance = (normals[line, 2] - nx * x - ny * y) / cosine
        if abs(cosine) < GRAZING or distance <= 0.0 or distance >= first:
            continue
        along = nx * (y + distance * uy) - ny * (x + distance * ux) - normals[line, 3]
        place = math.floor(along / BIN) - low[line]
        if 0 <= place < hits.shape[1] and _is_wall(hits[line], place):
            first, found, its_cosine = distance, line, abs(cosine)
    return first, found, its_cosine


@compiled
def _nearest_before(
    beam: tuple[float, float, float, float],
    reading: float,
    first: float,
    width: float,
    normals: FloatArray,
    low: IntArray,
    hits: IntArray,
) -> tuple[float, int]:
    """The residual of a reading to the nearest wall that its beam may meet up to ``first``, m."""
    x, y, ux, uy = beam
    misfit, best = _FAR, -1
    for line in range(len(normals)):
        nx, ny = normals[line, 0], normals[line, 1]
        cosine = nx * ux + ny * uy
        distance = (normals[line, 2] - nx * x - ny * y) / cosine
        if abs(cosine) < GRAZING or distance <= 0.0 or distance > first:
            continue
        away = abs(distance * read_share(cosine, width) - reading)
        if away >= misfit:
            continue
        along = nx * (y + distance * uy) - ny * (x + distance * ux) - normals[line, 3]
        place = math.floor(along / BIN) - low[line]
        if -2 < place <= hits.shape[1] and _has_hits(hits[line], place):
            misfit, best = away, line
    return misfit, best


@compiled
def _has_hits(hits: IntArray, place: int) -> bool:
    """Whether beams ended in a bin or in an adjacent bin."""
    return bool(hits[max(place - 1, 0) : place + 2].sum() > 0)
