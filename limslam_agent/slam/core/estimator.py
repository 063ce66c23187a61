"""The interface of the estimators, which compute poses and walls from motions and readings."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from limslam_agent.kernels.tables import POSE
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure, Comparison, Extraction, PendingPoints
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Motion, OdometryCalibration
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec


class Estimator:
    """Base class of the estimators.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage.
    belief
        The filter.

    Attributes
    ----------
    closures
        Pairs of landmarks that were found to be one wall, in order.
    last_extraction
        The lines of the latest scan; None before the first.
    associations
        The associations of observed lines so far, in order.
    on_association
        Called with the association of each observed line, for those who watch. Copies have no listener.
    on_comparison
        Called with each observed line and the landmarks that it was compared with, before the line is used. The
        comparisons are only collected if this is set.
    """

    def __init__(self, robot: RobotSpec, belief: Any) -> None:
        self.robot, self._belief = robot, belief
        self.closures: list[Closure] = []
        self.last_extraction: Extraction | None = None
        self.associations: list[AssociationRecord] = []
        self.on_association: Callable[[AssociationRecord], None] | None = None
        self.on_comparison: Callable[[Comparison], None] | None = None

    @property
    def association_limits(self) -> dict[str, float]:
        """The limits that decide about associations and loops, for diagnostics to show beside the values."""
        raise NotImplementedError

    @property
    def poses(self) -> FloatArray:
        """Estimated poses of all robots (n, 3), m, m, rad."""
        return np.asarray(self._belief.poses)

    @property
    def joint_covariance(self) -> FloatArray:
        """Covariance of all poses together (3 n, 3 n)."""
        return np.asarray(self._belief.joint_pose_covariance)

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3)."""
        joint = self.joint_covariance
        count = len(joint) // POSE
        if count == 1:
            return joint[None]
        return np.array([joint[POSE * k : POSE * k + POSE, POSE * k : POSE * k + POSE] for k in range(count)])

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m, in the world."""
        raise NotImplementedError

    @property
    def landmarks(self) -> list[Landmark]:
        """The landmarks that are walls of the map."""
        raise NotImplementedError

    @property
    def all_landmarks(self) -> list[Landmark]:
        """All landmarks, provisional ones included, by number."""
        raise NotImplementedError

    def odometry_calibration(self, robot: int) -> tuple[OdometryCalibration, FloatArray] | None:
        """A robot's odometry calibration and its covariance (3, 3); None if its odometry is not corrected."""
        del robot
        return None

    def assumed_calibration(self, robot: int) -> OdometryCalibration | None:
        """The odometry calibration by which a robot's next motion is corrected; None if it is never estimated."""
        del robot
        return None

    def report(self, record: AssociationRecord) -> None:
        """Store an association, and tell the listener of it."""
        self.associations.append(record)
        if self.on_association is not None:
            self.on_association(record)

    def relocate(self, pose: FloatArray, covariance: FloatArray, robot: int, by_lines: FloatArray | None) -> None:
        """Put a robot at another pose (3,), with a derivative (3, 2 N) by the lines: see :meth:`LineEKF.relocate`."""
        self._belief.relocate(pose, covariance, robot, by_lines)

    def know(self, landmarks: Sequence[Landmark], segments: FloatArray) -> None:
        """Begin with the walls (k, 4), m, of an earlier map, and the landmarks that they lie on."""
        raise NotImplementedError

    def predict(self, motion: Motion, robot: int) -> None:
        """Predict the pose of a robot that has moved."""
        self._belief.predict(motion.increment, motion.covariance, robot)

    def measure(self, number: int, front: FrontEnd, motion: Motion) -> None:
        """Use the new readings of a robot after its motion has been predicted."""
        raise NotImplementedError

    def finish(self, fronts: Sequence[FrontEnd]) -> None:
        """Use all pending readings at the end of a run."""
        raise NotImplementedError

    def pending_points(self, fronts: Sequence[FrontEnd]) -> list[PendingPoints]:
        """The pending points of each robot and side, in the world."""
        raise NotImplementedError
