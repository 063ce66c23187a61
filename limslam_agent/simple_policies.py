"""Policies without a planner: laps, along a wall, and at random."""

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config import PolicyConfig
from limslam_agent.controller import steer
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

_ARRIVED = 0.08
# Wheel speeds that sum to less than this hardly move the robot; it waits so many steps before it gives up.
_CREEP = 0.05
_PATIENCE = 40


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
