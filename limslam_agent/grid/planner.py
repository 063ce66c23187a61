"""Shortest paths on the occupancy grid by Dijkstra's algorithm."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.tables import STEPS
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_TIGHT = 20.0
# A step where no wall is in sight costs this many times as much.
_OPEN = 3.0
# No path is this long. SciPy ignores steps of infinite cost only if a search has a limit.
_ANYWHERE = 1e15
_WIDER = 2.5


@dataclass(frozen=True, eq=False)
class Routes:
    """Least-cost paths from one cell to all others.

    Attributes
    ----------
    cost
        Cost of the path to each cell (rows, columns), m, increased near walls; infinite for unreachable cells.
    predecessors
        Flat index of the cell before each cell on its path (k,), in the part of the grid that was searched; negative
        for none.
    corner, columns
        First row and column of that part, and its number of columns.
    """

    cost: FloatArray
    predecessors: IntArray
    corner: tuple[int, int]
    columns: int

    def path_to(self, cell: tuple[int, int]) -> IntArray:
        """Cells (k, 2) as (row, column) from the robot to a reachable cell."""
        (top, left), columns = self.corner, self.columns
        index = (cell[0] - top) * columns + cell[1] - left
        path = [index]
        while (index := int(self.predecessors[index])) >= 0:
            path.append(index)
        rows, cols = np.divmod(np.array(path[::-1]), columns)
        return np.column_stack((rows + top, cols + left))


def routes(
    grid: GridView,
    start: FloatArray,
    radius: float,
    comfort: float,
    *,
    targets: BoolArray | None = None,
    closed: BoolArray | None = None,
    coast: float = math.inf,
) -> Routes:
    """Least-cost paths from a place (2,), m, over free cells (E. Dijkstra, "A note on two problems", 1959).

    Steps far away from walls cost more, so that a robot that needs walls to know where it is stays near them (N. Roy,
    W. Burgard, D. Fox and S. Thrun, "Coastal navigation", 1999).

    Parameters
    ----------
    grid
        The map.
    start
        Position of the robot (2,), m. Its cell counts as free.
    radius
        Distance from occupied cells within which a step costs many times as much, m. Such steps are not forbidden,
        because cells are coarse, and a passage that looks too narrow may be the only one.
    comfort
        Further distance within which a step costs up to three times as much, m.
    targets
        Cells (rows, columns) of interest. If given, the search ends when the cheapest of them is found, and the cost
        of cells that are more expensive may be infinite.
    closed
        Free cells (rows, columns) that paths must not cross.
    coast
        Distance from occupied cells beyond which a step costs three times as much, m.
    """
    from limslam_agent.kernels.paths import price_cells

    row, column = (int(index) for index in grid.cells(start[None])[0])
    open_cells = grid.free if closed is None else grid.free & ~closed
    rows, columns = open_cells.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return Routes(np.full(open_cells.shape, np.inf), np.full(open_cells.size, -1), (0, 0), columns)
    open_cells[row, column] = True
    prices = np.empty(open_cells.shape)
    price_cells(wall_distance(grid), radius, comfort, coast, grid.cell, _TIGHT, _OPEN, prices)
    wanted = np.zeros(0, dtype=np.int64) if targets is None else np.flatnonzero(targets)
    limit = _first_limit(wanted, (row, column), columns, grid.cell) if wanted.size else _ANYWHERE
    while True:
        ways = _within(open_cells, prices, (row, column), limit, grid.cell)
        if limit >= _ANYWHERE or np.isfinite(ways.cost.flat[wanted]).any():
            return ways
        limit = limit * _WIDER if limit * _WIDER < grid.cell * grid.values.size else _ANYWHERE


def wall_distance(grid: GridView) -> FloatArray:
    """Distance (rows, columns), m, of each cell's centre from the nearest occupied cell's edge."""
    occupied = grid.occupied
    if not occupied.any():
        return np.full(grid.values.shape, np.inf)
    cells = cv2.distanceTransform((~occupied).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray((cells.astype(float) - 0.5) * grid.cell)


def _graph(open_cells: BoolArray, price: FloatArray) -> "sparse.csr_array[Any, Any]":
    """Costs of the steps from each cell to its eight neighbours; infinite for steps that are not possible."""
    from limslam_agent.kernels.paths import price_steps

    rows, columns = open_cells.shape
    weights = np.empty((rows, columns, 2 * len(STEPS)))
    neighbours = np.empty(weights.shape, dtype=np.int32)
    # One kind of array, or the kernel would be compiled for each kind.
    price_steps(np.ascontiguousarray(open_cells), np.ascontiguousarray(price), weights, neighbours)
    pointers = np.arange(0, weights.size + 1, 2 * len(STEPS), dtype=np.int32)
    return sparse.csr_array((weights.ravel(), neighbours.ravel(), pointers), shape=(rows * columns, rows * columns))


def _first_limit(wanted: IntArray, start: tuple[int, int], columns: int, cell: float) -> float:
    """Cost (m) up to which paths are searched first: a little more than that of a straight path to the nearest target.

    ``wanted`` (k,) are the flat indices of the targets.
    """
    away = np.hypot(wanted // columns - start[0], wanted % columns - start[1])
    return cell * (1.25 * float(away.min()) + 2.0)


def _within(open_cells: BoolArray, price: FloatArray, start: tuple[int, int], limit: float, cell: float) -> Routes:
    """Paths up to a cost ``limit`` (m), searched only in the cells that a straight path of this cost can reach.

    ``price`` (rows, columns) is what a step of the length of a cell costs in each cell, m.
    """
    reach = int(min(limit / cell, sum(open_cells.shape))) + 2
    low = max(start[0] - reach, 0), max(start[1] - reach, 0)
    window = tuple(slice(first, place + reach + 1) for first, place in zip(low, start, strict=True))
    rows, columns = (part := open_cells[window]).shape
    begin = (start[0] - low[0]) * columns + start[1] - low[1]
    found, before = csgraph.dijkstra(
        _graph(part, price[window]), indices=np.array([begin]), return_predecessors=True, limit=limit
    )
    cost = np.full(open_cells.shape, np.inf)
    cost[window] = found[0].reshape(rows, columns)
    return Routes(cost, before[0], low, columns)
