"""Frontiers: free cells beside unknown ones.

Source: B. Yamauchi, "A frontier-based approach for autonomous exploration", 1997.
"""

import numpy as np
from scipy import ndimage

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray

_ALL_AROUND = np.ones((3, 3), dtype=int)


def frontier_cells(grid: GridView, min_size: int, ignored: BoolArray | None = None) -> BoolArray:
    """Free cells (rows, columns) beside an unknown cell, in groups of at least ``min_size``.

    Cells that are ``ignored`` (rows, columns) are no frontiers, and the others are grouped without
    them.
    """
    # Cells beyond the grid are unknown.
    unknown = np.pad(grid.unknown, 1, constant_values=True)
    found = grid.free & (
        unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    )
    if ignored is not None:
        found &= ~ignored
    labels, _ = ndimage.label(found, structure=_ALL_AROUND)
    return np.asarray(found & (np.bincount(labels.ravel()) >= min_size)[labels])


def group_places(grid: GridView, frontier: BoolArray) -> FloatArray:
    """The middle (n, 2), m, of each group of frontier cells (rows, columns)."""
    labels, count = ndimage.label(frontier, structure=_ALL_AROUND)
    middles = ndimage.center_of_mass(frontier, labels, np.arange(1, count + 1))
    return grid.centres(np.array(middles).reshape(-1, 2))
