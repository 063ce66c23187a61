"""Steering: from a target point to wheel speeds, and a guard that slows down before the body
touches anything.
"""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.belief import Belief
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec

_FRONT = math.radians(60.0)
_BODY_MARGIN = 0.03
_TURN_IN_PLACE = math.radians(40.0)
_TURN_GAIN = 2.5
TURN_RATE = 2.0
"""Fastest turn, rad/s."""
STOP_DISTANCE = 0.06
"""Free distance ahead of the rim below which the robot only turns, m."""
PATIENCE = 30
"""Number of steps without progress after which a look or the corner of a tour is given up.
Frontiers, the way home and turns on the spot have a multiple of it.
"""
_LOOKAHEAD = 0.25  # m
ARRIVED = 0.08
"""Distance at which a place is reached, m."""
AHEAD = 0.05
"""Progress on a path means that what is left of it is shorter by this distance, m."""
REPLAN_PERIOD = 5
"""Number of steps between two plans."""

# Number of steps for which a measured point is remembered, and a point of a beam that reads its
# minimum range.
MEMORY = 40
TOUCH = 3
# A beam at its minimum range is assumed to have hit something at this share of the minimum range.
TOUCHING = 0.4
LOOK_AHEAD = 0.3  # s
MARGIN = 0.025  # m
# A point that lies deeper (m) inside the body is wrong: it is noise, or the pose has been corrected
# since.
GHOST = 0.02
SHARES = np.array([1.0, 0.5, 0.25])


@dataclass
class Progress:
    """Whether a robot comes nearer to where it drives.

    ``left`` is the shortest remaining way so far, m, and ``idle`` the number of steps since it
    became shorter.
    """

    left: float = math.inf
    idle: int = 0

    def count(self, left: float, *, is_new: bool = False) -> None:
        """Count a step with a remaining way, m. ``is_new`` is whether the robot has seen something
        new.
        """
        is_nearer = left < self.left - AHEAD and math.isfinite(self.left)
        self.idle = 0 if is_nearer or is_new else self.idle + 1
        if is_nearer or not math.isfinite(self.left):
            self.left = left

    @property
    def is_stuck(self) -> bool:
        """Whether there has been no progress for too long."""
        return self.idle > PATIENCE


def steer(
    pose: FloatArray, target: FloatArray, ranges: FloatArray, robot: RobotSpec, cruise: float
) -> FloatArray:
    """Wheel speeds (2,), fractions of the maximum, that drive towards a point (2,), m, at
    ``cruise`` m/s or less.

    If the heading is off by more than 40 degrees, the robot turns on the spot. Otherwise it drives,
    and slows down when the front beams show little free distance.
    """
    error = bearing_of(pose, target)
    if abs(error) > _TURN_IN_PLACE:
        return turn_by(error, robot)
    room = free_ahead(ranges, robot) - STOP_DISTANCE
    speed = cruise * math.cos(error) * min(max(room / 0.2, 0.0), 1.0)
    return wheel_speeds(speed, _turn_rate(error), robot)


def follow(
    path: FloatArray, belief: Belief, robot: RobotSpec, cruise: float
) -> tuple[FloatArray, float] | None:
    """Wheel speeds (2,) along a path (k, 2), m, at ``cruise`` m/s or less, and the length of path
    that is left, m. None at its end.

    The robot steers for the first point after the nearest one that is farther away than 25 cm, or
    for the last one.
    """
    away = np.hypot(*(path - belief.pose[:2]).T)
    if away[-1] < ARRIVED or len(path) == 1:
        return None
    nearest = int(away.argmin())
    ahead = np.flatnonzero(away[nearest:] > _LOOKAHEAD)
    aim = path[nearest + ahead[0]] if ahead.size else path[-1]
    left = float(away[nearest]) + (len(path) - nearest) * belief.grid.cell
    return steer(belief.pose, aim, belief.ranges, robot, cruise), left


def turn_by(error: float, robot: RobotSpec) -> FloatArray:
    """Wheel speeds (2,) that turn the robot on the spot by ``error`` (rad), positive
    counter-clockwise.
    """
    return wheel_speeds(0.0, _turn_rate(error), robot)


