"""Correlative matching: the pose at which the points of one chunk fit best into the grid of
another.

The score of a pose is the mean of the cells at the points, minus a small penalty towards the border
of the window. The score is 1 if all points lie in occupied cells. All poses of a window are
compared, so that no first guess has to be good. The largest cells of small blocks bound the scores
of many poses at once (Olson, "Real-time correlative scan matching", 2009).
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from limslam_agent.slam.map_graph.local_maps import Cells
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

_BLOCK = 4  # cells along each side of a block of poses
_VOLUME_CELLS = 10
_VOLUME_TURNS = 5
_PRIOR = 0.05  # penalty of a match at the border of its window, for shift and for turn
_SHARPNESS = 0.25  # from a difference in score to one in log-likelihood, for each point
# least standard deviations of a match, m and rad
_FLOOR_POSITION = 0.06
_FLOOR_TURN = math.radians(1.2)
NO_MATCH = -math.inf
LEAST_POINTS = 20
"""Fewer points are not matched, since they fit nearly anywhere. By ``_SHARPNESS``, a perfect fit of
20 points is only e^5 = 150 times as likely as a fit in unknown cells, and a search compares
thousands of poses.
"""
_FAR_CELLS = 60  # by which points are shifted to see how well a match is known
_FALL = 2.0  # the loss of log-likelihood at two standard deviations
_UNKNOWN_STD = 10.0  # m, of a match along a direction in which nothing speaks against any shift

Sums = NDArray[np.int16]


@dataclass(frozen=True, eq=False)
class SearchGrid:
    """A chunk's grid, prepared for searches."""

    padded: Cells  # cells (n, n), padded on all sides by the size of the window
    # The largest cell (b, b, k, k) of a square of b cells, by the first cell of the square: its
    # rest and its quotient by b, along x and y each
    largest: Cells
    low: float  # lowest x and y of the padded grid, m
    cell: float  # side of a cell, m
    margin: int  # largest shift that can be searched, cells


@dataclass(frozen=True)
class Window:
    """The search window about a first guess: shifts up to ``shift`` (m) along x and y, turns up to
    ``turn`` (rad).
    """

    shift: float
    turn: float
    turn_step: float


@dataclass(frozen=True, eq=False)
class Match:
    """The best pose (3,) of a chunk in another chunk's frame, and its score.

    The score is ``NO_MATCH`` if every score is too low, or if there are fewer than ``LEAST_POINTS``
    points.
    """

    score: float
    pose: FloatArray


def search_grid(grid: Cells, cell: float, window: float) -> SearchGrid:
    """Prepare the grid (n, n) of a chunk, with cells of ``cell`` m, for windows of up to ``window``
    m.
    """
    margin = max(int(window / cell + 1e-6), _VOLUME_CELLS)
    # A point that lies further outside can be moved nearer, since it still meets only unknown
    # cells.
    pad = 2 * margin + 1
    padded = np.pad(grid, pad)
    return SearchGrid(padded, _largest(padded), -0.5 * cell * len(padded), cell, margin)


