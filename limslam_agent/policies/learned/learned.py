"""A learned exploration policy: a small network on the believed grid chooses the heading, and a
planner finishes.

The network sees what is near. The frontier explorer plans paths to what is far away, looks into the
last corners, and knows when there is nothing left. So the network drives where there is much to
see, and the frontier explorer drives elsewhere and ends the exploration.

It also begins: it turns to what is near before it drives off. A robot that drives off at once, at
top speed, loses its heading before it knows any wall, and the whole map stays turned by that error.
"""

import math
from collections import deque
from dataclasses import replace
from pathlib import Path

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.controller import wheel_speeds
from limslam_agent.policies.frontier_policy import FrontierPolicy
from limslam_agent.policies.learned.network import DirectionNetwork, load_network
from limslam_agent.policies.learned.polar_view import FAR, expected_ranges, observe
from limslam_agent.policies.targets import (
    Target,
    cells_near_robots,
    nearer_to_others,
    next_target,
)
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of the shipped weights."""

SHIPPED = "explorer.npz"
"""File of the weights that drive by default."""

TEMPERATURE = 0.5
"""Temperature of the softmax from which directions are drawn.

The best direction at every decision would sometimes make the robot alternate between two places for
ever.
"""


HOLD = 5
"""Number of steps between two decisions."""

# Rate of turn per heading error, 1/s, and largest rate of turn, rad/s.
_GAIN = 5.0
_TURN_RATE = 2.5
# The network drives while the map has grown by so many m^2 for each robot within the last so many
# seconds, and so not in the first ones.
_GROWTH = 0.6
_WINDOW = 8.0
# Distance to the nearest frontier, m, up to which the network drives. It is the distance of the
# network's input, in which small remnants count as farther away.
_FARTHEST = 2.0
# Frontiers of at least so many widths of the robot are explored first. Most of what the network
# leaves are small remnants, cells at wall ends that cost long ways and show next to nothing.
_LARGE = 4.0


class LearnedPolicy(FrontierPolicy):
    """Drives at top speed in directions that a network chooses twice a second. Where there is
    little to see, the robot explores frontiers at the same speed, and so ends the exploration.

    The network knows the beams of the robot that it was trained with. For a robot with another
    number of beams, it gets what those beams would read by the believed grid.

    Parameters
    ----------
    robot, config
        Body, and the settings that all policies share. Those of the paper's robot and the default
        settings if left out.
    network
        Network that scores directions. The shipped one by default. It was trained with as many
        beams as the robot has, or as the paper's robot has.
    seed
        Seed of the random numbers, or a generator.

    Raises
    ------
    ValueError
        If the network was trained with another number of beams.

    Attributes
    ----------
    plan
        Path to the present frontier (k, 2), m. Empty while the network drives.

    Examples
    --------
    >>> from limslam_agent import LimSlamAgent, LearnedPolicy
    >>> from limslam_env import RobotSpec
    >>> agent = LimSlamAgent(RobotSpec(), policy=LearnedPolicy(RobotSpec(), seed=3))
    """

    def __init__(
        self,
        robot: RobotSpec | None = None,
        config: PolicyConfig | None = None,
        network: DirectionNetwork | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        robot = robot or RobotSpec()
        config = config or PolicyConfig()
        self._network = network or load_network(WEIGHTS / SHIPPED)
        self._generator = np.random.default_rng(seed)
        # The robot whose beams the network knows.
        self._eyes = robot if len(robot.beams) == self._network.readings else RobotSpec()
        if len(self._eyes.beams) != self._network.readings:
            raise ValueError(
                f"the network was trained with {self._network.readings} beams, which neither this "
                f"robot with {len(robot.beams)} nor the paper's robot has"
            )
        super().__init__(robot, replace(config, speed=robot.max_wheel_speed))

    def _forget_map(self) -> None:
        super()._forget_map()
        # Number of known cells in the last steps.
        self._counts = deque[int](maxlen=math.ceil(_WINDOW / self.robot.control_period) + 1)

    def _plan_anew(self) -> None:
        super()._plan_anew()
        self._until_choice = 0
        # Heading that the network has chosen, rad. None while the robot explores frontiers.
        self._heading: float | None = None

    def _target(self, belief: Belief) -> Target | None:
        size = math.ceil(_LARGE * 2.0 * self.robot.radius / belief.grid.cell)
        large = replace(self._config, min_frontier=max(size, self._config.min_frontier))
        target = next_target(belief, self._ignored(belief), self.robot, large)
        return super()._target(belief) if target is None else target

    def _wheels(self, belief: Belief) -> FloatArray:
        known = int(np.count_nonzero(belief.grid.values))
        # Cells that become unknown again, and are seen again, are no growth.
        self._counts.append(max(known, *self._counts, 0))
        if self._until_choice <= 0:
            self._choose(belief)
            self._until_choice = HOLD
        self._until_choice -= 1
        if self._heading is None:
            return super()._wheels(belief)
        return wheels_towards(self._heading, belief.pose, self.robot)

    def _choose(self, belief: Belief) -> None:
        """Choose whether the network drives, and its heading."""
        view = self._network.view
        grid = own_part(belief, self.robot) if len(belief.other_poses) else belief.grid
        is_own = self._eyes is self.robot
        ranges = belief.ranges if is_own else expected_ranges(grid, belief.pose, self._eyes)
        observation = observe(grid, belief.pose, ranges, self._eyes, view)
        # The last two numbers of the observation are the distance to a frontier and whether there
        # is a way to it.
        is_near = bool(observation[-1]) and FAR * float(observation[-2]) <= _FARTHEST
        self._heading = None
        growth = (self._counts[-1] - self._counts[0]) * belief.grid.cell**2
        is_growing = (
            len(self._counts) == self._counts.maxlen
            and growth >= (1 + len(belief.other_poses)) * _GROWTH
        )
        if is_near and is_growing:
            self._drop()
            scores = self._network.scores(observation).astype(float)
            # The index of the largest score plus Gumbel noise has the distribution of the softmax.
            drawn = int(np.argmax(scores + TEMPERATURE * self._generator.gumbel(size=len(scores))))
            self._heading = float(belief.pose[2]) + view.angle(drawn)


def wheels_towards(heading: float, pose: FloatArray, robot: RobotSpec) -> FloatArray:
    """Wheel speeds (2,), fractions of the maximum, that turn a robot at a pose (3,) to a heading
    (rad) while it drives at top speed.
    """
    error = float(wrap_angle(heading - pose[2]))
    turn = float(np.clip(_GAIN * error, -_TURN_RATE, _TURN_RATE))
    return wheel_speeds(robot.max_wheel_speed * max(float(np.cos(error)), 0.0), turn, robot)


def own_part(belief: Belief, robot: RobotSpec) -> GridView:
    """The grid of one robot of a team: other robots are obstacles, and unknown cells that are
    nearer to another robot count as free.
    """
    grid = belief.grid
    others = belief.other_poses
    theirs = grid.unknown & nearer_to_others(grid, belief.pose, others)
    values = np.where(theirs, 1, grid.values)
    values[cells_near_robots(grid, others, 2.0 * robot.radius)] = -1
    return replace(grid, values=values.astype(grid.values.dtype))
