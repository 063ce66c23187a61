"""Choice of the next frontier and of the path to it; a team explores apart, and a lost robot looks
for its place.

The places where a lost robot may be predict what lies beyond its frontiers: free ground or walls,
or nothing, where the earlier map knows nothing. What the robot learns by looking at a cell is the
mutual information of the cell's state and of the place (D. Fox, W. Burgard and S. Thrun, "Active
Markov localization for mobile robots", 1998). It is large where the likely places predict different
things, or where the only likely place predicts something at all, since ground that the earlier map
does not have may look alike.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from limslam_agent.belief import Belief, Guess
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.planner import Clearance, Routes, routes
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

# Distance (m) that the planner keeps between the robot's rim and occupied cells unless there is no
# other path, and further distance that it keeps where there is enough space.
_MARGIN = 0.05
_CLEARANCE = 0.15
# In maps larger than this (m), paths stay so near to walls that several beams see them: the second
# number is the share of the beams' reach.
_LARGE = 12.0
_SIGHT_SHARE = 0.7
_PART_WITHIN = 2.5
_PART_WEIGHT = 2.0
_AROUND = 0.7  # m: how far around a frontier cell the robot looks
_STEP = 0.2  # m: between the points that are compared
_GUESSES = 6  # number of the likeliest places that are compared
_FREE = (
    0.95,
    0.6,
)  # probability that a point is free: where a place predicts that, and where nothing is known
_LARGEST = 2.0  # log odds of a place: more are an overconfident likelihood
_ENOUGH = 0.03  # mean information of a point, nats, from which on a frontier costs nothing more
_TURN = 1.0  # m of path: cost of a frontier at the robot's side, and half of that of one behind it
_PRICE = 3.0  # m of path: cost of a frontier that tells the robot nothing about its place


@dataclass(frozen=True, eq=False)
class Target:
    """A frontier to drive to.

    Attributes
    ----------
    goal
        Centre of the frontier's nearest cell (2,), m.
    aim
        Centre of the unknown cells adjacent to that cell (2,), m.
    path
        Path to the frontier (k, 2), m.
    """

    goal: FloatArray
    aim: FloatArray
    path: FloatArray


def ways_from(
    place: FloatArray,
    grid: GridView,
    robot: RobotSpec,
    *,
    targets: BoolArray | None = None,
    extra: FloatArray | None = None,
    closed: BoolArray | None = None,
) -> Routes:
    """Paths of a robot from a place (2,), m, that keep away from walls, and in large maps within
    sight of them.

    ``targets``, ``extra`` and ``closed`` are those of :func:`~limslam_agent.grid.planner.routes`.
    """
    is_large = max(grid.values.shape) * grid.cell > _LARGE
    coast = _SIGHT_SHARE * robot.reach if is_large else math.inf
    clearance = Clearance(robot.radius + _MARGIN, _CLEARANCE, coast)
    return routes(grid, place, clearance, targets=targets, extra=extra, closed=closed)


def next_target(
    belief: Belief, ignored: BoolArray, robot: RobotSpec, config: PolicyConfig
) -> Target | None:
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
    return Target(path[-1], _aim(grid, cell), path)


def _aim(grid: GridView, cell: IntArray) -> FloatArray:
    """Centre (2,), m, of the unknown cells that are adjacent to a frontier cell (2,)."""
    # Cells beyond the grid are unknown.
    around = np.pad(grid.values, 1)[cell[0] : cell[0] + 3, cell[1] : cell[1] + 3]
    beside = np.argwhere(ndimage.generate_binary_structure(2, 1) & (around == 0)) - 1
    return np.asarray(grid.centres(cell + beside).mean(axis=0))


def separation_cost(
    grid: GridView, pose: FloatArray, other_poses: FloatArray, other_goals: FloatArray
) -> FloatArray:
    """Additional cost (rows, columns), m, of each cell as a goal, which makes the robots of a team
    separate.

    The cost is high within 2.5 m of another robot or of its goal, and where another robot is closer
    than this one, which is at ``pose`` (3,).
    """
    total = np.zeros(grid.values.shape)
    own = _away(grid, pose)
    for place in (*other_poses, *other_goals):
        total += _PART_WEIGHT * np.clip(_PART_WITHIN - _away(grid, place), 0.0, None)
    for place in other_poses:
        total += np.clip(own - _away(grid, place), 0.0, None)
    return total


def cells_near_robots(grid: GridView, other_poses: FloatArray, distance: float) -> BoolArray:
    """Cells (rows, columns) whose centres are closer than ``distance`` (m) to another robot."""
    return np.asarray(np.any([_away(grid, place) < distance for place in other_poses], axis=0))


def nearer_to_others(grid: GridView, pose: FloatArray, other_poses: FloatArray) -> BoolArray:
    """Cells (rows, columns) that are nearer to another robot than to this one, which is at ``pose``
    (3,).
    """
    return np.asarray(
        np.any([_away(grid, place) < _away(grid, pose) for place in other_poses], axis=0)
    )


def _away(grid: GridView, place: FloatArray) -> FloatArray:
    """Distance (rows, columns), m, from the centres of all cells to a place, whose first two
    numbers are x and y.
    """
    rows, columns = np.ogrid[0 : grid.values.shape[0], 0 : grid.values.shape[1]]
    x = grid.low[0] + (columns + 0.5) * grid.cell
    y = grid.low[1] + (rows + 0.5) * grid.cell
    return np.asarray(np.hypot(x - place[0], y - place[1]))


def search_cost(belief: Belief, cells: BoolArray) -> FloatArray:
    """Additional cost (rows, columns), m, of frontier cells of a mask (rows, columns) for a lost
    robot; 0 otherwise.

    A cell costs more the less the robot learns there about its place, and if the robot must turn
    back to it.
    """
    total = np.zeros(cells.shape)
    if belief.status.level == "lost":
        at = np.argwhere(cells)
        cost = _TURN * (1.0 - _ahead(belief, at))
        if belief.guesses:
            cost += _PRICE * (1.0 - np.minimum(_information(belief, at) / _ENOUGH, 1.0))
        total[at[:, 0], at[:, 1]] = cost
    return total


def _ahead(belief: Belief, cells: IntArray) -> FloatArray:
    """Cosine (n,) of the angle between the robot's heading and the direction to cells (n, 2)."""
    x, y, heading = belief.pose.tolist()
    off = belief.grid.centres(cells) - np.array([x, y])
    return np.asarray(
        (off @ [np.cos(heading), np.sin(heading)]) / np.maximum(np.hypot(*off.T), 1e-9)
    )


