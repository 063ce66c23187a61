"""Which cells belong to the other robots of a team, so that the robots explore apart."""

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray

_PART_WITHIN = 2.5
_PART_WEIGHT = 2.0


def separation_cost(grid: GridView, pose: FloatArray, other_poses: FloatArray, other_goals: FloatArray) -> FloatArray:
    """Additional cost (rows, columns), m, of each cell as a goal, which makes the robots of a team separate.

    The cost is high within 2.5 m of another robot or of its goal, and where another robot is closer than this one,
    which is at ``pose`` (3,).
    """
    total, own = np.zeros(grid.values.shape), _away(grid, pose)
    for place in (*other_poses, *other_goals):
        total += _PART_WEIGHT * np.clip(_PART_WITHIN - _away(grid, place), 0.0, None)
    for place in other_poses:
        total += np.clip(own - _away(grid, place), 0.0, None)
    return total


def cells_near_robots(grid: GridView, other_poses: FloatArray, distance: float) -> BoolArray:
    """Cells (rows, columns) whose centres are closer than ``distance`` (m) to another robot."""
    return np.asarray(np.any([_away(grid, place) < distance for place in other_poses], axis=0))


def nearer_to_others(grid: GridView, pose: FloatArray, other_poses: FloatArray) -> BoolArray:
    """Cells (rows, columns) that are nearer to another robot than to this one, which is at ``pose`` (3,)."""
    return np.asarray(np.any([_away(grid, place) < _away(grid, pose) for place in other_poses], axis=0))


def _away(grid: GridView, place: FloatArray) -> FloatArray:
    """Distance (rows, columns), m, from the centres of all cells to a place, whose first two numbers are x and y."""
    rows, columns = np.ogrid[0 : grid.values.shape[0], 0 : grid.values.shape[1]]
    x, y = grid.low[0] + (columns + 0.5) * grid.cell, grid.low[1] + (rows + 0.5) * grid.cell
    return np.asarray(np.hypot(x - place[0], y - place[1]))
