"""Policies without a planner: laps of a known loop, wall following, and a random walk."""

import math
from abc import abstractmethod

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.controller import (
    ARRIVED,
    STOP_DISTANCE,
    TURN_RATE,
    Progress,
    free_ahead,
    steer,
    turn_by,
    wheel_speeds,
)
from limslam_agent.policies.policy import MapExplorer
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

LAP_SPEED = 0.25
"""Cruising speed on laps, m/s."""
# The map has grown when it has this many more known cells.
_NEW_CELLS = 5
# Beams between these angles (rad from ahead to the right) see a wall beside the robot. A wall
# farther away than _LOST (m) does not count.
_SIDE = math.radians(30.0), math.radians(120.0)
_LOST = 0.8
_DISTANCE = 0.25  # m, between a wall that is followed and the rim of the robot
# Rate of turn per metre of sideways error, rad/s per m, and its largest value, rad/s.
_GAIN = 4.0
_SHARPEST = 1.0
_LITTLE_ROOM = 0.1
_MEAN_RUN = 2.0
_FACING = math.radians(8.0)


class Laps:
    """Drives a number of laps of a closed loop, by the estimated pose.

    Parameters
    ----------
    robot
        Body and beams.
    corners
        Corners of the loop (k, 2), m, in driving order.
    laps
        Number of laps.

    Examples
    --------
    >>> from limslam_agent import Laps, LimSlamAgent
    >>> from limslam_env import RobotSpec, load_world
    >>> policy = Laps(RobotSpec(), load_world("square").loop, laps=4)
    >>> agent = LimSlamAgent(RobotSpec(), policy=policy)
    """

    def __init__(self, robot: RobotSpec, corners: FloatArray, laps: int) -> None:
        self._robot = robot
        self._corners = corners
        self._remaining = laps * len(corners)
        self._next: int | None = None
        self._progress = Progress()
        self._frame = 0
        self.stop_reason: str | None = None
        self.plan: FloatArray = corners

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) towards the next corner. Zero after the last one."""
        away = np.hypot(*(self._corners - belief.pose[:2]).T)
        if self._next is None:
            self._next = (int(away.argmin()) + 1) % len(away)
        has_arrived = away[self._next] < ARRIVED
        if has_arrived:
            self._next = (self._next + 1) % len(away)
            self._remaining -= 1
        # In another frame, the corner is as near or far as that frame says.
        if has_arrived or belief.frame != self._frame:
            self._frame = belief.frame
            self._progress = Progress()
        if self._remaining <= 0:
            self.stop_reason = "all laps driven"
        self._progress.count(float(away[self._next]))
        if self.stop_reason is None and self._progress.is_stuck:
            self.stop_reason = (
                f"stopped: something is in the way to corner {self._next + 1} of the loop"
            )
        if self.stop_reason is not None:
            return np.zeros(2)
        corner = self._corners[self._next]
        return steer(belief.pose, corner, belief.ranges, self._robot, LAP_SPEED)


class ReactivePolicy(MapExplorer):
    """Base class of policies that react to the readings and stop when the map has not grown for a
    while.

    Parameters
    ----------
    robot, config
        Body and settings. Those of the paper's robot and the default settings if left out.
    patience
        Time without new cells after which the policy stops, s.
    where
        Where nothing new was seen, for the stop reason.
    """

    def __init__(
        self, robot: RobotSpec | None, config: PolicyConfig | None, patience: float, where: str
    ) -> None:
        self._config = config or PolicyConfig()
        self._patience = patience
        self._where = where
        super().__init__(robot or RobotSpec())

    def _plan_anew(self) -> None:
        self._known = self._since = 0

    def _wheels(self, belief: Belief) -> FloatArray:
        known = int(np.count_nonzero(belief.grid.values))
        self._since += 1
        if known > self._known + _NEW_CELLS:
            self._known = known
            self._since = 0
        if self._since > math.ceil(self._patience / self.robot.control_period):
            self.stop_reason = (
                f"stopped: nothing new was seen {self._where} for {self._patience:g} s"
            )
            return np.zeros(2)
        return self._wanted(belief)

    @abstractmethod
    def _wanted(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) while something new is seen."""