def _information(belief: Belief, cells: IntArray) -> FloatArray:
    """Mean information (n,), nats, about the place in the unknown points around cells (n, 2)."""
    side = np.arange(-_AROUND, _AROUND + 0.5 * _STEP, _STEP)
    disc = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    disc = disc[np.hypot(*disc.T) <= _AROUND]
    points = (belief.grid.centres(cells)[:, None] + disc).reshape(-1, 2)
    is_new = belief.grid.values_at(points) == 0
    guesses = sorted(belief.guesses, key=lambda guess: -guess.log_odds)[:_GUESSES]
    # The last hypothesis is ground that the earlier map does not have.
    odds = np.exp([*(min(guess.log_odds, _LARGEST) for guess in guesses), 0.0])
    shares = (odds / odds.sum())[:, None]
    free = np.array(
        [*(_predicted(guess, points) for guess in guesses), np.full(len(points), _FREE[1])]
    )
    known = _entropy((shares * free).sum(axis=0)) - (shares * _entropy(free)).sum(axis=0)
    return np.asarray(np.where(is_new, known, 0.0).reshape(len(cells), -1).mean(axis=1))


def _predicted(guess: Guess, points: FloatArray) -> FloatArray:
    """Probability (n,) that points (n, 2) of the present frame are free if a guess is right."""
    values = guess.grid.values_at(transform_points(guess.pose, points))
    sure, unknown = _FREE
    return np.where(values > 0, sure, np.where(values < 0, 1.0 - sure, unknown))


def _entropy(free: FloatArray) -> FloatArray:
    """Entropy (n,), nats, of events of these probabilities (n,)."""
    return np.asarray(-free * np.log(free) - (1.0 - free) * np.log(1.0 - free))
