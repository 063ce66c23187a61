"""Policies: from what the robot believes to what its wheels do. Each has ``act(belief) -> action``."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import ndimage

from limslam_agent.config import PolicyConfig
from limslam_agent.controller import steer, turn_towards
from limslam_agent.frontier import frontier_cells
from limslam_agent.occupancy import GridView
from limslam_agent.planner import Routes, routes
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

_ARRIVED = 0.08
_FACING = np.radians(8.0)
# Wheel speeds that sum to less than this hardly move the robot; it waits so many steps before it gives a goal up.
_CREEP = 0.02
_PATIENCE = 40
_MAX_RETRIES = 2


@dataclass(frozen=True, eq=False)
class Belief:
    """All that a policy may look at.

    Attributes
    ----------
    pose, covariance
        Believed pose (3,), m, m, rad, and its covariance (3, 3).
    ranges
        The latest readings (n_beams,), m.
    segments
        Walls of the map (N, 4), m.
    grid
        Occupancy.
    """

    pose: FloatArray
    covariance: FloatArray
    ranges: FloatArray
    segments: FloatArray
    grid: GridView


class Policy(Protocol):
    """Anything that turns a belief into wheel speeds.

    Attributes
    ----------
    stop_reason
        Why the policy wants to do no more, in words; None while it goes on.
    plan
        The way it means to go (k, 2), m; may be empty.
    """

    stop_reason: str | None
    plan: FloatArray

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) from -1 to 1, fractions of the maximum."""
        ...


_NO_PLAN = np.zeros((0, 2))


class FrontierPolicy:
    """Drive to the frontier of least cost until there is none left (step 8 of the method).

    A frontier that is still there after the robot has gone to it and faced it cannot be
    resolved by these beams, and is left. One that the robot could not get to is tried again
    when there is nothing else.
    """

    def __init__(self, robot: RobotSpec, config: PolicyConfig) -> None:
        self._robot, self._config = robot, config
        self.stop_reason: str | None = None
        self.plan: FloatArray = _NO_PLAN
        self._goal: FloatArray | None = None
        self._faced: list[FloatArray] = []
        self._missed: list[FloatArray] = []
        self._retries = 0
        self._until_plan = 0
        self._standing = 0

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) towards the present goal; zero when done."""
        if self.stop_reason is None and (self._until_plan <= 0 or self._goal is None):
            self._replan(belief)
            self._until_plan = self._config.replan_period
        self._until_plan -= 1
        if self._goal is None:
            return np.zeros(2)
        return self._follow(belief, self._goal)

    def _replan(self, belief: Belief) -> None:
        grid = belief.grid
        left = frontier_cells(grid, self._config.min_frontier) & ~_around(grid, self._faced)
        frontier = left & ~_around(grid, self._missed)
        view = max(round(self._config.view_distance / grid.cell), 1)
        ways = self._ways_to(frontier, belief, view)
        if ways is None:
            self._run_out(left)
            return
        cost = np.where(frontier, _cheapest_nearby(ways.cost, view), np.inf)
        goal = self._kept_goal(grid, cost)
        if goal is None:
            goal = np.array(np.unravel_index(int(np.argmin(cost)), cost.shape))
        self._goal = grid.centres(goal[None])[0]
        self.plan = grid.centres(_way_near(ways, goal, view))

    def _ways_to(self, frontier: BoolArray, belief: Belief, view: int) -> Routes | None:
        """Ways on which some frontier cell can be reached, with as much room as can be had; or None."""
        if not frontier.any():
            return None
        reach = ndimage.binary_dilation(frontier, structure=_disc(view))
        for margin in (self._config.margin, 0.0, -0.4 * self._robot.radius):
            ways = routes(belief.grid, belief.pose[:2], self._robot.radius + margin, self._config.clearance)
            if np.isfinite(ways.cost[reach]).any():
                return ways
        return None

    def _run_out(self, left: BoolArray) -> None:
        """Nothing can be reached: try what was missed once more, then stop."""
        self._goal, self.plan = None, _NO_PLAN
        if self._missed and self._retries < _MAX_RETRIES:
            self._missed = []
            self._retries += 1
        elif left.any():
            self.stop_reason = f"explored: {int(left.sum())} frontier cells are left that cannot be reached"
        else:
            self.stop_reason = "explored: no frontier is left"

    def _kept_goal(self, grid: GridView, cost: FloatArray) -> IntArray | None:
        """The old goal, or the frontier cell beside it, while it can be had: changing one's mind costs time."""
        if self._goal is None:
            return None
        row, column = grid.cells(self._goal[None])[0]
        window = cost[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3]
        if window.size == 0 or not np.isfinite(window).any():
            return None
        near = np.array(np.unravel_index(int(np.argmin(window)), window.shape))
        return np.asarray(near + np.array([max(row - 2, 0), max(column - 2, 0)]))

    def _follow(self, belief: Belief, goal: FloatArray) -> FloatArray:
        remaining = np.linalg.norm(self.plan - belief.pose[:2], axis=1)
        if remaining[-1] < _ARRIVED or len(self.plan) == 1:
            return self._look(belief, goal)
        nearest = int(np.argmin(remaining))
        ahead = np.nonzero(remaining[nearest:] > self._config.lookahead)[0]
        target = self.plan[nearest + ahead[0]] if ahead.size else self.plan[-1]
        action = steer(belief.pose, target, belief.ranges, self._robot, self._config)
        self._standing = self._standing + 1 if abs(float(action.sum())) < _CREEP else 0
        if self._standing > _PATIENCE:
            self._leave(self._missed, goal)
        return action

    def _look(self, belief: Belief, goal: FloatArray) -> FloatArray:
        """Turn to the goal from where it should be seen; once faced, it can be shown no better."""
        offset = goal - belief.pose[:2]
        error = wrap_angle(float(np.arctan2(offset[1], offset[0]) - belief.pose[2]))
        if abs(error) < _FACING or np.hypot(*offset) < 0.5 * _ARRIVED:
            self._leave(self._faced, goal)
            return np.zeros(2)
        return turn_towards(belief.pose, goal, self._robot, self._config)

    def _leave(self, pile: list[FloatArray], goal: FloatArray) -> None:
        pile.append(goal)
        self._goal = None
        self._standing = 0


