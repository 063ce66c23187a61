"""Straight walls, found by a Hough transform of points with normals in windows of distance driven.

Each point votes for the lines through it whose normal is close to the normal of the point. The strongest line is
refined by total least squares, its points are removed, and the next line is searched. In the least-squares problem a
line has two unknowns: a rotation about its centre and an offset.
"""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.config.graph import WallLineConfig
from limslam_agent.slam.graph.key_poses import ERRORS
from limslam_agent.slam.graph.point_links import PointCloud
from limslam_agent.slam.least_squares.normal_equations import NormalEquations
from limslam_env.compilation import entry_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

_OFFSET_BIN = 0.08  # m, of the Hough space
_MAX_ANGLE = math.radians(20.0)  # between the normals of a point and its line
_INFLATION = 2.0  # of the standard deviation of a point about its line


@dataclass(frozen=True, eq=False)
class WallLines:
    """A number l of lines, with k assignments of points to lines.

    Attributes
    ----------
    angles, centres
        Directions of the normals (l,), rad, and centres (l, 2), m.
    points, lines
        Assignments (k,): a point and its line, sorted by line and then by point. A point may belong to one line in each
        window that contains the point.
    """

    angles: FloatArray
    centres: FloatArray
    points: IntArray
    lines: IntArray


def find_lines(cloud: PointCloud, config: WallLineConfig, window: float, tolerance: float) -> WallLines:
    """Lines of points within ``tolerance`` m, in all windows of ``window`` m of driving."""
    end = cloud.travel[-1] if len(cloud.travel) else 0.0
    begins = np.arange(0.0, max(end - 0.5 * window, 1e-3), 0.5 * window)
    spans = np.searchsorted(cloud.travel, np.column_stack((begins, begins + window)))
    return lines_in(cloud.places, cloud.normals, cloud.good, spans, config, tolerance)


def lines_in(
    places: FloatArray,
    normals: FloatArray,
    good: BoolArray,
    spans: IntArray,
    config: WallLineConfig,
    tolerance: float,
) -> WallLines:
    """Lines among the points of each span (w, 2), which is given by its first point and its last point (excluded)."""
    limits = np.array([tolerance, config.min_length, config.max_gap, np.cos(_MAX_ANGLE)])
    bins = round(2.0 * np.pi / config.angle_bin)
    counts = np.array([config.min_points, config.max_lines, config.max_tries, config.spread, bins])
    found = _lines(places, normals, good, spans, counts, limits)
    return WallLines(*found)


def add_lines(equations: NormalEquations, poses: FloatArray, cloud: PointCloud, lines: WallLines, std: float) -> None:
    """Add the distances of points from their lines, with the Geman-McClure kernel, and a weak prior of the lines.

    ``std`` (m) is the standard deviation of a point about its line, before its inflation.
    """
    if not len(lines.angles):
        return
    places = cloud.places[lines.points]
    pairs, hessian, gradient = _line_blocks(
        poses, cloud.key[lines.points], places, lines.lines, lines.angles, lines.centres, std
    )
    first = 3 * len(poses) + ERRORS
    columns = np.hstack((3 * pairs[:, :1] + np.arange(3), first + 2 * pairs[:, 1:] + np.arange(2)))
    equations.add_blocks(columns, hessian, gradient)
    own = first + np.arange(2 * len(lines.angles)).reshape(-1, 2)
    equations.add_blocks(own, np.tile(0.01 * np.eye(2), (len(own), 1, 1)), np.zeros((len(own), 2)))


@kernel
def line_error(pose: FloatArray, place: FloatArray, angle: float, centre: FloatArray, by: FloatArray) -> float:
    """Distance of a point, observed from a pose, to a line; writes the derivatives by pose and line to ``by`` (5,)."""
    nx, ny = np.cos(angle), np.sin(angle)
    dx, dy = place[0] - centre[0], place[1] - centre[1]
    by[0], by[1] = nx, ny
    by[2] = (place[0] - pose[0]) * ny - (place[1] - pose[1]) * nx
    by[3], by[4] = nx * dy - ny * dx, -1.0
    return float(nx * dx + ny * dy)


