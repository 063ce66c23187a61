"""The map of the consistent estimator at one moment, with the pose: a joint Gaussian, and the
extents of the walls.
"""

from dataclasses import dataclass

import numpy as np

from limslam_agent.kernels.tables import POSE
from limslam_agent.slam.consistent.wall_map import Wall
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import direction, normal

_AT_WALL = 0.2  # m: a reading that ends farther from a wall says nothing of it
_AROUND = 0.5  # m: lines that are nearer count alike for the motion around an anchor
_ALIKE = np.deg2rad(
    0.5
)  # rad: lines whose directions are known so well, relative to each other, count alike, too
# share of the best determined direction below which the walls do not determine a direction
_LEAST_SEEN = 1e-3


@dataclass(frozen=True, eq=False)
class MapState:
    """What the estimator of one robot knows, without its pending readings.

    Attributes
    ----------
    pose
        Pose (3,), m, m, rad.
    lines, anchors
        Lines (m, 2) as (d, theta) about one anchor point each, m and rad, and the anchors (m, 2),
        m.
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
        rows = np.append(
            np.arange(POSE), [POSE + 2 * index + part for index in chosen for part in (0, 1)]
        ).astype(int)
        covariance = self.covariance[np.ix_(rows, rows)]
        walls = [self.walls[index] for index in chosen]
        return MapState(self.pose, self.lines[chosen], self.anchors[chosen], covariance, walls)

    def by_walls(self, pose: FloatArray, ends: FloatArray) -> FloatArray:
        """Derivative (3, 2 m) of a pose (3,) by the lines, if it was found by readings that end on
        them.

        The readings end at points (n, 2). A least squares fit of these points to the nearest walls
        has found the pose. The derivative is zero in directions that no wall determines.
        """
        if not self.walls:
            return np.zeros((POSE, 0))
        off = ends[:, None] - self.anchors
        low, high = np.array([wall.extent.ends for wall in self.walls]).T
        along = np.einsum("nmd,md->nm", off, direction(self.lines))
        away = np.abs(np.einsum("nmd,md->nm", off, normal(self.lines)) - self.lines[:, 0])
        away[(along < low - _AT_WALL) | (along > high + _AT_WALL)] = np.inf
        nearest = away.argmin(axis=1)
        rows = np.flatnonzero(away.min(axis=1) < _AT_WALL)
        # How far the walls move towards the points with each line, and with all of them together.
        by_lines = np.zeros((len(rows), 2 * len(self.lines)))
        column = 2 * nearest[rows]
        by_lines[np.arange(len(rows)), column] = 1.0
        by_lines[np.arange(len(rows)), column + 1] = -along[rows, nearest[rows]]
        x, y, _ = pose.tolist()
        by_motion = by_lines @ lines_moved_with((x, y), self.lines, self.anchors)
        return np.asarray(np.linalg.lstsq(by_motion, by_lines, rcond=_LEAST_SEEN)[0])


def poses_moved_with(place: tuple[float, float], poses: FloatArray) -> FloatArray:
    """Derivative (3 n, 3) of poses (n, 3) by a rigid motion of the world that moves a pose at a
    place, m.
    """
    by_pose = np.zeros((len(poses), POSE, POSE))
    by_pose[:] = np.eye(POSE)
    by_pose[:, 0, 2] = place[1] - poses[:, 1]
    by_pose[:, 1, 2] = poses[:, 0] - place[0]
    return by_pose.reshape(-1, POSE)


def lines_moved_with(
    place: tuple[float, float], lines: FloatArray, anchors: FloatArray
) -> FloatArray:
    """Derivative (2 n, 3) of lines (n, 2) about anchors (n, 2), as of the poses in
    :func:`poses_moved_with`.
    """
    by_line = np.zeros((len(lines), 2, POSE))
    by_line[:, 0, :2] = normal(lines)
    by_line[:, 0, 2] = np.sum((np.array(place) - anchors) * direction(lines), axis=1)
    by_line[:, 1, 2] = 1.0
    return by_line.reshape(-1, POSE)
