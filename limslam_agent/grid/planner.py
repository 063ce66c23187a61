"""Shortest paths on the occupancy grid by Dijkstra's algorithm."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_TIGHT = 20.0
# A step where no wall is in sight costs this many times as much.
_OPEN = 3.0


class Clearance(NamedTuple):
    """Distances from occupied cells by which a step costs more, m."""

    # Within this, a step costs many times as much. It is not forbidden, because cells are coarse,
    # and a passage that looks too narrow may be the only one.
    radius: float
    comfort: float  # further distance within which a step costs up to three times as much
    coast: float = math.inf  # distance beyond which a step costs three times as much


@dataclass(frozen=True, eq=False)
class Routes:
    """Least-cost paths from one cell to all others.

    Attributes
    ----------
    cost
        Cost of the path to each cell (rows, columns), m, increased near walls; infinite for
        unreachable cells.
    predecessors
        Flat index of the cell before each cell on its path (k,); negative for none.
    """

    cost: FloatArray
    predecessors: IntArray

    def path_to(self, cell: tuple[int, int]) -> IntArray:
        """Cells (k, 2) as (row, column) from the robot to a reachable cell."""
        columns = self.cost.shape[1]
        path = [cell[0] * columns + cell[1]]
        while (index := int(self.predecessors[path[-1]])) >= 0:
            path.append(index)
        return np.column_stack(np.divmod(np.array(path[::-1]), columns))


def routes(
    grid: GridView,
    start: FloatArray,
    clearance: Clearance,
    *,
    targets: BoolArray | None = None,
    extra: FloatArray | None = None,
    closed: BoolArray | None = None,
) -> Routes:
    """Least-cost paths from a place (2,), m, over free cells (E. Dijkstra, "A note on two
    problems", 1959).

    Steps far away from walls cost more, so that a robot that needs walls to know where it is stays
    near them (N. Roy, W. Burgard, D. Fox and S. Thrun, "Coastal navigation", 1999).

    Parameters
    ----------
    grid
        The map.
    start
        Position of the robot (2,), m. Its cell counts as free.
    clearance
        How far from walls a step costs more.
    targets
        Cells (rows, columns) of interest. If given, the search ends when the cheapest of them is
        found, and the cost of cells that are more expensive may be infinite.
    extra
        What the targets cost besides their paths (rows, columns), m, at least 0. Nothing if it is
        left out.
    closed
        Free cells (rows, columns) that paths must not cross.
    """
    from limslam_agent.kernels.paths import search_paths

    row, column = grid.cells(start[None])[0].tolist()
    shape = grid.values.shape
    ways = Routes(np.full(shape, np.inf), np.full(grid.values.size, -1, dtype=np.int32))
    if not (0 <= row < shape[0] and 0 <= column < shape[1]):
        return ways
    open_cells = grid.free if closed is None else grid.free & ~closed
    open_cells[row, column] = True
    away = wall_distance(grid)
    radius, comfort, coast = clearance
    factors = np.where(away > coast, _OPEN, 1.0) + np.where(away < radius, _TIGHT, 0.0)
    factors += 2.0 * np.clip((radius + comfort - away) / comfort, 0.0, 1.0)
    prices = np.where(open_cells, grid.cell * factors, np.inf)
    ends = np.full(shape, np.inf)
    if targets is not None:
        ends[targets] = 0.0 if extra is None else extra[targets]
    search_paths(prices, ends, row * shape[1] + column, ways.cost.ravel(), ways.predecessors)
    return ways


def wall_distance(grid: GridView) -> FloatArray:
    """Distance (rows, columns), m, of each cell's centre from the nearest occupied cell's edge."""
    if not grid.occupied.any():
        return np.full(grid.values.shape, np.inf)
    cells = cv2.distanceTransform(
        (~grid.occupied).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE
    )
    return np.asarray((cells.astype(float) - 0.5) * grid.cell)
