"""An entry of the arena in Python: an actor, which gets the readings of its robot and answers with
wheel speeds.
"""

import numpy as np

from limslam_env import Observation, RobotSpec


class Reactive:
    """Drive ahead, and turn to the side with more space in front of a wall.

    The arena offers ``robot`` (body and beams) and ``seed`` (a random generator); both may be left
    out.
    """

    def __init__(self, robot: RobotSpec, seed: np.random.Generator) -> None:
        self._is_left = robot.beam_angles > 0.0
        self._seed = seed
        self.done = False  # True ends the run and says that everything is explored
        self._turn = 0

    def act(self, observation: Observation) -> np.ndarray:
        """Wheel speeds, left and right, from -1 to 1."""
        ranges = observation["ranges"]
        if self._turn == 0 and ranges[1:5].min() < 0.35:
            is_freer = ranges[self._is_left].mean() > ranges[~self._is_left].mean()
            self._turn = (1 if is_freer else -1) * int(self._seed.integers(5, 15))
        if self._turn == 0:
            return np.array([0.8, 0.8])
        side = 1 if self._turn > 0 else -1
        self._turn -= side
        return np.array([-0.5 * side, 0.5 * side])
