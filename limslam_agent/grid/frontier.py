"""Frontiers: free cells beside unknown ones.

Source: B. Yamauchi, "A frontier-based approach for autonomous exploration", 1997.
"""

import numpy as np
from scipy import ndimage

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_ALL_AROUND = np.ones((3, 3), dtype=int)


def frontier_cells(grid: GridView, min_size: int, ignored: BoolArray | None = None) -> BoolArray:
    """Free cells (rows, columns) beside an unknown cell, in groups of at least ``min_size``.

    Cells that are ``ignored`` (rows, columns) are no frontiers, and the others are grouped without them.
    """
    # Cells beyond the grid are unknown.
    unknown = np.pad(grid.unknown, 1, constant_values=True)
    found = grid.free & (unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:])
    if ignored is not None:
        found &= ~ignored
    labels, _ = ndimage.label(found, structure=_ALL_AROUND)
    return np.asarray(found & (np.bincount(labels.ravel()) >= min_size)[labels])


def group_of(frontier: BoolArray, cell: IntArray) -> IntArray:
    """The cells (n, 2) of the group that a cell (2,), row and column, belongs to."""
    labels, _ = ndimage.label(frontier, structure=_ALL_AROUND)
    return np.argwhere(labels == labels[tuple(cell)])


def group_places(grid: GridView, frontier: BoolArray) -> FloatArray:
    """For each group of frontier cells (rows, columns) the centre (n, 2), m, of the cell nearest to its middle."""
    labels, count = ndimage.label(frontier, structure=_ALL_AROUND)
    places = [_middle(np.argwhere(labels == label)) for label in range(1, count + 1)]
    return grid.centres(np.array(places, dtype=np.int64).reshape(-1, 2))


def _middle(cells: IntArray) -> IntArray:
    return np.asarray(cells[int(np.argmin(np.hypot(*(cells - cells.mean(axis=0)).T)))])
