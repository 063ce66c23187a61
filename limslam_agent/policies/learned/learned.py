"""A learned exploration policy: a small network on the believed grid chooses the heading."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.controller import wheel_speeds
from limslam_agent.policies.learned.network import DirectionNetwork, load_network
from limslam_agent.policies.learned.polar_view import observe
from limslam_agent.policies.simple_policies import ReactivePolicy
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of the shipped weights, ``belief.npz`` and ``true_pose.npz``."""

TEMPERATURE = 0.5
"""Temperature of the softmax from which directions are drawn.

The best direction at every decision would sometimes make the robot alternate between two places for ever.
"""


@dataclass(frozen=True)
class DriveConfig:
    """Settings for driving in a chosen direction. The values are this project's choices.

    Attributes
    ----------
    hold
        Number of steps between two decisions.
    gain, turn_rate
        Rate of turn per heading error, 1/s, and largest rate of turn, rad/s.
    """

    hold: int = 5
    gain: float = 5.0
    turn_rate: float = 2.5


class LearnedPolicy(ReactivePolicy):
    """Drives at top speed in directions that a network chooses twice a second, until there is nothing new to see.

    Parameters
    ----------
    robot, config
        Body, and the settings that all policies share. Those of the paper's robot and the default settings if left out.
    network
        Network that scores directions. The shipped one by default.
    drive
        Settings for driving in a chosen direction.
    seed
        Seed of the random numbers, or a generator.
    temperature
        Temperature of the softmax from which directions are drawn. 0 takes the best direction.
    patience
        Time without new cells after which the policy stops, s.
    """

    def __init__(
        self,
        robot: RobotSpec | None = None,
        config: PolicyConfig | None = None,
        network: DirectionNetwork | None = None,
        drive: DriveConfig | None = None,
        seed: int | np.random.Generator = 0,
        temperature: float = TEMPERATURE,
        patience: float = 90.0,
    ) -> None:
        super().__init__(robot, config, patience, "wherever it went")
        self._network = network or load_network(WEIGHTS / "belief.npz")
        self._drive = drive or DriveConfig()
        self._generator, self._temperature = np.random.default_rng(seed), temperature
        self._until_choice, self._heading = 0, 0.0

    def _wheels(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) towards the chosen direction."""
        drive, robot = self._drive, self._robot
        if self._until_choice <= 0:
            self._heading = float(belief.pose[2]) + self._network.view.angle(self._chosen(belief))
            self._until_choice = drive.hold
        self._until_choice -= 1
        error = float(wrap_angle(self._heading - belief.pose[2]))
        turn = float(np.clip(drive.gain * error, -drive.turn_rate, drive.turn_rate))
        return wheel_speeds(robot.max_wheel_speed * max(float(np.cos(error)), 0.0), turn, robot)

    def _chosen(self, belief: Belief) -> int:
        view = self._network.view
        observation = observe(belief.grid, belief.pose, belief.ranges, self._robot.max_ranges, view)
        scores = self._network.scores(observation).astype(float)
        # The index of the largest score plus Gumbel noise has the distribution of the softmax.
        return int(np.argmax(scores + self._temperature * self._generator.gumbel(size=len(scores))))
