"""The map of the consistent estimator at one moment, with the pose: a joint Gaussian, and the extents of the walls."""

from dataclasses import dataclass

import numpy as np

from limslam_agent.slam.consistent.wall_map import Wall
from limslam_agent.slam.core.ekf import POSE
from limslam_env.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class MapState:
    """What the estimator of one robot knows, without its pending readings.

    Attributes
    ----------
    pose
        Pose (3,), m, m, rad.
    lines, anchors
        Lines (m, 2) as (d, theta) about one anchor point each, m and rad, and the anchors (m, 2), m.
    covariance
        Joint covariance of the pose and all lines (3 + 2 m, 3 + 2 m).
    walls
        Extents and numbers of readings of the m landmarks.
    """

    pose: FloatArray
    lines: FloatArray
    anchors: FloatArray
    covariance: FloatArray
    walls: list[Wall]

    def select(self, chosen: list[int]) -> "MapState":
        """The state without the other landmarks."""
        rows = np.append(np.arange(POSE), [POSE + 2 * index + part for index in chosen for part in (0, 1)]).astype(int)
        covariance, walls = self.covariance[np.ix_(rows, rows)], [self.walls[index] for index in chosen]
        return MapState(self.pose, self.lines[chosen], self.anchors[chosen], covariance, walls)
