"""The interface of a policy, from the belief of a robot to wheel speeds, and checks of what a
policy answers.
"""

import math
from abc import ABC, abstractmethod
from typing import Any, Protocol

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.policies.controller import CollisionGuard
from limslam_env.geometry import FloatArray, no_rows
from limslam_env.interface import RobotSpec
from limslam_env.messages import described

NO_PLAN = no_rows(2)
"""The plan of a policy that plans no path. The array is read-only."""

NO_PLAN.setflags(write=False)


NOT_EXPLORED = "not explored"
"""The end of the stop reason of a policy that has stopped although it could not explore."""


class Policy(Protocol):
    """Anything that turns a belief into wheel speeds: a planner, a rule, or a trained network.

    Attributes
    ----------
    stop_reason
        Why the policy has stopped, in words. None while the policy is active.
    plan
        The path (k, 2), m, that the policy intends to drive. May be empty.

    Examples
    --------
    >>> import numpy as np
    >>> from limslam_agent import LimSlamAgent
    >>> from limslam_env import RobotSpec
    >>> class Circle:
    ...     stop_reason = None
    ...     plan = np.zeros((0, 2))
    ...     def act(self, belief):
    ...         return np.array([0.4, 0.5])
    >>> agent = LimSlamAgent(RobotSpec(), policy=Circle())
    """

    stop_reason: str | None
    plan: FloatArray

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,), left and right, as fractions from -1 to 1 of the maximum speed."""
        ...


class MapExplorer(ABC):
    """A policy whose plans belong to a frame of a map, and which settles things for the map as a
    whole.

    A new map comes with a new frame. A map that was moved has another frame and the same number. A
    collision guard limits the speeds that the policy wants.

    Parameters
    ----------
    robot
        Body and beams.

    Attributes
    ----------
    robot
        The robot that the policy drives.
    stop_reason
        Why there is nothing left to do, in words. None while the policy is active.
    plan
        Path to the present goal (k, 2), m.
    """

    _frame = _map_number = 0

    def __init__(self, robot: RobotSpec) -> None:
        self.robot = robot
        self._forget_map()
        self._begin()

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,). Zero after the policy has stopped."""
        self.enter(belief)
        if self.stop_reason is not None:
            return np.zeros(2)
        self._collision_guard.add_readings(belief.pose, belief.ranges)
        return self._collision_guard.limit_speed(belief.pose, self.wanted(belief))

    def restart(self) -> None:
        """Explore again, after teammates have mapped new ground."""
        self._forget_map()
        self._begin()

    def wanted(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,), before the collision guard limits them. The caller has told the frame
        by :meth:`enter`.
        """
        return self._wheels(belief)

    def enter(self, belief: Belief) -> None:
        """Plan anew if the frame is another one, and also forget what was settled if the map is
        another one.
        """
        if belief.map_number != self._map_number:
            self._map_number = belief.map_number
            self._forget_map()
        if belief.frame != self._frame:
            self._frame = belief.frame
            self._begin()

    def _begin(self) -> None:
        self.stop_reason: str | None = None
        self.plan: FloatArray = NO_PLAN
        self._collision_guard = CollisionGuard(self.robot)
        self._plan_anew()

    @abstractmethod
    def _wheels(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,), before the collision guard limits them."""

    def _forget_map(self) -> None:  # noqa: B027 (most policies settle nothing)
        """Begin without anything that was settled in a map."""

    @abstractmethod
    def _plan_anew(self) -> None:
        """Begin without plans, which mean nothing in another frame."""


def checked_action(policy: Policy, belief: Belief) -> FloatArray:
    """The wheel speeds (2,) that a policy chooses.

    Raises
    ------
    ValueError
        If the answer is not two finite numbers, or if ``stop_reason`` is neither None nor a text.
    """
    action = _numbers(answer := policy.act(belief))
    if action is None or action.shape != (2,) or not all(map(math.isfinite, action.tolist())):
        raise _refusal(
            policy, "act must return two finite numbers, the left and the right wheel speed", answer
        )
    if not isinstance(policy.stop_reason, str | None):
        raise _refusal(policy, "stop_reason must be None or a text", policy.stop_reason)
    return action


def checked_plan(policy: Policy) -> FloatArray:
    """A copy of the plan (k, 2), m, of a policy. An empty list or tuple is a plan without points.

    Raises
    ------
    ValueError
        If the plan is not a list of finite points.
    """
    plan = _numbers(policy.plan)
    if plan is not None and plan.size == 0:
        return NO_PLAN.copy()
    if plan is None or plan.ndim != 2 or plan.shape[1] != 2 or not np.isfinite(plan).all():
        raise _refusal(policy, "plan must be an array (k, 2) of finite points, m", policy.plan)
    return plan.copy()


def _numbers(value: Any) -> FloatArray | None:
    """A value as an array of numbers, or None if it is no such array."""
    try:
        return np.asarray(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return None


def _refusal(policy: Policy, rule: str, value: Any) -> ValueError:
    return ValueError(f"{type(policy).__name__}: {rule}, not {described(value)}")
