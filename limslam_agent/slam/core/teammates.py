"""Detection of beams that may have hit another robot of the team, and must not become walls."""

import numpy as np

from limslam_agent.kernels.tables import POSE, THROUGH_SIGMAS, THROUGH_SLACK
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec


def may_hit_others(
    index: int,
    ranges: FloatArray,
    poses: FloatArray,
    covariance: FloatArray,
    robot: RobotSpec,
    sensor: RangeSensor,
) -> BoolArray:
    """Which beams (n_beams,) of one robot may end on another robot's body.

    A beam may have hit another robot if its end point is closer to that robot's estimated position than the body's
    radius plus a margin for the uncertainty of both positions, the same as that of beams that pass through walls.

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
    """
    from limslam_agent.kernels.nearness import beams_on_robot

    margins, suspicious = (float(robot.radius), THROUGH_SIGMAS, THROUGH_SLACK), np.zeros(len(ranges), bool)
    for other in range(len(poses)):
        if other != index:
            beams_on_robot(
                poses[index], poses[other], ranges, robot.beam_table, sensor.numbers, covariance, POSE * index,
                POSE * other, margins, suspicious,
            )  # fmt: skip
    return suspicious
