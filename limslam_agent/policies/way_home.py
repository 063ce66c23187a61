"""Exploration that ends where it began: the way back to the start."""

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.controller import PATIENCE, REPLAN_PERIOD, Progress, follow
from limslam_agent.policies.policy import NO_PLAN, MapExplorer, Policy
from limslam_agent.policies.wall_views import path_to
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

# Steps without progress after which the robot gives up. It has seen its surroundings anew by then.
_MOST_IDLE = 4 * PATIENCE
# points: a way home with so many more than any before is another way, on which progress begins anew
_LONGER = 5


class WayHome(MapExplorer):
    """A policy, and after it the way back to the start.

    While the robot is lost, the way is not known. The policy drives then, so that the robot sees
    the places by which it is found again.

    Parameters
    ----------
    policy
        Drives until it stops, or until :meth:`go_home`.
    robot, config
        Body and settings.
    home
        Where the robot began (2,), m. The origin by default.
    always
        Whether to drive home whenever the policy has stopped. If not, only :meth:`go_home` does so.

    Attributes
    ----------
    is_going_home
        Whether the robot is on its way home.
    """

    def __init__(
        self,
        policy: Policy,
        robot: RobotSpec,
        config: PolicyConfig,
        home: FloatArray | None = None,
        *,
        always: bool = False,
    ) -> None:
        self._policy = policy
        self._config = config
        self._always = always
        self._home = np.zeros(2) if home is None else np.asarray(home, dtype=float)
        self.is_going_home = False
        self._why = "asked to drive home"
        super().__init__(robot)

    def go_home(self) -> None:
        """End the exploration, and drive home."""
        self.is_going_home = True

    def _plan_anew(self) -> None:
        self._way: FloatArray | None = None  # home (k, 2), m
        self._progress = Progress()
        self._longest = 0
        self._until_plan = 0

    def _wheels(self, belief: Belief) -> FloatArray:
        if self.is_going_home and belief.status.level != "lost":
            return self._drive(belief)
        wheels = self._policy.act(belief)
        reason = self._policy.stop_reason
        self.plan = self._policy.plan
        self._way = None
        self._longest = 0
        if reason is not None and self.is_going_home:
            self.stop_reason = (
                f"{self._why}; the robot is lost, and does not know the way back to the start"
            )
        elif reason is not None and self._always:
            self._why = reason
            self.is_going_home = True
            self.plan = NO_PLAN
        else:
            self.stop_reason = reason
        return wheels

    def _drive(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) along the path home."""
        if self._way is None or self._until_plan <= 0:
            path = path_to(belief, self._home, self.robot)
            self._until_plan = REPLAN_PERIOD
            way = self._way if path is None else np.vstack((path, self._home))
            if way is not None and len(way) > self._longest + _LONGER:
                self._longest = len(way)
                self._progress = Progress()
            self._way = way
        if self._way is None:
            self.stop_reason = f"{self._why}; the map shows no way back to the start"
            return np.zeros(2)
        self.plan, self._until_plan = self._way, self._until_plan - 1
        step = follow(self.plan, belief, self.robot, self._config.speed)
        if step is None:
            self.stop_reason = f"{self._why}; the robot is back at its start"
            return np.zeros(2)
        wheels, left = step
        self._progress.count(left)
        if self._progress.idle > _MOST_IDLE:
            self.stop_reason = f"{self._why}; something is in the way back to the start"
        return wheels
