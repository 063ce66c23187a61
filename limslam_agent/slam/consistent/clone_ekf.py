"""The filter of the consistent estimator: poses, lines, and clones of poses at which beams were read.

State: x = [poses of the robots, factors of their odometry if asked for, lines (d, theta), clones], covariance P. A
clone is a copy of a pose, as sure and as unsure as it, and from then on correlated with all else (S. Roumeliotis and
J. Burdick, "Stochastic cloning", 2002). A beam is a measurement of the clone it was read from, however late one finds
out which wall it hit, and no noise of the odometry in between is counted twice.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg.blas import dgemm

from limslam_agent.slam.consistent.beam_model import GRAZING, Expected, Readings, expected_ranges
from limslam_agent.slam.core.ekf import POSE, LineEKF
from limslam_agent.slam.core.triangular import solve_lower
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import normalise
from limslam_env.geometry.se2 import compose_jacobians, wrap_angle

_PRIOR = np.array([10.0**2, 3.0**2])
_EXACT = np.array([1e-4, 1e-5]) ** 2


class Disagreement(NamedTuple):
    """How badly readings fit a line: by where it lies (two degrees of freedom), beside that, and how many were used."""

    of_line: float
    left: float
    used: int


class CloneEKF(LineEKF):
    """The line filter with anchored lines and clones.

    Parameters
    ----------
    pose
        Start (3,), m, m, rad; of several robots (n, 3).
    factors
        What is known beforehand of each robot's ``Factors``, as a covariance (3, 3) about
        zero; None to take odometry at its word.
    """

    def __init__(self, pose: FloatArray, factors: FloatArray | None = None) -> None:
        super().__init__(pose)
        if factors is not None:
            self._first = 2 * self._poses_end
            self.x, self.dim_x = np.concatenate((self.x, np.zeros(self._poses_end))), self._first
            self.P = np.kron(np.diag([0.0, 1.0]), np.kron(np.eye(self._poses_end // POSE), factors))
        self._anchors = np.zeros((0, 2))
        self._memory = [np.empty(0), np.empty(0)]
        self._clones: list[int] = []
        self._next_clone = 0

    @property
    def num_lines(self) -> int:
        """How many lines the state holds."""
        return len(self._anchors)

    @property
    def num_clones(self) -> int:
        """How many clones the state holds."""
        return len(self._clones)

    @property
    def lines(self) -> FloatArray:
        """The lines (N, 2) as (r, theta) in the world, normalised."""
        return normalise(self._about_origin()) if self.num_lines else np.zeros((0, 2))

    @property
    def anchored(self) -> FloatArray:
        """The lines (N, 2) as (d, theta) about their anchors, a copy."""
        return np.array(self.x[self._first : self._clones_from].reshape(-1, 2))

    @property
    def anchors(self) -> FloatArray:
        """The lines' anchors (N, 2), m."""
        return self._anchors

    def line_covariance(self, index: int) -> FloatArray:
        """Covariance (2, 2) of one line as (r, theta) in the world."""
        part = self._part(index)
        theta, anchor = float(self.x[part][1]), self._anchors[index]
        lever = anchor[1] * np.cos(theta) - anchor[0] * np.sin(theta)
        sign = 1.0 if self._about_origin()[index, 0] >= 0.0 else -1.0
        by_line = np.array([[sign, sign * lever], [0.0, 1.0]])
        return np.asarray(by_line @ self.P[part, part] @ by_line.T)

    def factors(self, robot: int = 0) -> tuple[FloatArray, FloatArray] | None:
        """A robot's odometry factors (3,) and their covariance (3, 3), if they are part of the state."""
        part = self._factors_part(robot)
        return (np.array(self.x[part]), np.array(self.P[part, part])) if self._first > self._poses_end else None

    def predict(
        self, increment: FloatArray, covariance: FloatArray, robot: int = 0, by_factors: FloatArray | None = None
    ) -> None:
        """Move a robot by an increment (3,) in its frame, with its covariance and derivative by the factors (3, 3)."""
        if by_factors is None:
            super().predict(increment, covariance, robot)
            return
        moved = slice(POSE * robot, POSE * robot + POSE)
        by_pose, by_increment = compose_jacobians(self.x[moved], increment)
        F, columns = np.hstack((by_pose, by_increment @ by_factors)), np.r_[moved, self._factors_part(robot)]
        self._move(moved, increment, F, by_increment @ covariance @ by_increment.T, columns)

    def clone(self, robot: int = 0) -> int:
        """Keep a copy of a robot's pose, and give back the copy's number."""
        moved, old = slice(POSE * robot, POSE * robot + POSE), len(self.x)
        P = self._spare(old + POSE)
        P[:old, :old] = self.P
        P[old:, :old] = self.P[moved]
        P[:old, old:] = self.P[moved].T
        P[old:, old:] = self.P[moved, moved]
        self.x, self.P = np.concatenate((self.x, self.x[moved])), P
        self._clones.append(self._next_clone)
        self._next_clone += 1
        return self._clones[-1]

    def keep_clones(self, wanted: set[int]) -> None:
        """Let go of all other clones: what they told stays in what they are correlated with."""
        kept = [place for place, number in enumerate(self._clones) if number in wanted]
        if len(kept) == len(self._clones):
            return
        places = (self._clones_from + POSE * np.array(kept, dtype=int)[:, None] + np.arange(POSE)).ravel()
        self._keep(np.concatenate((np.arange(self._clones_from), places)))
        self._clones = [self._clones[place] for place in kept]

    def clone_poses(self, clones: IntArray) -> FloatArray:
        """Where clones (n,) are believed to be (n, 3)."""
        return np.asarray(self.x[self._columns(clones)])

    def add_line(self, theta: float, anchor: FloatArray) -> int:
        """A new line through a point (2,), m, with the normal at ``theta``, of which nothing is known yet."""
        at, old = self._clones_from, len(self.x)
        places = np.concatenate((np.arange(at), np.arange(at + 2, old + 2)))
        x, P = np.zeros(old + 2), self._spare(old + 2)
        P[at : at + 2] = P[:, at : at + 2] = 0.0
        x[places] = self.x
        P[np.ix_(places, places)] = 0.5 * (self.P + self.P.T)
        x[at + 1] = theta
        P[[at, at + 1], [at, at + 1]] = _PRIOR
        self.x, self.P, self.dim_x = x, P, old + 2
        self._anchors = np.vstack((self._anchors, anchor))
        return self.num_lines - 1

    def observe(self, readings: Readings, index: int, std: float, iterations: int, huber: float) -> None:
        """Update by readings of one line, linearised anew at each iteration (the iterated EKF).

        Readings farther off than ``huber`` standard deviations count less, after Huber.
        """
        readings = readings.select(self._clear(readings, index))
        if not len(readings.ranges):
            return
        columns, places = self._involved(readings, index)
        start, carried, moved = self.x.copy(), self._carried(), np.zeros((len(self.x), POSE))
        change, weights = np.zeros_like(start), np.ones(len(readings.ranges))
        for _ in range(iterations):
            self.x += change
            # Jacobian and covariance belong to one and the same place.
            moved = self._carried() - carried
            expected = self._expected(self.x[columns], places, readings, index)
            H, off = self._jacobian(expected, places, len(columns)), readings.ranges - expected.ranges
            HP, so_far = H @ self._carried_rows(columns, moved), self.x - start
            S = HP[:, columns] @ H.T + np.diag(std**2 / weights)
            change = np.linalg.solve(S, off + H @ so_far[columns]) @ HP - so_far
            weights = np.minimum(1.0, huber * std / np.maximum(np.abs(off), 1e-9)) if huber else weights
        factor = np.linalg.cholesky(S)
        self._carry(moved)
        self._subtract_square(np.ascontiguousarray(solve_lower(factor, HP)))
        self._correct(change)

    def disagreement(self, readings: Readings, index: int, std: float) -> Disagreement | None:
        """How badly readings fit a line; None if too few of them meet it well enough to say.

        The generalised likelihood ratio of "it is this line" and "it is another one", both with all that is
        unsure about poses and line, and what "another one" leaves unexplained.
        """
        readings = readings.select(self._clear(readings, index))
        if len(readings.ranges) < 4:
            return None
        columns, places = self._involved(readings, index)
        expected = self._expected(self.x[columns], places, readings, index)
        H = self._jacobian(expected, places, len(columns))
        S = H @ self.P[np.ix_(columns, columns)] @ H.T + std**2 * np.eye(len(readings.ranges))
        off, by_line = readings.ranges - expected.ranges, expected.by_line
        solved = np.linalg.solve(S, np.column_stack((off, by_line)))
        along = by_line.T @ solved[:, 0]
        of_line = float(along @ np.linalg.solve(by_line.T @ solved[:, 1:], along))
        return Disagreement(of_line, float(off @ solved[:, 0]) - of_line, len(readings.ranges))

    def clone_covariance(self, clones: IntArray) -> FloatArray:
        """Joint covariance (3 n, 3 n) of clones (n,)."""
        columns = self._columns(clones).ravel()
        return np.asarray(self.P[np.ix_(columns, columns)])

    def difference(self, older: int, younger: int) -> tuple[FloatArray, FloatArray]:
        """How far two lines are from being one (2,), about the younger's anchor, and the covariance of that (2, 2)."""
        off, H, columns = self._equality(older, younger)
        return off, H @ self.P[np.ix_(columns, columns)] @ H.T

    def unite(self, older: int, younger: int) -> None:
        """Make two lines one: both are corrected by their being equal, and the younger is let go."""
        off, H, columns = self._equality(older, younger)
        HP = H @ self.P[columns]
        S = HP[:, columns] @ H.T + np.diag(_EXACT)
        gain = np.linalg.solve(S, HP)
        factor = np.linalg.cholesky(S)
        self._subtract_square(solve_lower(factor, HP))
        self._correct(-off @ gain)
        part = self._part(younger)
        self._keep(np.delete(np.arange(len(self.x)), np.arange(part.start, part.stop)))
        self._anchors = np.delete(self._anchors, younger, axis=0)

    @property
    def _clones_from(self) -> int:
        return self._first + 2 * self.num_lines

    def _correct(self, change: FloatArray) -> None:
        """Change the state after an update, and carry what is unsure along with it.

        When the whole world is turned or shifted, no range changes. The plain filter forgets that once a correction
        has moved what Jacobians are taken at, and seems to learn its heading from nothing. An error is therefore kept
        as what it is beside the first robot's own, as an invariant filter would (A. Barrau and S. Bonnabel, "An
        EKF-SLAM algorithm with consistency properties", 2015), and P follows when the state moves.
        """
        before = self._carried()
        self.x += change
        self._carry(self._carried() - before)
        self._restore_angles()

    def _carried(self) -> FloatArray:
        """How all of the state (n, 3) moves with the first robot when the whole world does."""
        moved = np.zeros((len(self.x), POSE))
        x, y, _ = self.x[:POSE]
        for part in (slice(0, self._poses_end), slice(self._clones_from, None)):
            poses, by_pose = self.x[part].reshape(-1, POSE), moved[part].reshape(-1, POSE, POSE)
            by_pose[:] = np.eye(POSE)
            by_pose[:, 0, 2], by_pose[:, 1, 2] = y - poses[:, 1], poses[:, 0] - x
        theta, by_line = self.anchored[:, 1], moved[self._first : self._clones_from].reshape(-1, 2, POSE)
        cos, sin, (anchor_x, anchor_y) = np.cos(theta), np.sin(theta), self._anchors.T
        by_line[:, 0] = np.stack((cos, sin, cos * (y - anchor_y) - sin * (x - anchor_x)), axis=1)
        by_line[:, 1, 2] = 1.0
        return moved

    def _carry(self, moved: FloatArray) -> None:
        """P after what moves with the first robot's error (n, 3) has changed by ``moved``, in place."""
        rows = self.P[:POSE].copy()
        dgemm(1.0, rows.T, moved.T, beta=1.0, c=self.P.T, overwrite_c=1)
        columns = np.ascontiguousarray(self.P[:, :POSE])
        dgemm(1.0, moved, columns.T, beta=1.0, c=self.P.T, overwrite_c=1)

    def _carried_rows(self, columns: IntArray, moved: FloatArray) -> FloatArray:
        """Some rows of what P would then be."""
        rows = self.P[columns] + moved[columns] @ self.P[:POSE]
        return np.asarray(rows + rows[:, :POSE] @ moved.T)

    def _factors_part(self, robot: int) -> slice:
        first = self._poses_end + POSE * robot
        return slice(first, first + POSE)

    def _about_origin(self) -> FloatArray:
        lines = self.anchored
        normals = np.stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])), axis=1)
        return np.column_stack((lines[:, 0] + np.sum(normals * self._anchors, axis=1), lines[:, 1]))

    def _spare(self, size: int) -> FloatArray:
        """A matrix (size, size) to fill, in memory that P is not in: asking for new takes longer than filling it."""
        self._memory.reverse()
        if self._memory[0].size < size**2:
            self._memory[0] = np.empty(2 * size**2)
        return self._memory[0][: size**2].reshape(size, size)

    def _keep(self, places: IntArray) -> None:
        P = self._spare(len(places))
        # Mostly the last ones go; rows and columns by number take five times as long as a block.
        is_block = int(places[-1]) == len(places) - 1
        P[:] = self.P[: len(places), : len(places)] if is_block else self.P[np.ix_(places, places)]
        # Rounding makes P drift from symmetry over thousands of updates; here a copy is due anyway.
        P[:] = 0.5 * (P + P.T)
        self.x, self.P, self.dim_x = self.x[places], P, len(places)

    def _columns(self, clones: IntArray) -> IntArray:
        """The numbers of the state (n, 3) that clones (n,) are."""
        places = np.searchsorted(self._clones, clones)
        return np.asarray(self._clones_from + POSE * places[:, None] + np.arange(POSE))

    def _involved(self, readings: Readings, index: int) -> tuple[IntArray, IntArray]:
        """The numbers of the state that readings of a line depend on, and each reading's clone among them (n,)."""
        clones, places = np.unique(readings.clones, return_inverse=True)
        part = self._part(index)
        return np.append(self._columns(clones).ravel(), [part.start, part.start + 1]), places

    def _expected(self, state: FloatArray, places: IntArray, readings: Readings, index: int) -> Expected:
        poses = state[:-2].reshape(-1, POSE)[places]
        return expected_ranges(poses, readings, state[-2:], self._anchors[index])

    def _clear(self, readings: Readings, index: int) -> IntArray:
        """Which readings do not graze a line."""
        line = self.x[self._part(index)]
        expected = expected_ranges(self.clone_poses(readings.clones), readings, line, self._anchors[index])
        return np.nonzero((np.abs(expected.cosines) > GRAZING) & (expected.ranges > 0.0))[0]

    @staticmethod
    def _jacobian(expected: Expected, places: IntArray, size: int) -> FloatArray:
        H, rows = np.zeros((len(places), size)), np.arange(len(places))
        for number in range(POSE):
            H[rows, POSE * places + number] = expected.by_pose[:, number]
        H[:, -2:] = expected.by_line
        return H

    def _equality(self, older: int, younger: int) -> tuple[FloatArray, FloatArray, IntArray]:
        first, second = self._part(older), self._part(younger)
        (d, theta), other = self.x[first], self.x[second]
        between = self._anchors[younger] - self._anchors[older]
        cos, sin = np.cos(theta), np.sin(theta)
        turned = np.cos(theta - other[1]) < 0.0
        sign = -1.0 if turned else 1.0
        off = np.array([
            sign * (d - between[0] * cos - between[1] * sin) - other[0],
            wrap_angle(float(theta - other[1]) + (np.pi if turned else 0.0)),
        ])  # fmt: skip
        H = np.array([[sign, sign * (between[0] * sin - between[1] * cos), -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
        return off, H, np.array([first.start, first.start + 1, second.start, second.start + 1])

    def _restore_angles(self) -> None:
        """Wrap the robots' headings; lines and clones are only ever used through sines and cosines."""
        for heading in range(2, self._poses_end, POSE):
            self.x[heading] = wrap_angle(float(self.x[heading]))
