"""Steering: from a target point to wheel speeds, with a look at the front beams."""

import math

import numpy as np

from limslam_agent.belief import Belief
from limslam_agent.grid.occupancy import GridView
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
"""Number of steps for which the robot waits in front of an obstacle before it tries another way.

Three times as many steps without progress end the approach of a goal.
"""
_LOOKAHEAD = 0.25  # m
ARRIVED = 0.08
"""Distance at which a place is reached, m."""
AHEAD = 0.05
"""Progress on a path means that what is left of it is shorter by this distance, m."""
REPLAN_PERIOD = 5
"""Number of steps between two plans."""
BACK_STEPS = 8
"""Number of steps for which a robot drives backwards that could not go on."""


def steer(pose: FloatArray, target: FloatArray, ranges: FloatArray, robot: RobotSpec, cruise: float) -> FloatArray:
    """Wheel speeds (2,), fractions of the maximum, that drive towards a point (2,), m, at ``cruise`` m/s or less.

    If the heading is off by more than 40 degrees, the robot turns on the spot. Otherwise it drives, and slows down when
    the front beams show little free distance.
    """
    error = bearing_of(pose, target)
    if abs(error) > _TURN_IN_PLACE:
        return turn_by(error, robot)
    room = free_ahead(ranges, robot) - STOP_DISTANCE
    speed = cruise * math.cos(error) * min(max(room / 0.2, 0.0), 1.0)
    return wheel_speeds(speed, _turn_rate(error), robot)


def follow(
    path: FloatArray, away: FloatArray, belief: Belief, robot: RobotSpec, cruise: float
) -> tuple[FloatArray, float]:
    """Wheel speeds (2,) along a path (k, 2), m, at ``cruise`` m/s or less, and the length of path that is left, m.

    The robot steers for the first point after the nearest one that is farther away than 25 cm, or for the last one.
    ``away`` (k,) has the distances of the points from the robot, m.
    """
    nearest = int(away.argmin())
    ahead = np.flatnonzero(away[nearest:] > _LOOKAHEAD)
    aim = path[nearest + ahead[0]] if ahead.size else path[-1]
    left = float(away[nearest]) + (len(path) - nearest) * belief.grid.cell
    return steer(belief.pose, aim, belief.ranges, robot, cruise), left


def turn_by(error: float, robot: RobotSpec) -> FloatArray:
    """Wheel speeds (2,) that turn the robot on the spot by ``error`` (rad), positive counter-clockwise."""
    return wheel_speeds(0.0, _turn_rate(error), robot)


def bearing_of(pose: FloatArray, place: FloatArray) -> float:
    """Direction from a pose (3,) to a place (2,), m, as an angle from straight ahead, rad."""
    (x, y, heading), (goal_x, goal_y) = pose.tolist(), place.tolist()
    return float(wrap_angle(math.atan2(goal_y - y, goal_x - x) - heading))


def _turn_rate(error: float) -> float:
    return min(max(_TURN_GAIN * error, -TURN_RATE), TURN_RATE)


def free_ahead(ranges: FloatArray, robot: RobotSpec) -> float:
    """Distance (m) that the body can drive straight ahead before it meets the nearest point seen by a front beam.

    A beam without a finite reading is ignored. If all front beams are without a finite reading, the distance is zero.
    """
    from limslam_agent.kernels.nearness import room_ahead

    return room_ahead(np.asarray(ranges, dtype=float), robot.beam_table, _FRONT, robot.radius, _BODY_MARGIN)


def wheel_speeds(speed: float, turn_rate: float, robot: RobotSpec) -> FloatArray:
    """Left and right wheel speed (2,) as fractions of the maximum, from a speed (m/s) and a rate of turn (rad/s).

    If the wheels cannot do both, the rate of turn is kept and the speed is reduced.
    """
    turn = min(max(0.5 * turn_rate * robot.axle, -robot.max_wheel_speed), robot.max_wheel_speed)
    room = robot.max_wheel_speed - abs(turn)
    forward = min(max(speed, -room), room)
    return np.array([forward - turn, forward + turn]) / robot.max_wheel_speed


def nearest_beam(pose: FloatArray, place: FloatArray, robot: RobotSpec) -> tuple[int, float]:
    """The beam that needs the smallest turn to point at a place (2,), m, and that turn, rad."""
    offset = place - pose[:2]
    errors = wrap_angle(math.atan2(offset[1], offset[0]) - float(pose[2]) - robot.beam_angles)
    beam = int(np.argmin(np.abs(errors)))
    return beam, float(errors[beam])


def back_off(pose: FloatArray, grid: GridView, robot: RobotSpec, cruise: float) -> FloatArray:
    """Wheel speeds (2,) that drive straight back at half of ``cruise``, m/s.

    They are zero where the map does not show free ground behind.
    """
    heading = np.array([math.cos(pose[2]), math.sin(pose[2])])
    behind = robot.radius + np.arange(1, 4)[:, None] * 0.05
    places = np.vstack(
        [pose[:2] - behind * heading + side * robot.radius * heading[[1, 0]] * (-1, 1) for side in (-1, 0, 1)]
    )
    cells = grid.cells(places)
    inside = ((cells >= 0) & (cells < grid.values.shape)).all(axis=1)
    is_free = bool(inside.all()) and bool((grid.values[cells[:, 0], cells[:, 1]] > 0).all())
    return wheel_speeds(-0.5 * cruise if is_free else 0.0, 0.0, robot)