def _around(grid: GridView, places: list[FloatArray]) -> BoolArray:
    """The cells (rows, columns) of some places and those beside them."""
    mask = np.zeros(grid.values.shape, dtype=bool)
    if places:
        cells = grid.cells(np.array(places))
        inside = ((cells >= 0) & (cells < mask.shape)).all(axis=1)
        mask[cells[inside, 0], cells[inside, 1]] = True
        mask = ndimage.binary_dilation(mask, structure=np.ones((3, 3), dtype=bool))
    return mask


def _cheapest_nearby(cost: FloatArray, cells: int) -> FloatArray:
    """For each cell, the least cost among those at most ``cells`` away."""
    return np.asarray(ndimage.minimum_filter(cost, footprint=_disc(cells), mode="constant", cval=np.inf))


def _way_near(ways: Routes, goal: IntArray, cells: int) -> IntArray:
    """The path (k, 2) to the cheapest cell at most ``cells`` from a goal (row, column)."""
    rows, columns = np.nonzero(_disc(cells))
    candidates = np.column_stack((rows, columns)) - cells + goal
    inside = ((candidates >= 0) & (candidates < ways.cost.shape)).all(axis=1)
    candidates = candidates[inside]
    best = candidates[int(np.argmin(ways.cost[candidates[:, 0], candidates[:, 1]]))]
    return ways.path_to((int(best[0]), int(best[1])))


def _disc(cells: int) -> BoolArray:
    rows, columns = np.ogrid[-cells : cells + 1, -cells : cells + 1]
    return np.asarray(rows**2 + columns**2 <= cells**2)


class Laps:
    """Drive round a closed tour a number of times, by the believed pose.

    Parameters
    ----------
    robot, config
        Body and speeds.
    corners
        Of the tour (k, 2), m, in driving order.
    laps
        How many times.
    """

    def __init__(self, robot: RobotSpec, config: PolicyConfig, corners: FloatArray, laps: int) -> None:
        self._robot, self._config = robot, config
        self._corners = corners
        self._remaining = laps * len(corners)
        self._next: int | None = None
        self.stop_reason: str | None = None
        self.plan: FloatArray = corners

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) towards the next corner; zero after the last."""
        if self._next is None:
            nearest = int(np.argmin(np.linalg.norm(self._corners - belief.pose[:2], axis=1)))
            self._next = (nearest + 1) % len(self._corners)
        if np.linalg.norm(self._corners[self._next] - belief.pose[:2]) < _ARRIVED:
            self._next = (self._next + 1) % len(self._corners)
            self._remaining -= 1
        if self._remaining <= 0:
            self.stop_reason = "all laps driven"
            return np.zeros(2)
        return steer(belief.pose, self._corners[self._next], belief.ranges, self._robot, self._config)
