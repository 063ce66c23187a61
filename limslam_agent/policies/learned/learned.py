"""An explorer that has learned where to head: a small network on the believed grid, and a bumper."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.controller import wheel_speeds
from limslam_agent.policies.learned.network import DirectionNetwork, load_network
from limslam_agent.policies.learned.polar_view import observe
from limslam_agent.policies.simple_policies import Wanderer
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

WEIGHTS = Path(__file__).parent / "weights"
"""Where the shipped weights lie: ``belief.npz`` and ``true_pose.npz``."""

TEMPERATURE = 0.5
"""Directions are drawn by their scores over this: the best one each time would now and then go to and fro for ever."""


@dataclass(frozen=True)
class DriveConfig:
    """How a chosen direction is driven. All ours.

    Attributes
    ----------
    hold
        Steps between two decisions.
    gain, turn_rate
        Rate of turn for an error of heading, 1/s, and the fastest turn, rad/s.
    """

    hold: int = 5
    gain: float = 5.0
    turn_rate: float = 2.5


class LearnedPolicy(Wanderer):
    """Head where a network says, twice a second, at top speed, until there is nothing new to see.

    Parameters
    ----------
    robot, config
        Body, and the settings that all policies share.
    network
        Scores of directions; the shipped one if left out.
    drive
        How a direction is driven.
    seed
        Of the numbers drawn, or a generator.
    temperature
        Directions are drawn by their scores over this; 0 takes the best one.
    patience
        Time without anything new after which it stops, s.
    """

    def __init__(
        self,
        robot: RobotSpec,
        config: PolicyConfig,
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
        """Towards the chosen direction."""
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
        # The largest of scores with Gumbel noise is drawn by its softmax.
        return int(np.argmax(scores + self._temperature * self._generator.gumbel(size=len(scores))))
