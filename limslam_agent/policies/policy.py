"""The interface of a policy: from the belief of a robot to the speeds of its wheels."""

from typing import Protocol

from limslam_agent.belief import Belief
from limslam_env.geometry import FloatArray, no_rows

NO_PLAN = no_rows(2)
"""The plan of a policy that plans no path. The array is read-only."""

NO_PLAN.setflags(write=False)


class Policy(Protocol):
    """Anything that turns a belief into wheel speeds: a planner, a rule, or a trained network.

    Attributes
    ----------
    stop_reason
        Why the policy has stopped, in words. None while the policy is active.
    plan
        The path (k, 2), m, that the policy intends to drive. May be empty.
    """

    stop_reason: str | None
    plan: FloatArray

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,), left and right, as fractions from -1 to 1 of the maximum speed."""
        ...
