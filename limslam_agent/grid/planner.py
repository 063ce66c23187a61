"""Dijkstra on the occupancy grid: what it costs to get anywhere, and the way there."""

import functools
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse import csgraph

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_TIGHT = 20.0
# A step in each of these directions, its length in cells; the slots 7 to 4 hold the same steps backwards.
_STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2.0**0.5), (1, -1, 2.0**0.5))
# No way is this long. Steps of infinite cost are left out of a search with any limit, and of no other.
_ANYWHERE = 1e15
_WIDER = 2.5


@dataclass(frozen=True, eq=False)
class Routes:
    """Least-cost ways from one cell to all others.

    Attributes
    ----------
    cost
        (rows, columns), m, more near walls; infinite where the robot cannot get.
    predecessors
        For each cell, by flat index, the one before it on its way; negative for none.
    """

    cost: FloatArray
    predecessors: IntArray

    def path_to(self, cell: tuple[int, int]) -> IntArray:
        """Cells (k, 2) as (row, column) from the robot to a reachable cell."""
        columns = self.cost.shape[1]
        index = cell[0] * columns + cell[1]
        path = [index]
        while (index := int(self.predecessors[index])) >= 0:
            path.append(index)
        rows, cols = np.divmod(np.array(path[::-1]), columns)
        return np.column_stack((rows, cols))


def routes(
    grid: GridView,
    start: FloatArray,
    radius: float,
    comfort: float,
    *,
    targets: BoolArray | None = None,
    closed: BoolArray | None = None,
) -> Routes:
    """Dijkstra (1959) from a place (2,), m, over free cells.

    Parameters
    ----------
    grid
        The map.
    start
        Where the robot is. Its cell counts as free: it is there.
    radius
        Distance from occupied cells within which a step costs many times as much, m. It is not forbidden:
        cells are coarse, and a passage that looks too narrow may be the only one.
    comfort
        Further distance within which a step costs up to three times as much, m.
    targets
        Cells (rows, columns) of interest. With them the search ends when the cheapest one is found: what costs
        more than that one may then be left at infinity.
    closed
        Cells (rows, columns) that are not to be driven over though they are free.
    """
    row, column = (int(index) for index in grid.cells(start[None])[0])
    open_cells = grid.free if closed is None else grid.free & ~closed
    rows, columns = open_cells.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return Routes(np.full(open_cells.shape, np.inf), np.full(open_cells.size, -1))
    open_cells[row, column] = True
    distance = wall_distance(grid)
    toll = 1.0 + 2.0 * np.clip((radius + comfort - distance) / comfort, 0.0, 1.0) + _TIGHT * (distance < radius)
    graph = _graph(open_cells, toll * grid.cell)
    cost, predecessors = _search(graph, row * columns + column, targets, grid)
    return Routes(cost.reshape(rows, columns), predecessors)


def wall_distance(grid: GridView) -> FloatArray:
    """Distance (rows, columns), m, of each cell's centre from the nearest occupied cell's edge."""
    occupied = grid.occupied
    if not occupied.any():
        return np.full(grid.values.shape, np.inf)
    cells = cv2.distanceTransform((~occupied).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray((cells.astype(float) - 0.5) * grid.cell)


def _graph(open_cells: BoolArray, toll: FloatArray) -> "sparse.csr_array[Any, Any]":
    """Each cell's steps to its eight neighbours; those that cannot be taken have infinite cost."""
    rows, columns = open_cells.shape
    price = np.where(open_cells, toll, np.inf)
    weights = np.full((rows, columns, 8), np.inf)
    for slot, (down, right, length) in enumerate(_STEPS):
        here = (slice(0, rows - down), slice(max(-right, 0), columns - max(right, 0)))
        there = (slice(down, rows), slice(max(right, 0), columns - max(-right, 0)))
        step = 0.5 * length * (price[here] + price[there])
        if down and right:
            # No cutting of corners: between two occupied cells that touch, the wall goes on.
            step[~(open_cells[here[0], there[1]] & open_cells[there[0], here[1]])] = np.inf
        weights[(*here, slot)] = step
        weights[(*there, 7 - slot)] = step
    indices, pointers = _neighbours(rows, columns)
    return sparse.csr_array((weights.reshape(-1), indices, pointers), shape=(rows * columns, rows * columns))


@functools.lru_cache(maxsize=4)
def _neighbours(rows: int, columns: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Columns and row pointers of a grid's graph, for grids of one size; past the edge stands any cell."""
    ahead = np.array([down * columns + right for down, right, _ in _STEPS])
    offsets = np.concatenate((ahead, -ahead[::-1]))
    size = rows * columns
    indices = np.clip(np.arange(size)[:, None] + offsets, 0, size - 1).astype(np.int32).reshape(-1)
    return indices, np.arange(0, 8 * size + 1, 8, dtype=np.int32)


def _search(
    graph: "sparse.csr_array[Any, Any]", start: int, targets: BoolArray | None, grid: GridView
) -> tuple[FloatArray, IntArray]:
    """Costs and predecessors by flat index. Wider and wider round the start, until a target is found."""
    wanted = np.zeros(0, dtype=np.int64) if targets is None else np.flatnonzero(targets)
    limit = _ANYWHERE
    if wanted.size:
        columns = grid.values.shape[1]
        away = np.hypot(wanted // columns - start // columns, wanted % columns - start % columns)
        limit = grid.cell * (1.25 * float(away.min()) + 2.0)
    while True:
        cost, predecessors = csgraph.dijkstra(graph, indices=np.array([start]), return_predecessors=True, limit=limit)
        if limit >= _ANYWHERE or np.isfinite(cost[0, wanted]).any():
            return cost[0], predecessors[0]
        limit = limit * _WIDER if limit * _WIDER < grid.cell * grid.values.size else _ANYWHERE
