"""An entry of the arena: the learned explorer in robots that share nothing.

The entry ``learned`` is a team with one map. Here each robot estimates its own pose and draws its
own map from its own readings, and knows nothing of other robots. The difference between the two
entries is what sharing a map gains.
"""

import numpy as np

from limslam_agent import LimSlamAgent
from limslam_agent.policies.learned.learned import LearnedPolicy
from limslam_env import RobotSpec


class LearnedAlone(LimSlamAgent):
    """One robot with its own map, driven by the learned policy. The arena makes one for each
    robot.
    """

    def __init__(self, robot: RobotSpec, seed: np.random.Generator) -> None:
        super().__init__(robot, policy=LearnedPolicy(robot, seed=seed))
