"""Choice of the next frontier, of the path to it, and of a place from which to look at an unreachable one."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.frontier import frontier_cells, group_of
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.planner import Routes, routes, wall_distance
from limslam_agent.policies.relocalisation import search_cost
from limslam_agent.policies.right_of_way import cells_near_robots, separation_cost
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec

LAST_FRONTIER = 2
"""Least number of cells of a frontier when no larger frontiers are left: in a corridor twice as wide as the robot."""

MARGIN = 0.05
"""Distance that the planner keeps between the robot's rim and occupied cells unless there is no other path, m."""
# Distance (m) that it keeps where there is enough space.
_CLEARANCE = 0.15
# Up to this share of the beams' reach, a wall beside the robot is in sight of more than one beam.
_SIGHT_SHARE = 0.7
# Unknown regions of fewer cells cannot hide an obstacle.
_POCKET = 3
# One metre of wall or unknown cells between a place and its target costs as much as this many metres of path.
_BETWEEN = 3.0
# Number of cells around the old goal within which its frontier is searched again.
_KEPT = 2
# The goal changes only if another frontier costs less than this share of the present one.
_WORTH = 0.5
_SPACING = 0.05
# Unreachable free regions of fewer cells are errors of the map.
_ISLAND = 15
# Number of cells of the smallest unreachable frontier that the robot still looks at.
_WORTH_A_LOOK = 5


@dataclass(frozen=True, eq=False)
class Target:
    """A frontier to drive to.

    Attributes
    ----------
    goal
        Centre of the frontier's nearest cell (2,), m.
    aim
        Centre of the unknown cells adjacent to that cell (2,), m.
    group
        All cells of the frontier (n, 2), m.
    path
        Path to the frontier (k, 2), m. If the frontier is unreachable, the path ends at the nearest reachable place.
    is_reachable
        Whether the path ends at the frontier.
    is_frontier
        Whether there is a frontier. Otherwise the robot only drives to the goal.
    """

    goal: FloatArray
    aim: FloatArray
    group: FloatArray
    path: FloatArray
    is_reachable: bool
    is_frontier: bool = True


def coast_of(grid: GridView, robot: RobotSpec, config: PolicyConfig) -> float:
    """Distance (m) from walls beyond which paths cost more. It is infinite while the map is small."""
    return sight_of(robot) if max(grid.values.shape) * grid.cell > config.large_map else math.inf


def ways_from(
    place: FloatArray, grid: GridView, robot: RobotSpec, config: PolicyConfig, *, targets: BoolArray | None = None,
    extra: FloatArray | None = None, closed: BoolArray | None = None,
) -> Routes:  # fmt: skip
    """Paths of a robot from a place (2,), m, that keep away from walls, and in large maps within sight of them.

    ``targets``, ``extra`` and ``closed`` are those of :func:`~limslam_agent.grid.planner.routes`.
    """
    return routes(
        grid, place, robot.radius + MARGIN, _CLEARANCE, targets=targets, extra=extra, closed=closed,
        coast=coast_of(grid, robot, config),
    )  # fmt: skip


def sight_of(robot: RobotSpec) -> float:
    """Distance (m) from a wall within which several beams of a robot that drives along the wall see it."""
    return _SIGHT_SHARE * robot.reach


def open_frontier(grid: GridView, size: int, ignored: BoolArray, robot: RobotSpec) -> BoolArray:
    """Frontier cells (rows, columns) in groups of at least ``size``, without gaps that the robot cannot pass."""
    # Two cells may be a passage, because walls look thicker on the grid than they are.
    close_gaps = grid.cell < 2.0 * robot.radius
    return frontier_cells(grid, size, ignored, close_gaps=close_gaps, pocket=_POCKET)


def islands(grid: GridView, pose: FloatArray) -> BoolArray:
    """Small free regions (rows, columns) that do not contain the robot, which is at a pose (3,).

    Such regions are errors of a map that does not fit together.
    """
    labels, _ = ndimage.label(grid.free, structure=np.ones((3, 3), dtype=int))
    small = np.bincount(labels.ravel()) < _ISLAND
    row, column = grid.cells(pose[None, :2])[0]
    if 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]:
        small[labels[row, column]] = False
    return np.asarray(small[labels] & (labels > 0))


