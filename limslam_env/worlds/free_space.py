"""The free space of a round robot and its reachable regions, as masks on a grid."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from limslam_env.geometry import BoolArray, FloatArray, IntArray

CELL = 0.025
"""Side of a cell of the reachability grid, m; coarser in worlds that would have more than MAX_CELLS
of them.
"""

MAX_CELLS = 4_000_000

# Of the smallest discs: these take two gigabytes.
_MOST_CELLS = 80_000_000

COARSEST = 0.6
"""Largest side of a cell, in radii: neighbouring free centres must not lie on two sides of a
wall.
"""

_EIGHT = np.ones((3, 3), dtype=np.uint8)  # a cell and its eight neighbours
_COUNTED = (
    1_000_000  # cells counted in one go, for each of which bincount makes a number of eight bytes
)


_Labels = np.ndarray[tuple[int, int], np.dtype[np.int32]]


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """A grid over a world, and the cells at whose centres a disc touches no wall.

    Attributes
    ----------
    origin, cell
        Lower left corner of the grid, (2,), m, and side of a cell, m. The grid reaches past the
        walls on all sides.
    free
        (rows, columns), row 0 at the bottom.
    """

    origin: FloatArray
    cell: float
    free: BoolArray

    def centres(self, mask: BoolArray) -> FloatArray:
        """Centres (n, 2) of the cells of a mask over this grid, m, row by row."""
        rows, columns = np.nonzero(mask)
        return _centres(self.origin, self.cell, columns, rows)

    def first_centre(self, mask: BoolArray) -> FloatArray:
        """Centre (2,) of the first cell of a mask that is not empty, m: ``centres(mask)[0]``
        without all the others.
        """
        row, column = divmod(int(np.argmax(mask)), mask.shape[1])
        centre: FloatArray = _centres(self.origin, self.cell, np.array([column]), np.array([row]))[
            0
        ]
        return centre

    def label_of(self, point: FloatArray) -> int:
        """The number of the region that a disc at a point (2,) can reach; 0 where it does not
        fit.
        """
        return int(self.labels_of(point[None])[0])

    def labels_of(self, points: FloatArray) -> IntArray:
        """The number of the region that a disc at each point (n, 2) can reach; 0 where it does not
        fit.
        """
        columns, rows = np.floor((points - self.origin) / self.cell).astype(int).T
        height, width = self.labels.shape
        is_on_grid = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
        found = np.zeros(len(points), dtype=np.int64)
        found[is_on_grid] = self.labels[rows[is_on_grid], columns[is_on_grid]]
        for number in np.flatnonzero(is_on_grid & (found == 0)):
            # A start may stand a fraction of a cell from the nearest free centre.
            row = rows[number]
            column = columns[number]
            near = self.labels[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
            found[number] = near[near > 0][0] if (near > 0).any() else 0
        return found

    def region_of(self, point: FloatArray) -> BoolArray:
        """The cells that a disc at a point (2,) can reach. Empty where it does not fit."""
        label = self.label_of(point)
        return np.asarray((self.labels == label) & (label > 0))

    def largest_closed_region(self) -> BoolArray:
        """The largest connected region that does not reach the border of the grid; may be empty."""
        labels = self.labels
        sizes = np.zeros(int(labels.max()) + 1, dtype=np.int64)
        for part in np.array_split(labels, labels.size // _COUNTED + 1):
            sizes += np.bincount(part.ravel(), minlength=len(sizes))
        sizes[0] = 0
        sizes[self.border_labels] = 0
        return np.asarray(labels == np.argmax(sizes)) if sizes.any() else np.zeros_like(self.free)

    def pockets(self, region: BoolArray) -> BoolArray:
        """The parts of a region that are only reached through gaps which are hardly wider than the
        disc.

        A gap is that narrow if a disc with one cell more of radius does not pass. The cavity of a
        wall whose lines leave a slit is such a part. The largest part of the region is no pocket.
        """
        parts = connected(eroded(region))
        if parts.max() < 2:
            return np.zeros_like(region)
        sizes = np.bincount(parts.ravel())
        sizes[0] = 0
        main = parts == np.argmax(sizes)
        others = _dilated((parts > 0) & ~main)
        return np.asarray(region & others & ~_dilated(main))

    def is_open(self, points: FloatArray) -> BoolArray:
        """Whether a disc at each point (n, 2) does not fit, or can reach the outermost cells,
        beyond every wall.
        """
        labels = self.labels_of(points)
        return np.asarray((labels == 0) | np.isin(labels, self.border_labels))

    @functools.cached_property
    def border_labels(self) -> IntArray:
        """The numbers of the regions that reach the border of the grid, and 0."""
        labels = self.labels
        return np.unique(np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1])))

    @functools.cached_property
    def labels(self) -> _Labels:
        """The number of each cell's connected region, from 1; 0 where the disc does not fit."""
        # Diagonal steps cannot cross a wall: free centres keep a radius away from it on either
        # side.
        return connected(self.free)


