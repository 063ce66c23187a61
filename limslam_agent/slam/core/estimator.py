"""What all estimators have in common: poses and walls out of motions and readings."""

from collections.abc import Callable, Sequence

import numpy as np

from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure, Extraction, Waiting
from limslam_agent.slam.core.ekf import POSE, LineEKF
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Factors, Motion
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec


class Estimator:
    """The part of SLAM that two methods do in two ways.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    belief
        The filter.

    Attributes
    ----------
    closures
        Pairs of landmarks that were taken for one wall, in order.
    last_extraction
        What was found in the latest scan; None before the first.
    on_association
        Message what became of each observed line, for those who keep a record.
    """

    def __init__(self, robot: RobotSpec, belief: LineEKF) -> None:
        self.robot, self._belief = robot, belief
        self.closures: list[Closure] = []
        self.last_extraction: Extraction | None = None
        self.on_association: Callable[[AssociationRecord], None] | None = None

    @property
    def poses(self) -> FloatArray:
        """The believed poses of all robots (n, 3)."""
        return self._belief.poses

    @property
    def joint_covariance(self) -> FloatArray:
        """Covariance of all poses together (3 n, 3 n)."""
        return self._belief.joint_pose_covariance

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3)."""
        joint, count = self.joint_covariance, len(self.joint_covariance) // POSE
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
        """The same, and those that are provisional, by number."""
        raise NotImplementedError

    def factors(self, robot: int) -> tuple[Factors, FloatArray] | None:
        """What a robot's odometry is wrong by, and the covariance (3, 3); None where that is not estimated."""
        del robot
        return None

    def predict(self, motion: Motion, robot: int) -> None:
        """A robot has moved."""
        self._belief.predict(motion.increment, motion.covariance, robot)

    def measure(self, number: int, front: FrontEnd, motion: Motion) -> None:
        """Use the new readings of a robot, which has just moved."""
        raise NotImplementedError

    def finish(self, fronts: Sequence[FrontEnd]) -> None:
        """Use what still waits: nothing more will come."""
        raise NotImplementedError

    def waiting(self, fronts: Sequence[FrontEnd]) -> list[Waiting]:
        """What still waits, for those who want to watch."""
        raise NotImplementedError
