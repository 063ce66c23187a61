"""Shortest paths on the occupancy grid by Dijkstra's algorithm."""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_TIGHT = 20.0
# A step where no wall is in sight costs this many times as much.
_OPEN = 3.0
# No path is this long.
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
    extra: FloatArray | None = None,
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
    extra
        What the targets cost besides their paths (rows, columns), m, at least 0. Nothing if it is left out.
    closed
        Free cells (rows, columns) that paths must not cross.
    coast
        Distance from occupied cells beyond which a step costs three times as much, m.
    """
    row, column = (int(index) for index in grid.cells(start[None])[0])
    rows, columns = grid.values.shape
    if not (0 <= row < rows and 0 <= column < columns):
        return Routes(np.full(grid.values.shape, np.inf), np.full(grid.values.size, -1), (0, 0), columns)
    wanted = np.zeros(0, dtype=np.int64) if targets is None else np.flatnonzero(targets)
    limit = _first_limit(wanted, (row, column), columns, grid.cell) if wanted.size else _ANYWHERE
    aims = targets if wanted.size else None
    while True:
        ways, nearest = _within(grid, (row, column), limit, (radius, comfort, coast), aims, extra, closed)
        if limit >= _ANYWHERE or nearest <= limit:
            return ways
        limit = limit * _WIDER if limit * _WIDER < grid.cell * grid.values.size else _ANYWHERE


def wall_distance(grid: GridView) -> FloatArray:
    """Distance (rows, columns), m, of each cell's centre from the nearest occupied cell's edge."""
    return _distances(grid.occupied, grid.cell)


def _distances(occupied: BoolArray, cell: float) -> FloatArray:
    if not occupied.any():
        return np.full(occupied.shape, np.inf)
    cells = cv2.distanceTransform((~occupied).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.asarray((cells.astype(float) - 0.5) * cell)


def _first_limit(wanted: IntArray, start: tuple[int, int], columns: int, cell: float) -> float:
    """Cost (m) up to which paths are searched first: a little more than that of a straight path to the nearest target.

    ``wanted`` (k,) are the flat indices of the targets.
    """
    away = np.hypot(wanted // columns - start[0], wanted % columns - start[1])
    return cell * (1.25 * float(away.min()) + 2.0)


def _within(
    grid: GridView, start: tuple[int, int], limit: float, distances: tuple[float, float, float],
    targets: BoolArray | None, extra: FloatArray | None, closed: BoolArray | None,
) -> tuple[Routes, float]:  # fmt: skip
    """Paths up to a cost ``limit`` (m), searched only in the cells that a straight path of this cost can reach.

    The search ends at the cheapest of the targets (rows, columns); its cost, m, is returned, too.
    ``distances`` are radius, comfort and coast of :func:`routes`.
    """
    from limslam_agent.kernels.paths import search_paths

    values = grid.values
    reach = int(min(limit / grid.cell, sum(values.shape))) + 2
    part, low = _window(values.shape, start, reach)
    open_cells = values[part] > 0
    if closed is not None:
        open_cells &= ~closed[part]
    open_cells[start[0] - low[0], start[1] - low[1]] = True
    columns, size = open_cells.shape[1], open_cells.size
    wanted = np.zeros((0, 0), dtype=bool) if targets is None else targets[part].copy()
    added = np.zeros((0, 0)) if extra is None else extra[part].copy()
    cost, before = np.full(open_cells.shape, np.inf), np.full(size, -1, dtype=np.int32)
    nearest = search_paths(
        open_cells, _prices(grid, start, reach, distances), wanted, added,
        (start[0] - low[0]) * columns + start[1] - low[1], limit,
        np.empty(size, dtype=np.int32), np.empty(size, dtype=np.int32), cost.ravel(), before,
    )  # fmt: skip
    everywhere = np.full(values.shape, np.inf)
    everywhere[part] = cost
    return Routes(everywhere, before, low, columns), nearest


def _prices(grid: GridView, place: tuple[int, int], reach: int, distances: tuple[float, float, float]) -> FloatArray:
    """What a step of the length of a cell costs, m, in the cells up to ``reach`` cells from a place.

    Walls farther away than the largest of the ``distances`` that counts change no cost.
    """
    from limslam_agent.kernels.paths import price_cells

    radius, comfort, coast = distances
    counts = max(radius + comfort, coast if math.isfinite(coast) else 0.0)
    around, corner = _window(grid.values.shape, place, reach + math.ceil(counts / grid.cell) + 2)
    part, _ = _window(grid.values.shape, place, reach)
    away = _distances(grid.values[around] < 0, grid.cell)
    prices = np.empty(away.shape)
    price_cells(away, radius, comfort, coast, grid.cell, _TIGHT, _OPEN, prices)
    inner = (slice(each.start - first, each.stop - first) for each, first in zip(part, corner, strict=True))
    return np.ascontiguousarray(prices[tuple(inner)])


def _window(
    shape: tuple[int, ...], place: tuple[int, int], reach: int
) -> tuple[tuple[slice, slice], tuple[int, int]]:  # fmt: skip
    """The part of an array of a shape up to ``reach`` cells from a place, and its first row and column."""
    low = max(place[0] - reach, 0), max(place[1] - reach, 0)
    return (slice(low[0], min(place[0] + reach + 1, shape[0])), slice(low[1], min(place[1] + reach + 1, shape[1]))), low
