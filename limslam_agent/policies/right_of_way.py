"""How robots of a team stay out of each other's way: apart in their goals, round each other, and one gives way."""

import math

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import wrap_angle

_PART_WITHIN = 2.5
_PART_WEIGHT = 2.0
_IN_THE_WAY = math.radians(70.0)


def parting(grid: GridView, pose: FloatArray, other_poses: FloatArray, other_goals: FloatArray) -> FloatArray:
    """What to add to the cost (rows, columns), m, of going somewhere, so that robots part.

    Where another robot goes to or stands within 2.5 m, and where another one is nearer than this one at ``pose`` (3,).
    """
    toll = np.zeros(grid.values.shape)
    for place in np.vstack((other_poses[:, :2], other_goals)):
        toll += _PART_WEIGHT * np.clip(_PART_WITHIN - _away(grid, place), 0.0, None)
    own = _away(grid, pose)
    for place in other_poses:
        toll += np.clip(own - _away(grid, place), 0.0, None)
    return toll


def taken_cells(grid: GridView, other_poses: FloatArray, distance: float) -> BoolArray:
    """Cells (rows, columns) whose centres are nearer than ``distance`` (m) to another robot's."""
    taken = np.zeros(grid.values.shape, dtype=bool)
    for place in other_poses:
        taken |= _away(grid, place) < distance
    return taken


def _away(grid: GridView, place: FloatArray) -> FloatArray:
    """How far the cells' centres (rows, columns) lie from a place, of which x and y come first, m."""
    rows, columns = grid.values.shape
    y, x = np.ogrid[0:rows, 0:columns]
    return np.asarray(
        np.hypot(grid.low[0] + (x + 0.5) * grid.cell - place[0], grid.low[1] + (y + 0.5) * grid.cell - place[1])
    )


class Manners:
    """Whether to wait for another robot. Of two the one of the higher index does, for a time.

    Parameters
    ----------
    index
        This robot's place in its team.
    distance
        Between centres, m, within which another robot is in the way.
    patience
        Steps to wait at most, and to go on for before waiting again.
    """

    def __init__(self, index: int, distance: float, patience: int) -> None:
        self._index, self._distance, self._patience = index, distance, patience
        self._count = 0

    def waits(self, pose: FloatArray, other_poses: FloatArray) -> bool:
        """Whether to stand still at ``pose`` (3,) for this step, given all other robots' poses (m, 3) in order."""
        if self._count < 0:
            self._count += 1
            return False
        first = other_poses[: self._index, :2] - pose[:2]
        bearing = wrap_angle(np.arctan2(first[:, 1], first[:, 0]) - pose[2])
        if not ((np.hypot(*first.T) < self._distance) & (np.abs(bearing) < _IN_THE_WAY)).any():
            self._count = 0
            return False
        self._count += 1
        if self._count > self._patience:
            self._count = -self._patience
            return False
        return True