def _largest(cells: Cells) -> Cells:
    """The largest cells of squares, as in :class:`SearchGrid`. Cells beyond the border are
    unknown.
    """
    count = len(cells) // _BLOCK + 2
    squares = maximum_filter(cells, _BLOCK, mode="constant", origin=-(_BLOCK // 2))
    squares = np.pad(squares, (0, count * _BLOCK - len(cells)))
    return np.ascontiguousarray(squares.reshape(count, _BLOCK, count, _BLOCK).transpose(1, 3, 0, 2))


def match(
    grid: SearchGrid, points: FloatArray, guess: FloatArray, window: Window, least: float
) -> Match:
    """The best pose of points (k, 2) within a window about a guess (3,), if its score is above
    ``least``.

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
    score, turn, x, y = _best(
        grid.padded,
        grid.largest,
        points,
        guess,
        grid.low,
        grid.cell,
        window.turn_step,
        margin,
        turns,
        least,
    )
    if score <= least:
        return Match(NO_MATCH, guess)
    return Match(score, guess + np.array([x * grid.cell, y * grid.cell, turn * window.turn_step]))


def match_covariance(
    grid: SearchGrid,
    points: FloatArray,
    pose: FloatArray,
    turn_step: float,
    backward: tuple[SearchGrid, FloatArray] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3) of a match, from the scores of all poses around it.

    The likelihood of a pose is exp(``_SHARPNESS`` times the number of points times the score).
    Along the direction that is known least, only cells that are known speak against a pose.
    ``backward`` has the grid of the chunk of the points and the points of the chunk of the grid,
    which speak against poses as well.
    """
    scores = _volume(
        grid.padded, points, pose, grid.low, grid.cell, turn_step, _VOLUME_CELLS, _VOLUME_TURNS
    )
    weight = np.exp((scores - scores.max()) * len(points) * _SHARPNESS)
    weight /= weight.sum()
    turn, x, y = np.indices(scores.shape)
    shifts = [
        grid.cell * (x - _VOLUME_CELLS),
        grid.cell * (y - _VOLUME_CELLS),
        turn_step * (turn - _VOLUME_TURNS),
    ]
    offsets = np.stack(shifts, axis=-1).reshape(-1, 3)
    mean = weight.ravel() @ offsets
    apart = offsets - mean
    floor = np.diag([_FLOOR_POSITION**2, _FLOOR_POSITION**2, _FLOOR_TURN**2])
    pose = pose + mean
    covariance = (apart * weight.reshape(-1, 1)).T @ apart + floor
    along = np.append(np.linalg.eigh(covariance[:2, :2])[1][:, 1], 0.0)
    lost = _lost(grid, points, pose, along)
    if backward:
        lost += _lost(
            *backward, se2.inverse(pose), -se2.compose(np.array([0.0, 0.0, -pose[2]]), along)
        )
    missing = _variance_along(_SHARPNESS * lost, grid.cell) - along @ covariance @ along
    return pose, covariance + max(missing, 0.0) * np.outer(along, along)


def _lost(grid: SearchGrid, points: FloatArray, pose: FloatArray, along: FloatArray) -> FloatArray:
    """How many points (2 ``_FAR_CELLS`` + 1,) no longer fit if all are shifted along a direction
    (3,), cell by cell.

    Two chunks of one corridor fit best where they overlap most, since unknown cells count for
    nothing in a score. That says nothing about the distance along the corridor, so the points in
    unknown cells are left out here.
    """
    sums, known = _profile(grid.padded, points, pose, along, grid.low, grid.cell, _FAR_CELLS)
    return sums[_FAR_CELLS] / max(known[_FAR_CELLS], 1.0) * known - sums


def _variance_along(lost: FloatArray, cell: float) -> float:
    """Variance, m^2, from the log-likelihood that is lost by shifts (2 ``_FAR_CELLS`` + 1,) to both
    sides.
    """
    falls = [int(np.argmax(side >= _FALL)) for side in (lost[_FAR_CELLS::-1], lost[_FAR_CELLS:])]
    return (cell * max(falls)) ** 2 / (2.0 * _FALL) if all(falls) else _UNKNOWN_STD**2


@kernel
def _pixels(
    points: FloatArray,
    x: float,
    y: float,
    turn: float,
    low: float,
    cell: float,
    edge: int,
    size: int,
    out: IntArray,
) -> None:
    """Cells (k, 2) of points at a pose, moved to at least ``edge`` cells from the border."""
    cos = np.cos(turn)
    sin = np.sin(turn)
    for k in range(len(points)):
        i = int(np.floor((cos * points[k, 0] - sin * points[k, 1] + x - low) / cell))
        j = int(np.floor((sin * points[k, 0] + cos * points[k, 1] + y - low) / cell))
        out[k, 0], out[k, 1] = (
            min(max(i, edge), size - 1 - edge),
            min(max(j, edge), size - 1 - edge),
        )


@kernel
def _add_rows(sums: Sums, cells: Cells, row: int, column: int) -> None:
    """Add a patch of cells that begins at a given row and column to sums of the same shape."""
    for a in range(sums.shape[0]):
        line = cells[row + a, column : column + sums.shape[1]]
        total = sums[a]
        for b in range(sums.shape[1]):
            total[b] += line[b]


@kernel
def _sums(
    padded: Cells,
    points: FloatArray,
    x: float,
    y: float,
    turn: float,
    low: float,
    cell: float,
    sums: Sums,
) -> None:
    """Compute the sums of the cells at points at all shifts (2 m + 1, 2 m + 1) about a pose."""
    cells = len(sums) // 2
    size = len(padded)
    pixels = np.empty((len(points), 2), np.int64)
    _pixels(points, x, y, turn, low, cell, cells, size, pixels)
    sums[:] = 0
    for k in range(len(points)):
        _add_rows(sums, padded, pixels[k, 0] - cells, pixels[k, 1] - cells)


@kernel
def _best(
    padded: Cells,
    largest: Cells,
    points: FloatArray,
    guess: FloatArray,
    low: float,
    cell: float,
    turn_step: float,
    margin: int,
    turns: int,
    least: float,
) -> tuple[float, int, int, int]:
    """Score, turn in steps and shifts in cells of the best pose of a window; ``least`` if no score
    is above it.
    """
    best = least
    best_turn = 0
    best_x = 0
    best_y = 0
    by_shift = _PRIOR / (margin * margin + 1.0)
    by_turn = _PRIOR / (turns * turns + 1.0)
    block = len(largest)
    count = (2 * margin + block) // block
    bounds = np.empty((count, count), np.int16)
    pixels = np.empty((len(points), 2), np.int64)
    for turn in range(-turns, turns + 1):
        _pixels(
            points,
            guess[0],
            guess[1],
            guess[2] + turn * turn_step,
            low,
            cell,
            margin,
            len(padded),
            pixels,
        )
        pixels -= margin
        bounds[:] = 0
        for i, j in pixels:
            _add_rows(bounds, largest[i % block, j % block], i // block, j // block)
        for a, b in np.ndindex(count, count):
            if bounds[a, b] / (5.0 * len(points)) - by_turn * turn * turn <= best:
                continue
            for x in range(block * a, min(block * (a + 1), 2 * margin + 1)):
                for y in range(block * b, min(block * (b + 1), 2 * margin + 1)):
                    total = 0
                    for i, j in pixels:
                        total += padded[i + x, j + y]
                    penalty = (
                        by_shift * ((x - margin) ** 2 + (y - margin) ** 2) + by_turn * turn * turn
                    )
                    score = total / (5.0 * len(points)) - penalty
                    if score > best:
                        best = score
                        best_turn = turn
                        best_x = x - margin
                        best_y = y - margin
    return best, best_turn, best_x, best_y


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
    """Scores (2 turns + 1, 2 cells + 1, 2 cells + 1) of all poses in a window around a given
    pose.
    """
    scores = np.empty((2 * turns + 1, 2 * cells + 1, 2 * cells + 1))
    sums = np.empty((2 * cells + 1, 2 * cells + 1), np.int16)
    for t in range(2 * turns + 1):
        _sums(padded, points, pose[0], pose[1], pose[2] + (t - turns) * turn_step, low, cell, sums)
        scores[t] = sums / (5.0 * len(points))
    return scores


@kernel
def _profile(
    padded: Cells,
    points: FloatArray,
    pose: FloatArray,
    direction: FloatArray,
    low: float,
    cell: float,
    cells: int,
) -> tuple[FloatArray, FloatArray]:
    """Sums of the cells at points that are moved along a direction, as shares of hits, and numbers
    of known cells.

    Both have the shape (2 cells + 1,), from the shift by ``-cells`` cells on.
    """
    sums = np.zeros(2 * cells + 1)
    known = np.zeros(2 * cells + 1)
    pixels = np.empty((len(points), 2), np.int64)
    size = padded.shape[0]
    for t in range(2 * cells + 1):
        shift = cell * (t - cells)
        x = pose[0] + shift * direction[0]
        y = pose[1] + shift * direction[1]
        _pixels(points, x, y, pose[2], low, cell, 0, size, pixels)
        for k in range(len(points)):
            value = padded[pixels[k, 0], pixels[k, 1]]
            sums[t] += value / 5.0
            known[t] += 1.0 if value else 0.0
    return sums, known
