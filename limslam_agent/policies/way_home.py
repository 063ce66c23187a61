"""Exploration that ends where it began: the way back to the start."""

import math

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.controller import AHEAD, ARRIVED, BACK_STEPS, PATIENCE, REPLAN_PERIOD, back_off, follow
from limslam_agent.policies.policy import NO_PLAN, MapExplorer, Policy
from limslam_agent.policies.wall_views import path_to
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

_MOST_TRIES = 3  # number of times that the robot backs off where it cannot go on


class WayHome(MapExplorer):
    """A policy, and after it the way back to the start.

    While the robot is lost, the way is not known. The policy drives then, so that the robot sees the places by which
    it is found again.

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
        self._policy, self._config, self._always = policy, config, always
        self._home = np.zeros(2) if home is None else np.asarray(home, dtype=float)
        self.is_going_home, self._why = False, "asked to drive home"
        super().__init__(robot)

    def go_home(self) -> None:
        """End the exploration, and drive home."""
        self.is_going_home = True

    def _forget_map(self) -> None:
        self._tries = 0

    def _plan_anew(self) -> None:
        self._way: FloatArray | None = None  # home (k, 2), m
        self._left, self._idle, self._until_plan, self._backing = math.inf, 0, 0, 0

    def _wheels(self, belief: Belief) -> FloatArray:
        if self.is_going_home and belief.status.level != "lost":
            return self._drive(belief)
        wheels, reason = self._policy.act(belief), self._policy.stop_reason
        self.plan, self._way = self._policy.plan, None
        if reason is not None and self.is_going_home:
            self.stop_reason = f"{self._why}; the robot is lost, and does not know the way back to the start"
        elif reason is not None and self._always:
            self._why, self.is_going_home, self.plan = reason, True, NO_PLAN
        else:
            self.stop_reason = reason
        return wheels

    def _drive(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) along the path home."""
        if self._backing > 0:
            self._backing -= 1
            return back_off(belief.pose, belief.grid, self.robot, self._config.speed)
        if float(np.hypot(*(self._home - belief.pose[:2]))) < ARRIVED:
            self.stop_reason = f"{self._why}; the robot is back at its start"
            return np.zeros(2)
        if self._way is None or self._until_plan <= 0:
            path, self._until_plan = path_to(belief, self._home, self.robot), REPLAN_PERIOD
            self._way = self._way if path is None else np.vstack((path, self._home))
        if self._way is None:
            self.stop_reason = f"{self._why}; the map shows no way back to the start"
            return np.zeros(2)
        self.plan, self._until_plan = self._way, self._until_plan - 1
        away = np.hypot(*(self.plan - belief.pose[:2]).T)
        wheels, left = follow(self.plan, away, belief, self.robot, self._config.speed)
        self._count_idle(left)
        return wheels

    def _count_idle(self, left: float) -> None:
        """Count the steps in which the remaining path, ``left`` (m), became no shorter; back off, or give up."""
        self._idle = 0 if left < self._left - AHEAD else self._idle + 1
        self._left = left if self._idle == 0 else self._left
        if self._idle > PATIENCE:
            self._idle, self._left, self._tries = 0, math.inf, self._tries + 1
            self._backing, self._until_plan = BACK_STEPS, 0
        if self._tries > _MOST_TRIES:
            self.stop_reason = f"{self._why}; something is in the way back to the start"
