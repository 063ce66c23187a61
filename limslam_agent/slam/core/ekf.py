"""Extended Kalman filter over the poses of robots and the lines that they share, with sparse
Jacobians.

State (the paper's eq. 1): x = [x, y, theta, ..., r_1, theta_1, ..., r_N, theta_N], one pose a
robot, covariance P. Letters x, P, F, Q, H, R, S are those of the literature. They are used in the
modules of the filters only.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from limslam_agent.kernels.tables import POSE
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import (
    from_frame,
    from_frame_jacobians,
    nearest_form,
    to_frame,
    to_frame_jacobians,
)
from limslam_env.geometry.se2 import compose, compose_jacobians, wrap_angle


class LineEKF(ExtendedKalmanFilter):
    """filterpy's filter for a growing state of length n: O(n) for a prediction and O(n^2) for an
    update.

    A motion changes only the pose, and an observed line depends on five entries of the state. So
    ``F`` and ``Q`` hold only the pose's (3, 3) block, ``update`` takes the non-zero columns of the
    Jacobian, and P changes in place by a product of rank two. The result equals that of the dense
    filter. It starts at the pose (3,), or at those of several robots (n, 3), with a covariance (3
    n, 3 n) that is zero if left out.
    """

    def __init__(self, pose: FloatArray, covariance: FloatArray | None = None) -> None:
        super().__init__(dim_x=np.size(pose), dim_z=2)
        self.x = np.array(pose, dtype=float).ravel()
        self._first = len(self.x)  # where the poses end in the state, and the lines begin
        self.P = (
            np.zeros((self._first,) * 2)
            if covariance is None
            else np.array(covariance, dtype=float, order="C")
        )

    @property
    def num_lines(self) -> int:
        """How many lines the state holds."""
        return (len(self.x) - self._first) // 2

    @property
    def poses(self) -> FloatArray:
        """The poses (n, 3), a copy."""
        return np.array(self.x[: self._first].reshape(-1, POSE))

    @property
    def pose(self) -> FloatArray:
        """The pose of the first robot (3,), a copy."""
        return np.array(self.x[:POSE])

    @property
    def joint_pose_covariance(self) -> FloatArray:
        """Covariance of all poses together (3 n, 3 n), a copy."""
        return np.array(self.P[: self._first, : self._first])

    def relocate(self, pose: FloatArray, covariance: FloatArray, robot: int = 0) -> None:
        """Put a robot at another pose (3,) with a covariance (3, 3), which is independent of all
        else.
        """
        part = slice(POSE * robot, POSE * robot + POSE)
        self.x[part] = pose
        self.P[part] = 0.0
        self.P[:, part] = 0.0
        self.P[part, part] = covariance

    @property
    def lines(self) -> FloatArray:
        """The lines (N, 2), a copy."""
        return np.array(self.x[self._first :].reshape(-1, 2))

    def line_covariance(self, index: int) -> FloatArray:
        """Covariance of one line (2, 2), a copy."""
        part = self._part(index)
        return np.array(self.P[part, part])

    def predict(self, increment: FloatArray, covariance: FloatArray, robot: int = 0) -> None:
        """Move a robot by an increment (3,) in its frame, with its covariance (3, 3)."""
        moved = slice(POSE * robot, POSE * robot + POSE)
        self.F, by_increment = compose_jacobians(self.x[moved], increment)
        self.Q = by_increment @ covariance @ by_increment.T
        self.x[moved] = compose(self.x[moved], increment)
        rows = self.F @ self.P[moved]
        rows[:, moved] = rows[:, moved] @ self.F.T + self.Q
        self.P[moved] = rows
        self.P[:, moved] = rows.T

    def update(
        self,
        z: FloatArray,
        HJacobian: Callable[..., FloatArray],
        Hx: Callable[..., FloatArray],
        R: FloatArray,
        args: tuple[Any, ...] = (),
        hx_args: tuple[Any, ...] = (),
        residual: Callable[[FloatArray, FloatArray], FloatArray] = np.subtract,
        *,
        columns: IntArray,
    ) -> None:
        """Correct the whole state by a measurement: filterpy's call, with a sparse Jacobian.

        Parameters
        ----------
        z
            Measurement (m,).
        HJacobian, Hx
            Functions of the state: Jacobian (m, k), and predicted measurement (m,).
        R
            Covariance of the measurement (m, m).
        args, hx_args
            Further arguments of the two.
        residual
            Difference of two measurements, for angles.
        columns
            Indices (k,) in the state of all that the measurement depends on. The Jacobian's other
            columns are zero.
        """
        H = HJacobian(self.x, *args)
        self.z = z
        self.R = R
        self.y = residual(z, Hx(self.x, *hx_args))
        HP = H @ self.P[columns]
        self.S = HP[:, columns] @ H.T + R
        # With S = L L^T, W = L^-1 H P: the gain's correction is W^T L^-1 y, and P loses W^T W.
        W, whitened = _whiten(self.S, HP, self.y)
        self.x += whitened @ W
        self.P -= W.T @ W
        self._restore_angles()

    def columns_of(self, index: int, robot: int = 0) -> IntArray:
        """Indices (5,) in the state of all that a robot's observation of one line depends on."""
        first = self._first + 2 * index
        pose = POSE * robot
        return np.array([pose, pose + 1, pose + 2, first, first + 1])

    def innovation(
        self, line: FloatArray, R: FloatArray, index: int, robot: int = 0
    ) -> tuple[FloatArray, FloatArray]:
        """Difference (2,) between an observed line and landmark ``index``, and its covariance (2,
        2).

        ``line`` is (r, theta) in the robot's frame with covariance ``R``. The covariance is that
        of observation and landmark together, the paper's Psi.
        """
        columns = self.columns_of(index, robot)
        H = self._line_jacobian(self.x, columns)
        predicted = self._observed(self.x, columns)
        form = nearest_form(line, predicted)
        return form - predicted, H @ self.P[np.ix_(columns, columns)] @ H.T + _in_form(
            R, line, form
        )

    def observe_line(self, line: FloatArray, R: FloatArray, index: int, robot: int = 0) -> None:
        """Update by an observed line (r, theta) in a robot's frame that is landmark ``index``."""
        columns = self.columns_of(index, robot)
        form = nearest_form(line, self._observed(self.x, columns))
        self.update(
            form,
            self._line_jacobian,
            self._observed,
            _in_form(R, line, form),
            args=(columns,),
            hx_args=(columns,),
            columns=columns,
        )

    def difference(self, older: int, younger: int) -> tuple[FloatArray, FloatArray]:
        """Difference (2,) of two landmarks in the younger's form, m and rad, and its covariance (2,
        2).
        """
        columns = np.concatenate((self.columns_of(older)[POSE:], self.columns_of(younger)[POSE:]))
        line = self.x[columns[:2]]
        other = self.x[columns[2:]]
        form = nearest_form(line, other)
        H = np.hstack((_in_form_jacobian(line, form), -np.eye(2)))
        return form - other, H @ self.P[np.ix_(columns, columns)] @ H.T

    def observe_landmark(self, older: int, younger: int) -> None:
        """Update by the older of two landmarks as if it were an observation of the younger, as the
        paper does.

        This ignores the correlation of the two landmarks and therefore counts shared information
        twice.
        """
        line = self.lines[older]
        R = self.line_covariance(older)
        columns = self.columns_of(younger)[POSE:]
        form = nearest_form(line, self.x[columns])
        self.update(
            form,
            lambda _: np.eye(2),
            lambda x: x[columns],
            _in_form(R, line, form),
            columns=columns,
        )

    def augment(self, line: FloatArray, R: FloatArray, robot: int = 0) -> int:
        """Add a new landmark, observed as ``line`` in a robot's frame, and return its index.

        Its covariance with the rest of the state follows from the pose from which it was observed.
        """
        pose = slice(POSE * robot, POSE * robot + POSE)
        by_pose, by_line = from_frame_jacobians(line, self.x[pose])
        old = len(self.x)
        P = np.empty((old + 2, old + 2))
        # Rounding makes P asymmetric over thousands of updates. P is copied here in any case.
        P[:old, :old] = 0.5 * (self.P + self.P.T)
        P[old:, :old] = by_pose @ P[pose, :old]
        P[:old, old:] = P[old:, :old].T
        P[old:, old:] = by_pose @ P[pose, pose] @ by_pose.T + by_line @ R @ by_line.T
        self.x = np.concatenate((self.x, from_frame(line, self.x[pose])))
        self.P = P
        self.dim_x = old + 2
        return self.num_lines - 1

    def _part(self, index: int) -> slice:
        first = self._first + 2 * index
        return slice(first, first + 2)

    @staticmethod
    def _observed(x: FloatArray, columns: IntArray) -> FloatArray:
        return to_frame(x[columns[POSE:]], x[columns[:POSE]])

    @staticmethod
    def _line_jacobian(x: FloatArray, columns: IntArray) -> FloatArray:
        return np.hstack(to_frame_jacobians(x[columns[POSE:]], x[columns[:POSE]]))

    def _restore_angles(self) -> None:
        """Wrap the angles, and normalise lines that crossed the origin to r >= 0, P included."""
        for heading in range(2, self._first, POSE):
            self.x[heading] = wrap_angle(float(self.x[heading]))
        r = self.x[self._first :: 2]
        theta = self.x[self._first + 1 :: 2]
        for index in np.nonzero(r < 0.0)[0]:
            row = self._first + 2 * index
            r[index] = -r[index]
            theta[index] = theta[index] + np.pi
            self.P[row] *= -1.0
            self.P[:, row] *= -1.0
        if len(theta) and np.abs(theta).max() > np.pi:
            theta[:] = wrap_angle(theta)


