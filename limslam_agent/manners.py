"""How robots of a team stay out of each other's way: apart in their goals, round each other, and one gives way."""

import math

import numpy as np

from limslam_agent.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import wrap_angle

_PART_WITHIN = 2.5
_PART_WEIGHT = 2.0
_IN_THE_WAY = math.radians(70.0)


def parting(grid: GridView, pose: FloatArray, other_poses: FloatArray, other_goals: FloatArray) -> FloatArray:
    """What to add to the cost (rows, columns), m, of going somewhere, so that robots part.

    Where another robot goes to or stands within 2.5 m, and where another one is nearer than this one at ``pose`` (3,).
    """
    rows, columns = grid.values.shape
    y, x = np.ogrid[0:rows, 0:columns]
    x, y = grid.low[0] + (x + 0.5) * grid.cell, grid.low[1] + (y + 0.5) * grid.cell
    toll = np.zeros((rows, columns))
    for place in np.vstack((other_poses[:, :2], other_goals)):
        toll += _PART_WEIGHT * np.clip(_PART_WITHIN - np.hypot(x - place[0], y - place[1]), 0.0, None)
    own = np.hypot(x - pose[0], y - pose[1])
    for place in other_poses:
        toll += np.clip(own - np.hypot(x - place[0], y - place[1]), 0.0, None)
    return toll


def taken_cells(grid: GridView, other_poses: FloatArray, distance: float) -> BoolArray:
    """Cells (rows, columns) whose centres are nearer than ``distance`` (m) to another robot's."""
    rows, columns = grid.values.shape
    y, x = np.ogrid[0:rows, 0:columns]
    taken = np.zeros((rows, columns), dtype=bool)
    for place in other_poses:
        away = np.hypot(grid.low[0] + (x + 0.5) * grid.cell - place[0], grid.low[1] + (y + 0.5) * grid.cell - place[1])
        taken |= away < distance
    return taken


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
