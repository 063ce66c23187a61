"""How far the robot has moved, and how surely: from wheel travel or from a log's odometry."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from limslam_agent.config.shared import OdometryConfig
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import arc, arc_jacobian, wheels_to_arc
from limslam_env.interface import NominalNoise, Observation, RobotSpec

# The arc model itself is not perfect; this also keeps a covariance of a standing robot regular.
_LEAST_VARIANCE = 1e-12

# In standard deviations: smaller turns may be nothing but noise.
_SURE_TURN = 4.0


@dataclass(frozen=True, eq=False)
class Motion:
    """One step's motion.

    Attributes
    ----------
    increment
        The new pose in the frame of the old one (3,), m, m, rad.
    covariance
        Of the increment (3, 3).
    by_factors
        How the increment depends on the odometry's factors (3, 3), where those are estimated.
    """

    increment: FloatArray
    covariance: FloatArray
    by_factors: FloatArray | None = None


class Factors(NamedTuple):
    """What odometry is wrong by all the time: left wheel, right wheel and axle are larger by these shares."""

    left: float
    right: float
    axle: float


def motion_from_wheels(wheels: FloatArray, robot: RobotSpec, noise: NominalNoise) -> Motion:
    """Differential-drive kinematics: the arc of left and right wheel travel (2,), m.

    Each wheel's variance is proportional to its travel (Chong and Kleeman, "Accurate odometry
    and error modelling for a mobile robot", 1997).
    """
    distance, turn = wheels_to_arc(wheels, robot.axle)
    by_wheels = arc_jacobian(distance, turn) @ np.array([[0.5, 0.5], [-1.0 / robot.axle, 1.0 / robot.axle]])
    variance = noise.wheel_variance * np.abs(wheels) + _LEAST_VARIANCE
    return Motion(arc(distance, turn), (by_wheels * variance) @ by_wheels.T)


def motion_from_odometry(odometry: FloatArray, config: OdometryConfig) -> Motion:
    """Motion reported as a pose increment (3,), corrected for its known bias.

    The noise grows with the distance driven and the angle turned.
    """
    x, y, turn = (float(value) for value in odometry)
    distance = math.hypot(x, y)
    scale = config.distance_scale
    # What the heading misses a metre unwinds when driving backwards.
    signed = math.copysign(distance, x)
    increment = np.array([scale * x, scale * y, turn + config.turn_bias * signed])
    along = config.distance_variance * distance + _LEAST_VARIANCE
    heading = config.turn_variance_per_metre * distance + config.turn_variance_per_radian * abs(turn) + _LEAST_VARIANCE
    # Heading noise acts along the way, half of it on the sideways position at the end.
    by_noise = np.array([[1.0, -0.5 * y], [0.0, 0.5 * x], [0.0, 1.0]])
    covariance = (by_noise * np.array([along, heading])) @ by_noise.T
    covariance[1, 1] += 0.1 * along
    return Motion(increment, covariance)


def resized(motion: Motion, axle: float, factors: Factors) -> Motion:
    """A motion as it is if wheels and axle are larger than was thought.

    With wheels l = d - t b / 2 and r = d + t b / 2 and the axle b (m), the distance d and the turn t become
    (1 + (fl + fr) / 2) d + (fr - fl) t b / 4 and ((1 + (fl + fr) / 2) t + (fr - fl) d / b) / (1 + fb).

    A turn that may be nothing but noise does not count in ``by_factors``. The filter takes that for exact, and would
    put down the noise of a straight drive to an axle that is too narrow (errors in variables).
    """
    x, y, turn = motion.increment.tolist()
    size, uneven, wider = 1.0 + 0.5 * (factors.left + factors.right), factors.right - factors.left, 1.0 + factors.axle
    ahead = x * math.cos(0.5 * turn) + y * math.sin(0.5 * turn)
    driven = math.copysign(math.hypot(x, y), ahead) / np.sinc(0.5 * turn / math.pi)
    lever, drift = 0.25 * axle * turn, driven / axle
    distance, turned = size * driven + uneven * lever, (size * turn + uneven * drift) / wider
    # A log's poses need not lie on the arc of any wheels.
    aside = motion.increment - arc(driven, turn)
    is_sure = turn**2 > _SURE_TURN**2 * motion.covariance[2, 2]
    sure, sure_turned = (turn, turned) if is_sure else (0.0, uneven * drift / wider)
    by_factors = arc_jacobian(distance, turned) @ np.array([
        [0.5 * driven - lever, 0.5 * driven + lever, 0.0],
        [(0.5 * sure - drift) / wider, (0.5 * sure + drift) / wider, -sure_turned / wider],
    ])  # fmt: skip
    return Motion(arc(distance, turned) + aside, motion.covariance, by_factors)


def motion_of(observation: Observation, robot: RobotSpec, noise: NominalNoise, odometry: OdometryConfig) -> Motion:
    """The motion that an observation reports, by its wheels or by its odometry.

    Raises
    ------
    ValueError
        If it reports neither, or something that is not finite.
    """
    if "wheels" in observation:
        wheels = np.asarray(observation["wheels"], dtype=float)
        _check(wheels, 2, "wheels")
        return motion_from_wheels(wheels, robot, noise)
    if "odometry" in observation:
        increment = np.asarray(observation["odometry"], dtype=float)
        _check(increment, 3, "odometry")
        return motion_from_odometry(increment, odometry)
    raise ValueError("an observation needs 'wheels' or 'odometry'")


def _check(values: FloatArray, size: int, key: str) -> None:
    if values.shape != (size,) or not np.isfinite(values).all():
        raise ValueError(f"{key} must be {size} finite numbers, not {values!r}")
