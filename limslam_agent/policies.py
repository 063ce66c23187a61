"""Policies: from what the robot believes to what its wheels do. Each has ``act(belief) -> action``."""

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import ndimage

from limslam_agent.config import PolicyConfig
from limslam_agent.controller import steer, turn_towards, wheel_speeds
from limslam_agent.frontier import frontier_cells
from limslam_agent.occupancy import GridView
from limslam_agent.planner import routes
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

_ARRIVED = 0.08
_FACING = np.radians(8.0)
# Wheel speeds that sum to less than this hardly move the robot; it waits so many steps before it gives a goal up.
_CREEP = 0.05
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
        self._looking_round = 0
        self._until_plan = 0
        self._standing = 0

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) towards the present goal; zero when done."""
        if self._looking_round > 0:
            self._looking_round -= 1
            return wheel_speeds(0.0, self._config.turn_rate, self._robot)
        if self.stop_reason is None and (self._until_plan <= 0 or self._goal is None):
            self._replan(belief)
            self._until_plan = self._config.replan_period
        self._until_plan -= 1
        if self._goal is None:
            return np.zeros(2)
        return self._follow(belief, self._goal)

    def _replan(self, belief: Belief) -> None:
        grid = belief.grid
        faced = _around(grid, self._faced)
        tried = faced | _around(grid, self._missed)
        ways = routes(grid, belief.pose[:2], self._robot.radius + self._config.margin, self._config.clearance)
        for size in (self._config.min_frontier, self._config.min_last_frontier):
            cost = np.where(frontier_cells(grid, size, tried), ways.cost, np.inf)
            if np.isfinite(cost).any():
                break
        else:
            self._run_out(frontier_cells(grid, self._config.min_last_frontier, faced))
            return
        goal = self._kept_goal(grid, cost)
        if goal is None:
            goal = np.array(np.unravel_index(int(np.argmin(cost)), cost.shape))
        self._goal = grid.centres(goal[None])[0]
        self.plan = _cut_short(grid.centres(ways.path_to((int(goal[0]), int(goal[1])))), self._config.view_distance)

    def _run_out(self, left: BoolArray) -> None:
        """Nothing can be reached: look round and try all again, a few times, then stop."""
        self._goal, self.plan = None, _NO_PLAN
        if left.any() and self._retries < _MAX_RETRIES:
            self._missed = []
            self._retries += 1
            self._looking_round = math.ceil(2.0 * math.pi / (self._config.turn_rate * self._robot.control_period))
        elif left.any():
            self.stop_reason = f"explored: frontiers are left that cannot be reached ({int(left.sum())} cells)"
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
        action = steer(belief.pose, target, belief.ranges, self._robot, self._config, self._config.speed)
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
            self._retries = 0
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


def _cut_short(path: FloatArray, distance: float) -> FloatArray:
    """A path (k, 2) without its last ``distance`` (m): from there its end can be seen. One place at least."""
    lengths = np.hypot(*np.diff(path, axis=0).T)
    to_go = np.append(np.cumsum(lengths[::-1])[::-1], 0.0)
    return path[: max(int(np.count_nonzero(to_go >= distance)), 1)]


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
        self._standing = 0
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
        if self.stop_reason is not None:
            return np.zeros(2)
        action = steer(
            belief.pose, self._corners[self._next], belief.ranges, self._robot, self._config, self._config.lap_speed
        )
        self._standing = self._standing + 1 if abs(float(action.sum())) < _CREEP else 0
        if self._standing > _PATIENCE:
            self.stop_reason = f"stopped: something is in the way to corner {self._next + 1} of the loop"
            return np.zeros(2)
        return action
