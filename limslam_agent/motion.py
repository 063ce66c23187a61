"""How far the robot has moved, and how surely: from wheel travel or from a log's odometry."""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.config import OdometryConfig
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import arc, arc_jacobian, wheels_to_arc
from limslam_env.interface import NominalNoise, Observation, RobotSpec

# The arc model itself is not perfect; this also keeps a covariance of a standing robot regular.
_LEAST_VARIANCE = 1e-12


@dataclass(frozen=True, eq=False)
class Motion:
    """One step's motion.

    Attributes
    ----------
    increment
        The new pose in the frame of the old one (3,), m, m, rad.
    covariance
        Of the increment (3, 3).
    """

    increment: FloatArray
    covariance: FloatArray


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