@kernel
def _line_blocks(
    poses: FloatArray,
    key: IntArray,
    places: FloatArray,
    line: IntArray,
    angles: FloatArray,
    centres: FloatArray,
    std: float,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Sums over points sorted by line and key pose: pairs (k, 2) of key pose and line, (k, 5, 5), (k, 5)."""
    count = 1
    for row in range(1, len(key)):
        count += 0 if key[row] == key[row - 1] and line[row] == line[row - 1] else 1
    pairs = np.empty((count, 2), np.int64)
    hessian, gradient, by = np.zeros((count, 5, 5)), np.zeros((count, 5)), np.empty(5)
    last = -1
    for row in range(len(key)):
        a, b = key[row], line[row]
        if last < 0 or pairs[last, 0] != a or pairs[last, 1] != b:
            last += 1
            pairs[last, 0], pairs[last, 1] = a, b
        error = line_error(poses[a], places[row], angles[b], centres[b], by)
        weight = 1.0 / ((1.0 + (error / (2.0 * std)) ** 2) * std * _INFLATION) ** 2
        for u in range(5):
            gradient[last, u] += weight * by[u] * error
            for v in range(5):
                hessian[last, u, v] += weight * by[u] * by[v]
    return pairs, hessian, gradient


@kernel
def _vote(
    votes: FloatArray, places: FloatArray, turn: float, spread: int, grid: tuple[int, int, float, float], sign: float
) -> None:
    """Add or remove the votes of one point with a normal at ``turn`` rad."""
    bins, width, side, low = grid
    step = 2.0 * np.pi / bins
    middle = int(np.round(turn / step))
    for off in range(-spread, spread + 1):
        angle = (middle + off) * step
        offset = places[0] * np.cos(angle) + places[1] * np.sin(angle)
        column = int(np.floor((offset - low) / side))
        weight = sign * np.exp(-0.125 * off * off)
        row = (middle + off) % bins
        votes[row * width + column] += weight
        votes[row * width + column + 1] += 0.7 * weight
        votes[row * width + column - 1] += 0.7 * weight


@kernel
def _touched(places: FloatArray, turns: FloatArray, spread: int, grid: tuple[int, int, float, float]) -> IntArray:
    """The bins that the points vote for, each bin once."""
    bins, width, side, low = grid
    step = 2.0 * np.pi / bins
    out = np.empty(len(places) * (2 * spread + 1), np.int64)
    count = 0
    for k in range(len(places)):
        middle = int(np.round(turns[k] / step))
        for off in range(-spread, spread + 1):
            angle = (middle + off) * step
            offset = places[k, 0] * np.cos(angle) + places[k, 1] * np.sin(angle)
            out[count] = ((middle + off) % bins) * width + int(np.floor((offset - low) / side))
            count += 1
    return np.unique(out)


@kernel
def _longest_run(along: FloatArray, member: BoolArray, gap: float) -> tuple[int, float, float]:
    """Number of points, begin and end of the run with the most points along a line; larger gaps end a run."""
    spots = np.sort(along[member])
    best, low, high = 0, 0.0, 0.0
    begin = 0
    for k in range(1, len(spots) + 1):
        if k == len(spots) or spots[k] - spots[k - 1] > gap:
            if k - begin > best:
                best, low, high = k - begin, spots[begin], spots[k - 1]
            begin = k
    return best, low, high


@kernel
def fit_line(places: FloatArray, member: BoolArray, nx: float, ny: float) -> tuple[float, float, float, float]:
    """Total least squares of member points: centre and unit normal, oriented towards the side of (nx, ny)."""
    n = mx = my = sxx = syy = sxy = 0.0
    for k in range(len(places)):
        if member[k]:
            n += 1.0
            mx, my = mx + places[k, 0], my + places[k, 1]
    mx, my = mx / n, my / n
    for k in range(len(places)):
        if member[k]:
            dx, dy = places[k, 0] - mx, places[k, 1] - my
            sxx, syy, sxy = sxx + dx * dx, syy + dy * dy, sxy + dx * dy
    angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
    ux, uy = -np.sin(angle), np.cos(angle)
    if ux * nx + uy * ny < 0.0:
        ux, uy = -ux, -uy
    return mx, my, ux, uy


@kernel
def _refine(
    places: FloatArray,
    normals: FloatArray,
    good: BoolArray,
    label: IntArray,
    line: FloatArray,
    min_points: int,
    limits: FloatArray,
) -> tuple[bool, float, float]:
    """Fit a line three times to its longest run; return whether the line is valid, and its ends.

    The line is given by normal x, y and centre x, y.
    """
    member, along = np.empty(len(places), np.bool_), np.empty(len(places))
    low = high = 0.0
    for _turn in range(3):
        nx, ny, cx, cy = line
        for k in range(len(places)):
            dx, dy = places[k, 0] - cx, places[k, 1] - cy
            along[k] = nx * dy - ny * dx
            cosine = nx * normals[k, 0] + ny * normals[k, 1]
            member[k] = label[k] < 0 and good[k] and abs(nx * dx + ny * dy) < limits[0] and cosine > limits[3]
        best, low, high = _longest_run(along, member, limits[2])
        if best < min_points or high - low < limits[1]:
            return False, low, high
        for k in range(len(places)):
            member[k] = member[k] and low <= along[k] <= high
        old_x, old_y = line[2], line[3]
        line[2], line[3], line[0], line[1] = fit_line(places, member, nx, ny)
        shift = line[0] * (line[3] - old_y) - line[1] * (line[2] - old_x)
        low, high = low - shift, high - shift
    return True, low, high


@kernel
def _take(
    places: FloatArray,
    normals: FloatArray,
    turns: FloatArray,
    good: BoolArray,
    label: IntArray,
    number: int,
    line: FloatArray,
    ends: tuple[float, float],
    limits: FloatArray,
    votes: FloatArray,
    spread: int,
    grid: tuple[int, int, float, float],
) -> tuple[int, int]:
    """Label the free points between the ends of a line, also those without a reliable normal, and remove their votes.

    Returns the numbers of labels and of removed votes.
    """
    labelled, removed = 0, 0
    for k in range(len(places)):
        dx, dy = places[k, 0] - line[2], places[k, 1] - line[3]
        along = line[0] * dy - line[1] * dx
        cosine = line[0] * normals[k, 0] + line[1] * normals[k, 1]
        near = abs(line[0] * dx + line[1] * dy) < limits[0] and ends[0] - 0.1 < along < ends[1] + 0.1
        if label[k] < 0 and near and (cosine > limits[3] or not good[k]):
            label[k] = number
            labelled += 1
            if good[k]:
                _vote(votes, places[k], turns[k], spread, grid, -1.0)
                removed += 1
    return labelled, removed


@kernel
def _window(
    places: FloatArray,
    normals: FloatArray,
    good: BoolArray,
    counts: IntArray,
    limits: FloatArray,
    label: IntArray,
    found: FloatArray,
) -> int:
    """Find lines in one window: write the line of each point to ``label``, angle and centre to ``found``."""
    label[:] = -1
    if good.sum() < counts[0]:
        return 0
    mx, my = places[:, 0].mean(), places[:, 1].mean()
    local = np.empty_like(places)
    local[:, 0], local[:, 1] = places[:, 0] - mx, places[:, 1] - my
    turns = np.arctan2(normals[:, 1], normals[:, 0])
    reach = np.sqrt((local**2).sum(axis=1).max()) + 3.0 * _OFFSET_BIN
    width = int(2.0 * reach / _OFFSET_BIN) + 4
    votes = np.zeros(counts[4] * width)
    grid = (counts[4], width, _OFFSET_BIN, -reach)
    chosen = np.nonzero(good)[0]
    touched = _touched(local[chosen], turns[chosen], counts[3], grid)
    for each in chosen:
        _vote(votes, local[each], turns[each], counts[3], grid, 1.0)
    line, lines = np.empty(4), 0
    for _try in range(counts[2]):
        best = int(touched[np.argmax(votes[touched])])
        if lines == counts[1] or votes[best] < 0.6 * counts[0]:
            break
        angle = (best // width) * 2.0 * np.pi / counts[4]
        offset = (best % width + 0.5) * _OFFSET_BIN - reach
        line[0], line[1] = np.cos(angle), np.sin(angle)
        line[2], line[3] = offset * line[0], offset * line[1]
        stands, low, high = _refine(local, normals, good, label, line, counts[0], limits)
        taken = labelled = 0
        if stands:
            labelled, taken = _take(
                local, normals, turns, good, label, lines, line, (low, high), limits, votes, counts[3], grid
            )
        # The last fit of a line may turn it away from all of its points.
        if labelled:
            found[lines, 0] = np.arctan2(line[1], line[0])
            found[lines, 1], found[lines, 2] = line[2] + mx, line[3] + my
            lines += 1
        if not taken:
            votes[best] = 0.0
    return lines


@kernel
def _lines(
    places: FloatArray,
    normals: FloatArray,
    good: BoolArray,
    spans: IntArray,
    counts: IntArray,
    limits: FloatArray,
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    total = 0
    for w in range(len(spans)):
        total += spans[w, 1] - spans[w, 0]
    points, owner, members = np.empty(total, np.int64), np.empty(total, np.int64), 0
    angles, centres, count = np.empty(len(spans) * counts[1]), np.empty((len(spans) * counts[1], 2)), 0
    label, found = np.empty(total, np.int64), np.empty((counts[1], 3))
    for w in range(len(spans)):
        begin, end = spans[w]
        if end - begin < 2 * counts[0]:
            continue
        lines = _window(
            places[begin:end], normals[begin:end], good[begin:end], counts, limits, label[: end - begin], found
        )
        for each in range(lines):
            angles[count + each] = found[each, 0]
            centres[count + each, 0], centres[count + each, 1] = found[each, 1], found[each, 2]
            for k in range(end - begin):
                if label[k] == each:
                    points[members], owner[members] = begin + k, count + each
                    members += 1
        count += lines
    return angles[:count].copy(), centres[:count].copy(), points[:members].copy(), owner[:members].copy()
