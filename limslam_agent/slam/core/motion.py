"""Motion of a robot in one step, with its covariance, from wheel travel or from a log's
odometry.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from limslam_agent.config.shared import OdometryConfig
from limslam_agent.slam.core.turn_meter import Turn
from limslam_env.geometry import FloatArray
from limslam_env.geometry.numbers import floats
from limslam_env.geometry.se2 import arc, arc_derivatives, arc_jacobian, wheels_to_arc
from limslam_env.interface import NominalNoise, Observation, RobotSpec
from limslam_env.messages import described

# The arc model is not exact. The least variance also keeps the covariance of a standing robot
# regular.
LEAST_VARIANCE = 1e-12
"""Added to the variance of each wheel's travel, m^2."""

TOO_FAST = 300.0
"""A wheel that travels this many times as far in a step as the robot's largest wheel speed allows
is refused.
"""

LARGEST_MOTION = 1000.0
"""Largest motion in one step, m or rad, that is computed with."""

_SURE_TURN = 4.0  # in standard deviations: a smaller turn may be noise only


@dataclass(frozen=True, eq=False)
class Motion:
    """One step's motion.

    Attributes
    ----------
    increment
        The new pose in the frame of the old one (3,), m, m, rad.
    covariance
        Of the increment (3, 3).
    by_calibration
        Derivative (3, 3) of the increment by the odometry's calibration, where that is estimated.
    jitter
        Covariance (3, 3) of the pose, in its frame, about the sum of all increments:
        ``encoder_ticks.jitter_of``.
    turn
        The turn by a heading sensor, which the increment has; None for a robot without one.
    is_by_wheels
        Whether the wheels' travel has reported it, and not the odometry of a log.
    """

    increment: FloatArray
    covariance: FloatArray
    by_calibration: FloatArray | None = None
    jitter: FloatArray = field(default_factory=lambda: np.zeros((3, 3)))
    turn: Turn | None = None
    is_by_wheels: bool = False

    @property
    def has_turned(self) -> bool:
        """Whether the turn is no noise only.

        A filter takes the derivative by a constant error as exact, and would explain the noise of a
        straight drive by an axle that is too narrow, or by late ranges (errors in variables).
        """
        turn = self.increment.item(2)
        covariance = self.covariance.item(8)
        jitter = self.jitter.item(8)
        return bool(turn**2 > _SURE_TURN**2 * (covariance + 2.0 * jitter))


class OdometryCalibration(NamedTuple):
    """Constant errors of the odometry: the shares by which wheels and axle are larger than their
    nominal sizes.

    Attributes
    ----------
    left, right
        Of the left and of the right wheel.
    axle
        Of the distance between the wheels.
    """

    left: float
    right: float
    axle: float


AS_SPECIFIED = OdometryCalibration(0.0, 0.0, 0.0)
"""The calibration of odometry without constant errors."""


class HeadingCalibration(NamedTuple):
    """Constant errors of the odometry of a robot with a heading sensor.

    Attributes
    ----------
    size
        Share by which both wheels are larger than their nominal size.
    scale
        Share by which the robot turns more than the sensor says.
    drift
        How fast the heading of a robot that does not turn grows, rad/s.
    """

    size: float
    scale: float
    drift: float


Calibration = OdometryCalibration | HeadingCalibration
"""The constant errors of the odometry, which are three numbers with and without a heading sensor.
"""


def motion_from_wheels(wheels: FloatArray, robot: RobotSpec, noise: NominalNoise) -> Motion:
    """Differential-drive kinematics: the arc of left and right wheel travel (2,), m.

    Each wheel's variance is proportional to its travel (Chong and Kleeman, "Accurate odometry
    and error modelling for a mobile robot", 1997).
    """
    return Motion(*wheel_motion(wheels, robot.axle, noise.wheel_variance))


def wheel_motion(
    wheels: FloatArray, axle: float, wheel_variance: float, more: Sequence[float] = (0.0, 0.0)
) -> tuple[FloatArray, FloatArray]:
    """The increment (3,) of :func:`motion_from_wheels`, and its covariance (3, 3). A batch compiles
    this function. The variances of the travel are larger by ``more`` (2,), m^2.
    """
    distance, turn = wheels_to_arc(wheels, axle)
    by_arc = arc_derivatives(distance, turn)
    covariance = np.zeros((3, 3))
    for wheel, by_turn in ((0, -1.0 / axle), (1, 1.0 / axle)):
        variance = wheel_variance * abs(float(wheels[wheel])) + LEAST_VARIANCE + more[wheel]
        by_travel = [0.5 * by_distance + by_turn * by_heading for by_distance, by_heading in by_arc]
        for i in range(3):
            for j in range(3):
                covariance[i, j] += variance * by_travel[i] * by_travel[j]
    return arc(distance, turn), covariance


