"""The changes of an occupancy grid from one frame to the next, as runs of cells."""

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import IntArray

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""Kinds of cells."""


class GridChanges:
    """Compares each grid with the one before it.

    Rows and columns of cells count from the origin of the map's frame, so that they remain valid when the grid grows.
    """

    def __init__(self) -> None:
        self._kinds = np.zeros((0, 0), dtype=np.int8)
        self._low = (0, 0)

    def since_last(self, grid: GridView) -> IntArray:
        """Runs (k, 4) of cells that have changed: row, first column, number of cells, and their new kind."""
        kinds = np.where(grid.values > 0, FREE, np.where(grid.values < 0, OCCUPIED, UNKNOWN)).astype(np.int8)
        column, row = np.rint(grid.low / grid.cell).astype(int).tolist()
        low, before, after = _on_common_cells(((row, column), kinds), (self._low, self._kinds))
        self._low, self._kinds = (row, column), kinds
        rows, columns = np.nonzero(before != after)
        if not len(rows):
            return np.zeros((0, 4), dtype=np.int64)
        found = after[rows, columns]
        is_first = np.ones(len(rows), dtype=bool)
        is_first[1:] = (np.diff(rows) != 0) | (np.diff(columns) != 1) | (np.diff(found) != 0)
        firsts = np.flatnonzero(is_first)
        lengths = np.diff(np.append(firsts, len(rows)))
        return np.column_stack((rows[firsts] + low[0], columns[firsts] + low[1], lengths, found[firsts]))


_Placed = tuple[tuple[int, int], "np.ndarray[tuple[int, int], np.dtype[np.int8]]"]


def _on_common_cells(new: _Placed, old: _Placed) -> tuple[IntArray, IntArray, IntArray]:
    """The lowest row and column of two grids, and the old and the new kinds on all cells of both."""
    if not old[1].size:
        old = (new[0], np.zeros_like(new[1]))
    lows = np.array([new[0], old[0]])
    low = lows.min(axis=0)
    high = (lows + np.array([new[1].shape, old[1].shape])).max(axis=0)
    spread = []
    for at, kinds in (old, new):
        every = np.zeros(high - low, dtype=np.int64)
        first, last = at - low, at - low + kinds.shape
        every[first[0] : last[0], first[1] : last[1]] = kinds
        spread.append(every)
    return low, spread[0], spread[1]
