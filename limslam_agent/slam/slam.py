"""LineSlam: estimates the poses of robots, and the walls around them, from a few beams and
odometry.
"""

import functools
from collections.abc import Callable
from typing import Any

from limslam_agent.config.presets import AgentConfig
from limslam_agent.config.published import PublishedConfig
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.consistent.map_state import MapState
from limslam_agent.slam.core.diagnostics import AssociationRecord, Extraction
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

__all__ = ["AssociationRecord", "Extraction", "LineSlam", "RangeSensor"]


class LineSlam(Estimator):
    """SLAM with line landmarks, for one robot or for several robots that share a map.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage. The type of its ``estimator`` chooses the estimator, of whose class
        the SLAM is.
    start_pose
        Start pose of the robot (3,), m, m, rad, by default the origin of the map; of several robots
        (n, 3).
    sensor
        How the ranges are measured, if that is known to differ from ``robot`` and ``config``. Only
        the consistent estimator uses it.

    Attributes
    ----------
    robots
        The front end of each robot.
    increments
        The motion (3,) of each robot in the latest step as its odometry reports it, without the
        calibration, in the frame of the robot before it.
    ticks
        The ticks (n, 2) of the wheels' encoders, m, as ``encoder_ticks.tick_by`` finds them.
    closures
        Pairs of landmarks that were found to be one wall, in order.
    last_extraction
        The lines of the latest scan; None before the first.
    associations
        The associations of observed lines so far, in order.
    on_association, on_comparison
        Called with the association of each observed line, and with each observed line and the
        landmarks that it was compared with before it is used, if set. Copies have no listeners.
    """

    def __new__(  # noqa: PYI034 (an estimator of another class)
        cls,
        robot: RobotSpec,
        config: AgentConfig,
        start_pose: FloatArray | None = None,
        sensor: RangeSensor | None = None,
    ) -> "LineSlam":
        """An object of the estimator that the settings choose."""
        del robot, start_pose, sensor
        return _empty(cls, config)

    def __reduce__(
        self,
    ) -> tuple[Callable[..., "LineSlam"], tuple[type["LineSlam"], AgentConfig], dict[str, Any]]:
        return _empty, (getattr(self, "_asked", LineSlam), self.config), vars(self)

    @property
    def map_state(self) -> MapState:
        """The pose and the map of a renewable estimate, without the pending readings. Later steps
        do not change it.
        """
        raise TypeError(_NOT_RENEWABLE)

    def renew(self, state: MapState) -> None:
        """Replace pose and map by a better estimate of both, which knows all readings so far."""
        del state
        raise TypeError(_NOT_RENEWABLE)

    def close(
        self, pose: FloatArray, covariance: FloatArray, ends: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Close a loop: readings that end at points (n, 2) have found the pose (3,) of the robot
        among the walls there.

        ``covariance`` (3, 3) is that of the match. Readings that are still pending are used before.
        Where the world has moved is returned: anchors (m, 2) of walls, and the rigid motion (m, 3)
        around each of them. It is None, and nothing changes, if the estimate does not explain that
        the robot is there.
        """
        del pose, covariance, ends
        raise TypeError(_NOT_RENEWABLE)


_NOT_RENEWABLE = "only the estimate of a single robot by the consistent estimator can be renewed"


class _ConsistentSlam(ConsistentEstimator, LineSlam):
    """The consistent estimator."""


@functools.cache
def _published_slam() -> type[LineSlam]:
    # Only this estimator needs filterpy, which loads all of scipy.stats.
    from limslam_agent.slam.published.published import PublishedEstimator

    class PublishedSlam(PublishedEstimator, LineSlam):
        """The published estimator."""

    return PublishedSlam


@functools.cache
def _subclass(asked: Any, kind: Any) -> Any:
    """A user's subclass of ``LineSlam``, as one of an estimator."""
    return type(asked.__name__, (asked, kind), {"_asked": asked})


def _empty(asked: Any, config: AgentConfig) -> LineSlam:
    """An object, still without state, of the estimator that the settings choose by their type."""
    kind: Any = (
        _published_slam() if isinstance(config.estimator, PublishedConfig) else _ConsistentSlam
    )
    made: type[LineSlam] = kind if asked is LineSlam else _subclass(asked, kind)
    return object.__new__(made)