def is_walled_in(grid: GridView, pose: FloatArray) -> bool:
    """Whether most of the free ground is cut off from a pose (3,), although the robot came from there."""
    row, column = grid.cells(pose[None, :2])[0]
    labels, _ = ndimage.label(grid.free)
    if not (0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]):
        return True
    around = labels[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    own = np.isin(labels, np.unique(around[around > 0]))
    return bool(2 * np.count_nonzero(own) < np.count_nonzero(labels))


def has_seen_little(grid: GridView, radius: float) -> bool:
    """Whether the free ground is hardly more than the ground under a robot of a radius, m."""
    return bool(np.count_nonzero(grid.free) * grid.cell**2 < 4.0 * np.pi * radius**2)


def next_target(
    belief: Belief, ignored: BoolArray, old_goal: FloatArray | None, robot: RobotSpec, config: PolicyConfig
) -> Target | None:
    """The frontier of least cost, or the old one while it exists, because a change of goal costs time.

    Small frontiers are chosen after large ones. Unreachable frontiers are chosen last.

    Parameters
    ----------
    belief
        What the robot believes.
    ignored
        Cells (rows, columns) in which no goal may lie.
    old_goal
        The present goal (2,), m, or None.
    robot, config
        Body and settings.

    Returns
    -------
    target
        None if there is no frontier left.
    """
    grid, searches = belief.grid, _searches(belief, robot)
    # A search without a result has covered the whole grid, so one search of each kind is enough.
    whole: list[Routes | None] = [None for _ in searches]
    for size in (config.min_frontier, LAST_FRONTIER):
        cells = open_frontier(grid, size, ignored, robot)
        for wanted in (_beside(grid, cells, old_goal), cells):
            if not wanted.any():
                continue
            extra = separation_cost(grid, belief.pose, belief.other_poses, belief.other_goals, cells)
            extra += search_cost(belief, cells)
            costs = extra if extra.any() else None
            for number, closed in enumerate(searches):
                ways = whole[number] or ways_from(
                    belief.pose[:2], grid, robot, config, targets=wanted, extra=costs, closed=closed
                )
                found = _least(ways.cost + extra, wanted, cells)
                if found is not None:
                    return _reachable(grid, cells, found, ways)
                whole[number] = ways
    ignored = ignored | islands(grid, belief.pose)
    large = open_frontier(grid, max(config.min_frontier, _WORTH_A_LOOK), ignored, robot)
    return _unreachable(belief, whole[-1], large, old_goal, robot) if large.any() and whole[-1] is not None else None


def _searches(belief: Belief, robot: RobotSpec) -> list[BoolArray | None]:
    """The cells (rows, columns) that are closed in each search: in a team, paths lead around the other robots if they
    can, and else through them.
    """
    if not len(belief.other_poses):
        return [None]
    return [cells_near_robots(belief.grid, belief.other_poses, 2.0 * robot.radius + _SPACING), None]


def _least(cost: FloatArray, wanted: BoolArray, cells: BoolArray) -> IntArray | None:
    """The wanted cell (2,) of least cost, or any cell that costs far less. None if there is no path."""
    best, other = (int(np.argmin(np.where(among, cost, np.inf))) for among in (wanted, cells))
    if not np.isfinite(cost.flat[best]):
        return None
    if cost.flat[other] < _WORTH * cost.flat[best]:
        best = other
    return np.array(np.unravel_index(best, cost.shape))


def _beside(grid: GridView, cells: BoolArray, goal: FloatArray | None) -> BoolArray:
    """Those of the cells (rows, columns) that lie near a goal."""
    near = np.zeros_like(cells)
    if goal is not None:
        row, column = grid.cells(goal[None])[0]
        window = (
            slice(max(row - _KEPT, 0), max(row + _KEPT + 1, 0)),
            slice(max(column - _KEPT, 0), max(column + _KEPT + 1, 0)),
        )
        near[window] = cells[window]
    return near


def _reachable(grid: GridView, cells: BoolArray, cell: IntArray, ways: Routes) -> Target:
    path = grid.centres(ways.path_to((int(cell[0]), int(cell[1]))))
    return Target(path[-1], _aim(grid, cell), grid.centres(group_of(cells, cell)), path, is_reachable=True)


def _unreachable(
    belief: Belief, ways: Routes, cells: BoolArray, old_goal: FloatArray | None, robot: RobotSpec
) -> Target | None:
    """An unreachable frontier, with a path to the place from which the robot can look at it."""
    grid = belief.grid
    there = np.isfinite(ways.cost)
    room = there & (wall_distance(grid) >= robot.radius)
    room = room if room.any() else there
    if not room.any():
        return None
    away, (rows, columns) = ndimage.distance_transform_edt(~room, sampling=grid.cell, return_indices=True)
    cost = np.where(cells, _BETWEEN * away + ways.cost[rows, columns], np.inf)
    kept = np.where(_beside(grid, cells, old_goal), cost, np.inf)
    cost = kept if np.isfinite(kept).any() else cost
    cell = np.array(np.unravel_index(int(np.argmin(cost)), cost.shape))
    row, column = (int(index[tuple(cell)]) for index in (rows, columns))
    goal = grid.centres(cell[None])[0]
    group = grid.centres(group_of(cells, cell))
    return Target(goal, goal, group, grid.centres(ways.path_to((row, column))), is_reachable=False)


def _aim(grid: GridView, cell: IntArray) -> FloatArray:
    """Centre (2,), m, of the unknown cells that are adjacent to a cell (2,)."""
    row, column = (int(index) for index in cell)
    rows, columns = grid.values.shape
    beside = [(row + down, column + right) for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0))]
    inside = [0 <= place[0] < rows and 0 <= place[1] < columns for place in beside]
    # Cells beyond the grid are unknown.
    is_unknown = [not known or grid.values[place] == 0 for place, known in zip(beside, inside, strict=True)]
    there = [place for place, chosen in zip(beside, is_unknown, strict=True) if chosen] or [(row, column)]
    return np.asarray(grid.centres(np.array(there)).mean(axis=0))
