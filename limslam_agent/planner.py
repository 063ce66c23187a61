"""Dijkstra on the occupancy grid: what it costs to get anywhere, and the way there."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from limslam_agent.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_TIGHT = 20.0
_STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2.0**0.5), (1, -1, 2.0**0.5))


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


def routes(grid: GridView, start: FloatArray, radius: float, comfort: float) -> Routes:
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
    """
    distance = _wall_distance(grid)
    row, column = grid.cells(start[None])[0]
    open_cells = grid.free.copy()
    if not (0 <= row < open_cells.shape[0] and 0 <= column < open_cells.shape[1]):
        return Routes(np.full(open_cells.shape, np.inf), np.full(open_cells.size, -1))
    open_cells[row, column] = True
    toll = 1.0 + 2.0 * np.clip((radius + comfort - distance) / comfort, 0.0, 1.0) + _TIGHT * (distance < radius)
    return _dijkstra(open_cells, toll * grid.cell, int(row), int(column))


def _wall_distance(grid: GridView) -> FloatArray:
    """Distance (m) of each cell's centre from the nearest occupied cell's edge."""
    if not grid.occupied.any():
        return np.full(grid.values.shape, np.inf)
    distance = ndimage.distance_transform_edt(~grid.occupied, sampling=grid.cell)
    return np.asarray(distance - 0.5 * grid.cell)


def _dijkstra(open_cells: BoolArray, toll: FloatArray, row: int, column: int) -> Routes:
    rows, columns = open_cells.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    starts, ends, weights = [], [], []
    for down, right, length in _STEPS:
        here = (slice(0, rows - down), slice(max(-right, 0), columns - max(right, 0)))
        there = (slice(down, rows), slice(max(right, 0), columns - max(-right, 0)))
        both = open_cells[here] & open_cells[there]
        if down and right:
            # No cutting of corners: between two occupied cells that touch, the wall goes on.
            both &= open_cells[here[0], there[1]] & open_cells[there[0], here[1]]
        starts.append(index[here][both])
        ends.append(index[there][both])
        weights.append(0.5 * length * (toll[here][both] + toll[there][both]))
    graph = sparse.coo_array(
        (np.concatenate(weights), (np.concatenate(starts), np.concatenate(ends))), shape=(index.size, index.size)
    ).tocsr()
    cost, predecessors = csgraph.dijkstra(
        graph, directed=False, indices=index[row, column : column + 1], return_predecessors=True
    )
    return Routes(cost.reshape(rows, columns), predecessors[0])
