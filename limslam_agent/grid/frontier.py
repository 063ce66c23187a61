"""Frontiers: free cells beside unknown ones.

Source: B. Yamauchi, "A frontier-based approach for autonomous exploration", 1997.
"""

import numpy as np
from scipy import ndimage

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_ALL_AROUND = np.ones((3, 3), dtype=int)


def frontier_cells(
    grid: GridView, min_size: int, ignored: BoolArray | None = None, *, close_gaps: bool = False, pocket: int = 1
) -> BoolArray:
    """Free cells (rows, columns) beside an unknown cell, in groups of at least ``min_size``.

    Parameters
    ----------
    grid
        The map.
    min_size
        Least number of cells of a group.
    ignored
        Cells (rows, columns) that are not frontiers. The remaining cells are grouped without them.
    close_gaps
        Whether a single unknown cell between two occupied cells counts as wall, because it is only a gap between beams.
    pocket
        Least number of cells of an unknown region that makes frontiers.
    """
    from limslam_agent.kernels.regions import mark_frontier

    # One kind of array, or the kernel would be compiled for each kind: views are read-only and not contiguous.
    values = np.array(grid.values)
    if ignored is None:
        ignored = np.zeros((0, 0), dtype=bool)
    unknown = np.ones((values.shape[0] + 2, values.shape[1] + 2), dtype=bool)
    beside, chosen = np.empty(values.shape, dtype=bool), np.empty(values.shape, dtype=bool)
    found = np.empty((max(min_size, pocket, 1), 2), dtype=np.int64)
    mark_frontier(values, ignored, min_size, pocket, close_gaps, unknown, beside, chosen, found)
    return chosen


def group_of(frontier: BoolArray, cell: IntArray) -> IntArray:
    """The cells (n, 2) of the group that a cell (2,), row and column, belongs to."""
    labels, _ = ndimage.label(frontier, structure=_ALL_AROUND)
    return np.argwhere(labels == labels[tuple(cell)])


def group_places(grid: GridView, frontier: BoolArray) -> FloatArray:
    """For each group of frontier cells (rows, columns) the centre (n, 2), m, of the cell nearest to its middle."""
    labels, count = ndimage.label(frontier, structure=_ALL_AROUND)
    places = [_middle(np.argwhere(labels == label)) for label in range(1, count + 1)]
    return grid.centres(np.array(places, dtype=np.int64).reshape(-1, 2))


def sight_begins(grid: GridView, path: FloatArray, distance: float) -> int:
    """Index of the first point of a path (k, 2), m, whose end is visible from there within ``distance``, m."""
    away = np.hypot(*(path - path[-1]).T)
    shares = np.linspace(0.0, 1.0, 2 * int(distance / grid.cell) + 2)[:, None]
    place = len(path) - 1
    while place > 0 and away[place - 1] <= distance:
        cells = grid.cells(path[place - 1] + shares * (path[-1] - path[place - 1]))
        if not (grid.values[cells[:, 0], cells[:, 1]] > 0).all():
            break
        place -= 1
    return place


def _middle(cells: IntArray) -> IntArray:
    return np.asarray(cells[int(np.argmin(np.hypot(*(cells - cells.mean(axis=0)).T)))])
