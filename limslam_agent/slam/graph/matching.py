"""Correlative matching: the pose at which the points of one chunk fit best into the grid of another.

The score of a pose is the mean of the cells at the points, minus a small penalty towards the border of the window. The
score is 1 if all points lie in occupied cells. The search is exact branch and bound. The maximum over each block of
shifts bounds the scores in the block (Olson, "Real-time correlative scan matching", 2009). A block is divided into
four blocks of half the width only if its bound exceeds the least score (Hess et al., "Real-time loop closure in 2D
LIDAR SLAM", 2016). The smallest blocks are evaluated in the order of their bounds until no bound is better than the
best score.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limslam_agent.slam.graph.local_maps import Cells, LocalMap
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

_VOLUME_CELLS, _VOLUME_TURNS = 10, 5
_BLOCK = 4  # cells: width of the search's smallest blocks
_PRIOR = 0.05  # penalty of a match at the border of its window, for shift and for turn
_SHARPNESS = 0.25  # from a difference in score to one in log-likelihood, for each point
_FLOOR_POSITION, _FLOOR_TURN = 0.06, math.radians(1.2)  # least standard deviations of a match, m and rad
NO_MATCH = -9.0
LEAST_POINTS = 20
"""Fewer points are not matched, since they fit nearly anywhere. By ``_SHARPNESS``, a perfect fit of 20 points is only
e^5 = 150 times as likely as a fit in unknown cells, and a search compares thousands of poses."""
_FAR_CELLS = 60  # by which points are shifted to see how well a match is known
_FALL = 2.0  # the loss of log-likelihood at two standard deviations
_UNKNOWN_STD = 10.0  # m, of a match along a direction in which nothing speaks against any shift

Sums = NDArray[np.int16]
FlatCells = NDArray[np.int8]
IndexArray = NDArray[np.uint64]
Maxima = tuple[Cells, Cells, Cells, Cells]


@dataclass(frozen=True, eq=False)
class SearchGrid:
    """A chunk's grid, prepared for searches.

    Attributes
    ----------
    padded
        Cells (n, n), padded on all sides by the size of the window.
    maxima
        Maxima over blocks of ``width`` cells from each cell on (n, n), over blocks of twice the width from every second
        cell on, over blocks of four times the width from every fourth cell on, and so on.
    width
        Width of the smallest blocks, cells.
    low
        Lowest x and y of the padded grid, m.
    cell
        Side of a cell, m.
    margin
        Largest shift that can be searched, cells.
    """

    padded: Cells
    maxima: Maxima
    width: int
    low: float
    cell: float
    margin: int


@dataclass(frozen=True)
class Window:
    """The search window about a first guess: shifts up to ``shift`` (m) along x and y, turns up to ``turn`` (rad)."""

    shift: float
    turn: float
    turn_step: float


@dataclass(frozen=True, eq=False)
class Match:
    """The best pose (3,) of a chunk in another chunk's frame, and its score.

    The score is ``NO_MATCH`` if every score is too low, or if there are fewer than ``LEAST_POINTS`` points.
    """

    score: float
    pose: FloatArray


def search_grid(chunk: LocalMap, window: float) -> SearchGrid:
    """Prepare a chunk's grid for windows of up to ``window`` m."""
    width = _BLOCK
    margin = max(int(window / chunk.cell + 1e-6), _VOLUME_CELLS)
    # A point that lies further outside can be moved nearer, since it still meets only unknown cells.
    pad = -(-(2 * margin + 2 * width + 2) // width) * width
    size = -(-(len(chunk.grid) + 2 * pad) // width) * width
    padded = np.zeros((size, size), np.int8)
    padded[pad : pad + len(chunk.grid), pad : pad + len(chunk.grid)] = chunk.grid
    return SearchGrid(padded, _maxima_of(padded, width), width, chunk.low - pad * chunk.cell, chunk.cell, margin)


def match(grid: SearchGrid, points: FloatArray, guess: FloatArray, window: Window, least: float) -> Match:
    """The best pose of points (k, 2) within a window about a guess (3,), if its score is above ``least``.

    Raises
    ------
    ValueError
        If the grid was prepared for smaller windows.
    """
    margin = int(window.shift / grid.cell + 1e-6)
    if margin > grid.margin:
        raise ValueError(f"the grid is made for windows of {grid.margin} cells, not {margin}")
    turns = int(window.turn / window.turn_step + 1e-6)
    if len(points) < LEAST_POINTS:
        return Match(NO_MATCH, guess)
    numbers = np.array([grid.low, grid.cell, window.turn_step, _PRIOR, least])
    found = _search(grid.padded, grid.maxima, grid.width, points, guess, margin, turns, numbers)
    return Match(float(found[0]), np.array(found[1:]))


def match_covariance(
    grid: SearchGrid,
    points: FloatArray,
    pose: FloatArray,
    turn_step: float,
    backward: tuple[SearchGrid, FloatArray] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3) of a match, from the scores of all poses around it.

    The likelihood of a pose is exp(``_SHARPNESS`` times the number of points times the score). Along the direction that
    is known least, only cells that are known speak against a pose. ``backward`` has the grid of the chunk of the points
    and the points of the chunk of the grid, which speak against poses as well.
    """
    scores = _volume(grid.padded, points, pose, grid.low, grid.cell, turn_step, _VOLUME_CELLS, _VOLUME_TURNS)
    weight = np.exp((scores - scores.max()) * len(points) * _SHARPNESS)
    weight /= weight.sum()
    turn, x, y = np.indices(scores.shape)
    shifts = [grid.cell * (x - _VOLUME_CELLS), grid.cell * (y - _VOLUME_CELLS), turn_step * (turn - _VOLUME_TURNS)]
    offsets = np.stack(shifts, axis=-1).reshape(-1, 3)
    mean = weight.ravel() @ offsets
    apart = offsets - mean
    floor = np.diag([_FLOOR_POSITION**2, _FLOOR_POSITION**2, _FLOOR_TURN**2])
    pose, covariance = pose + mean, (apart * weight.reshape(-1, 1)).T @ apart + floor
    along = np.append(np.linalg.eigh(covariance[:2, :2])[1][:, 1], 0.0)
    lost = _lost(grid, points, pose, along)
    if backward:
        lost += _lost(*backward, se2.inverse(pose), -se2.compose(np.array([0.0, 0.0, -pose[2]]), along))
    missing = _variance_along(_SHARPNESS * lost, grid.cell) - along @ covariance @ along
    return pose, covariance + max(missing, 0.0) * np.outer(along, along)


def _lost(grid: SearchGrid, points: FloatArray, pose: FloatArray, along: FloatArray) -> FloatArray:
    """How many points (2 ``_FAR_CELLS`` + 1,) no longer fit if all are shifted along a direction (3,), cell by cell.

    Two chunks of one corridor fit best where they overlap most, since unknown cells count for nothing in a score. That
    says nothing about the distance along the corridor, so the points in unknown cells are left out here.
    """
    sums, known = _profile(grid.padded, points, pose, along, grid.low, grid.cell, _FAR_CELLS)
    return sums[_FAR_CELLS] / max(known[_FAR_CELLS], 1.0) * known - sums


def _variance_along(lost: FloatArray, cell: float) -> float:
    """Variance, m^2, from the log-likelihood that is lost by shifts (2 ``_FAR_CELLS`` + 1,) to both sides."""
    falls = [int(np.argmax(side >= _FALL)) for side in (lost[_FAR_CELLS::-1], lost[_FAR_CELLS:])]
    return (cell * max(falls)) ** 2 / (2.0 * _FALL) if all(falls) else _UNKNOWN_STD**2


@kernel
def _maxima_of(padded: Cells, width: int) -> Maxima:
    """Maxima over blocks of four sizes, for blocks that begin at each, every second, fourth and eighth cell."""
    size = len(padded)
    # The maximum over a block is computed from maxima over 2, 4, 8, ... cells.
    maxima, done = padded.copy(), 1
    while done < width:
        more = min(done, width - done)
        for i in range(size):
            for j in range(size - more):
                maxima[i, j] = max(maxima[i, j], maxima[i, j + more])
        for i in range(size - more):
            for j in range(size):
                maxima[i, j] = max(maxima[i, j], maxima[i + more, j])
        done += more
    second = _coarser(maxima, width)
    third = _coarser(second, width)
    return maxima, second, third, _coarser(third, width)


@kernel
def _coarser(maxima: Cells, width: int) -> Cells:
    """Maxima over blocks of twice the width, with half as many entries in each direction.

    An entry holds for all blocks that begin at one of the cells up to the next entry.
    """
    size = -(-len(maxima) // 2)
    coarse = np.zeros((size, size), np.int8)
    for i in range(size):
        for j in range(size):
            most = maxima[2 * i, 2 * j]
            for a in (0, width, width + 1):
                row = min(2 * i + a, len(maxima) - 1)
                for b in (0, width, width + 1):
                    most = max(most, maxima[row, min(2 * j + b, len(maxima) - 1)])
            coarse[i, j] = most
    return coarse


@kernel
def _pixels(
    points: FloatArray, x: float, y: float, turn: float, low: float, cell: float, edge: int, size: int, out: IntArray
) -> None:
    """Cells (k, 2) of points at a pose, moved to at least ``edge`` cells from the border."""
    cos, sin = np.cos(turn), np.sin(turn)
    for k in range(len(points)):
        i = int(np.floor((cos * points[k, 0] - sin * points[k, 1] + x - low) / cell))
        j = int(np.floor((sin * points[k, 0] + cos * points[k, 1] + y - low) / cell))
        out[k, 0], out[k, 1] = min(max(i, edge), size - 1 - edge), min(max(j, edge), size - 1 - edge)


@kernel
def _add_rows(sums: Sums, cells: Cells, row: int, column: int) -> None:
    """Add a patch of cells that begins at a given row and column to sums of the same shape."""
    for a in range(sums.shape[0]):
        line = cells[row + a, column : column + sums.shape[1]]
        total = sums[a]
        for b in range(sums.shape[1]):
            total[b] += line[b]


@kernel
def _bound(maxima: FlatCells, places: IndexArray, first: int, least: float) -> float:
    """Sum of the maxima over a block of shifts; any upper limit of the sum if it cannot exceed ``least``.

    The maximum for each point lies ``first`` entries after its place.
    """
    total, count, begin = 0, len(places), 0
    while begin < count:
        end = min(begin + 32, count)
        for k in range(begin, end):
            total += maxima[places[k] + np.uint64(first)]
        begin = end
        if total + 5 * (count - begin) <= least:
            break
    return total + 5.0 * (count - begin)


@kernel
def _places(maxima: Cells, pixels: IntArray, margin: int, stride: int, out: IndexArray) -> None:
    """Index of each point (k,) at the shift (-margin, -margin) in maxima of every ``stride`` th cell."""
    for k in range(len(pixels)):
        i, j = (pixels[k, 0] - margin) // stride, (pixels[k, 1] - margin) // stride
        out[k] = i * maxima.shape[1] + j


@kernel
def _promising(
    maxima: Maxima, width: int, pixels: IntArray, margin: int, least: float, blocks: IntArray, bounds: FloatArray
) -> int:
    """Write the smallest blocks (k, 2) whose sums can exceed ``least``, and their bounds (k,); return their number."""
    found, end, waiting = 0, 2 * margin + 1, 0
    places, flat = (
        np.empty((4, len(pixels)), np.uint64),
        (maxima[0].ravel(), maxima[1].ravel(), maxima[2].ravel(), maxima[3].ravel()),
    )
    for level in range(4):
        _places(maxima[level], pixels, margin, 1 << level, places[level])
    top = 8 * width
    stack = np.empty(((end // top + 1) ** 2 + 16, 3), np.int64)
    for x in range(0, end, top):
        for y in range(0, end, top):
            stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = x, y, 3
            waiting += 1
    while waiting:
        waiting -= 1
        x, y, level = stack[waiting]
        bound = _bound(flat[level], places[level], (x >> level) * maxima[level].shape[1] + (y >> level), least)
        if bound <= least:
            continue
        if level == 0:
            blocks[found, 0], blocks[found, 1], bounds[found] = x - margin, y - margin, bound
            found += 1
            continue
        half = width << (level - 1)
        for u in range(x, min(x + 2 * half, end), half):
            for v in range(y, min(y + 2 * half, end), half):
                stack[waiting, 0], stack[waiting, 1], stack[waiting, 2] = u, v, level - 1
                waiting += 1
    return found


@kernel
def _open(padded: Cells, pixels: IntArray, first_x: int, first_y: int, sums: Sums) -> None:
    """Compute the sums of the cells for all shifts in a block."""
    sums[:] = 0
    for k in range(len(pixels)):
        _add_rows(sums, padded, pixels[k, 0] + first_x, pixels[k, 1] + first_y)


@kernel
def _best_in_block(
    sums: Sums, full: float, first: tuple[int, int], margin: int, by_shift: float
) -> tuple[float, int, int]:
    """The best score in an opened block, and its shift."""
    best, best_x, best_y = -9.0, 0, 0
    for u in range(sums.shape[0]):
        for v in range(sums.shape[1]):
            x, y = first[0] + u, first[1] + v
            score = sums[u, v] / full - by_shift * (x * x + y * y)
            if score > best and x <= margin and y <= margin:
                best, best_x, best_y = score, x, y
    return best, best_x, best_y


@kernel
def _search(
    padded: Cells,
    maxima: Maxima,
    width: int,
    points: FloatArray,
    guess: FloatArray,
    margin: int,
    turns: int,
    numbers: FloatArray,
) -> tuple[float, float, float, float]:
    """Score, x, y and turn of the best pose; the score is -9 if no score exceeds the least score."""
    low, cell, turn_step, prior, least = numbers
    size, count = padded.shape[0], len(points)
    across, angles = (2 * margin) // width + 1, 2 * turns + 1
    full, edge = 5.0 * count, margin + width
    by_shift, by_turn = prior / (margin * margin + 1.0), prior / (turns * turns + 1.0)
    pixels = np.empty((angles, count, 2), np.int64)
    blocks, bounds = np.empty((across * across * angles, 2), np.int64), np.empty(across * across * angles)
    turn_of, worth = np.empty(len(bounds), np.int64), 0
    for t in range(angles):
        _pixels(points, guess[0], guess[1], guess[2] + (t - turns) * turn_step, low, cell, edge, size, pixels[t])
        penalty = by_turn * (t - turns) ** 2
        more = _promising(maxima, width, pixels[t], margin, (least + penalty) * full, blocks[worth:], bounds[worth:])
        for place in range(worth, worth + more):
            bounds[place], turn_of[place] = bounds[place] / full - penalty, t
        worth += more
    best, best_x, best_y, best_turn, found = least, 0, 0, 0, False
    inner = np.empty((width, width), np.int16)
    for place in np.argsort(-bounds[:worth]):
        if bounds[place] <= best:
            break
        t, first = turn_of[place], (blocks[place, 0], blocks[place, 1])
        _open(padded, pixels[t], first[0], first[1], inner)
        score, x, y = _best_in_block(inner, full, first, margin, by_shift)
        score -= by_turn * (t - turns) ** 2
        if score > best:
            best, best_x, best_y, best_turn, found = score, x, y, t - turns, True
    if not found:
        best = -9.0
    return best, guess[0] + best_x * cell, guess[1] + best_y * cell, guess[2] + best_turn * turn_step


@kernel
def _volume(
    padded: Cells,
    points: FloatArray,
    pose: FloatArray,
    low: float,
    cell: float,
    turn_step: float,
    cells: int,
    turns: int,
) -> FloatArray:
    """Scores (2 turns + 1, 2 cells + 1, 2 cells + 1) of all poses in a window around a given pose."""
    wide, count, size = 2 * cells + 1, len(points), padded.shape[0]
    scores = np.empty((2 * turns + 1, wide, wide))
    pixels, sums = np.empty((count, 2), np.int64), np.empty((wide, wide), np.int16)
    for t in range(2 * turns + 1):
        _pixels(points, pose[0], pose[1], pose[2] + (t - turns) * turn_step, low, cell, cells, size, pixels)
        sums[:] = 0
        for k in range(count):
            _add_rows(sums, padded, pixels[k, 0] - cells, pixels[k, 1] - cells)
        scores[t] = sums / (5.0 * count)
    return scores


@kernel
def _profile(
    padded: Cells, points: FloatArray, pose: FloatArray, direction: FloatArray, low: float, cell: float, cells: int
) -> tuple[FloatArray, FloatArray]:
    """Sums of the cells at points that are moved along a direction, as shares of hits, and numbers of known cells.

    Both have the shape (2 cells + 1,), from the shift by ``-cells`` cells on.
    """
    sums, known = np.zeros(2 * cells + 1), np.zeros(2 * cells + 1)
    pixels, size = np.empty((len(points), 2), np.int64), padded.shape[0]
    for t in range(2 * cells + 1):
        shift = cell * (t - cells)
        x, y = pose[0] + shift * direction[0], pose[1] + shift * direction[1]
        _pixels(points, x, y, pose[2], low, cell, 0, size, pixels)
        for k in range(len(points)):
            value = padded[pixels[k, 0], pixels[k, 1]]
            sums[t] += value / 5.0
            known[t] += 1.0 if value else 0.0
    return sums, known
