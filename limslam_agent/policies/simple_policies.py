"""Policies without a planner: laps, along a wall, and at random."""

import math
from typing import Literal

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.collision_guard import Bumper
from limslam_agent.policies.controller import free_ahead, steer, turn_by, wheel_speeds
from limslam_agent.policies.policy import NO_PLAN
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

_ARRIVED = 0.08
# Wheel speeds that sum to less than this hardly move the robot; it waits so many steps before it gives up.
_CREEP = 0.05
_PATIENCE = 40
# The map has grown when it has so many more cells.
_NEW_CELLS = 5
# Beams that see a wall beside the robot, rad from ahead; what is farther across than _LOST, m, is another wall.
_SIDE = math.radians(30.0), math.radians(120.0)
_LOST = 0.8
# Rate of turn for an error across, rad/s per metre, and the largest one.
_GAIN, _SHARPEST = 4.0, 1.0
_LITTLE_ROOM = 0.1
_MEAN_RUN = 2.0
_FACING = math.radians(8.0)


class Laps:
    """Drive round a closed tour a number of times, by the believed pose.

    Parameters
    ----------
    robot, config
        Body and speeds.
    corners
        Of the tour (k, 2), m, in driving order.
    laps
        How many times.
    """

    def __init__(self, robot: RobotSpec, config: PolicyConfig, corners: FloatArray, laps: int) -> None:
        self._robot, self._config = robot, config
        self._corners = corners
        self._remaining = laps * len(corners)
        self._next: int | None = None
        self._standing = 0
        self.stop_reason: str | None = None
        self.plan: FloatArray = corners

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) towards the next corner; zero after the last."""
        if self._next is None:
            nearest = int(np.argmin(np.linalg.norm(self._corners - belief.pose[:2], axis=1)))
            self._next = (nearest + 1) % len(self._corners)
        if np.linalg.norm(self._corners[self._next] - belief.pose[:2]) < _ARRIVED:
            self._next = (self._next + 1) % len(self._corners)
            self._remaining -= 1
        if self._remaining <= 0:
            self.stop_reason = "all laps driven"
        if self.stop_reason is not None:
            return np.zeros(2)
        action = steer(
            belief.pose, self._corners[self._next], belief.ranges, self._robot, self._config, self._config.lap_speed
        )
        self._standing = self._standing + 1 if abs(float(action.sum())) < _CREEP else 0
        if self._standing > _PATIENCE:
            self.stop_reason = f"stopped: something is in the way to corner {self._next + 1} of the loop"
            return np.zeros(2)
        return action


class Wanderer:
    """Drives by what the beams show, until the map has not grown by anything worth mentioning for a while.

    Parameters
    ----------
    robot, config
        Body and speeds.
    patience
        Time without anything new after which it stops, s.
    where
        Nothing new was seen there.
    """

    def __init__(self, robot: RobotSpec, config: PolicyConfig, patience: float, where: str) -> None:
        self._robot, self._config = robot, config
        self._bumper = Bumper(robot)
        self._patience, self._where = patience, where
        self._known = self._since = 0
        self.stop_reason: str | None = None
        self.plan: FloatArray = NO_PLAN

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,); zero when there was nothing new for too long."""
        if self.stop_reason is None and self._is_old_news(belief.grid):
            self.stop_reason = f"stopped: nothing new was seen {self._where} for {self._patience:g} s"
        if self.stop_reason is not None:
            return np.zeros(2)
        self._bumper.note(belief.pose, belief.ranges)
        return self._bumper.soften(belief.pose, self._wheels(belief))

    def _wheels(self, belief: Belief) -> FloatArray:
        raise NotImplementedError

    def _is_old_news(self, grid: GridView) -> bool:
        known = int(np.count_nonzero(grid.values))
        self._since += 1
        if known > self._known + _NEW_CELLS:
            self._known, self._since = known, 0
        return self._since > math.ceil(self._patience / self._robot.control_period)


class WallFollower(Wanderer):
    """Keep a wall on one side, as far as these beams allow, until there is nothing new to see.

    It goes round rooms, and round whatever stands alone where it first meets a wall. It needs no map but to know when
    to stop.

    Parameters
    ----------
    robot, config
        Body and speeds.
    side
        Where to keep the wall, ``"left"`` or ``"right"``.
    distance
        Between the wall and the rim, m.
    patience
        Time without anything new after which it stops, s.

    Raises
    ------
    ValueError
        If the side is neither.
    """

    def __init__(
        self,
        robot: RobotSpec,
        config: PolicyConfig,
        side: Literal["left", "right"] = "right",
        distance: float = 0.25,
        patience: float = 90.0,
    ) -> None:
        if side not in {"left", "right"}:
            raise ValueError(f"a wall is followed on the left or the right side, not {side!r}")
        super().__init__(robot, config, patience, "along the wall")
        self._distance, self._toward = distance, 1.0 if side == "left" else -1.0
        # How far it has turned after a wall that it lost, rad; nothing to turn after before the first one.
        self._turned = 2.0 * math.pi

    def _wheels(self, belief: Belief) -> FloatArray:
        """Along the wall."""
        ranges = belief.ranges
        robot, config = self._robot, self._config
        room = free_ahead(ranges, robot) - config.stop_distance
        away = self._clearance(ranges)
        if room < 0.5 * self._distance:
            self._turned = 0.0
            return wheel_speeds(0.0, -self._toward * config.turn_rate, robot)
        speed = config.speed * min(room / 0.2, 1.0)
        if math.isfinite(away):
            self._turned = 0.0
            turn = float(np.clip(_GAIN * (away - self._distance), -_SHARPEST, _SHARPEST))
            return wheel_speeds(speed, self._toward * turn, robot)
        if self._turned > 1.5 * math.pi:
            return wheel_speeds(speed, 0.0, robot)
        # The wall has ended: round its end, as far as another wall can be.
        turn = speed / (self._distance + robot.radius)
        self._turned += turn * robot.control_period
        return wheel_speeds(speed, self._toward * turn, robot)

    def _clearance(self, ranges: FloatArray) -> float:
        """Distance (m) between the rim and what the beams of this side see, sideways; infinite if that is nothing."""
        robot = self._robot
        angles = self._toward * robot.beam_angles
        beside = (angles > _SIDE[0]) & (angles < _SIDE[1]) & np.isfinite(ranges) & (ranges < robot.too_far)
        across = self._toward * (robot.beam_origins[:, 1] + ranges * robot.beam_directions[:, 1])[beside]
        across = across[across < _LOST]
        return float(across.min()) - robot.radius if across.size else math.inf


class RandomPolicy(Wanderer):
    """Drive straight on, and turn by chance: in front of a wall, and after a while anyway.

    Parameters
    ----------
    robot, config
        Body and speeds.
    seed
        Of the numbers drawn, or a generator.
    patience
        Time without anything new after which it stops, s.
    """

    def __init__(
        self, robot: RobotSpec, config: PolicyConfig, seed: int | np.random.Generator = 0, patience: float = 180.0
    ) -> None:
        super().__init__(robot, config, patience, "by chance")
        self._generator = np.random.default_rng(seed)
        self._heading: float | None = None
        self._until_turn = 0

    def _wheels(self, belief: Belief) -> FloatArray:
        """A walk that bounces off the walls."""
        robot, config = self._robot, self._config
        yaw, room = float(belief.pose[2]), free_ahead(belief.ranges, robot) - config.stop_distance
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
        return turn_by(error, robot, config)
