"""Exploration that ends where it began: the way back to the start."""

import math

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.collision_guard import CollisionGuard
from limslam_agent.policies.controller import AHEAD, ARRIVED, BACK_STEPS, PATIENCE, REPLAN_PERIOD, back_off, follow
from limslam_agent.policies.policy import NO_PLAN, Policy
from limslam_agent.policies.wall_views import path_to
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

_MOST_TRIES = 3  # number of times that the robot backs off where it cannot go on


class WayHome:
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
    stop_reason
        Why the policy has stopped, in words, and whether the robot is back. None while the robot drives.
    plan
        Path to the present goal (k, 2), m.
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
        self._policy, self._robot, self._config, self._always = policy, robot, config, always
        self._home = np.zeros(2) if home is None else np.asarray(home, dtype=float)
        self.stop_reason: str | None = None
        self.is_going_home = False
        self._why, self._tries = "asked to drive home", 0
        self._begin((0, False))

    def go_home(self) -> None:
        """End the exploration, and drive home."""
        if not self.is_going_home:
            self.is_going_home, self.plan = True, NO_PLAN

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,). Zero after the policy has stopped."""
        if self.stop_reason is not None:
            return np.zeros(2)
        is_lost = belief.status.level == "lost"
        if (belief.frame, is_lost) != self._place:
            self._begin((belief.frame, is_lost))
        self._collision_guard.add_readings(belief.pose, belief.ranges)
        if not self.is_going_home:
            return self._explore(belief)
        if is_lost:
            return self._look_around(belief)
        return self._collision_guard.limit_speed(belief.pose, self._drive(belief))

    def _begin(self, place: tuple[int, bool]) -> None:
        """Forget all points and paths. They are of another frame, or of a pose that was wrong."""
        self._place = place  # the frame, and whether the robot is lost
        self._collision_guard = CollisionGuard(self._robot)
        self.plan = NO_PLAN
        self._left, self._idle, self._until_plan, self._backing = math.inf, 0, 0, 0

    def _look_around(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) of the policy, while the robot is lost on its way home."""
        wheels = self._policy.act(belief)
        self.plan = self._policy.plan
        if self._policy.stop_reason is not None:
            self.stop_reason = f"{self._why}; the robot is lost, and does not know the way back to the start"
        return wheels

    def _explore(self, belief: Belief) -> FloatArray:
        wheels = self._policy.act(belief)
        self.plan = self._policy.plan
        reason = self._policy.stop_reason
        if reason is not None and self._always:
            self._why = reason
            self.go_home()
        elif reason is not None:
            self.stop_reason = reason
        return wheels

    def _drive(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) along the path home."""
        if self._backing > 0:
            self._backing -= 1
            return back_off(belief.pose, belief.grid, self._robot, self._config.speed)
        self._until_plan -= 1
        if self._until_plan < 0:
            self._plan(belief)
        if self.stop_reason is None and float(np.hypot(*(self._home - belief.pose[:2]))) < ARRIVED:
            self.stop_reason = f"{self._why}; the robot is back at its start"
        if self.stop_reason is not None:
            return np.zeros(2)
        away = np.hypot(*(self.plan - belief.pose[:2]).T)
        wheels, left = follow(self.plan, away, belief, self._robot, self._config.speed)
        self._count_idle(left)
        return wheels

    def _plan(self, belief: Belief) -> None:
        self._until_plan = REPLAN_PERIOD
        path = path_to(belief, self._home, self._robot, self._config)
        if path is None and not len(self.plan):
            self.stop_reason = f"{self._why}; the map shows no way back to the start"
        self.plan = self.plan if path is None else np.vstack((path, self._home))

    def _count_idle(self, left: float) -> None:
        """Count the steps in which the remaining path, ``left`` (m), became no shorter; back off, or give up."""
        self._idle = 0 if left < self._left - AHEAD else self._idle + 1
        self._left = left if self._idle == 0 else self._left
        if self._idle <= PATIENCE:
            return
        self._idle, self._left, self._tries = 0, math.inf, self._tries + 1
        self._backing, self._until_plan = BACK_STEPS, 0
        if self._tries > _MOST_TRIES:
            self.stop_reason = f"{self._why}; something is in the way back to the start"
