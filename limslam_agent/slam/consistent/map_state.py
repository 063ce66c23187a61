"""The map of the consistent estimator at one moment, with the pose: a joint Gaussian, and the
extents of the walls.
"""

from dataclasses import dataclass

import numpy as np

from limslam_agent.kernels.tables import POSE
from limslam_agent.slam.consistent.limits import ONE_WALL_GATE
from limslam_agent.slam.consistent.wall_map import Wall
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import direction, normal
from limslam_env.geometry.se2 import wrap_angle

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

    def closed(
        self, pose: FloatArray, covariance: FloatArray, ends: FloatArray
    ) -> "tuple[MapState, FloatArray] | None":
        """The state after a loop: readings that end at points (n, 2) have found the pose (3,) among
        the walls there.

        This is the update of the Kalman filter by a measurement of the pose relative to these
        walls, whose covariance (3, 3) is given. It moves all that is known since the robot has left
        them. The difference of both poses is measured in the found one, so that a motion of the
        whole world changes nothing in it. What lies around a wall moves with it along the wall,
        too: its own extent, and the cells of a grid.

        Returns
        -------
        state, motions
            The state, and the rigid motion (m, 3) of what lies around each line, about the anchors
            of this state. None if the covariance of this state does not explain the difference of
            the poses, or the walls do not determine the pose.
        """
        # Kernels. Who imports this module need not wait for numba.
        from limslam_agent.kernels.covariance import correct_state
        from limslam_agent.kernels.updates import linear_update
        from limslam_agent.slam.consistent.clone_ekf import CloneEKF

        by_walls = self.by_walls(pose, ends)
        off = self.pose - pose
        off[2] = wrap_angle(off[2])
        by_state = np.hstack((np.eye(POSE), -by_walls))
        by_state[:2, POSE:] -= np.outer([-off[1], off[0]], by_walls[2])
        x, y, _ = pose.tolist()
        determined = by_walls @ lines_moved_with((x, y), self.lines, self.anchors)
        ekf = CloneEKF(self.pose)
        ekf.restart(self.pose, self.lines, self.anchors, self.covariance)
        columns = np.arange(len(ekf.x))
        nothing = np.zeros((len(columns), POSE))
        update = linear_update(ekf.arrays, columns, by_state, -off, covariance, nothing)
        whitened = np.linalg.solve(np.tril(update.factor), off)
        if not np.allclose(determined, np.eye(POSE)) or whitened @ whitened > ONE_WALL_GATE:
            return None
        correct_state(ekf.arrays, update)
        lines = ekf.anchored
        motions = _motions_around(self, lines)
        along = np.einsum("md,md->m", motions[:, :2], direction(lines))
        about = _about_moved_anchors(along)
        anchors = self.anchors + along[:, None] * direction(lines)
        spread = about @ ekf.P @ about.T
        return MapState(ekf.pose, lines, anchors, spread, self.walls), motions


def _motions_around(state: MapState, lines: FloatArray) -> FloatArray:
    """The rigid motion (m, 3) of the world around each anchor of a state, of which the lines are
    now (m, 2).

    A line says nothing of a motion along it. So it is the motion that fits the lines around: most
    of all those that are near, and have the same error of the heading, since both ends of a loop
    may lie at the same place of the map.
    """
    motions = np.zeros((len(lines), POSE))
    changes = (lines - state.lines).ravel()
    headings = state.covariance[POSE + 1 :: 2, POSE + 1 :: 2]
    for number, (x, y) in enumerate(state.anchors.tolist()):
        away = np.hypot(*(state.anchors - (x, y)).T)
        turned = np.sqrt(
            np.maximum(
                np.diag(headings) + headings[number, number] - 2.0 * headings[number], _ALIKE**2
            )
        )
        weights = np.repeat(1.0 / ((_AROUND + away) * turned), 2)
        by_motion = lines_moved_with((x, y), state.lines, state.anchors)
        motions[number] = np.linalg.lstsq(
            by_motion * weights[:, None], changes * weights, rcond=_LEAST_SEEN
        )[0]
    return motions


def _about_moved_anchors(along: FloatArray) -> FloatArray:
    """Derivative (3 + 2 m, 3 + 2 m) of a state by the same state about anchors that lie back by
    distances (m,), m.
    """
    by_state = np.eye(POSE + 2 * len(along))
    lines = POSE + 2 * np.arange(len(along))
    by_state[lines, lines + 1] = -along
    return by_state


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
