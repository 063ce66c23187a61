"""MapSnapshot: the map and the poses at one moment."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class MapSnapshot:
    """The map and the poses at one moment. Later steps do not change a snapshot.

    Attributes
    ----------
    poses
        Estimated pose of each robot (n, 3) in the world frame: x (m), y (m), heading (rad).
    covariances
        Covariance of each estimated pose (n, 3, 3). It grows while a robot is lost.
    odometry
        Pose of each robot by odometry alone (n, 3).
    landmarks
        The walls of the map as lines with covariances.
    segments
        The walls of the map (N, 4) as x1, y1, x2, y2 in the world frame, m.
    grid
        Occupancy grid.
    """

    poses: FloatArray
    covariances: FloatArray
    odometry: FloatArray
    landmarks: list[Landmark]
    segments: FloatArray
    grid: GridView

    @property
    def pose(self) -> FloatArray:
        """Pose of the first robot (3,)."""
        return np.asarray(self.poses[0])

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the first robot's pose (3, 3)."""
        return np.asarray(self.covariances[0])
