"""A policy of your own, with map, picture and film: ``limslam run --policy
examples/my_policy.py:TurnFromWalls``.
"""

import numpy as np

from limslam_agent import Belief


class TurnFromWalls:
    """Drive ahead, and turn right in front of a wall. After ``most_steps`` steps, stop."""

    def __init__(self, most_steps: int = 600) -> None:
        self.stop_reason: str | None = None  # a text ends the run
        self.plan = np.zeros((0, 2))  # the path that pictures show
        self._steps_left = most_steps

    def act(self, belief: Belief) -> np.ndarray:
        """Wheel speeds, left and right, from -1 to 1."""
        self._steps_left -= 1
        if self._steps_left <= 0:
            self.stop_reason = "enough steps were driven"
        is_near = belief.ranges[1:5].min() < 0.35
        return np.array([0.6, -0.5] if is_near else [0.7, 0.7])
