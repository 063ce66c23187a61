"""Rules that keep the robots of a team apart: separate goals, detours, and right of way."""

import math

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.controller import PATIENCE
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

_PART_WITHIN = 2.5
_PART_WEIGHT = 2.0
_IN_THE_WAY = math.radians(70.0)
_BLOCKS = 5.0  # radii: another robot whose centre is nearer blocks the way


def separation_cost(
    grid: GridView,
    pose: FloatArray,
    other_poses: FloatArray,
    other_goals: FloatArray,
    among: BoolArray | None = None,
) -> FloatArray:
    """Additional cost (rows, columns), m, of each cell as a goal, which makes the robots of a team separate.

    The cost is high within 2.5 m of another robot or of its goal, and where another robot is closer than this one,
    which is at ``pose`` (3,). If some cells (rows, columns) are given, ``among``, it is 0 elsewhere.
    """
    total = np.zeros(grid.values.shape)
    if not len(other_poses) and not len(other_goals):
        return total
    rows, columns = np.nonzero(np.ones(total.shape, dtype=bool) if among is None else among)
    from_others = [_away(grid, rows, columns, place) for place in other_poses]
    cost = np.zeros(len(rows))
    for away in (*from_others, *(_away(grid, rows, columns, place) for place in other_goals)):
        cost += _PART_WEIGHT * np.clip(_PART_WITHIN - away, 0.0, None)
    own = _away(grid, rows, columns, pose)
    for away in from_others:
        cost += np.clip(own - away, 0.0, None)
    total[rows, columns] = cost
    return total


def cells_near_robots(grid: GridView, other_poses: FloatArray, distance: float) -> BoolArray:
    """Cells (rows, columns) whose centres are closer than ``distance`` (m) to another robot."""
    taken, reach = np.zeros(grid.values.shape, dtype=bool), math.ceil(distance / grid.cell) + 1
    for row, column, place in zip(*grid.cells(other_poses[:, :2]).T.tolist(), other_poses, strict=True):
        low = max(row - reach, 0), max(column - reach, 0)
        part = taken[low[0] : max(row + reach + 1, 0), low[1] : max(column + reach + 1, 0)]
        rows, columns = np.ogrid[low[0] : low[0] + part.shape[0], low[1] : low[1] + part.shape[1]]
        part |= _away(grid, rows, columns, place) < distance
    return taken


def nearer_to_others(grid: GridView, pose: FloatArray, other_poses: FloatArray) -> BoolArray:
    """Cells (rows, columns) that are nearer to another robot than to this one, which is at ``pose`` (3,)."""
    rows, columns = np.ogrid[0 : grid.values.shape[0], 0 : grid.values.shape[1]]
    nearer, own = np.zeros(grid.values.shape, dtype=bool), _away(grid, rows, columns, pose)
    for place in other_poses:
        nearer |= _away(grid, rows, columns, place) < own
    return nearer


def _away(grid: GridView, rows: IntArray, columns: IntArray, place: FloatArray) -> FloatArray:
    """Distance, m, from the centres of cells to a place, whose first two numbers are x and y."""
    x, y = grid.low[0] + (columns + 0.5) * grid.cell, grid.low[1] + (rows + 0.5) * grid.cell
    return np.asarray(np.hypot(x - place[0], y - place[1]))


class RightOfWay:
    """Decides whether to wait for another robot. Of two robots, the one with the higher index waits for a limited time.

    After that it drives for as long before it waits again.

    Parameters
    ----------
    index
        This robot's place in its team.
    robot
        Body of each robot.
    """

    def __init__(self, index: int, robot: RobotSpec) -> None:
        self._index, self._distance = index, _BLOCKS * robot.radius
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
        if self._count > PATIENCE:
            self._count = -PATIENCE
            return False
        return True