def _whiten(S: FloatArray, HP: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """``L^-1 HP`` (m, n) and ``L^-1 y`` (m,) with the Cholesky factor L of S (m, m).

    Written without LAPACK: m is one or two, and the overhead of its calls would exceed the rest of
    an update.
    """
    rows: list[list[float]] = S.tolist()
    L = [[0.0] * len(rows) for _ in rows]
    W = np.empty_like(HP)
    whitened = np.empty_like(y)
    for i in range(len(rows)):
        row = HP[i]
        difference = y[i]
        for j in range(i):
            L[i][j] = (rows[i][j] - sum(L[i][k] * L[j][k] for k in range(j))) / L[j][j]
            row = row - L[i][j] * W[j]
            difference = difference - L[i][j] * whitened[j]
        pivot = rows[i][i] - sum(part * part for part in L[i][:i])
        if not pivot > 0.0:
            raise np.linalg.LinAlgError("the innovation's covariance is not positive")
        L[i][i] = math.sqrt(pivot)
        W[i] = row / L[i][i]
        whitened[i] = difference / L[i][i]
    return W, whitened


def _in_form_jacobian(line: FloatArray, form: FloatArray) -> FloatArray:
    """Derivative (2, 2) of a line's equivalent form (-r, theta + pi), or of the line itself, by the
    line.
    """
    opposite = abs(wrap_angle(float(line[1] - form[1]))) > 0.5 * np.pi
    return np.diag([-1.0, 1.0]) if opposite else np.eye(2)


def _in_form(R: FloatArray, line: FloatArray, form: FloatArray) -> FloatArray:
    """Covariance (2, 2) of a line in an equivalent form, in which r may have the other sign."""
    turned = _in_form_jacobian(line, form)
    return np.asarray(turned @ R @ turned)
