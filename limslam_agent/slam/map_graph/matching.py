"""Correlative matching: the pose at which the points of one chunk fit best into the grid of
another.

The score of a pose is the mean of the cells at the points, minus a small penalty towards the border
of the window. The score is 1 if all points lie in occupied cells. All poses of a window are
compared, so that no first guess has to be good. The largest cells of small blocks bound the scores
of many poses at once (Olson, "Real-time correlative scan matching", 2009).
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from limslam_agent.slam.map_graph.local_maps import HIT, Cells
from limslam_env.compilation import compiled, entry_of
from limslam_env.geometry import FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

TURN_STEP = math.radians(3.0)
"""Step of the turns of a match, rad."""
_BLOCK = 4  # cells along each side of a block of poses
# cells and turns around the best pose whose scores tell how well it is known
_AROUND_CELLS = 10
_AROUND_TURNS = 5
_PRIOR = 0.05  # penalty of a match at the border of its window, for shift and for turn
_SHARPNESS = 0.25  # from a difference in score to one in log-likelihood, for each point
# least standard deviations of a match, m and rad
_FLOOR_STDS = 0.06, 0.06, math.radians(1.2)
NO_MATCH = -math.inf
LEAST_POINTS = 20
"""Fewer points are not matched, since they fit nearly anywhere. By ``_SHARPNESS``, a perfect fit of
20 points is only e^5 = 150 times as likely as a fit in unknown cells, and a search compares
thousands of poses.
"""
FAR_CELLS = 60
"""Cells by which points are shifted to see how well a match is known."""
_FALL = 3.0  # the loss of log-likelihood at a few standard deviations, as of a box beside a wall
SEEN = 1.0 / 3.0
"""Share of the points that have to lie in known cells after a shift, to tell whether they fit
there.
"""
UNKNOWN_STD = 30.0
"""Standard deviation of a match along a direction in which nothing speaks against any shift, m."""


class SearchGrid(NamedTuple):
    """A chunk's grid, prepared for searches."""

    cells: Cells  # cells (n, n), padded on all sides by the size of the window
    # The largest cell (b, b, k, k) of a square of b cells, by the first cell of the square: its
    # rest and its quotient by b, along x and y each
    largest: Cells
    low: float  # lowest x and y of the padded grid, m
    cell: float  # side of a cell, m
    margin: int  # largest shift that can be searched, cells

    def at(self, places: FloatArray) -> Cells:
        """The cells (...) at places (..., 2), m. Nothing is known outside of the grid."""
        indices = np.floor((places - self.low) / self.cell).astype(np.int64)
        indices = np.clip(indices, 0, len(self.cells) - 1)
        return self.cells[indices[..., 0], indices[..., 1]]


class Window(NamedTuple):
    """The search window about a first guess: shifts up to ``shift`` (m) along x and y, turns up to
    ``turn`` (rad).
    """

    shift: float
    turn: float


@dataclass(frozen=True, eq=False)
class Match:
    """The best pose (3,) of a chunk in another chunk's frame, and its score.

    The score is ``NO_MATCH`` if every score is too low, or if there are fewer than ``LEAST_POINTS``
    points.
    """

    score: float
    pose: FloatArray


def search_grid(cells: Cells, cell: float, window: float) -> SearchGrid:
    """Prepare the cells (n, n) of a chunk, with sides of ``cell`` m, for windows of up to
    ``window`` m.
    """
    margin = max(int(window / cell + 1e-6), _AROUND_CELLS)
    # A point that lies further outside can be moved nearer, since it still meets only unknown
    # cells.
    padded = np.pad(cells, 2 * margin + 1)
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
    if len(points) < LEAST_POINTS:
        return Match(NO_MATCH, guess)
    turns = int(window.turn / TURN_STEP + 1e-6)
    score, turn, x, y = _best(grid, points, guess, (margin, turns), least)
    if score <= least:
        return Match(NO_MATCH, guess)
    return Match(score, guess + np.array([x * grid.cell, y * grid.cell, turn * TURN_STEP]))


