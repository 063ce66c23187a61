"""Rules that keep the robots of a team apart: separate goals, detours, and right of way."""

import math

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import wrap_angle

_PART_WITHIN = 2.5
_PART_WEIGHT = 2.0
_IN_THE_WAY = math.radians(70.0)


def separation_cost(grid: GridView, pose: FloatArray, other_poses: FloatArray, other_goals: FloatArray) -> FloatArray:
    """Additional cost (rows, columns), m, of each cell as a goal, which makes the robots of a team separate.

    The cost is high within 2.5 m of another robot or of its goal, and where another robot is closer than this one,
    which is at ``pose`` (3,).
    """
    cost = np.zeros(grid.values.shape)
    for place in np.vstack((other_poses[:, :2], other_goals)):
        cost += _PART_WEIGHT * np.clip(_PART_WITHIN - _away(grid, place), 0.0, None)
    if not len(other_poses):
        return cost
    own = _away(grid, pose)
    for place in other_poses:
        cost += np.clip(own - _away(grid, place), 0.0, None)
    return cost


def cells_near_robots(grid: GridView, other_poses: FloatArray, distance: float) -> BoolArray:
    """Cells (rows, columns) whose centres are closer than ``distance`` (m) to another robot."""
    taken = np.zeros(grid.values.shape, dtype=bool)
    for place in other_poses:
        taken |= _away(grid, place) < distance
    return taken


def nearer_to_others(grid: GridView, pose: FloatArray, other_poses: FloatArray) -> BoolArray:
    """Cells (rows, columns) that are nearer to another robot than to this one, which is at ``pose`` (3,)."""
    nearer, own = np.zeros(grid.values.shape, dtype=bool), _away(grid, pose)
    for place in other_poses:
        nearer |= _away(grid, place) < own
    return nearer


def _away(grid: GridView, place: FloatArray) -> FloatArray:
    """Distance (rows, columns), m, from each cell's centre to a place, whose first two numbers are x and y."""
    rows, columns = grid.values.shape
    y, x = np.ogrid[0:rows, 0:columns]
    return np.asarray(
        np.hypot(grid.low[0] + (x + 0.5) * grid.cell - place[0], grid.low[1] + (y + 0.5) * grid.cell - place[1])
    )


class RightOfWay:
    """Decides whether to wait for another robot. Of two robots, the one with the higher index waits for a limited time.

    Parameters
    ----------
    index
        This robot's place in its team.
    distance
        Distance between centres, m, below which another robot blocks the way.
    patience
        Largest number of steps to wait, and number of steps to drive before waiting again.
    """

    def __init__(self, index: int, distance: float, patience: int) -> None:
        self._index, self._distance, self._patience = index, distance, patience
        self._count = 0

    def waits(self, pose: FloatArray, other_poses: FloatArray) -> bool:
        """Whether to stand still for this step at ``pose`` (3,). ``other_poses`` (m, 3) are all other robots in
        order.
        """
        if self._count < 0:
            self._count += 1
            return False
        if not self._index:
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