def motion_from_odometry(odometry: FloatArray, config: OdometryConfig) -> Motion:
    """Motion reported as a pose increment (3,), m, m, rad, corrected for its known bias.

    The variances are proportional to the distance driven and to the angle turned.
    """
    x, y, turn = (float(value) for value in odometry)
    distance = math.hypot(x, y)
    scale = config.distance_scale
    # The heading's error per metre has the opposite sign when the robot drives backwards.
    signed = math.copysign(distance, x)
    increment = np.array([scale * x, scale * y, turn + config.turn_bias * signed])
    along = config.distance_variance * distance + LEAST_VARIANCE
    heading = (
        config.turn_variance_per_metre * distance
        + config.turn_variance_per_radian * abs(turn)
        + LEAST_VARIANCE
    )
    # Heading noise accumulates on the way, so half of it acts on the sideways position at the end.
    by_noise = np.array([[1.0, -0.5 * y], [0.0, 0.5 * x], [0.0, 1.0]])
    covariance = (by_noise * np.array([along, heading])) @ by_noise.T
    covariance[1, 1] += 0.1 * along
    return Motion(increment, covariance)


def steered(
    motion: Motion, wheels: FloatArray, turn: Turn, noise: NominalNoise, more: float = 0.0
) -> Motion:
    """The motion of wheels that travel (2,), m, with the turn by a heading sensor. The variances of
    both wheels are larger by ``more`` in all, m^2.
    """
    left = float(wheels[0])
    right = float(wheels[1])
    distance = 0.5 * (left + right)
    variance = 0.5 * LEAST_VARIANCE + 0.25 * (
        noise.wheel_variance * (abs(left) + abs(right)) + more
    )
    by_arc = arc_jacobian(distance, turn.angle)
    covariance = (by_arc * np.array([variance, turn.variance])) @ by_arc.T
    # The covariance of a standing robot stays regular.
    covariance[1, 1] += LEAST_VARIANCE
    return replace(motion, increment=arc(distance, turn.angle), covariance=covariance, turn=turn)


def calibrated(motion: Motion, axle: float, calibration: Calibration) -> Motion:
    """A motion corrected for the constant errors of wheels and axle, or of wheels and heading.

    With wheel travel l = d - t b / 2 and r = d + t b / 2 and the axle b (m), the distance d and the
    turn t become (1 + (fl + fr) / 2) d + (fr - fl) t b / 4 and ((1 + (fl + fr) / 2) t + (fr - fl) d
    / b) / (1 + fb).

    A turn that may be noise only is left out of ``by_calibration``. With a heading sensor, the
    distance becomes (1 + size) d, and the turn t + scale m - drift s, if it has measured a turn m
    for s seconds.
    """
    x, y, turn = motion.increment.tolist()
    half = 0.5 * turn
    ahead = x * math.cos(half) + y * math.sin(half)
    driven = math.copysign(math.hypot(x, y), ahead) * (half / math.sin(half) if half else 1.0)
    if isinstance(calibration, HeadingCalibration):
        own = motion.turn or Turn(turn, 0.0)
        measured = (own.measured, own.seconds)
        distance, turned, by_errors = corrected_heading(driven, own.angle, measured, calibration)
        if not motion.has_turned:
            by_errors[1][1] = 0.0
    else:
        distance, turned, by_errors = corrected_wheels(driven, turn, axle, calibration)
        if not motion.has_turned:
            by_errors[1] = corrected_wheels(driven, 0.0, axle, calibration)[2][1]
    increment = motion.increment
    if any(calibration):
        # The motion of a log need not be an arc that wheels can drive.
        increment = arc(distance, turned) + (increment - arc(driven, turn))
    by_calibration = arc_jacobian(distance, turned) @ np.array(by_errors)
    return replace(motion, increment=increment, by_calibration=by_calibration)


