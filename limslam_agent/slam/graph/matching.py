"""Correlative matching: where do the points of one chunk fit best into the grid of another?

The score of a pose is the mean of the cells that the points fall on, 1 where all fall on hits, less a small penalty
towards the border of the window. The search is exact branch and bound on two levels: the maximum over each block of
shifts bounds the scores in it (Olson, "Real-time correlative scan matching", 2009), and blocks are opened in the order
of their bounds until no bound is better than the best score. The grid of block maxima is stored by its phase, so that
the bounds of a whole row of blocks lie side by side and are summed up together.
"""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.graph import MatchConfig
from limslam_agent.slam.graph.compilation import kernel
from limslam_agent.slam.graph.local_maps import Cells, LocalMap
from limslam_env.geometry import FloatArray, IntArray

_VOLUME_CELLS, _VOLUME_TURNS = 10, 5
# Rows of bounds are summed up in whole vectors of so many.
_LANES = 16
NO_MATCH = -9.0


@dataclass(frozen=True, eq=False)
class SearchGrid:
    """A chunk's grid made ready for searches.

    Attributes
    ----------
    padded
        (n, n) cells with room for the window all around.
    blocks
        (w, w, r, r): maxima over blocks of w x w cells, by the phase of their first cell.
    low
        Lowest x and y of the padded grid, m.
    cell
        Side of a cell, m.
    margin
        Largest shift that can be searched, cells.
    """

    padded: Cells
    blocks: Cells
    low: float
    cell: float
    margin: int


@dataclass(frozen=True)
class Window:
    """What is searched about a first guess: shifts up to ``shift`` (m) along x and y, turns up to ``turn`` (rad)."""

    shift: float
    turn: float
    turn_step: float


@dataclass(frozen=True, eq=False)
class Match:
    """The best pose (3,) of a chunk in another one's frame, and its score; ``NO_MATCH`` if none is good enough."""

    score: float
    pose: FloatArray


