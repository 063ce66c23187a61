"""Where a round robot fits, and where it can get to: masks on a grid, from wall segments alone."""

import functools
import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.segment import distances

CELL = 0.025
"""Side of a cell of the reachability grid, m; coarser in worlds that would have more than MAX_CELLS of them."""

MAX_CELLS = 4_000_000

COARSEST = 0.6
"""Largest side of a cell, in radii: neighbouring free centres must not lie on two sides of a wall."""


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """A grid over a world and the cells at whose centres a disc touches nothing.

    Attributes
    ----------
    origin
        Lower left corner of the grid, (2,), m. The grid reaches past the walls on all sides.
    cell
        Side of a cell, m.
    free
        (rows, columns), row 0 at the bottom.
    """

    origin: FloatArray
    cell: float
    free: BoolArray

    def centres(self, mask: BoolArray) -> FloatArray:
        """Centres (n, 2) of the cells of a mask over this grid, m, row by row."""
        rows, columns = np.nonzero(mask)
        return self.origin + (np.column_stack((columns, rows)) + 0.5) * self.cell

    def label_of(self, point: FloatArray) -> int:
        """The number of the region that a disc standing at a point (2,) can get to; 0 where it does not fit."""
        column, row = np.floor((point - self.origin) / self.cell).astype(int)
        if not (0 <= row < self.labels.shape[0] and 0 <= column < self.labels.shape[1]):
            return 0
        if self.labels[row, column]:
            return int(self.labels[row, column])
        # A start may stand a fraction of a cell from the nearest free centre.
        near = self.labels[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
        return int(near[near > 0][0]) if (near > 0).any() else 0

    def region_of(self, point: FloatArray) -> BoolArray:
        """The cells that a disc standing at a point (2,) can get to. Empty where it does not fit."""
        label = self.label_of(point)
        return np.asarray((self.labels == label) & (label > 0))

    def largest_closed_region(self) -> BoolArray:
        """The largest connected region that does not reach the border of the grid; may be empty."""
        labels = self.labels
        sizes = np.bincount(labels.ravel())
        sizes[0] = 0
        border = np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1]))
        sizes[np.unique(border)] = 0
        return np.asarray(labels == np.argmax(sizes)) if sizes.any() else np.zeros_like(self.free)

    def reaches_border(self, region: BoolArray) -> bool:
        """Whether a region touches the outermost cells, which lie beyond every wall."""
        return bool(region[0].any() or region[-1].any() or region[:, 0].any() or region[:, -1].any())

    @functools.cached_property
    def labels(self) -> np.ndarray[tuple[int, int], np.dtype[np.int32]]:
        """The number of each cell's connected region, from 1; 0 where the disc does not fit."""
        # Diagonal steps cannot cross a wall: free centres keep a radius away from it on either side.
        labels, _ = ndimage.label(self.free, structure=np.ones((3, 3), dtype=int))
        return np.asarray(labels, dtype=np.int32)


def cell_for(edges: FloatArray, radius: float) -> float:
    """Side of a cell (m) that suits a disc of ``radius`` (m) and the extent of edges (k, 4)."""
    extent = np.ptp(edges.reshape(-1, 2), axis=0) + 4.0 * radius
    return min(max(CELL, math.sqrt(float(np.prod(extent)) / MAX_CELLS)), COARSEST * radius)


def free_space(edges: FloatArray, radius: float, cell: float) -> FreeSpace:
    """Mark in cells of ``cell`` (m) where a disc of ``radius`` (m) fits between edges (k, 4)."""
    low = np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0)
    high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0)
    margin = max(2.0 * radius, 3.0 * cell)
    # Half a cell off the round numbers on which walls tend to stand.
    origin = low - margin - 0.5 * cell
    columns, rows = (np.ceil((high + margin - origin) / cell)).astype(int) + 1
    free = np.ones((rows, columns), dtype=bool)
    for edge in edges:
        _block(free, edge, origin, cell, radius)
    return FreeSpace(origin, cell, free)


def _block(free: BoolArray, edge: FloatArray, origin: FloatArray, cell: float, radius: float) -> None:
    first = np.floor((np.minimum(edge[:2], edge[2:]) - radius - origin) / cell).astype(int)
    last = np.ceil((np.maximum(edge[:2], edge[2:]) + radius - origin) / cell).astype(int) + 1
    (column0, row0), (column1, row1) = np.maximum(first, 0), last
    window = free[row0:row1, column0:column1]
    rows, columns = np.mgrid[0 : window.shape[0], 0 : window.shape[1]]
    centres = origin + (np.column_stack((columns.ravel() + column0, rows.ravel() + row0)) + 0.5) * cell
    window &= (distances(centres, edge[None])[:, 0] >= radius).reshape(window.shape)
