"""Frontiers: where what is free meets what is unknown (Yamauchi 1997)."""

import numpy as np
from scipy import ndimage

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_ALL_AROUND = np.ones((3, 3), dtype=int)


def frontier_cells(
    grid: GridView, min_size: int, ignored: BoolArray | None = None, *, close_gaps: bool = False, pocket: int = 1
) -> BoolArray:
    """Free cells (rows, columns) with an unknown one beside them, in groups of at least ``min_size``.

    Parameters
    ----------
    grid
        The map.
    min_size
        Cells of the smallest group.
    ignored
        Cells that are no frontier; what they leave of a group counts by itself.
    close_gaps
        Whether a single unknown cell between two occupied ones counts as wall: beams left it out.
    pocket
        Cells of the smallest unknown region that is worth a look.
    """
    # What lies past the grid's edge is unknown too.
    unknown = np.pad(grid.unknown, 1, constant_values=True)
    if close_gaps:
        unknown &= ~_closed_walls(np.pad(grid.occupied, 1))
    if pocket > 1:
        unknown = _without_small(unknown, pocket)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    frontier = grid.free & beside
    if ignored is not None:
        frontier &= ~ignored
    return _without_small(frontier, min_size)


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
    """From which place of a path (k, 2), m, on its end is seen over free cells, from ``distance`` (m) or less."""
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


def _closed_walls(occupied: BoolArray) -> BoolArray:
    """Cells (rows, columns) between two occupied ones, on opposite sides of them."""
    around = np.pad(occupied, 1)
    rows, columns = occupied.shape
    side = {
        (down, right): around[1 + down : 1 + down + rows, 1 + right : 1 + right + columns]
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
    }
    pairs = [side[way] & side[-way[0], -way[1]] for way in ((0, 1), (1, 0), (1, 1), (1, -1))]
    return np.asarray(pairs[0] | pairs[1] | pairs[2] | pairs[3])


def _without_small(cells: BoolArray, min_size: int) -> BoolArray:
    """The cells in groups, corners touching, of at least ``min_size``."""
    labels, _ = ndimage.label(cells, structure=_ALL_AROUND)
    keep = np.bincount(labels.ravel()) >= min_size
    # The first is what is in no group.
    keep[0] = False
    return np.asarray(keep[labels])
