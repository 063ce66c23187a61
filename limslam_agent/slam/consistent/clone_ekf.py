"""The filter of the consistent estimator: poses, lines, and clones of the poses at which beams were read.

The state is x = [poses of the robots, calibrations of their odometry if these are estimated, lines (d, theta), clones]
with covariance P. A clone is a copy of a pose with the same uncertainty, and correlated with all else from then on
(S. Roumeliotis and J. Burdick, "Stochastic cloning", 2002). A range is a measurement of the clone from which it was
read, even if the wall that the beam hit becomes known much later. So the noise of the odometry in between enters only
once.
"""

import numpy as np
from scipy.linalg.blas import dgemm

from limslam_agent.slam.consistent.clone_slots import CloneSlots, SpareMemory
from limslam_agent.slam.consistent.limits import HUBER
from limslam_agent.slam.consistent.separate_bias import (
    TURNS,
    OdometryErrors,
    RangeErrors,
    SeparateBias,
    by_range_errors,
)
from limslam_agent.slam.core.carried_anchors import KNOWN_PLACE, by_carried_anchor
from limslam_agent.slam.core.ekf import POSE, LineEKF
from limslam_agent.slam.core.triangular import solve_lower
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import normalise
from limslam_env.geometry.se2 import compose_jacobians, wrap_angle

LINE_PRIOR = (10.0**2, 3.0**2)
"""Variances of a new line's d and theta, m^2 and rad^2: large, so that the readings alone determine the line."""

EQUALITY_NOISE = (1e-4**2, 1e-5**2)
"""Variances, m^2 and rad^2, of the constraint that two merged lines are equal: small, but P stays regular."""


