"""Your own estimator on the log of a run, scored with the metrics of LimSLAM.

limslam run --world env1 --noise 0.02 --out my_run && python examples/own_estimator.py my_run
"""

import sys
from pathlib import Path

import numpy as np

from limslam_agent import read_log
from limslam_agent.output.tum import write_tum
from limslam_env import Observation, RobotSpec
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import arc, compose, wheels_to_arc
from limslam_env.metrics import trajectory_metrics


class DeadReckoning:
    """Odometry alone. Replace this class with your estimator: it gets the readings of each step,
    and nothing true.
    """

    def __init__(self, robot: RobotSpec, start_pose: FloatArray) -> None:
        self.robot = robot
        self.pose = start_pose

    def step(self, observation: Observation) -> FloatArray:
        """The pose (3,) after an observation: x (m), y (m), heading (rad)."""
        wheels = np.asarray(
            observation["wheels"], dtype=float
        )  # travel of the left and the right wheel, m
        self.pose = compose(self.pose, arc(*wheels_to_arc(wheels, self.robot.axle)))
        return self.pose


if len(sys.argv) != 2:
    sys.exit(__doc__)
folder = Path(sys.argv[1])
log = read_log(folder / "log.npz")
if log.true_pose is None:
    sys.exit(f"{folder}: this log has no true poses")
estimator = DeadReckoning(log.robot, log.start_pose)
poses = np.array([estimator.step(observation) for observation in log.observations()])
write_tum(folder / "trajectory_own.tum", log.time, poses)
for name, value in trajectory_metrics(log.true_pose, poses).items():
    print(f"{name:18} {value:.3f}")