def bearing_of(pose: FloatArray, place: FloatArray) -> float:
    """Direction from a pose (3,) to a place (2,), m, as an angle from straight ahead, rad."""
    (x, y, heading), (goal_x, goal_y) = pose.tolist(), place.tolist()
    return float(wrap_angle(math.atan2(goal_y - y, goal_x - x) - heading))


def _turn_rate(error: float) -> float:
    return min(max(_TURN_GAIN * error, -TURN_RATE), TURN_RATE)


def free_ahead(ranges: FloatArray, robot: RobotSpec) -> float:
    """Distance (m) that the body can drive straight ahead before it meets the nearest point seen by
    a front beam.

    A beam without a finite reading is ignored. If all front beams are without a finite reading, the
    distance is zero.
    """
    from limslam_agent.kernels.nearness import room_ahead

    return room_ahead(
        np.asarray(ranges, dtype=float), robot.beam_table, _FRONT, robot.radius, _BODY_MARGIN
    )


def wheel_speeds(speed: float, turn_rate: float, robot: RobotSpec) -> FloatArray:
    """Left and right wheel speed (2,) as fractions of the maximum, from a speed (m/s) and a rate of
    turn (rad/s).

    If the wheels cannot do both, the rate of turn is kept and the speed is reduced.
    """
    turn = min(max(0.5 * turn_rate * robot.axle, -robot.max_wheel_speed), robot.max_wheel_speed)
    room = robot.max_wheel_speed - abs(turn)
    forward = min(max(speed, -room), room)
    return np.array([forward - turn, forward + turn]) / robot.max_wheel_speed


def nearest_beam(pose: FloatArray, place: FloatArray, robot: RobotSpec) -> tuple[int, float]:
    """The beam that needs the smallest turn to point at a place (2,), m, and that turn, rad."""
    errors = wrap_angle(bearing_of(pose, place) - robot.beam_angles)
    beam = int(np.argmin(np.abs(errors)))
    return beam, float(errors[beam])


class CollisionGuard:
    """Reduces the forward speed when the body would come too close to a recently measured point.

    A few beams leave gaps, and a corner fits between two of them, so the guard remembers the
    readings of the last seconds. It places points by the change of the estimated pose since they
    were measured, and does not use the map, which may be wrong.

    Parameters
    ----------
    robot
        Body and beams.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self._seen = np.full((MEMORY, len(robot.beams), 2), np.nan)
        self._touched = np.full((TOUCH, len(robot.beams), 2), np.nan)
        self._steps = 0

    def add_readings(self, pose: FloatArray, ranges: FloatArray) -> None:
        """Remember the readings (n_beams,), m, that were taken at an estimated pose (3,)."""
        from limslam_agent.kernels.nearness import place_readings

        # The oldest readings are replaced.
        seen = self._seen[self._steps % MEMORY]
        touched = self._touched[self._steps % TOUCH]
        place_readings(
            pose, np.asarray(ranges, dtype=float), self._robot.beam_table, TOUCHING, seen, touched
        )
        self._steps += 1

    def limit_speed(self, pose: FloatArray, wheels: FloatArray) -> FloatArray:
        """Reduce wheel speeds (2,), fractions of the maximum, until the next 0.3 s are free of
        contact.

        The rate of turn stays the same. The forward speed is scaled by 1, 1/2, 1/4 or 0, whichever
        is the largest that keeps the body away from all remembered points.
        """
        from limslam_agent.kernels.nearness import safe_share

        robot = self._robot
        left, right = (each * robot.max_wheel_speed for each in wheels.tolist())
        speed = 0.5 * (left + right)
        turn = (right - left) / robot.axle
        heading = float(pose[2]) + 0.5 * turn * LOOK_AHEAD
        way = speed * LOOK_AHEAD * np.array([math.cos(heading), math.sin(heading)])
        nearest = robot.radius - GHOST, robot.radius + MARGIN
        share = safe_share(pose, way, self._seen, self._touched, *nearest, SHARES)
        return np.asarray(wheels - (1.0 - share) * (0.5 * float(wheels[0] + wheels[1])))
