"""An actor as the policy of a robot: the actor sees the readings, and a mapper draws the map from the same readings."""

from typing import Any

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.policies.policy import NO_PLAN
from limslam_agent.runs.actors import driver_of
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation

_NAME = "robot_0"
_DONE = "the actor says that it is done"


class ActorPolicy:
    """Drives a robot by an actor, which knows nothing of the belief.

    Parameters
    ----------
    actor
        An actor for one robot, as `limslam_agent.evaluate` takes it.

    Raises
    ------
    ValueError
        If the object cannot act.
    """

    def __init__(self, actor: Any) -> None:
        self._actor, self._driver = actor, driver_of(actor, is_team=False)
        self._observation: Observation = {}
        self.stop_reason: str | None = None
        self.plan: FloatArray = NO_PLAN

    def reset(self, start_pose: FloatArray, seed: int) -> None:
        """Begin an episode at a known pose (3,), m and rad."""
        self._driver.reset({_NAME: np.array(start_pose)}, seed)
        self.stop_reason = None

    def observe(self, observation: Observation) -> None:
        """Take the readings of this step."""
        self._observation = observation

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) of the actor, 0 once it is done. The belief is ignored."""
        del belief
        if self.stop_reason is not None:
            return np.zeros(2)
        action: FloatArray = self._driver.act({_NAME: self._observation})[_NAME]
        if self._driver.done:
            self.stop_reason = self._driver.stop_reason or _DONE
        return action

    def close(self) -> None:
        """End what the actor has started, such as a process. An actor without a ``close`` has started nothing."""
        close = getattr(self._actor, "close", None)
        if callable(close):
            close()