class WallFollower(ReactivePolicy):
    """Keeps a wall on the robot's right until there is nothing new to see.

    The robot drives around a room, or around a free-standing obstacle if that is the first wall
    that it meets. The policy uses the map only to decide when to stop.

    Parameters
    ----------
    robot, config
        Body and settings. Those of the paper's robot and the default settings if left out.

    Examples
    --------
    >>> from limslam_agent import LimSlamAgent, WallFollower
    >>> from limslam_env import RobotSpec
    >>> agent = LimSlamAgent(RobotSpec(), policy=WallFollower(RobotSpec()))
    """

    def __init__(self, robot: RobotSpec | None = None, config: PolicyConfig | None = None) -> None:
        super().__init__(robot, config, 90.0, "along the wall")
        # Angle (rad) turned since the wall was lost. A full turn means that no wall is followed
        # yet.
        self._turned = 2.0 * math.pi

    def _wanted(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) along the wall."""
        ranges = belief.ranges
        robot = self.robot
        config = self._config
        room = free_ahead(ranges, robot) - STOP_DISTANCE
        away = self._clearance(ranges)
        if room < 0.5 * _DISTANCE:
            self._turned = 0.0
            return wheel_speeds(0.0, TURN_RATE, robot)
        speed = config.speed * min(room / 0.2, 1.0)
        if math.isfinite(away):
            self._turned = 0.0
            return wheel_speeds(
                speed, float(np.clip(_GAIN * (_DISTANCE - away), -_SHARPEST, _SHARPEST)), robot
            )
        if self._turned > 1.5 * math.pi:
            return wheel_speeds(speed, 0.0, robot)
        # The wall has ended: drive around its end until another wall must appear.
        turn = speed / (_DISTANCE + robot.radius)
        self._turned += turn * robot.control_period
        return wheel_speeds(speed, -turn, robot)

    def _clearance(self, ranges: FloatArray) -> float:
        """Sideways distance (m) between the rim and the wall that the beams of the right see.
        Infinite if they see no wall.
        """
        robot = self.robot
        angles = -self.robot.beam_angles
        beside = (
            (angles > _SIDE[0])
            & (angles < _SIDE[1])
            & np.isfinite(ranges)
            & (ranges < robot.too_far)
        )
        across = -(robot.beam_origins[:, 1] + ranges * robot.beam_directions[:, 1])[beside]
        across = across[across < _LOST]
        return float(across.min()) - robot.radius if across.size else math.inf


class RandomPolicy(ReactivePolicy):
    """Drives straight ahead and turns at random: in front of a wall, and otherwise after a random
    time.

    Parameters
    ----------
    robot, config
        Body and settings. Those of the paper's robot and the default settings if left out.
    seed
        Seed of the random numbers, or a generator.

    Examples
    --------
    >>> from limslam_agent import LimSlamAgent, RandomPolicy
    >>> from limslam_env import RobotSpec
    >>> agent = LimSlamAgent(RobotSpec(), policy=RandomPolicy(RobotSpec(), seed=3))
    """

    def __init__(
        self,
        robot: RobotSpec | None = None,
        config: PolicyConfig | None = None,
        seed: int | np.random.Generator = 0,
    ) -> None:
        super().__init__(robot, config, 180.0, "by chance")
        self._generator = np.random.default_rng(seed)
        self._heading: float | None = None
        self._until_turn = 0

    def _wanted(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) of a random walk that bounces off the walls."""
        robot = self.robot
        config = self._config
        yaw = float(belief.pose[2])
        room = free_ahead(belief.ranges, robot) - STOP_DISTANCE
        self._until_turn -= 1
        if self._heading is None:
            if room > _LITTLE_ROOM and self._until_turn > 0:
                return wheel_speeds(config.speed * min(room / 0.2, 1.0), 0.0, robot)
            widest = math.pi if room <= _LITTLE_ROOM else 0.5 * math.pi
            self._heading = yaw + float(self._generator.uniform(-widest, widest))
            run = float(self._generator.exponential(_MEAN_RUN))
            self._until_turn = math.ceil(run / (config.speed * robot.control_period))
        error = float(wrap_angle(self._heading - yaw))
        if abs(error) < _FACING:
            self._heading = None
        return turn_by(error, robot)
