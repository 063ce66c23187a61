"""LineSlam: estimates the poses of robots, and the walls around them, from a few beams and
odometry.
"""

from typing import TYPE_CHECKING, TypeGuard

from limslam_agent.config.presets import AgentConfig
from limslam_agent.config.published import PublishedConfig
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.core.diagnostics import AssociationRecord, Extraction
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

if TYPE_CHECKING:
    from limslam_agent.slam.published import Associate

__all__ = [
    "AssociationRecord",
    "ConsistentEstimator",
    "Estimator",
    "Extraction",
    "LineSlam",
    "RangeSensor",
    "is_renewable",
]


def LineSlam(  # noqa: N802 (the public name of a SLAM)
    robot: RobotSpec,
    config: AgentConfig,
    start_pose: FloatArray | None = None,
    sensor: RangeSensor | None = None,
    associate: "Associate | None" = None,
) -> Estimator:
    """SLAM with line landmarks, for one robot or for several robots that share a map.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage. The type of its ``estimator`` chooses the estimator.
    start_pose
        Start pose of the robot (3,), m, m, rad, by default the origin of the map; of several robots
        (n, 3).
    sensor
        How the ranges are measured, if that is known to differ from ``robot`` and ``config``. Only
        the consistent estimator uses it.
    associate
        What decides which landmark an observed line is, in place of the paper's association. Only
        the published method has such a part.

    Returns
    -------
    Estimator
        The consistent estimator, or the published method.

    Raises
    ------
    ValueError
        If another estimator than the published method is to associate in another way.

    Examples
    --------
    >>> import numpy as np
    >>> from limslam_agent import LineSlam, preset
    >>> from limslam_env import RobotSpec
    >>> slam = LineSlam(RobotSpec(), preset("paper"))
    >>> slam.step({"ranges": np.full(6, 1.0), "wheels": np.array([0.02, 0.02])})
    >>> slam.pose.tolist()
    [0.02, 0.0, 0.0]
    """
    if isinstance(config.estimator, PublishedConfig):
        # Only this estimator needs filterpy, which loads all of scipy.stats.
        from limslam_agent.slam.published import PublishedSlam

        return PublishedSlam(robot, config, start_pose, associate)
    if associate is not None:
        raise ValueError("only the published method (preset paper) takes another association")
    return ConsistentEstimator(robot, config, start_pose, sensor)


def is_renewable(slam: Estimator) -> TypeGuard[ConsistentEstimator]:
    """Whether pose and map can be replaced: those of a single robot, by the consistent
    estimator.
    """
    return isinstance(slam, ConsistentEstimator) and slam.is_renewable
