"""The way to a place of the map: back to the start, or to a goal that a person has chosen."""

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.controller import PATIENCE, REPLAN_PERIOD, Progress, follow
from limslam_agent.policies.policy import MapExplorer
from limslam_agent.policies.wall_views import path_to
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

# Steps without progress after which the robot gives up. It has seen its surroundings anew by then.
_MOST_IDLE = 4 * PATIENCE
# points: a way with so many more than any before is another way, on which progress begins anew
_LONGER = 5


class WayTo(MapExplorer):
    """Drives to a place of the map, and stops there, or where there is no way any more.

    Parameters
    ----------
    goal
        The place (2,), m.
    words
        What the place is called.
    robot, config
        Body and settings.

    Attributes
    ----------
    goal
        The place (2,), m.
    """

    def __init__(
        self, goal: FloatArray, words: str, robot: RobotSpec, config: PolicyConfig
    ) -> None:
        self.goal = np.asarray(goal, dtype=float)
        self._words = words
        self._config = config
        super().__init__(robot)

    def _plan_anew(self) -> None:
        self._way: FloatArray | None = None  # to the goal (k, 2), m
        self._progress = Progress()
        self._longest = 0
        self._until_plan = 0

    def _wheels(self, belief: Belief) -> FloatArray:
        if self._way is None or self._until_plan <= 0:
            path = path_to(belief, self.goal, self.robot)
            self._until_plan = REPLAN_PERIOD
            way = self._way if path is None else np.vstack((path, self.goal))
            if way is not None and len(way) > self._longest + _LONGER:
                self._longest = len(way)
                self._progress = Progress()
            self._way = way
        if self._way is None:
            self.stop_reason = f"the map shows no way to {self._words}"
            return np.zeros(2)
        self.plan = self._way
        self._until_plan -= 1
        step = follow(self.plan, belief, self.robot, self._config.speed)
        if step is None:
            self.stop_reason = f"the robot is at {self._words}"
            return np.zeros(2)
        wheels, left = step
        self._progress.count(left)
        if self._progress.idle > _MOST_IDLE:
            self.stop_reason = f"something is in the way to {self._words}"
        return wheels


def objection(goal: FloatArray, belief: Belief, robot: RobotSpec) -> str:
    """Why the map shows no way to a place (2,), m, in words. Empty if there is a way."""
    (value,) = belief.grid.values_at(goal[None])
    if value == 0:
        return "that ground is not mapped yet"
    if value < 0:
        return "there is a wall or an obstacle"
    return "" if path_to(belief, goal, robot) is not None else "the map shows no way to it"
