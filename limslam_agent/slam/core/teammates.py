"""Detection of beams that may have hit another robot of the team, and must not become walls."""

import numpy as np

from limslam_agent.config.exploration import TeamConfig
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec


def may_hit_others(
    index: int,
    ranges: FloatArray,
    poses: FloatArray,
    covariance: FloatArray,
    robot: RobotSpec,
    sensor: RangeSensor,
    config: TeamConfig,
) -> BoolArray:
    """Which beams (n_beams,) of one robot may end on another robot's body.

    A beam may have hit another robot if its end point is closer to that robot's estimated position than the body's
    radius plus a margin for the uncertainty of both positions.

    Parameters
    ----------
    index
        The robot that measured.
    ranges
        Its readings (n_beams,), m.
    poses, covariance
        Estimated poses of all robots (n, 3), m, m, rad, and their joint covariance (3 n, 3 n).
    robot
        Body and beams of each robot.
    sensor
        How ranges are measured.
    config
        Size of the margin.
    """
    reached = ranges - sensor.bias
    ends = transform_points(poses[index], robot.beam_origins + reached[:, None] * robot.beam_directions)
    suspicious = np.zeros(len(ranges), dtype=bool)
    for other in range(len(poses)):
        if other == index:
            continue
        apart = ends - poses[other, :2]
        distance = np.linalg.norm(apart, axis=1)
        toward = apart / np.maximum(distance, 1e-9)[:, None]
        variance = _variance_along(toward, ends - poses[index, :2], index, other, covariance)
        margin = config.sigmas * np.sqrt(variance + sensor.variances(reached)) + config.slack
        # The nearest point inside a wide beam may be anywhere between its borders.
        suspicious |= distance <= robot.radius + margin + sensor.cone * reached
    return suspicious


def _variance_along(toward: FloatArray, arms: FloatArray, index: int, other: int, covariance: FloatArray) -> FloatArray:
    """Variance (k,), m^2, of the distance between beams' ends and another robot, along unit vectors (k, 2).

    ``arms`` (k, 2), m, are the vectors from the measuring robot to the end points, which rotate with its heading.
    """
    # Derivative of the distance by the measuring robot's x, y and theta, and by the other's x and y.
    turning = arms[:, 0] * toward[:, 1] - arms[:, 1] * toward[:, 0]
    jacobian = np.column_stack((toward, turning, -toward))
    first, second = POSE * index, POSE * other
    columns = [first, first + 1, first + 2, second, second + 1]
    block = covariance[np.ix_(columns, columns)]
    return np.asarray(np.maximum(np.einsum("ki,ij,kj->k", jacobian, block, jacobian), 0.0))
