"""Frontiers: where what is free meets what is unknown (Yamauchi 1997)."""

import numpy as np
from scipy import ndimage

from limslam_agent.occupancy import GridView
from limslam_env.geometry import BoolArray

_ALL_AROUND = np.ones((3, 3), dtype=int)


def frontier_cells(grid: GridView, min_size: int, ignored: BoolArray | None = None) -> BoolArray:
    """Free cells (rows, columns) with an unknown one beside them, in groups of at least ``min_size``.

    ``ignored`` cells are none; what they leave of a group counts by itself.
    """
    # What lies past the grid's edge is unknown too.
    unknown = np.pad(grid.unknown, 1, constant_values=True)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    frontier = grid.free & beside
    if ignored is not None:
        frontier &= ~ignored
    labels, _ = ndimage.label(frontier, structure=_ALL_AROUND)
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(sizes[labels] >= min_size)
