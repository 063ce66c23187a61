"""Unfinished borders: stretches where free ground ends, and where the map has no wall.

Free ground ends at faces, the sides that a free cell shares with a cell that is not free. A face is
finished if a wall of the map is drawn there.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray, IntArray

# Steps to the four neighbours of a cell, as (row, column).
_NEIGHBOURS = ((0, 1), (1, 0), (0, -1), (-1, 0))
# Farthest distance, in cells, of a face from a wall that is drawn there: across the wall, if the
# face looks along it, and past the wall's end.
_ACROSS = 1.8
_SIDEWAYS = 0.8
_PAST = 0.5
# A wall and a face look the same way if their normals differ by less than the angle with this
# cosine.
_SAME_WAY = 0.5
# Faces whose middles are at most this many cells apart belong to one stretch.
_JOINED = 1.5
# Radius (m) within which faces count for the direction in which a place of the border looks.
_SMOOTHED = 0.25


@dataclass(frozen=True, eq=False)
class Faces:
    """Sides of cells where free ground ends: their middles (n, 2), m, and unit normals (n, 2) into
    the free ground.
    """

    middles: FloatArray
    normals: FloatArray

    def __len__(self) -> int:
        return len(self.middles)

    def select(self, which: BoolArray) -> "Faces":
        """Some of the faces, chosen by a mask (n,)."""
        return Faces(self.middles[which], self.normals[which])


def border_faces(grid: GridView, ground: BoolArray) -> Faces:
    """All faces of some free cells (rows, columns), ``ground``. Their normals are smoothed along
    the border.
    """
    rows, columns = grid.values.shape
    free = np.zeros((rows + 2, columns + 2), dtype=bool)
    free[1:-1, 1:-1] = grid.values > 0
    cells = []
    normals = []
    for down, right in _NEIGHBOURS:
        beyond = free[1 + down : rows + 1 + down, 1 + right : columns + 1 + right]
        found = np.argwhere(ground & ~beyond)
        cells.append(found)
        normals.append(np.broadcast_to((-right, -down), found.shape))
    raw = np.concatenate(normals).astype(float)
    middles = np.ascontiguousarray(grid.centres(np.concatenate(cells)) - 0.5 * grid.cell * raw)
    return Faces(middles, _smoothed(Faces(middles, raw)))


def reachable_ground(grid: GridView, place: FloatArray) -> BoolArray:
    """Free cells (rows, columns) that are connected to the cell of a place (2,), m. All free cells,
    if it has none.
    """
    free, (row, column) = grid.free, grid.cells(place[None])[0].tolist()
    if not (0 <= row < free.shape[0] and 0 <= column < free.shape[1] and free[row, column]):
        return free
    labels, _ = ndimage.label(free)
    return np.asarray(labels == labels[row, column])


def unfinished_faces(faces: Faces, segments: FloatArray, cell: float) -> BoolArray:
    """Which faces (n,) have none of the walls (m, 4), m, on a grid of cells of a side (m)."""
    spans = segments[:, 2:] - segments[:, :2]
    lengths = np.maximum(np.hypot(*spans.T), 1e-9)
    along_x, along_y = (spans / lengths[:, None]).T
    x, y = np.moveaxis(faces.middles[:, None] - segments[:, :2], -1, 0)
    positions = x * along_x + y * along_y
    looks = np.abs(faces.normals[:, 1:] * along_x - faces.normals[:, :1] * along_y)
    reach = np.where(looks >= _SAME_WAY, _ACROSS * cell, _SIDEWAYS * cell)
    is_beside = (positions >= -_PAST * cell) & (positions <= lengths + _PAST * cell)
    is_drawn = is_beside & (np.abs(x * along_y - y * along_x) <= reach)
    return np.asarray(~is_drawn.any(axis=1))


def in_long_stretches(faces: Faces, least: float, cell: float) -> BoolArray:
    """Which faces (n,) are part of a stretch of at least ``least`` metres.

    Faces that look away from each other are of two stretches, so that a single occupied cell makes
    no stretch.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    first, second = _neighbours(faces, _JOINED * cell, _SAME_WAY)
    size = len(faces)
    joined = coo_array((np.ones(len(first), dtype=bool), (first, second)), shape=(size, size))
    _, stretches = connected_components(joined, directed=False)
    return np.asarray((np.bincount(stretches) * cell >= least)[stretches])


def _smoothed(faces: Faces) -> FloatArray:
    """Unit normals (n, 2): the mean of those of the faces around that do not look the opposite
    way.
    """
    total = faces.normals.copy()
    first, second = _neighbours(faces, _SMOOTHED, 0.0)
    np.add.at(total, first, faces.normals[second])
    np.add.at(total, second, faces.normals[first])
    size = np.hypot(*total.T)[:, None]
    return np.asarray(np.where(size > 1e-9, total / np.maximum(size, 1e-9), faces.normals))


def _neighbours(faces: Faces, reach: float, least: float) -> IntArray:
    """Pairs (2, k) of faces at most ``reach`` apart, m, between whose normals the cosine is at
    least ``least``.
    """
    pairs = cKDTree(faces.middles).query_pairs(reach, output_type="ndarray").T
    first, second = faces.normals[pairs]
    return np.asarray(pairs[:, (first * second).sum(axis=1) >= least])
