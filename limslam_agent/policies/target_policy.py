"""A policy around a planner that only says where to drive to next, as planners of others do."""

import inspect
import math
from typing import Protocol

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.attempts import SAME_GOAL, Attempt, Attempts
from limslam_agent.policies.controller import follow
from limslam_agent.policies.policy import NO_PLAN, NOT_EXPLORED, MapExplorer
from limslam_agent.policies.targets import ways_from
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.messages import described

# Least number of steps after which a planner is asked again on the way to a target.
_PERIOD = 10


class TargetPlanner(Protocol):
    """Anything that chooses where a robot drives to next.

    Examples
    --------
    >>> from limslam_agent import TargetPolicy
    >>> class Ahead:
    ...     def target(self, grid, pose):
    ...         return pose[:2] + [0.5, 0.0]
    >>> policy = TargetPolicy(Ahead())
    """

    def target(self, grid: GridView, pose: FloatArray) -> FloatArray | None:
        """The next target (2,), m, in the map of a robot at a pose (3,), m, m, rad. None if there
        is nothing left to explore.
        """
        ...


class TargetPolicy(MapExplorer):
    """Drives to the targets of a planner, on the shortest ways that keep away from walls.

    The planner is asked at the start, whenever the robot has arrived or cannot get any nearer, and
    every ten steps on the way if the map has grown. The robot drives to the free cell that is
    nearest to the target. The run ends when the planner has no target, or when it chooses one again
    that was tried since the map has grown (:mod:`limslam_agent.policies.attempts`).

    Parameters
    ----------
    planner
        Chooses the targets.
    robot, config
        Body and settings. Those of the paper's robot and the default settings if left out.

    Raises
    ------
    ValueError
        If the planner's ``target`` does not take a grid and a pose.

    Examples
    --------
    >>> from limslam_agent import LimSlamAgent, TargetPolicy
    >>> from limslam_env import RobotSpec
    >>> class Corner:
    ...     def target(self, grid, pose):
    ...         return grid.centres((grid.values > 0).nonzero()[0][-1:, None] * [1, 1])[0]
    >>> agent = LimSlamAgent(RobotSpec(), policy=TargetPolicy(Corner(), RobotSpec()))
    """

    def __init__(
        self,
        planner: TargetPlanner,
        robot: RobotSpec | None = None,
        config: PolicyConfig | None = None,
    ) -> None:
        try:
            inspect.signature(planner.target).bind(None, None)
        except TypeError:
            name = type(planner).__name__
            raise ValueError(f"{name} makes no policy: a planner has target(grid, pose)") from None
        self._planner = planner
        self._config = config or PolicyConfig()
        super().__init__(robot or RobotSpec())

    def _plan_anew(self) -> None:
        self._attempts = Attempts()
        self._drop()

    def _drop(self) -> None:
        self.goal: FloatArray | None = None
        self.plan = NO_PLAN
        self._until_choice = 0
        # Whether the map has grown since the planner was asked.
        self._is_new = False

    def _wheels(self, belief: Belief) -> FloatArray:
        has_grown = self._attempts.note(belief.grid)
        self._is_new = self._is_new or has_grown
        self._until_choice -= 1
        if self.goal is None or (self._is_new and self._until_choice <= 0):
            self._choose(belief)
        if self.goal is None:
            return np.zeros(2)
        attempt = self._attempts.of(self.goal, 0.5 * belief.grid.cell)
        step = follow(self.plan, belief, self.robot, self._config.speed)
        action, left = step or (np.zeros(2), 0.0)
        attempt.progress.count(left, is_new=has_grown)
        if step is None or attempt.is_over:
            self._end(attempt)
        return action

    def _end(self, attempt: Attempt) -> None:
        attempt.has_ended = True
        self._drop()

    def _choose(self, belief: Belief) -> None:
        """Ask the planner, and plan the path to its target."""
        self._is_new = False
        self._until_choice = _PERIOD
        answer = self._planner.target(belief.grid, belief.pose)
        if answer is None:
            self._drop()
            self.stop_reason = "the planner has no target left"
            return
        goal = _checked(answer, self._planner)
        attempt = self._attempts.of(goal, 0.5 * belief.grid.cell)
        if attempt.is_over:
            self._drop()
            self.stop_reason = (
                f"the planner has chosen ({goal[0]:.2f}, {goal[1]:.2f}) again, where nothing new "
                f"was seen: {NOT_EXPLORED}"
            )
            return
        ways = ways_from(belief.pose[:2], belief.grid, self.robot)
        reachable = np.argwhere(np.isfinite(ways.cost))
        away = np.hypot(*(belief.grid.centres(reachable) - goal).T)
        if away.min(initial=math.inf) > SAME_GOAL:
            self._end(attempt)
            return
        row, column = reachable[int(away.argmin())].tolist()
        self.goal = goal
        self.plan = belief.grid.centres(ways.path_to((row, column)))


def _checked(answer: object, planner: TargetPlanner) -> FloatArray:
    """A target (2,), m, as an array; a ValueError if it is none."""
    try:
        goal = np.asarray(answer, dtype=float)
        if goal.shape == (2,) and np.isfinite(goal).all():
            return goal
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(
        f"{type(planner).__name__}: target must return two finite numbers, x and y, m, or None, "
        f"not {described(answer)}"
    )
