"""Section 2.4: the extended Kalman filter over the poses of robots and the lines of walls.

Letters x, P, F, Q, H, R, z are those of the literature; x is the paper's mu, and P its Sigma.
"""

import warnings

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from scipy.linalg import LinAlgWarning

from limslam_agent.kernels.tables import POSE
from limslam_agent.slam.core.line_comparison import difference
from limslam_agent.slam.core.motion import Motion
from limslam_agent.slam.published.features import ObservedLine
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import from_frame, from_frame_jacobians, to_frame, to_frame_jacobians
from limslam_env.geometry.se2 import compose, compose_jacobians, wrap_angle


class LineFilter(ExtendedKalmanFilter):
    """The state x = [x, y, theta, r_1, theta_1, ..., r_N, theta_N] (eq. 1), P (eq. 2).

    ``predict`` and ``update`` are filterpy's. What was changed: a pose moves by the kinematic
    equations and not by a matrix, and an update restores angles and lines to one form, since they
    have several. It starts at poses (3,) or (n, 3), which are certain.
    """

    def __init__(self, poses: FloatArray) -> None:
        self._poses = np.size(poses)  # where the lines begin in the state
        self._begin(np.array(poses, dtype=float).ravel(), np.zeros((self._poses, self._poses)))

    def _begin(self, x: FloatArray, P: FloatArray) -> None:
        super().__init__(dim_x=len(x), dim_z=2)  # filterpy's state has a fixed length
        self.x = x
        self.P = P

    @property
    def poses(self) -> FloatArray:
        """The poses (n, 3), a copy."""
        return np.array(self.x[: self._poses].reshape(-1, POSE))

    @property
    def joint_pose_covariance(self) -> FloatArray:
        """Covariance of all poses together (3 n, 3 n), a copy."""
        return np.array(self.P[: self._poses, : self._poses])

    @property
    def lines(self) -> FloatArray:
        """The lines (N, 2), a copy."""
        return np.array(self.x[self._poses :].reshape(-1, 2))

    def line_covariance(self, index: int) -> FloatArray:
        """Covariance of one line (2, 2), a copy."""
        return np.array(self.P[self._line(index), self._line(index)])

    def move(self, motion: Motion, robot: int = 0) -> None:
        """Action update: a robot moves by odometry, and motion noise is added to P."""
        pose = self._pose(robot)
        self.F = np.eye(len(self.x))
        self.Q = np.zeros_like(self.P)
        self.F[pose, pose], by_motion = compose_jacobians(self.x[pose], motion.increment)
        self.Q[pose, pose] = by_motion @ motion.covariance @ by_motion.T
        self.predict((pose, motion.increment))

    def predict_x(self, u: tuple[slice, FloatArray]) -> None:
        """Move the pose in a part of the state by an increment (3,): a hook of filterpy."""
        pose, increment = u
        self.x[pose] = compose(self.x[pose], increment)

    def innovation(
        self, seen: ObservedLine, index: int, robot: int = 0
    ) -> tuple[FloatArray, FloatArray]:
        """Difference of an observed line and a landmark, and its covariance Psi of eq. 4."""
        predicted, H = self._expected(index, robot)
        y, turned = difference(seen.line, predicted)
        return y, H @ self.P @ H.T + turned @ seen.covariance @ turned

    def observe(self, seen: ObservedLine, index: int, robot: int = 0) -> None:
        """Measurement update of the whole state by an observed line that is a landmark."""
        self._correct(seen.line, seen.covariance, *self._expected(index, robot))

    def augment(self, seen: ObservedLine, robot: int = 0) -> int:
        """Add a landmark that is observed for the first time, and return its index."""
        pose = self.x[self._pose(robot)]
        by_pose, by_line = from_frame_jacobians(seen.line, pose)
        by_state = np.eye(len(self.x) + 2, len(self.x))
        by_state[-2:, self._pose(robot)] = by_pose
        P = by_state @ self.P @ by_state.T
        P[-2:, -2:] += by_line @ seen.covariance @ by_line.T
        self._begin(np.concatenate((self.x, from_frame(seen.line, pose))), 0.5 * (P + P.T))
        return len(self.lines) - 1

    def difference(self, older: int, younger: int) -> tuple[FloatArray, FloatArray]:
        """Difference of two landmarks, and its covariance."""
        rows = np.r_[self._line(older), self._line(younger)]
        y, turned = difference(*self.x[rows].reshape(2, 2))
        H = np.hstack((turned, -np.eye(2)))
        return y, H @ self.P[np.ix_(rows, rows)] @ H.T

    def observe_landmark(self, older: int, younger: int) -> None:
        """Section 2.5: a landmark is used as an observation, which counts twice what both share."""
        line = self._line(younger)
        H = np.eye(len(self.x))[line]
        self._correct(self.lines[older], self.line_covariance(older), self.lines[younger], H)

    def _pose(self, robot: int) -> slice:
        return slice(POSE * robot, POSE * robot + POSE)

    def _line(self, index: int) -> slice:
        return slice(self._poses + 2 * index, self._poses + 2 * index + 2)

    def _expected(self, index: int, robot: int) -> tuple[FloatArray, FloatArray]:
        """A landmark relative to a robot, z of eq. 3, and its Jacobian H (2, n)."""
        line = self._line(index)
        pose = self._pose(robot)
        H = np.zeros((2, len(self.x)))
        H[:, pose], H[:, line] = to_frame_jacobians(self.x[line], self.x[pose])
        return to_frame(self.x[line], self.x[pose]), H

    def _correct(self, line: FloatArray, R: FloatArray, z: FloatArray, H: FloatArray) -> None:
        """Correct the state by a line that is expected at z (2,)."""
        y, turned = difference(line, z)
        with warnings.catch_warnings():
            # Thousands of kilometres from the origin, r and theta of a line have one error.
            warnings.simplefilter("ignore", LinAlgWarning)
            self.update(z + y, lambda _: H, lambda _: z, turned @ R @ turned)
        # Lines that have crossed the origin get r >= 0, in P too, and all angles are wrapped.
        rows = self._poses + 2 * np.flatnonzero(self.x[self._poses :: 2] < 0.0)
        self.x[rows] *= -1.0
        self.x[rows + 1] += np.pi
        self.P[rows] *= -1.0
        self.P[:, rows] *= -1.0
        for angles in (self.x[2 : self._poses : POSE], self.x[self._poses + 1 :: 2]):
            angles[:] = wrap_angle(angles)
