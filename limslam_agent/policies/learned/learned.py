"""A learned exploration policy: a small network on the believed grid chooses the heading, and a planner finishes.

The network sees what is near. The frontier explorer plans paths to what is far away, looks into the last corners, and
knows when there is nothing left. So the network drives where there is much to see, and the frontier explorer drives
elsewhere and ends the exploration.
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
from limslam_agent.policies.learned.polar_view import FAR, observe
from limslam_agent.policies.policy import NO_PLAN, MapExplorer
from limslam_agent.policies.right_of_way import RightOfWay, cells_near_robots, nearer_to_others
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

WEIGHTS = Path(__file__).parent / "weights"
"""Folder of the shipped weights."""

SHIPPED = "explorer.npz"
"""File of the weights that drive by default."""

ONLY_REMNANTS = "explored: only small remnants are left"
"""Why the exploration is over where a frontier explorer would go on."""

TEMPERATURE = 0.5
"""Temperature of the softmax from which directions are drawn.

The best direction at every decision would sometimes make the robot alternate between two places for ever.
"""


HOLD = 5
"""Number of steps between two decisions."""

# Rate of turn per heading error, 1/s, and largest rate of turn, rad/s.
_GAIN, _TURN_RATE = 5.0, 2.5
# The network drives while the map has grown by so many m^2 for each robot within the last so many seconds.
_GROWTH, _WINDOW = 0.6, 8.0
# Distance to the nearest frontier, m, up to which the network drives. It is the distance of the network's input, in
# which small remnants count as farther away.
_FARTHEST = 2.0
# Number of cells from which on a frontier is explored first. Most of what the network leaves are small remnants, and
# they wait until the large frontiers are explored.
_LARGE_FRONTIER = 8
# The exploration is over when only smaller frontiers are left and the map has grown by less than this area, m^2, within
# the last seconds. Remnants are cells at wall ends, which cost long ways and show next to nothing.
_REMNANT = 0.01


class LearnedPolicy(MapExplorer):
    """Drives at top speed in directions that a network chooses twice a second. Where there is little to see, a frontier
    explorer drives at the same speed, and ends the exploration.

    Parameters
    ----------
    robot, config
        Body, and the settings that all policies share. Those of the paper's robot and the default settings if left out.
    network
        Network that scores directions. The shipped one by default.
    seed
        Seed of the random numbers, or a generator.
    index
        The robot's place in its team. Of two robots that meet, the one with the higher index waits.

    Attributes
    ----------
    plan
        Path to the present goal of the frontier explorer (k, 2), m. Empty while the network drives.
    """

    def __init__(
        self,
        robot: RobotSpec | None = None,
        config: PolicyConfig | None = None,
        network: DirectionNetwork | None = None,
        seed: int | np.random.Generator = 0,
        index: int = 0,
    ) -> None:
        robot, config = robot or RobotSpec(), config or PolicyConfig()
        self._network = network or load_network(WEIGHTS / SHIPPED)
        self._generator = np.random.default_rng(seed)
        large = max(config.min_frontier, _LARGE_FRONTIER)
        fast = replace(config, speed=robot.max_wheel_speed, min_frontier=large)
        self._right_of_way = RightOfWay(index, robot)
        self._finisher = FrontierPolicy(robot, fast, index)
        super().__init__(robot)

    def enter(self, belief: Belief) -> None:
        """Also tell the frontier explorer."""
        super().enter(belief)
        self._finisher.enter(belief)

    def _forget_map(self) -> None:
        self._known = deque[int](maxlen=math.ceil(_WINDOW / self.robot.control_period) + 1)

    def _plan_anew(self) -> None:
        self._until_choice, self._heading, self._is_finishing = 0, 0.0, False

    @property
    def goal(self) -> FloatArray | None:
        """Present goal of the frontier explorer (2,), m. None while the network drives."""
        return self._finisher.goal if self._is_finishing else None

    def _wheels(self, belief: Belief) -> FloatArray:
        self._known.append(int(np.count_nonzero(belief.grid.values)))
        if self._until_choice <= 0:
            self._choose(belief)
            self._until_choice = HOLD
        self._until_choice -= 1
        wheels = self._end(belief) if self._is_finishing else self._towards_heading(belief)
        self.plan = self._finisher.plan if self._is_finishing else NO_PLAN
        return wheels

    def _end(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) of the frontier explorer, which ends the exploration; zero if it is over."""
        wheels = self._finisher.act(belief)
        self.stop_reason, size = self._finisher.stop_reason, self._finisher.frontier_size
        is_remnant = size is not None and size < _LARGE_FRONTIER
        if self.stop_reason is None and is_remnant and not self._is_growing(belief.grid, _REMNANT):
            self.stop_reason = ONLY_REMNANTS
        return wheels if self.stop_reason is None else np.zeros(2)

    def _towards_heading(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) towards the chosen direction."""
        if self._right_of_way.waits(belief.pose, belief.other_poses):
            return np.zeros(2)
        return wheels_towards(self._heading, belief.pose, self.robot)

    def _choose(self, belief: Belief) -> None:
        """Choose who drives, and the direction if it is the network."""
        view = self._network.view
        grid = own_part(belief, self.robot) if len(belief.other_poses) else belief.grid
        observation = observe(grid, belief.pose, belief.ranges, self.robot, view)
        # The last two numbers of the observation are the distance to a frontier and whether there is a way to it.
        is_near = bool(observation[-1]) and FAR * float(observation[-2]) <= _FARTHEST
        growth = (1 + len(belief.other_poses)) * _GROWTH
        self._is_finishing = not (is_near and self._is_growing(belief.grid, growth))
        if not self._is_finishing:
            scores = self._network.scores(observation).astype(float)
            # The index of the largest score plus Gumbel noise has the distribution of the softmax.
            drawn = int(np.argmax(scores + TEMPERATURE * self._generator.gumbel(size=len(scores))))
            self._heading = float(belief.pose[2]) + view.angle(drawn)

    def _is_growing(self, grid: GridView, area: float) -> bool:
        """Whether the map has grown by an area, m^2, in the last seconds. At the beginning it has."""
        is_full = len(self._known) == self._known.maxlen
        return not is_full or (self._known[-1] - self._known[0]) * grid.cell**2 >= area


def wheels_towards(heading: float, pose: FloatArray, robot: RobotSpec) -> FloatArray:
    """Wheel speeds (2,), fractions of the maximum, that turn a robot at a pose (3,) to a heading (rad) while it drives
    at top speed.
    """
    error = float(wrap_angle(heading - pose[2]))
    turn = float(np.clip(_GAIN * error, -_TURN_RATE, _TURN_RATE))
    return wheel_speeds(robot.max_wheel_speed * max(float(np.cos(error)), 0.0), turn, robot)


def own_part(belief: Belief, robot: RobotSpec) -> GridView:
    """The grid of one robot of a team: other robots are obstacles, and unknown cells that are nearer to another robot
    count as free.
    """
    grid, others = belief.grid, belief.other_poses
    theirs = grid.unknown & nearer_to_others(grid, belief.pose, others)
    values = np.where(theirs, 1, grid.values)
    values[cells_near_robots(grid, others, 2.0 * robot.radius)] = -1
    return replace(grid, values=values.astype(grid.values.dtype))