class CloneEKF(LineEKF):
    """The line filter with anchored lines and clones.

    Parameters
    ----------
    pose
        Start (3,), m, m, rad; of several robots (n, 3).
    calibration
        Prior covariance (3, 3) about zero of each robot's ``OdometryCalibration``; None if the odometry's calibration
        is not estimated. It becomes part of the state by :meth:`calibrate`, and until then the state takes the
        odometry to be without constant errors.
    range_errors
        Standard deviations of the errors of ``RangeErrors``, m and rad; None if these are not estimated.

    Attributes
    ----------
    has_turned_beams
        Whether beams are known to be turned. What is unknown of their directions is then a part of the covariance of
        the poses.
    """

    def __init__(
        self, pose: FloatArray, calibration: FloatArray | None = None, range_errors: tuple[float, ...] | None = None
    ) -> None:
        super().__init__(pose)
        self._bias = None if calibration is None else OdometryErrors(self._poses_end, calibration)
        self._range_errors = None if range_errors is None else RangeErrors(self._poses_end, range_errors)
        self._beams, self.has_turned_beams = len((range_errors or ())[TURNS]), False
        self._anchors = np.zeros((0, 2))
        self._memory = SpareMemory()
        self._clones = CloneSlots()

    @property
    def num_lines(self) -> int:
        """How many lines the state holds."""
        return len(self._anchors)

    @property
    def joint_pose_covariance(self) -> FloatArray:
        """Covariance of all poses together (3 n, 3 n), a copy."""
        joint = super().joint_pose_covariance
        if self.has_turned_beams and self._range_errors is not None:
            joint += self._range_errors.spread_by_turns(slice(0, len(joint)))
        return joint

    @property
    def lines_from(self) -> int:
        """Index in the state at which the lines begin."""
        return self._first

    @property
    def clones_from(self) -> int:
        """Index in the state at which the slots of the clones begin."""
        return self._first + 2 * self.num_lines

    @property
    def num_clones(self) -> int:
        """How many clones the state holds, without free slots."""
        return len(self._clones)

    @property
    def lines(self) -> FloatArray:
        """The lines (N, 2) as (r, theta) in the world, normalised."""
        return normalise(self._about_origin()) if self.num_lines else np.zeros((0, 2))

    @property
    def anchored(self) -> FloatArray:
        """The lines (N, 2) as (d, theta) about their anchors, a copy."""
        return np.array(self.x[self._first : self.clones_from].reshape(-1, 2))

    @property
    def anchors(self) -> FloatArray:
        """The lines' anchors (N, 2), m."""
        return self._anchors

    def line(self, index: int) -> FloatArray:
        """One line (2,) as (d, theta) about its anchor, a view."""
        return np.asarray(self.x[self._part(index)])

    def line_covariance(self, index: int) -> FloatArray:
        """Covariance (2, 2) of one line as (r, theta) in the world."""
        part = self._part(index)
        theta, anchor = float(self.x[part][1]), self._anchors[index]
        lever = anchor[1] * np.cos(theta) - anchor[0] * np.sin(theta)
        sign = 1.0 if self._about_origin()[index, 0] >= 0.0 else -1.0
        by_line = np.array([[sign, sign * lever], [0.0, 1.0]])
        return np.asarray(by_line @ self.P[part, part] @ by_line.T)

    def calibration(self, robot: int = 0) -> tuple[FloatArray, FloatArray] | None:
        """A robot's odometry calibration (3,) and its covariance (3, 3); None if it is not part of the state."""
        part = self._calibration_part(robot)
        return (np.array(self.x[part]), np.array(self.P[part, part])) if self._first > self._poses_end else None

    @property
    def calibration_evidence(self) -> float | None:
        """:attr:`SeparateBias.evidence` for constant errors; None if they are not estimated, or part of the state."""
        return None if self._bias is None else self._bias.evidence

    def calibrate(self) -> None:
        """Make the odometry's calibration a part of the state, with what all updates so far say of it."""
        if self._bias is None:
            return
        bias, self._bias = self._bias, None
        (errors, covariance), by_errors, size = bias.estimate, bias.by_errors, len(self.x)
        added = np.arange(self._first, 2 * self._first)
        old = np.concatenate((np.arange(self._first), np.arange(2 * self._first, size + self._first)))
        P, joint = self._memory.square(size + len(added)), by_errors @ covariance
        P[np.ix_(old, old)] = self.P + joint @ by_errors.T
        P[np.ix_(old, added)], P[np.ix_(added, old)] = joint, joint.T
        P[np.ix_(added, added)] = covariance
        x, change = np.zeros(len(P)), np.zeros(len(P))
        x[old], change[old], change[added] = self.x, by_errors @ errors, errors
        if self._range_errors is not None:
            self._range_errors.insert_independent(self._first, len(added))
        self.x, self.P, self.dim_x, self._first = x, P, len(P), 2 * self._first
        self._correct(change)

    def know_calibration(self, calibration: FloatArray, covariance: FloatArray) -> None:
        """Set the odometry calibration (3,) of the first robot, if it is a part of the state.

        Its covariance (3, 3) is given, and it is independent of all else.
        """
        if self.calibration() is not None:
            part = self._calibration_part(0)
            self.x[part], self.P[part], self.P[:, part] = calibration, 0.0, 0.0
            self.P[part, part] = covariance

    def predict(
        self, increment: FloatArray, covariance: FloatArray, robot: int = 0, by_calibration: FloatArray | None = None
    ) -> None:
        """Move a robot.

        Parameters
        ----------
        increment, covariance
            The motion in the robot's frame (3,), m, m, rad, and its covariance (3, 3).
        robot
            Which robot moves.
        by_calibration
            Derivative (3, 3) of the increment by the odometry's calibration, where that is estimated.
        """
        from limslam_agent.kernels.updates import move_pose

        moved = slice(POSE * robot, POSE * robot + POSE)
        if by_calibration is not None and self._bias is None:
            by_pose, by_increment = compose_jacobians(self.x[moved], increment)
            F = np.hstack((by_pose, by_increment @ by_calibration))
            columns = np.r_[moved, self._calibration_part(robot)]
            self._move(moved, increment, F, by_increment @ covariance @ by_increment.T, columns)
        else:
            by_pose, by_increment = np.zeros((POSE, POSE)), np.zeros((POSE, POSE))
            move_pose(self.x, self.P, moved.start, increment, covariance, by_pose, by_increment)
            self.F = by_pose
        for bias in self._biases:
            bias.predict(moved, by_pose)
        if by_calibration is not None and self._bias is not None:
            self._bias.drive(moved, by_increment @ by_calibration)

    def _put(self, robot: int, pose: FloatArray, covariance: FloatArray, by_state: FloatArray) -> None:
        super()._put(robot, pose, covariance, by_state)
        for bias in self._biases:
            bias.replace(slice(POSE * robot, POSE * robot + POSE), by_state)

    def clone(self, robot: int = 0) -> int:
        """Add a copy of a robot's pose to the state, and return the copy's number."""
        moved, missing = slice(POSE * robot, POSE * robot + POSE), self._clones.missing(self.clones_from)
        if missing == 1:
            self._append_copy(moved)
            return self._clones.fill()[0]
        self._add_slots(missing)
        number, slot = self._clones.fill()
        part = slice(self.clones_from + POSE * slot, self.clones_from + POSE * slot + POSE)
        self.x[part], self.P[part] = self.x[moved], self.P[moved]
        self.P[:, part] = self.P[part].T
        self.P[part, part] = self.P[moved, moved]
        for bias in self._biases:
            bias.copy(part, moved)
        return number

    def keep_clones(self, wanted: set[int]) -> None:
        """Marginalise all clones but the wanted ones. What they contributed to other states remains."""
        if self._clones.keep(wanted, self.clones_from):
            of_clones = self._columns_of(self._clones.close())
            self._keep(np.concatenate((np.arange(self.clones_from), of_clones.ravel())))

    def places(self, clones: IntArray) -> IntArray:
        """Slots (n,) of clones (n,)."""
        return self._clones.of(clones)

    def add_line(self, theta: float, anchor: FloatArray) -> int:
        """Add a line with an uninformative prior, and return its index.

        It goes through ``anchor`` (2,), m, with its normal at ``theta``, rad.
        """
        at, old = self.clones_from, len(self.x)
        places = np.concatenate((np.arange(at), np.arange(at + 2, old + 2)))
        x, P = np.zeros(old + 2), self._memory.square(old + 2)
        P[at : at + 2] = P[:, at : at + 2] = 0.0
        x[places] = self.x
        P[np.ix_(places, places)] = 0.5 * (self.P + self.P.T)
        x[at + 1] = theta
        P[[at, at + 1], [at, at + 1]] = LINE_PRIOR
        self.x, self.P, self.dim_x = x, P, old + 2
        for bias in self._biases:
            bias.insert_independent(at, 2)
        self._anchors = np.vstack((self._anchors, anchor))
        return self.num_lines - 1

    def add_known_line(self, line: FloatArray, covariance: FloatArray, anchor: FloatArray) -> int:
        """Add a line (r, theta) with a covariance (2, 2), independent of all else, and return its index.

        Its anchor (2,), m, should be near the wall.
        """
        (r, theta), index = line.tolist(), self.add_line(float(line[1]), anchor)
        part, (x, y) = self._part(index), anchor.tolist()
        cos, sin = np.cos(theta), np.sin(theta)
        about_anchor = np.array([[1.0, x * sin - y * cos], [0.0, 1.0]])
        self.x[part] = r - x * cos - y * sin, theta
        self.P[part, part] = about_anchor @ covariance @ about_anchor.T
        return index

    def observe(
        self, places: IntArray, readings: FloatArray, index: int, variances: FloatArray, iterations: int,
        huber: float = HUBER,
    ) -> None:  # fmt: skip
        """Update by readings of one line: the iterated EKF, linearised anew at each iteration.

        Parameters
        ----------
        places, readings, index
            Places of the clones (n,), beams and ranges (n, 6), and the line that they show.
        variances
            Variances of the ranges (n,), m^2.
        iterations
            Number of iterations.
        huber
            Residuals larger than so many standard deviations are down-weighted (P. Huber, "Robust estimation of a
            location parameter", 1964); 0 for no weights.
        """
        from limslam_agent.kernels.updates import update_by_readings

        left, right, moved, moved_again, expected, H, columns, factor, W, innovation, chosen = update_by_readings(
            self.x, self.P, self._parts, self._anchors, index, places, readings, variances, iterations, float(huber)
        )
        if not len(left):
            return
        if not factor[-1, -1] > 0.0:
            raise np.linalg.LinAlgError("the innovation's covariance is not positive")
        self._add_product(left, right)
        headings, theta = self.x[self._columns_of(places[chosen])[:, 2]], float(self.line(index)[1])
        direct = by_range_errors(expected, readings[chosen], headings, theta, self._beams)
        for bias in self._biases:
            bias.transport(moved)
            bias.update(H, columns, innovation, factor, W, direct if bias is self._range_errors else None)
            bias.transport(moved_again)
        self._restore_angles()

    def difference(self, older: int, younger: int) -> tuple[FloatArray, FloatArray]:
        """Difference (2,) of two lines about the younger's anchor, m and rad, and its covariance (2, 2)."""
        off, H, columns = self._equality(older, younger)
        return off, H @ self.P[np.ix_(columns, columns)] @ H.T

    def differences(self, pairs: list[tuple[int, int]]) -> tuple[FloatArray, FloatArray]:
        """Those of n pairs (2 n,), as of :meth:`difference`, and their joint covariance (2 n, 2 n)."""
        off, H = np.zeros(2 * len(pairs)), np.zeros((2 * len(pairs), len(self.x)))
        for row, pair in enumerate(pairs):
            off[2 * row : 2 * row + 2], own, columns = self._equality(*pair)
            H[2 * row : 2 * row + 2, columns] = own
        return off, H @ self.P @ H.T

    def marginal(self) -> FloatArray:
        """Joint covariance of the poses and all lines, without the calibration of the odometry and without clones."""
        kept = np.r_[: self._poses_end, self._first : self.clones_from]
        return np.array(self.P[np.ix_(kept, kept)])

    def restart(self, poses: FloatArray, lines: FloatArray, anchors: FloatArray, covariance: FloatArray) -> None:
        """Replace poses (n, 3) and lines (m, 2) with anchors (m, 2), which have a joint covariance; no clones are left.

        The calibration of the odometry is kept. From now on it is independent of the rest.
        """
        part = slice(self._poses_end, self._first)
        kept, size = np.r_[: self._poses_end, self._first : self._first + lines.size], self._first + lines.size
        P = np.zeros((size, size))
        P[part, part] = self.P[part, part]
        P[np.ix_(kept, kept)] = covariance
        self.x = np.concatenate((poses.ravel(), self.x[part], lines.ravel()))
        self.P, self.dim_x, self._anchors = P, size, np.array(anchors)
        self._clones.clear()
        for bias in self._biases:
            bias.restart(size)
        self._restore_angles()

    def merge(self, older: int, younger: int, iterations: int = 1) -> None:
        """Merge two lines: update by the constraint that they are equal, and marginalise the younger one.

        With more than one iteration, the constraint is linearised where the lines are equal. A common rotation of all
        lines and poses then changes nothing in it, so that many merges say nothing about the global heading.
        """
        start, transport = self.x.copy(), self._error_transport()
        change, moved = np.zeros_like(start), np.zeros((len(start), POSE))
        for _ in range(iterations):
            self.x += change
            moved = self._error_transport() - transport
            off, H, columns = self._equality(older, younger)
            HP, so_far = H @ self._transported_rows(columns, moved), self.x - start
            S = HP[:, columns] @ H.T + np.diag(EQUALITY_NOISE)
            change = (H @ so_far[columns] - off) @ np.linalg.solve(S, HP) - so_far
        factor = np.asarray(np.linalg.cholesky(S), dtype=float)
        self._transport(moved)
        W = np.ascontiguousarray(solve_lower(factor, HP))
        self._subtract_square(W)
        for bias in self._biases:
            bias.update(H, columns, H @ so_far[columns] - off, factor, W)
        self._correct(change)
        part = self._part(younger)
        self._keep(np.delete(np.arange(len(self.x)), np.arange(part.start, part.stop)))
        self._anchors = np.delete(self._anchors, younger, axis=0)

    @property
    def range_errors(self) -> RangeErrors | None:
        """Errors of the ranges beside the assumed ones, which the state does not know of; None if not estimated."""
        return self._range_errors

    def correct_ranges(self, errors: FloatArray) -> None:
        """Correct the state for the errors (k,) of ``RangeErrors``, and begin anew to estimate further ones.

        What remains unknown of turned beams becomes a part of the state's covariance. With the derivative V of the
        state by the turns since the last correction, and their covariance M, that adds V M V' to P, and V begins again
        at zero. Each correction adds this term by itself, although the error of the turns is the same one in all of
        them: the products of the derivatives from before and after a correction are left out.
        """
        if self._range_errors is not None:
            change = self._range_errors.by_errors[:, : len(errors)] @ errors
            if len(errors[TURNS]):
                self.P += self._range_errors.spread_by_turns(slice(None))
            self._range_errors = self._range_errors.corrected(errors)
            self._correct(change)

    @property
    def _biases(self) -> list[SeparateBias]:
        """The errors that are estimated beside the filter."""
        return [bias for bias in (self._bias, self._range_errors) if bias is not None]

    @property
    def _parts(self) -> tuple[int, int, int]:
        """Where the poses end in the state, and where lines and clones begin."""
        return self._poses_end, self._first, self.clones_from

    def _correct(self, change: FloatArray) -> None:
        """Add the correction (n,) of an update to the state, and transport the error of P to the new state.

        A rotation or shift of the whole world changes no range, so the global pose is unobservable and an update must
        not reduce its uncertainty. A standard EKF does reduce it once a correction has moved the point at which
        Jacobians are taken. Here each error is defined relative to the first robot's error, as in an invariant filter
        (A. Barrau and S. Bonnabel, "An EKF-SLAM algorithm with consistency properties", 2015), and P is transformed
        when the state changes.
        """
        before = self._error_transport()
        self.x += change
        self._transport(self._error_transport() - before)
        self._restore_angles()

    def _error_transport(self) -> FloatArray:
        """Derivative (n, 3) of the state by the first robot's pose when robot and world move together rigidly."""
        from limslam_agent.kernels.measurement import error_transport

        return error_transport(self.x, self._parts, self._anchors)

    def _transport(self, moved: FloatArray) -> None:
        """Transform P, in place, when the derivative of :meth:`_error_transport` has changed by ``moved`` (n, 3)."""
        for bias in self._biases:
            bias.transport(moved)
        rows = self.P[:POSE].copy()
        dgemm(1.0, rows.T, moved.T, beta=1.0, c=self.P.T, overwrite_c=1)
        columns = np.ascontiguousarray(self.P[:, :POSE])
        dgemm(1.0, moved, columns.T, beta=1.0, c=self.P.T, overwrite_c=1)

    def _transported_rows(self, columns: IntArray, moved: FloatArray) -> FloatArray:
        """Some rows of P as :meth:`_transport` would change them."""
        rows = self.P[columns] + moved[columns] @ self.P[:POSE]
        return np.asarray(rows + rows[:, :POSE] @ moved.T)

    def _calibration_part(self, robot: int) -> slice:
        first = self._poses_end + POSE * robot
        return slice(first, first + POSE)

    def _about_origin(self) -> FloatArray:
        lines = self.anchored
        normals = np.stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])), axis=1)
        return np.column_stack((lines[:, 0] + np.sum(normals * self._anchors, axis=1), lines[:, 1]))

    def _add_slots(self, count: int) -> None:
        """Append free slots for clones."""
        if count:
            old, size = len(self.x), len(self.x) + POSE * count
            P = self._memory.square(size)
            P[:old, :old], P[old:], P[:old, old:] = self.P, 0.0, 0.0
            self.x, self.P, self.dim_x = np.concatenate((self.x, np.zeros(POSE * count))), P, size
            self._clones.append(count)
            for bias in self._biases:
                bias.insert_independent(old, POSE * count)

    def _append_copy(self, moved: slice) -> None:
        """Append a slot with a copy of a pose. In a small map this is done at every step."""
        old, size = len(self.x), len(self.x) + POSE
        P, rows = self._memory.square(size), self.P[moved]
        P[:old, :old], P[old:, :old], P[:old, old:], P[old:, old:] = self.P, rows, rows.T, rows[:, moved]
        self.x, self.P, self.dim_x = np.concatenate((self.x, self.x[moved])), P, size
        self._clones.append(1)
        for bias in self._biases:
            bias.append_copy(moved)

    def _keep(self, places: IntArray) -> None:
        """Marginalise all of the state but some places of it."""
        P = self._memory.square(len(places))
        # Usually the last states are removed. Copying a block is five times as fast as indexing rows and columns.
        is_block = bool(np.array_equal(places, np.arange(len(places))))
        P[:] = self.P[: len(places), : len(places)] if is_block else self.P.take(places, axis=0).take(places, axis=1)
        # Rounding makes P asymmetric over thousands of updates. P is copied here in any case.
        P[:] = 0.5 * (P + P.T)
        self.x, self.P, self.dim_x = self.x[places], P, len(places)
        for bias in self._biases:
            bias.keep(places)

    def _columns_of(self, slots: IntArray) -> IntArray:
        """Indices (n, 3) of slots (n,) in the state."""
        return np.asarray(self.clones_from + POSE * slots[:, None] + np.arange(POSE))

    def _equality(self, older: int, younger: int) -> tuple[FloatArray, FloatArray, IntArray]:
        first, second = self._part(older), self._part(younger)
        (d, theta), other = self.x[first], self.x[second]
        between = self._anchors[younger] - self._anchors[older]
        cos, sin = np.cos(theta), np.sin(theta)
        sign = -1.0 if np.cos(theta - other[1]) < 0.0 else 1.0
        off = np.array([
            sign * (d - between[0] * cos - between[1] * sin) - other[0],
            wrap_angle(float(theta - other[1]) + (np.pi if sign < 0.0 else 0.0)),
        ])  # fmt: skip
        H = np.array([[sign, sign * (between[0] * sin - between[1] * cos), -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
        columns = np.array([first.start, first.start + 1, second.start, second.start + 1])
        x, y = (self._anchors[younger] - self.x[:2]).tolist()
        by_pose = np.array(by_carried_anchor(x, y, float(theta), float(other[1]), sign))
        if by_pose @ self.P[:POSE, :POSE] @ by_pose < KNOWN_PLACE:
            return off, H, columns
        return off, np.hstack((np.vstack((by_pose, np.zeros(POSE))), H)), np.concatenate((np.arange(POSE), columns))

    def _restore_angles(self) -> None:
        """Wrap the robots' headings. Angles of lines and clones only enter through sines and cosines."""
        for heading in range(2, self._poses_end, POSE):
            self.x[heading] = wrap_angle(float(self.x[heading]))
