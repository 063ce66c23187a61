"""The map of the consistent estimator at one moment, with the pose: a joint Gaussian, and the extents of the walls."""

from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.slam.consistent.wall_map import NEW, Wall
from limslam_agent.slam.core.ekf import POSE
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import compose, transform_points


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

    def moved(self, frame: FloatArray, covariance: FloatArray) -> "MapState":
        """The state in another frame, in which the pose (3,) of its own frame is known by a match.

        ``covariance`` (3, 3) is that of the moved pose of the robot by the error of the match alone.
        """
        pose, anchors = compose(frame, self.pose), transform_points(frame, self.anchors)
        lines, turn = self.lines + np.array([0.0, frame[2]]), np.eye(len(self.covariance))
        cos, sin = np.cos(frame[2]), np.sin(frame[2])
        turn[:2, :2] = [[cos, -sin], [sin, cos]]
        x, y, _ = pose.tolist()
        by_match = np.vstack((poses_moved_with((x, y), pose[None]), lines_moved_with((x, y), lines, anchors)))
        joint = turn @ self.covariance @ turn.T + by_match @ covariance @ by_match.T
        return MapState(pose, lines, anchors, joint, self.walls)

    def joined(self, other: "MapState") -> "MapState":
        """The lines of both states, with the pose of the other one, which is independent of this one.

        The landmarks of the other state are ``NEW``.
        """
        count, size = 2 * len(self.lines), 2 * len(self.lines) + len(other.covariance)
        covariance, own = np.zeros((size, size)), slice(POSE, POSE + count)
        others = np.append(np.arange(POSE), np.arange(POSE + count, size))
        covariance[own, own] = self.covariance[POSE:, POSE:]
        covariance[np.ix_(others, others)] = other.covariance
        return MapState(
            pose=other.pose,
            lines=np.vstack((self.lines, other.lines)),
            anchors=np.vstack((self.anchors, other.anchors)),
            covariance=covariance,
            walls=[*self.walls, *(replace(wall, number=NEW) for wall in other.walls)],
        )


def poses_moved_with(place: tuple[float, float], poses: FloatArray) -> FloatArray:
    """Derivative (3 n, 3) of poses (n, 3) by a rigid motion of the world that moves a pose at a place, m."""
    by_pose = np.zeros((len(poses), POSE, POSE))
    by_pose[:] = np.eye(POSE)
    by_pose[:, 0, 2], by_pose[:, 1, 2] = place[1] - poses[:, 1], poses[:, 0] - place[0]
    return by_pose.reshape(-1, POSE)


def lines_moved_with(place: tuple[float, float], lines: FloatArray, anchors: FloatArray) -> FloatArray:
    """Derivative (2 n, 3) of lines (n, 2) about anchors (n, 2), as of the poses in :func:`poses_moved_with`."""
    by_line, (x, y) = np.zeros((len(lines), 2, POSE)), place
    cos, sin, (anchor_x, anchor_y) = np.cos(lines[:, 1]), np.sin(lines[:, 1]), anchors.T
    by_line[:, 0] = np.stack((cos, sin, cos * (y - anchor_y) - sin * (x - anchor_x)), axis=1)
    by_line[:, 1, 2] = 1.0
    return by_line.reshape(-1, POSE)
