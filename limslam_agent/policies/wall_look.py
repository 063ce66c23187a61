"""One look at a stretch of border without a wall: the drive to a place, and a sweep of the beams along the stretch."""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig
from limslam_agent.policies.controller import (
    AHEAD,
    ARRIVED,
    PATIENCE,
    TURN_RATE,
    follow,
    nearest_beam,
    turn_by,
    wheel_speeds,
)
from limslam_agent.policies.wall_views import View, is_unfinished, path_to
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

_POINTED = math.radians(2.0)
# Number of steps between two checks of the path and of the stretch.
_CHECK_PERIOD = 10
# The sweep goes beyond the ends of a stretch by this angle.
_BEYOND = math.radians(4.0)
# Smallest and largest turn in one step of a sweep, rad. Readings after a smaller turn are not collected.
_FINEST, _COARSEST = math.radians(1.1), math.radians(5.0)
# The readings of a sweep are at most this far apart, m, and at least so many.
_SPACING, _FEWEST_READINGS = 0.03, 14


@dataclass(frozen=True)
class Sweep:
    """A slow turn on the spot.

    Attributes
    ----------
    start, end
        Headings between which the robot turns, rad. Their difference has the sign of the turn.
    step
        Turn in one step, rad, without a sign.
    """

    start: float
    end: float
    step: float

    @property
    def steps(self) -> float:
        """Number of steps that the turn takes."""
        return abs(self.end - self.start) / self.step

    @property
    def direction(self) -> float:
        """1 for a turn counter-clockwise, and -1 for a turn clockwise."""
        return math.copysign(1.0, self.end - self.start)

    def left(self, heading: float) -> float:
        """Angle (rad) that is left to turn at a heading (rad). Negative after the end."""
        middle = 0.5 * (self.start + self.end)
        return 0.5 * abs(self.end - self.start) - self.direction * wrap_angle(heading - middle)


def sweep_along(view: View, pose: FloatArray, robot: RobotSpec) -> Sweep:
    """The sweep from a pose (3,) that takes enough readings of a view for a wall of its length.

    One beam sweeps if its readings are enough, and otherwise all beams on that side of the robot.

    Parameters
    ----------
    view
        The stretch.
    pose
        Pose of the robot (3,), m, m, rad.
    robot
        Body and beams.
    """
    first, width = view.bearings(pose[:2])
    beam, _ = nearest_beam(pose, view.middle, robot)
    wanted = max(view.length / _SPACING, _FEWEST_READINGS)
    angles = robot.beam_angles[[beam]]
    if wanted * _FINEST > width:
        angles = robot.beam_angles[[each.side == robot.beams[beam].side for each in robot.beams]]
    step = float(np.clip(width * len(angles) / wanted, _FINEST, _COARSEST))
    low, high = first - float(angles.max()) - _BEYOND, first + width - float(angles.min()) + _BEYOND
    is_nearer = abs(wrap_angle(low - float(pose[2]))) <= abs(wrap_angle(high - float(pose[2])))
    return Sweep(low, high, step) if is_nearer else Sweep(high, low, step)


class Look:
    """Drives to the place of a view, and sweeps beams along the stretch.

    Parameters
    ----------
    view
        The stretch, the place and the path.
    robot, config
        Body and settings.

    Attributes
    ----------
    view
        The view.
    path
        Path to its place (k, 2), m, as it was planned last.
    is_over, is_needless, is_stuck
        Whether the look has ended. It has if the sweep is done, if the stretch has got its wall before (the look was
        needless), or if the robot cannot reach the place (it is stuck).
    """

    def __init__(self, view: View, robot: RobotSpec, config: PolicyConfig) -> None:
        self.view, self.path = view, view.path
        self._robot, self._config = robot, config
        self.is_over = self.is_needless = self.is_stuck = False
        self._sweep: Sweep | None = None
        self._is_pointing, self._left = True, math.inf
        self._idle, self._until_check = 0, _CHECK_PERIOD

    def act(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,). Zero if the look ends in this step."""
        if self._sweep is None:
            return self._drive(belief)
        return self._point(belief.pose, self._sweep) if self._is_pointing else self._turn(belief.pose, self._sweep)

    def _drive(self, belief: Belief) -> FloatArray:
        """Wheel speeds (2,) along the path."""
        self._until_check -= 1
        if self._until_check < 0:
            self._check(belief)
        away = np.hypot(*(self.path - belief.pose[:2]).T)
        if self.is_over:
            return np.zeros(2)
        if away[-1] < ARRIVED or len(self.path) == 1:
            self._sweep, self._idle = sweep_along(self.view, belief.pose, self._robot), 0
            return np.zeros(2)
        wheels, left = follow(self.path, away, belief, self._robot, self._config.speed)
        self._count_idle(left)
        return wheels

    def _count_idle(self, left: float) -> None:
        """Count the steps in which the remaining path, ``left`` (m), became no shorter, and end after too many."""
        self._idle = 0 if left < self._left - AHEAD else self._idle + 1
        self._left = left if self._idle == 0 else self._left
        self.is_over = self.is_stuck = self._idle > PATIENCE

    def _check(self, belief: Belief) -> None:
        """Plan the path anew, and end if the stretch has got its wall or there is no path any more."""
        self._until_check = _CHECK_PERIOD
        path = path_to(belief, self.view.stand, self._robot)
        self.is_needless = not is_unfinished(belief, self.view)
        self.is_over = self.is_needless or path is None
        self.path = self.path if path is None else path

    def _point(self, pose: FloatArray, sweep: Sweep) -> FloatArray:
        """Wheel speeds (2,) to the first heading of the sweep."""
        self._idle += 1
        error = wrap_angle(sweep.start - float(pose[2]))
        if abs(error) > _POINTED and self._idle <= 3 * PATIENCE:
            return turn_by(error, self._robot)
        self._is_pointing, self._idle = False, 0
        return np.zeros(2)

    def _turn(self, pose: FloatArray, sweep: Sweep) -> FloatArray:
        """Wheel speeds (2,) to the last heading of the sweep."""
        self._idle += 1
        if sweep.left(float(pose[2])) < _POINTED or self._idle > 3.0 * sweep.steps + PATIENCE:
            self.is_over = True
            return np.zeros(2)
        rate = min(sweep.step / self._robot.control_period, TURN_RATE)
        return wheel_speeds(0.0, sweep.direction * rate, self._robot)