def corrected_wheels(
    driven: Any, turn: Any, axle: float, calibration: Sequence[Any]
) -> tuple[Any, Any, list[list[Any]]]:
    """Distance, m, and turn, rad, of arcs without the errors (3,) of both wheels and of the axle,
    m, and their derivatives (2, 3) by these errors; numbers or arrays.
    """
    left, right, wide = calibration
    size = 1.0 + 0.5 * (left + right)
    uneven = right - left
    wider = 1.0 + wide
    lever = 0.25 * axle * turn
    drift = driven / axle
    distance = size * driven + uneven * lever
    turned = (size * turn + uneven * drift) / wider
    by_errors = [
        [0.5 * driven - lever, 0.5 * driven + lever, 0.0],
        [(0.5 * turn - drift) / wider, (0.5 * turn + drift) / wider, -turned / wider],
    ]
    return distance, turned, by_errors


def corrected_heading(
    driven: Any, turn: Any, measured: tuple[Any, Any], calibration: Sequence[Any]
) -> tuple[Any, Any, list[list[Any]]]:
    """The same without the errors (3,) of the wheels and of a heading sensor, which has measured a
    turn, rad, for some time, s.
    """
    size, scale, drift = calibration
    angle, seconds = measured
    by_errors = [[driven, 0.0, 0.0], [0.0, angle, -seconds]]
    return (1.0 + size) * driven, turn + scale * angle - drift * seconds, by_errors


def motion_of(
    observation: Observation, robot: RobotSpec, noise: NominalNoise, odometry: OdometryConfig
) -> Motion:
    """The motion that an observation reports, by wheel travel or by odometry.

    Raises
    ------
    ValueError
        If it reports neither of them, or numbers that are not finite or above ``LARGEST_MOTION``.
    """
    if "wheels" in observation:
        wheels = _numbers(observation["wheels"], 2, "wheels")
        more = unknown_of(observation)
        return Motion(
            *wheel_motion(wheels, robot.axle, noise.wheel_variance, more), is_by_wheels=True
        )
    if "odometry" in observation:
        return motion_from_odometry(_numbers(observation["odometry"], 3, "odometry"), odometry)
    raise ValueError("an observation needs 'wheels' or 'odometry'")


def unknown_of(observation: Observation) -> list[float]:
    """By how much the travel of each wheel is less certain than encoders are, m^2. Raises a
    ValueError if that is not two numbers, 0 or more.
    """
    if "wheel_variances" not in observation:
        return [0.0, 0.0]
    given = observation["wheel_variances"]
    found: list[float] = floats(given).tolist()
    if len(found) != 2 or not all(each >= 0.0 for each in found):
        raise ValueError(f"wheel_variances must be 2 numbers, 0 or more, not {described(given)}")
    return found


def _numbers(values: Any, size: int, key: str) -> FloatArray:
    array = floats(values)
    if array.shape != (size,) or not all(abs(each) <= LARGEST_MOTION for each in array.tolist()):
        raise ValueError(
            f"{key} must be {size} finite numbers, at most {LARGEST_MOTION:g} m or rad, not "
            f"{described(values)}"
        )
    return array


def longest_travel(robot: RobotSpec) -> float:
    """How far a wheel may travel in one step, m, before :func:`check_travel` refuses it.

    A jump of the odometry by a few metres is accepted: it makes the status ``lost``.
    """
    return TOO_FAST * robot.max_wheel_speed * robot.control_period


def check_travel(observation: Observation, robot: RobotSpec, longest: float) -> None:
    """Refuse wheel travel that the robot cannot drive in a step.

    Raises
    ------
    ValueError
        If it is not two finite numbers, or a wheel travels farther than ``longest``, m.
    """
    if "wheels" not in observation:
        return
    wheels = floats(observation["wheels"])
    if wheels.shape == (2,) and np.isnan(wheels).all():
        return
    farthest = max(map(abs, wheels.ravel().tolist()), default=0.0)
    if math.isfinite(farthest) and farthest > longest:
        limit = f"{robot.max_wheel_speed:g} m/s for {robot.control_period:g} s"
        raise ValueError(
            f"a wheel travels {farthest:.3g} m in one step, but the robot drives at most {limit}: "
            "wheels must be metres since the last observation, not ticks or millimetres"
        )
    _numbers(observation["wheels"], 2, "wheels")