def search_grid(chunk: LocalMap, window: float, config: MatchConfig) -> SearchGrid:
    """Make a chunk's grid ready for windows of up to ``window`` m."""
    width = config.block
    margin = max(int(window / chunk.cell + 1e-6), _VOLUME_CELLS)
    # A point that lies further outside can be moved nearer: it still meets only unknown cells.
    pad = -(-(2 * margin + 2 * width + 2) // width) * width
    # The last row of bounds may be read beyond the window, in whole vectors.
    size = -(-(len(chunk.grid) + 2 * pad) // width) * width + _LANES * width
    padded, blocks = _blocks_of(chunk.grid, pad, size, width)
    return SearchGrid(padded, blocks, chunk.low - pad * chunk.cell, chunk.cell, margin)


def match(
    grid: SearchGrid, points: FloatArray, guess: FloatArray, window: Window, config: MatchConfig, least: float
) -> Match:
    """The best pose of points (k, 2) within a window about a guess (3,), if its score is above ``least``.

    Raises
    ------
    ValueError
        If the grid was not made for so large a window.
    """
    margin = int(window.shift / grid.cell + 1e-6)
    if margin > grid.margin:
        raise ValueError(f"the grid is made for windows of {grid.margin} cells, not {margin}")
    turns = int(window.turn / window.turn_step + 1e-6)
    if not len(points):
        return Match(NO_MATCH, guess)
    numbers = np.array([grid.low, grid.cell, window.turn_step, config.prior, least])
    found = _search(grid.padded, grid.blocks, points, guess, margin, turns, numbers)
    return Match(float(found[0]), np.array(found[1:]))


def match_covariance(
    grid: SearchGrid, points: FloatArray, pose: FloatArray, turn_step: float, config: MatchConfig
) -> tuple[FloatArray, FloatArray]:
    """Mean (3,) and covariance (3, 3) of a match, from the scores of all poses around it.

    Scores are taken for likelihoods: exp of ``sharpness`` times the number of points times the score.
    """
    scores = _volume(grid.padded, points, pose, grid.low, grid.cell, turn_step, _VOLUME_CELLS, _VOLUME_TURNS)
    weight = np.exp((scores - scores.max()) * len(points) * config.sharpness)
    weight /= weight.sum()
    turn, x, y = np.indices(scores.shape)
    shifts = [grid.cell * (x - _VOLUME_CELLS), grid.cell * (y - _VOLUME_CELLS), turn_step * (turn - _VOLUME_TURNS)]
    offsets = np.stack(shifts, axis=-1).reshape(-1, 3)
    mean = weight.ravel() @ offsets
    apart = offsets - mean
    floor = np.diag([config.floor_position**2, config.floor_position**2, config.floor_turn**2])
    return pose + mean, (apart * weight.reshape(-1, 1)).T @ apart + floor


def score_at(grid: SearchGrid, points: FloatArray, pose: FloatArray) -> float:
    """The score of points (k, 2) at one pose (3,), without the penalty."""
    return float(_volume(grid.padded, points, pose, grid.low, grid.cell, 1.0, 0, 0)[0, 0, 0])


@kernel
def _blocks_of(grid: Cells, pad: int, size: int, width: int) -> tuple[Cells, Cells]:
    padded = np.zeros((size, size), np.int8)
    padded[pad : pad + len(grid), pad : pad + len(grid)] = grid
    # The maximum over width cells, by maxima over 2, 4, 8, ... cells.
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
    rows = size // width
    blocks = np.empty((width, width, rows, rows), np.int8)
    for i in range(size):
        for j in range(size):
            blocks[i % width, j % width, i // width, j // width] = maxima[i, j]
    return padded, blocks


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
def _search(
    padded: Cells, blocks: Cells, points: FloatArray, guess: FloatArray, margin: int, turns: int, numbers: FloatArray
) -> tuple[float, float, float, float]:
    """Score, x, y and turn of the best pose; a score of -9 if none is above the least one."""
    low, cell, turn_step, prior, least = numbers
    width, size, count = blocks.shape[0], padded.shape[0], len(points)
    across, angles = (2 * margin) // width + 1, 2 * turns + 1
    full, edge, inside = 5.0 * count, margin + width, size - 16 * width
    by_shift, by_turn = prior / (margin * margin + 1.0), prior / (turns * turns + 1.0)
    pixels = np.empty((angles, count, 2), np.int64)
    bounds = np.empty((angles, across, across), np.float32)
    lanes = -(-across // 16) * 16
    sums = np.empty((across, lanes), np.int16)
    for t in range(angles):
        _pixels(points, guess[0], guess[1], guess[2] + (t - turns) * turn_step, low, cell, edge, inside, pixels[t])
        sums[:] = 0
        for k in range(count):
            i, j = pixels[t, k, 0] - margin, pixels[t, k, 1] - margin
            phase = blocks[i % width, j % width]
            row, column = i // width, j // width
            for a in range(across):
                line = phase[row + a, column : column + lanes]
                total = sums[a]
                for b in range(lanes):
                    total[b] += line[b]
        penalty = by_turn * (t - turns) ** 2
        for a in range(across):
            for b in range(across):
                bounds[t, a, b] = sums[a, b] / full - penalty
    flat = bounds.ravel()
    worth = np.nonzero(flat > least)[0]
    best, best_x, best_y, best_turn = least, 0, 0, 0
    found = False
    inner = np.empty((width, width), np.int16)
    for place in worth[np.argsort(-flat[worth])]:
        if flat[place] <= best:
            break
        t, a, b = place // (across * across), (place // across) % across, place % across
        first_x, first_y = a * width - margin, b * width - margin
        inner[:] = 0
        for k in range(count):
            i, j = pixels[t, k, 0] + first_x, pixels[t, k, 1] + first_y
            for u in range(width):
                line = padded[i + u, j : j + width]
                total = inner[u]
                for v in range(width):
                    total[v] += line[v]
        penalty = by_turn * (t - turns) ** 2
        for u in range(width):
            for v in range(width):
                x, y = first_x + u, first_y + v
                score = inner[u, v] / full - penalty - by_shift * (x * x + y * y)
                if score > best and x <= margin and y <= margin:
                    best, best_x, best_y, best_turn, found = score, x, y, t - turns, True
    if not found:
        best = -9.0
    return best, guess[0] + best_x * cell, guess[1] + best_y * cell, guess[2] + best_turn * turn_step


@kernel
def _volume(
    padded: Cells, points: FloatArray, pose: FloatArray, low: float, cell: float, turn_step: float, cells: int, turns: int
) -> FloatArray:
    """Scores (2 turns + 1, 2 cells + 1, 2 cells + 1) of all poses around one."""
    wide, count, size = 2 * cells + 1, len(points), padded.shape[0]
    scores = np.empty((2 * turns + 1, wide, wide))
    pixels, sums = np.empty((count, 2), np.int64), np.empty((wide, wide), np.int16)
    for t in range(2 * turns + 1):
        _pixels(points, pose[0], pose[1], pose[2] + (t - turns) * turn_step, low, cell, cells, size, pixels)
        sums[:] = 0
        for k in range(count):
            i, j = pixels[k, 0] - cells, pixels[k, 1] - cells
            for u in range(wide):
                line = padded[i + u, j : j + wide]
                total = sums[u]
                for v in range(wide):
                    total[v] += line[v]
        scores[t] = sums / (5.0 * count)
    return scores


