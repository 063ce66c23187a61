"""Choice of the next frontier, and of the path to it."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.frontier import frontier_cells, group_of
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.planner import Routes, routes
from limslam_agent.policies.relocalisation import search_cost
from limslam_agent.policies.separation import separation_cost
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec

# Distance (m) that the planner keeps between the robot's rim and occupied cells unless there is no other path, and
# further distance that it keeps where there is enough space.
_MARGIN, _CLEARANCE = 0.05, 0.15
# In maps larger than this (m), paths stay so near to walls that several beams see them: the second number is the
# share of the beams' reach.
_LARGE, _SIGHT_SHARE = 12.0, 0.7


@dataclass(frozen=True, eq=False)
class Target:
    """A frontier to drive to.

    Attributes
    ----------
    goal
        Centre of the frontier's nearest cell (2,), m.
    aim
        Centre of the unknown cells adjacent to that cell (2,), m.
    size
        Number of cells of the frontier.
    path
        Path to the frontier (k, 2), m.
    """

    goal: FloatArray
    aim: FloatArray
    size: int
    path: FloatArray


def ways_from(
    place: FloatArray, grid: GridView, robot: RobotSpec, *, targets: BoolArray | None = None,
    extra: FloatArray | None = None, closed: BoolArray | None = None,
) -> Routes:  # fmt: skip
    """Paths of a robot from a place (2,), m, that keep away from walls, and in large maps within sight of them.

    ``targets``, ``extra`` and ``closed`` are those of :func:`~limslam_agent.grid.planner.routes`.
    """
    is_large = max(grid.values.shape) * grid.cell > _LARGE
    return routes(
        grid, place, robot.radius + _MARGIN, _CLEARANCE, targets=targets, extra=extra, closed=closed,
        coast=_SIGHT_SHARE * robot.reach if is_large else math.inf,
    )  # fmt: skip


def next_target(belief: Belief, ignored: BoolArray, robot: RobotSpec, config: PolicyConfig) -> Target | None:
    """The frontier of least cost that can be reached. None if there is none.

    Parameters
    ----------
    belief
        What the robot believes.
    ignored
        Cells (rows, columns) in which no goal may lie.
    robot, config
        Body and settings.
    """
    grid = belief.grid
    cells = frontier_cells(grid, config.min_frontier, ignored)
    if not cells.any():
        return None
    extra = separation_cost(grid, belief.pose, belief.other_poses, belief.other_goals)
    extra += search_cost(belief, cells)
    ways = ways_from(belief.pose[:2], grid, robot, targets=cells, extra=extra)
    cost = np.where(cells, ways.cost + extra, np.inf)
    cell = np.array(np.unravel_index(int(np.argmin(cost)), cost.shape))
    if not np.isfinite(cost[tuple(cell)]):
        return None
    path = grid.centres(ways.path_to((int(cell[0]), int(cell[1]))))
    return Target(path[-1], _aim(grid, cell), len(group_of(cells, cell)), path)


def _aim(grid: GridView, cell: IntArray) -> FloatArray:
    """Centre (2,), m, of the unknown cells that are adjacent to a frontier cell (2,)."""
    # Cells beyond the grid are unknown.
    around = np.pad(grid.values, 1)[cell[0] : cell[0] + 3, cell[1] : cell[1] + 3]
    beside = np.argwhere(ndimage.generate_binary_structure(2, 1) & (around == 0)) - 1
    return np.asarray(grid.centres(cell + beside).mean(axis=0))