def connected(mask: BoolArray) -> _Labels:
    """The number of the region, connected diagonally too, that each cell of a mask is in, from 1; 0
    outside of it.

    Regions are numbered by their first cells, row by row.
    """
    _, labels = cv2.connectedComponentsWithAlgorithm(
        mask.astype(np.uint8), 8, cv2.CV_32S, cv2.CCL_SAUF
    )
    return np.asarray(labels, dtype=np.int32)


def eroded(mask: BoolArray) -> BoolArray:
    """The cells of a mask all of whose eight neighbours are in it; nothing beyond the border of the
    grid is.
    """
    inner = cv2.erode(
        mask.astype(np.uint8), _EIGHT, borderType=cv2.BORDER_CONSTANT, borderValue=(0,)
    )
    return np.asarray(inner, dtype=np.bool_)


def _dilated(mask: BoolArray) -> BoolArray:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), _EIGHT), dtype=np.bool_)


def cell_for(edges: FloatArray, radius: float) -> float:
    """Side of a cell (m) that suits a disc of ``radius`` (m) and the extent of edges (k, 4). Raises
    a ValueError if there would be too many.
    """
    extent = np.ptp(edges.reshape(-1, 2), axis=0) + 4.0 * radius
    area = float(np.prod(extent))
    cell = min(max(CELL, math.sqrt(area / MAX_CELLS)), COARSEST * radius)
    if area > _MOST_CELLS * cell**2:
        raise ValueError(
            f"a robot of {radius:g} m radius is too small for a world of {extent[0]:.0f} x "
            f"{extent[1]:.0f} m"
        )
    return cell


def free_space(
    edges: FloatArray, radius: float, cell: float, polygons: Sequence[FloatArray] = ()
) -> FreeSpace:
    """Mark the cells, of a side ``cell``, m, where a disc fits: ``radius``, m, from every edge and
    outside of polygons.

    ``edges`` (k, 4), m, are all that the disc must not touch, those of the simple polygons, each
    (k, 2), m, among them.
    """
    origin, shape = _grid_around(edges, radius, cell)
    free = np.ones(shape, dtype=bool)
    clear(free, edges, polygons, radius, origin, cell)
    return FreeSpace(origin, cell, free)


def clear(
    free: BoolArray,
    edges: FloatArray,
    polygons: Sequence[FloatArray],
    radius: float,
    origin: FloatArray,
    cell: float,
) -> None:
    """Clear the cells (rows, columns) of a grid whose centres lie less than ``radius`` (m) from an
    edge or inside of a polygon. The grid has its lower left corner at ``origin`` (2,), and ``cell``
    is the side of a cell, m.
    """
    # numba takes long to load, and worlds that are only read do without it.
    from limslam_env.kernels.floor import clear_inside, clear_near_walls

    space = np.array([*origin, cell])
    clear_near_walls(np.array(edges), space, radius, free)
    for polygon in polygons:
        clear_inside(np.array(polygon), space, np.empty(len(polygon)), free)


def _grid_around(
    edges: FloatArray, radius: float, cell: float
) -> tuple[FloatArray, tuple[int, int]]:
    """Lower left corner (2,), m, and rows and columns of a grid of cells (m) that a disc can go
    around edges in.
    """
    low = np.minimum(edges[:, :2], edges[:, 2:]).min(axis=0)
    high = np.maximum(edges[:, :2], edges[:, 2:]).max(axis=0)
    margin = max(2.0 * radius, 3.0 * cell)
    # The grid is shifted by half a cell, since walls tend to stand on round numbers.
    origin = low - margin - 0.5 * cell
    columns, rows = (np.ceil((high + margin - origin) / cell)).astype(int) + 1
    return origin, (int(rows), int(columns))


def _centres(origin: FloatArray, cell: float, columns: IntArray, rows: IntArray) -> FloatArray:
    centres = np.column_stack((columns, rows)).astype(float)
    # In place: in a large world these are hundreds of megabytes.
    centres += 0.5
    centres *= cell
    centres += origin
    return centres