def match_covariance(
    grid: SearchGrid, points: FloatArray, pose: FloatArray, backward: tuple[SearchGrid, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3) of a match, from the scores of all poses around it.

    The likelihood of a pose is exp(``_SHARPNESS`` times the number of points times the score).
    Along the direction that is known least, only cells that are known speak against a pose.
    ``backward`` has the grid of the chunk of the points and the points of the chunk of the grid,
    which speak against poses as well.
    """
    scores = _scores_around(grid, points, pose)
    weight = np.exp((scores - scores.max()) * len(points) * _SHARPNESS)
    weight /= weight.sum()
    middle = np.array([_AROUND_TURNS, _AROUND_CELLS, _AROUND_CELLS])
    steps = np.moveaxis(np.indices(scores.shape), 0, -1) - middle
    offsets = (steps * [TURN_STEP, grid.cell, grid.cell])[..., [1, 2, 0]].reshape(-1, 3)
    mean = weight.ravel() @ offsets
    apart = offsets - mean
    pose = pose + mean
    covariance = (apart * weight.reshape(-1, 1)).T @ apart + np.diag(np.square(_FLOOR_STDS))
    along = least_known(covariance)
    missing = variance_along(lost_along(grid, points, pose, backward, along), grid.cell)
    missing -= along @ covariance @ along
    return pose, covariance + max(missing, 0.0) * np.outer(along, along)


def least_known(covariance: FloatArray) -> FloatArray:
    """The direction (3,), without a turn, along which a pose with a covariance (3, 3) is known
    least.
    """
    return np.append(np.linalg.eigh(covariance[:2, :2])[1][:, 1], 0.0)


def lost_along(
    grid: SearchGrid,
    points: FloatArray,
    pose: FloatArray,
    backward: tuple[SearchGrid, FloatArray],
    along: FloatArray,
) -> FloatArray:
    """As :func:`_lost`, of the points of both chunks of a match."""
    turned = se2.compose(np.array([0.0, 0.0, -pose[2]]), along)
    return _lost(grid, points, pose, along) + _lost(*backward, se2.inverse(pose), -turned)


def _scores_around(grid: SearchGrid, points: FloatArray, pose: FloatArray) -> FloatArray:
    """Scores (turns, cells along x, cells along y) of all poses around a pose."""
    size = 2 * _AROUND_CELLS + 1
    turns = range(-_AROUND_TURNS, _AROUND_TURNS + 1)
    sums = np.zeros((len(turns), size, size), dtype=np.int16)
    for turn, own in zip(turns, sums, strict=True):
        _add_cells(grid, points, pose + np.array([0.0, 0.0, turn * TURN_STEP]), own)
    return np.asarray(sums / (HIT * len(points)))


def _lost(grid: SearchGrid, points: FloatArray, pose: FloatArray, along: FloatArray) -> FloatArray:
    """How many points (2, 2 ``FAR_CELLS`` + 1) no longer fit if all are shifted along a direction
    (3,), cell by cell, and how many tell.

    Two chunks of one corridor fit best where they overlap most, since unknown cells count for
    nothing in a score. That says nothing about the distance along the corridor, so only points
    count here that lie in known cells before and after a shift.
    """
    shifts = grid.cell * np.arange(-FAR_CELLS, FAR_CELLS + 1)[:, None] * along[:2]
    cells = grid.at(se2.transform_points(pose, points)[:, None] + shifts)
    unshifted = cells[:, [FAR_CELLS]]
    tells = (cells != 0) & (unshifted != 0)
    return np.array([(tells * (unshifted - cells)).sum(axis=0) / HIT, tells.sum(axis=0)])


def variance_along(both: FloatArray, cell: float) -> float:
    """Variance, m^2, from the points that are lost, and those that tell, after shifts
    (2, 2 ``FAR_CELLS`` + 1) to both sides.

    Along equal rooms, the likelihood falls and rises again. All matches there have the same rivals,
    so together they tell no more than one of them.
    """
    lost, tells = both
    is_less = _SHARPNESS * lost >= _FALL
    has_seen = tells >= SEEN * tells[FAR_CELLS]
    sides = (is_less & has_seen)[FAR_CELLS::-1], (is_less & has_seen)[FAR_CELLS:]
    falls = [int(np.argmax(side)) for side in sides]
    rivals = np.abs(np.flatnonzero(~is_less & has_seen) - FAR_CELLS)
    if not all(falls) or rivals.max() > max(falls):
        return UNKNOWN_STD**2
    return (cell * max(falls)) ** 2 / (2.0 * _FALL)


@compiled
def _add_rows(sums: NDArray[np.int16], cells: Cells, row: int, column: int) -> None:
    """Add a patch of cells that begins at a given row and column to sums of the same shape."""
    for a in range(sums.shape[0]):
        line = cells[row + a, column : column + sums.shape[1]]
        total = sums[a]
        for b in range(sums.shape[1]):
            total[b] += line[b]


@compiled
def _find_cells(
    grid: SearchGrid, points: FloatArray, pose: FloatArray, margin: int, out: IntArray
) -> None:
    """Cells (k, 2) of points at a pose, moved to at least ``margin`` cells from the border, and
    then by ``-margin`` cells.
    """
    cos = np.cos(pose[2])
    sin = np.sin(pose[2])
    last = len(grid.cells) - 1 - 2 * margin
    for k in range(len(points)):
        x = cos * points[k, 0] - sin * points[k, 1] + pose[0] - grid.low
        y = sin * points[k, 0] + cos * points[k, 1] + pose[1] - grid.low
        out[k, 0] = min(max(int(np.floor(x / grid.cell)) - margin, 0), last)
        out[k, 1] = min(max(int(np.floor(y / grid.cell)) - margin, 0), last)


@kernel
def _add_cells(
    grid: SearchGrid, points: FloatArray, pose: FloatArray, sums: NDArray[np.int16]
) -> None:
    """Add the cells at points at a pose to sums (2 m + 1, 2 m + 1), for all shifts by up to m
    cells.
    """
    cells = np.empty((len(points), 2), np.int64)
    _find_cells(grid, points, pose, len(sums) // 2, cells)
    for i, j in cells:
        _add_rows(sums, grid.cells, i, j)


@kernel
def _best(
    grid: SearchGrid,
    points: FloatArray,
    guess: FloatArray,
    steps: tuple[int, int],
    least: float,
) -> tuple[float, int, int, int]:
    """Score, turn in steps and shifts in cells of the best pose of a window of so many cells and
    turns to each side; ``least`` if no score is above it.
    """
    margin, turns = steps
    best = least
    best_turn = 0
    best_x = 0
    best_y = 0
    by_shift = _PRIOR / (margin * margin + 1.0)
    by_turn = _PRIOR / (turns * turns + 1.0)
    whole = 5.0 * len(points)
    count = (2 * margin + _BLOCK) // _BLOCK
    bounds = np.empty((count, count), np.int16)
    cells = np.empty((len(points), 2), np.int64)
    pose = guess.copy()
    for turn in range(-turns, turns + 1):
        pose[2] = guess[2] + turn * TURN_STEP
        _find_cells(grid, points, pose, margin, cells)
        bounds[:] = 0
        for i, j in cells:
            _add_rows(bounds, grid.largest[i % _BLOCK, j % _BLOCK], i // _BLOCK, j // _BLOCK)
        for a, b in np.ndindex(count, count):
            if bounds[a, b] / whole - by_turn * turn * turn <= best:
                continue
            for x in range(_BLOCK * a, min(_BLOCK * (a + 1), 2 * margin + 1)):
                for y in range(_BLOCK * b, min(_BLOCK * (b + 1), 2 * margin + 1)):
                    total = 0
                    for i, j in cells:
                        total += grid.cells[i + x, j + y]
                    off = (x - margin) ** 2 + (y - margin) ** 2
                    score = total / whole - by_shift * off - by_turn * turn * turn
                    if score > best:
                        best = score
                        best_turn = turn
                        best_x = x - margin
                        best_y = y - margin
    return best, best_turn, best_x, best_y
