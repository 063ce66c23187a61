"""The map of a place, as it is matched with another one: straight walls, and the ground that is known to be free."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter
from scipy.spatial import cKDTree

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.line import angle_between
from limslam_env.geometry.segment import distances, lengths, sample

SPACING = 0.10
"""Distance between the points on a wall that are compared, m."""
_CLEAR = 0.20  # m: free ground that is nearer to a wall of the same map does not contradict a wall of the other map


@dataclass(frozen=True, eq=False)
class PlaceMap:
    """Walls and free ground in one frame.

    Attributes
    ----------
    segments
        Walls (k, 4), m.
    points, owners
        Points (p, 2) along the walls, m, and the wall (p,) of each.
    low, cell
        Lower left corner (2,) of the grid, m, and the side of its cells, m.
    clear
        Cells (rows, columns) that are known to be free and are not near a wall of this map, row 0 at the bottom.
    inner
        The cells of these in which there is certainly no wall: no unknown cell and no end of a beam is near.
    """

    segments: FloatArray
    points: FloatArray
    owners: np.ndarray[tuple[int], np.dtype[np.intp]]
    low: FloatArray
    cell: float
    clear: BoolArray
    inner: BoolArray

    @property
    def middle(self) -> FloatArray:
        """Mean of the points (2,), m."""
        return np.asarray(self.points.mean(axis=0))

    @property
    def angles(self) -> FloatArray:
        """Direction of each wall (k,), rad, from 0 to pi."""
        spans = self.segments[:, 2:] - self.segments[:, :2]
        return np.asarray(np.arctan2(spans[:, 1], spans[:, 0]) % np.pi)

    @property
    def length(self) -> float:
        """Length of all walls, m."""
        return float(lengths(self.segments).sum())

    def lies_in(self, cells_of: BoolArray, points: FloatArray) -> BoolArray:
        """Which of the points (n, 2) lie in cells of a mask (rows, columns) over this map."""
        grid = GridView(self.low, self.cell, cells_of.astype(np.int16))
        return np.asarray(grid.values_at(points) > 0)


def place_map(segments: FloatArray, grid: GridView) -> PlaceMap:
    """The map of walls (k, 4), m, and of an occupancy grid in the same frame."""
    points, owners = sample(segments, SPACING) if len(segments) else (np.zeros((0, 2)), np.zeros(0, dtype=np.intp))
    clear, inner = grid.free.copy(), _inner_free(grid)
    cells = np.argwhere(clear)
    if len(cells) and len(segments):
        near = _is_near(grid.centres(cells), points)
        clear[cells[near, 0], cells[near, 1]] = False
    return PlaceMap(segments, points, owners, np.asarray(grid.low), grid.cell, clear, clear & inner)


def _inner_free(grid: GridView) -> BoolArray:
    """Free cells that border on no unknown cell, and are two cells or more from every occupied cell.

    A wall from which no line was extracted yet may lie in the cells that are left out.
    """
    # Cells beyond the grid's edge are unknown.
    unknown = maximum_filter(np.pad(grid.unknown, 1, constant_values=True), size=3)[1:-1, 1:-1]
    return np.asarray(grid.free & ~unknown & ~maximum_filter(grid.occupied, size=5))


def _is_near(centres: FloatArray, points: FloatArray) -> BoolArray:
    """Which centres (n, 2) are near a point of a wall (p, 2)."""
    return np.asarray(cKDTree(points).query(centres, distance_upper_bound=_CLEAR)[0] < _CLEAR)


def wall_distances(points: FloatArray, angles: FloatArray, other: PlaceMap, turn: float) -> FloatArray:
    """Distance of each point (n, 2) to the nearest wall of another map whose direction differs by less than ``turn``.

    The points lie on walls with directions ``angles`` (n,), rad. The distance (n,), m, is infinite without such a wall.
    """
    if not len(other.segments) or not len(points):
        return np.full(len(points), np.inf)
    apart = np.abs(angle_between(angles[:, None] - other.angles))
    return np.asarray(np.where(apart < turn, distances(points, other.segments), np.inf).min(axis=1))
