"""The filter of the consistent estimator: poses, lines, and clones of the poses at which beams were
read.

The state is x = [poses of the robots, calibrations of their odometry if these are estimated, lines
(d, theta), clones] with covariance P. A clone is a copy of a pose with the same uncertainty, and
correlated with all else from then on (S. Roumeliotis and J. Burdick, "Stochastic cloning", 2002). A
range is a measurement of the clone from which it was read, even if the wall that the beam hit
becomes known much later. So the noise of the odometry in between enters only once.

A rotation or shift of the whole world changes no range, so the global pose is unobservable and an
update must not reduce its uncertainty. A standard EKF does reduce it once a correction has moved
the point at which Jacobians are taken. Here each error is defined relative to the first robot's
error, as in an invariant filter (A. Barrau and S. Bonnabel, "An EKF-SLAM algorithm with consistency
properties", 2015), and P is transformed when the state changes.
"""

import math

import numpy as np

from limslam_agent.kernels.covariance import (
    correct_state,
    dense_block,
    mirror,
    move_pose,
)
from limslam_agent.kernels.tables import (
    CLONES,
    LINES,
    LINES_FROM,
    POSE,
    POSES_END,
    Filter,
    Readings,
    Update,
    clones_from,
    line_at,
    size_of,
)
from limslam_agent.kernels.updates import linear_update
from limslam_agent.slam.consistent import clone_filter
from limslam_agent.slam.consistent.clone_filter import equality, num_lines
from limslam_agent.slam.consistent.separate_bias import (
    DELAY,
    TURNS,
    ConstantErrors,
    OdometryErrors,
    RangeErrors,
    SeenWall,
)
from limslam_agent.slam.core.motion import Motion
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import normalise
from limslam_env.geometry.se2 import turned, wrap_angle

# room that is made at once, besides an eighth of the state
_LINES = 24
_CLONES = 12


class CloneEKF:
    """The filter of one team: any number of robots, constant errors of odometry and ranges, and
    room that grows.

    Parameters
    ----------
    pose
        Start (3,), m, m, rad; of several robots (n, 3).
    calibration
        Prior covariance (3, 3) about zero of each robot's ``OdometryCalibration``, which becomes
        part of the state by
        :meth:`calibrate`; None if it is not estimated.
    range_errors
        Standard deviations of the errors of ``RangeErrors``, m and rad; None if these are not
        estimated.

    Attributes
    ----------
    arrays
        The state with its covariance, as ``clone_filter`` reads and changes them.
    has_turned_beams
        Whether beams are known to be turned. What is unknown of their directions is then a part of
        the covariance of the poses.
    """

    def __init__(
        self,
        pose: FloatArray,
        calibration: FloatArray | None = None,
        range_errors: tuple[float, ...] | None = None,
    ) -> None:
        start = np.array(pose, dtype=float).ravel()
        self.has_turned_beams = False
        self._errors = ConstantErrors(
            None if calibration is None else OdometryErrors(len(start) // POSE, calibration),
            None if range_errors is None else RangeErrors(range_errors),
        )
        robots = len(start) // POSE
        # Of the poses in the latest step: the change in the world, the jitter in the robot's frame,
        # and, since each step asks for it several times, the jitter in the world at a heading.
        self._motions = np.zeros((robots, POSE))
        self.jitters = [np.zeros((POSE, POSE))] * robots
        self._in_world = [(math.nan, self.jitters[0], self.jitters[0])] * robots
        counts = np.array([len(start), len(start), 0, 0, 0])
        by_errors = np.zeros((len(start), self._errors.count))
        self.arrays = Filter(
            start,
            np.zeros((len(start),) * 2),
            by_errors,
            np.zeros((0, 2)),
            np.zeros(0, dtype=np.int64),
            counts,
        )

    @property
    def x(self) -> FloatArray:
        """The state (n,), a view."""
        return self.arrays.x[: size_of(self.arrays.counts)]

    @property
    def P(self) -> FloatArray:  # noqa: N802 (the literature's letter)
        """Its covariance (n, n), a view."""
        size = size_of(self.arrays.counts)
        mirror(self.arrays)
        return self.arrays.P[:size, :size]

    @property
    def by_errors(self) -> FloatArray:
        """Derivative (n, k) of the state by the constant errors that it takes to be zero, a
        view.
        """
        return self.arrays.by_errors[: size_of(self.arrays.counts)]

    @property
    def num_lines(self) -> int:
        """How many lines the state holds."""
        return num_lines(self.arrays)

    @property
    def num_clones(self) -> int:
        """How many clones the state holds."""
        return int(self.arrays.counts[CLONES])

    @property
    def poses(self) -> FloatArray:
        """The poses (n, 3), a copy."""
        return self.arrays.x[: self._poses_end].reshape(-1, POSE).copy()

    @property
    def pose(self) -> FloatArray:
        """The pose of the first robot (3,), a copy."""
        return np.array(self.arrays.x[:POSE])

    @property
    def joint_pose_covariance(self) -> FloatArray:
        """Covariance of all poses together (3 n, 3 n), a copy."""
        joint = np.array(self.arrays.P[: self._poses_end, : self._poses_end])
        for robot, jitter in enumerate(self.jitters):
            own = slice(POSE * robot, POSE * robot + POSE)
            heading = self.arrays.x.item(POSE * robot + 2)
            if self._in_world[robot][0] != heading or self._in_world[robot][1] is not jitter:
                self._in_world[robot] = heading, jitter, turned(jitter, heading)
            joint[own, own] += self._in_world[robot][2]
        return joint + self._spread_by_turns(len(joint)) if self.has_turned_beams else joint

    @property
    def lines(self) -> FloatArray:
        """The lines (N, 2) as (r, theta) in the world, normalised."""
        return normalise(self._about_origin()) if self.num_lines else np.zeros((0, 2))

    @property
    def anchored(self) -> FloatArray:
        """The lines (N, 2) as (d, theta) about their anchors, a copy."""
        return np.array(self.x[self._lines_from : clones_from(self.arrays.counts)].reshape(-1, 2))

    @property
    def anchors(self) -> FloatArray:
        """The lines' anchors (N, 2), m, a view."""
        return self.arrays.anchors[: self.num_lines]

    def line(self, index: int) -> FloatArray:
        """One line (2,) as (d, theta) about its anchor, a view."""
        return self.arrays.x[self._part(index)]

    def line_covariance(self, index: int) -> FloatArray:
        """Covariance (2, 2) of one line as (r, theta) in the world."""
        theta = self.line(index).item(1)
        anchor = self.anchors[index]
        lever = anchor[1] * np.cos(theta) - anchor[0] * np.sin(theta)
        sign = 1.0 if self._about_origin()[index, 0] >= 0.0 else -1.0
        by_line = np.array([[sign, sign * lever], [0.0, 1.0]])
        return np.asarray(by_line @ self._block(self._part(index)) @ by_line.T)

    def calibration(self, robot: int = 0) -> tuple[FloatArray, FloatArray] | None:
        """A robot's odometry calibration (3,) and its covariance (3, 3); None if it is not part of
        the state.
        """
        if self._lines_from == self._poses_end:
            return None
        part = self._calibration_part(robot)
        return self.x[part].copy(), self._block(part)

    @property
    def calibration_evidence(self) -> float | None:
        """``OdometryErrors.evidence`` for constant errors; None if they are not estimated, or part
        of the state.
        """
        return None if self._errors.odometry is None else self._errors.odometry.evidence

    @property
    def range_errors(self) -> RangeErrors | None:
        """Errors of the ranges beside the assumed ones, which the state does not know of; None if
        not estimated.
        """
        return self._errors.ranges

    def calibrate(self) -> None:
        """Make the odometry's calibration a part of the state, with what all updates so far say of
        it.
        """
        odometry = self._errors.odometry
        if odometry is None:
            return
        errors, covariance = odometry.estimate_of(slice(None))
        count = len(errors)
        size = len(self.x) + count
        first = self._lines_from
        by_errors = self.by_errors[:, :count]
        added = np.arange(first, first + count)
        old = np.r_[:first, first + count : size]
        joint = by_errors @ covariance
        self._errors.odometry = None
        arrays = self._room_for(size, self.num_lines, len(self.arrays.clones))
        arrays.P[np.ix_(old, old)] = self.P + joint @ by_errors.T
        arrays.P[np.ix_(old, added)] = joint
        arrays.P[np.ix_(added, old)] = joint.T
        arrays.P[np.ix_(added, added)] = covariance
        arrays.x[old] = self.x
        arrays.by_errors[old] = self.by_errors[:, count:]
        change = np.zeros(size)
        change[old] = by_errors @ errors
        change[added] = errors
        arrays.counts[LINES_FROM] += count
        self.arrays = arrays
        self._correct(change)

    def know_calibration(
        self, calibration: FloatArray, covariance: FloatArray, robot: int = 0
    ) -> None:
        """Set the odometry calibration (3,) of a robot, if it is a part of the state.

        Its covariance (3, 3) is given, and it is independent of all else.
        """
        if self.calibration() is not None:
            part = self._calibration_part(robot)
            self.x[part] = calibration
            self.P[part] = 0.0
            self.P[:, part] = 0.0
            self.P[part, part] = covariance
            self.by_errors[part] = 0.0

    def observe_drift(self, drift: float, variance: float, robot: int = 0) -> None:
        """Update by the drift, rad/s, that the heading of a standing robot shows, and its variance.

        It is the last number of the robot's calibration, if that is a part of the state.
        """
        if self.calibration() is None:
            return
        arrays = self.arrays
        column = np.array([self._calibration_part(robot).stop - 1])
        innovation = drift - arrays.x[column]
        nothing = np.zeros((len(self.x), POSE))
        update = linear_update(
            arrays, column, np.ones((1, 1)), innovation, np.full((1, 1), variance), nothing
        )
        self.corrected(update, correct_state(arrays, update), 0)

    def corrected(
        self,
        update: Update,
        after: FloatArray,
        wall: int,
        used: Readings | None = None,
        expected: FloatArray | None = None,
    ) -> None:
        """An update by measurements of a wall has corrected the state. ``after`` is what
        ``correct_state`` has returned; the others are those of ``update_by_readings``, if it has
        found the update.
        """
        seen = None
        if used is not None and expected is not None:
            headings = self.x[clones_from(self.arrays.counts) + POSE * used.places + 2]
            seen = SeenWall(used.rows, expected, headings, self.line(wall).item(1))
        self._errors.learn(self.by_errors, update, after, wall, seen)

    def predict(self, motion: Motion, robot: int = 0) -> None:
        """Move a robot."""
        arrays = self.arrays
        moved = slice(POSE * robot, POSE * robot + POSE)
        by_pose = np.zeros((POSE, POSE))
        by_increment = np.zeros((POSE, POSE))
        increment = motion.increment
        move_pose(arrays, moved.start, increment, motion.covariance, by_pose, by_increment)
        self._motions[robot] = by_increment @ increment
        self.jitters[robot] = motion.jitter
        if not motion.has_turned:
            self._motions[robot, 2] = 0.0
        if arrays.by_errors.shape[1]:
            arrays.by_errors[moved] = by_pose @ arrays.by_errors[moved]
        if motion.by_calibration is None:
            return
        drift = by_increment @ motion.by_calibration
        if self._errors.odometry is not None:
            arrays.by_errors[moved, moved] += drift
        else:
            part = self._calibration_part(robot)
            P = self.P
            P[moved] += drift @ P[part]
            P[:, moved] += P[:, part] @ drift.T

    def relocate(
        self,
        pose: FloatArray,
        covariance: FloatArray,
        robot: int = 0,
        by_lines: FloatArray | None = None,
    ) -> None:
        """Put a robot at another pose (3,), which was found without regard to where it was before.

        The covariance (3, 3) is that of its error with respect to the lines. With a derivative
        ``by_lines`` (3, 2 N) of the pose by the lines among which it was found, it has their
        errors; otherwise it is independent of all else.
        """
        by_state = np.zeros((POSE, len(self.x)))
        part = slice(POSE * robot, POSE * robot + POSE)
        if by_lines is not None:
            by_state[:, self._lines_from : self._lines_from + by_lines.shape[1]] = by_lines
        joint = by_state @ self.P
        by_errors = by_state @ self.by_errors
        own = joint @ by_state.T + covariance
        self.x[part] = pose
        self.P[part] = joint
        self.P[:, part] = joint.T
        self.by_errors[part] = by_errors
        self.P[part, part] = own

    def make_room(self, lines: int = 0, clones: int = 0) -> None:
        """Make room in the arrays for so many further lines and clones."""
        arrays = self.arrays
        size = size_of(self.arrays.counts)
        count = self.num_clones
        lines = self.num_lines + lines
        clones = count + clones
        wanted = self._lines_from + 2 * lines + POSE * clones
        if wanted > len(arrays.x) or lines > len(arrays.anchors) or clones > len(arrays.clones):
            room = wanted + wanted // 8 + 2 * _LINES + POSE * _CLONES
            self.arrays = new = self._room_for(room, lines + _LINES, clones + _CLONES)
            new.x[:size] = arrays.x[:size]
            new.P[:size, :size] = arrays.P[:size, :size]
            new.by_errors[:size] = arrays.by_errors[:size]

    def clone(self, robot: int = 0) -> int:
        """Add the pose at which a robot's present readings were taken to the state, and return its
        number. It is a copy of the robot's pose with its jitter.
        """
        self.make_room(clones=1)
        number = clone_filter.clone(self.arrays, robot, self.jitters[robot])
        self.cloned(robot)
        return number

    def cloned(self, robot: int) -> None:
        """A robot's pose has just been cloned. Late readings were taken where the robot was
        before.
        """
        ranges = self._errors.ranges
        if ranges is not None:
            self.by_errors[-POSE:, DELAY - ranges.count] -= self._motions[robot]

    def add_line(self, theta: float, anchor: FloatArray) -> int:
        """Add a line with an uninformative prior, and return its index.

        It goes through ``anchor`` (2,), m, with its normal at ``theta``, rad.
        """
        self.make_room(lines=1)
        return clone_filter.add_line(self.arrays, theta, float(anchor[0]), float(anchor[1]))

    def add_known_line(self, line: FloatArray, covariance: FloatArray, anchor: FloatArray) -> int:
        """Add a line (r, theta) with a covariance (2, 2), independent of all else, and return its
        index.

        Its anchor (2,), m, should be near the wall.
        """
        (r, theta), index = line.tolist(), self.add_line(float(line[1]), anchor)
        part, (x, y) = self._part(index), anchor.tolist()
        cos = np.cos(theta)
        sin = np.sin(theta)
        about_anchor = np.array([[1.0, x * sin - y * cos], [0.0, 1.0]])
        self.x[part] = r - x * cos - y * sin, theta
        self.P[part, part] = about_anchor @ covariance @ about_anchor.T
        return index

    def differences(self, pairs: list[tuple[int, int]]) -> tuple[FloatArray, FloatArray]:
        """Differences of n pairs of lines (2 n,), as of ``clone_filter.difference``, and their
        covariance.
        """
        off = np.zeros(2 * len(pairs))
        H = np.zeros((2 * len(pairs), len(self.x)))
        for row, pair in enumerate(pairs):
            off[2 * row : 2 * row + 2], own, columns = equality(self.arrays, *pair)
            H[2 * row : 2 * row + 2, columns] = own
        return off, H @ self.P @ H.T

    def marginal(self) -> FloatArray:
        """Joint covariance of the poses and all lines, without the calibration of the odometry and
        without clones.
        """
        kept = np.r_[: self._poses_end, self._lines_from : clones_from(self.arrays.counts)]
        return np.array(self.P[np.ix_(kept, kept)])

    def restart(
        self, poses: FloatArray, lines: FloatArray, anchors: FloatArray, covariance: FloatArray
    ) -> None:
        """Replace poses (n, 3) and lines (m, 2) with anchors (m, 2), which have a joint covariance;
        no clones are left.

        The calibration of the odometry is kept. From now on it is independent of the rest.
        """
        part = slice(self._poses_end, self._lines_from)
        size = self._lines_from + lines.size
        kept = np.r_[: self._poses_end, self._lines_from : size]
        arrays = self._room_for(size, len(lines), 0)
        arrays.P[part, part] = self.P[part, part]
        arrays.P[np.ix_(kept, kept)] = covariance
        arrays.x[:] = np.concatenate((poses.ravel(), self.x[part], lines.ravel()))
        arrays.x[2 : self._poses_end : POSE] = wrap_angle(poses.reshape(-1, POSE)[:, 2])
        arrays.anchors[:] = anchors
        arrays.counts[LINES] = len(lines)
        arrays.counts[CLONES] = 0
        self.arrays = arrays

    def correct_ranges(self, errors: FloatArray) -> None:
        """Correct the state for the errors (k,) of ``RangeErrors``, and begin anew to estimate
        further ones.

        What remains unknown of turned beams becomes a part of the state's covariance. With the
        derivative V of the state by the turns since the last correction, and their covariance M,
        that adds V M V' to P, and V begins again at zero. Each correction adds this term by itself,
        although the error of the turns is the same one in all of them: the products of the
        derivatives from before and after a correction are left out.
        """
        ranges = self._errors.ranges
        if ranges is not None:
            by_ranges = self.by_errors[:, -ranges.count :]
            change = by_ranges[:, : len(errors)] @ errors
            if len(errors[TURNS]):
                self.P[:] += self._spread_by_turns(len(change))
            by_ranges[:] = 0.0
            self._errors.ranges = ranges.corrected(errors)
            self._correct(change)

    @property
    def _poses_end(self) -> int:
        return int(self.arrays.counts[POSES_END])

    @property
    def _lines_from(self) -> int:
        return int(self.arrays.counts[LINES_FROM])

    def _part(self, index: int) -> slice:
        first = line_at(self.arrays.counts, index)
        return slice(first, first + 2)

    def _block(self, part: slice) -> FloatArray:
        """Covariance of some states that follow the poses."""
        return dense_block(self.arrays.P, np.arange(part.start, part.stop))

    def _calibration_part(self, robot: int) -> slice:
        first = self._poses_end + POSE * robot
        return slice(first, first + POSE)

    def _about_origin(self) -> FloatArray:
        lines = self.anchored
        normals = np.stack((np.cos(lines[:, 1]), np.sin(lines[:, 1])), axis=1)
        return np.column_stack((lines[:, 0] + np.sum(normals * self.anchors, axis=1), lines[:, 1]))

    def _spread_by_turns(self, size: int) -> FloatArray:
        """Covariance of the first states (size, size) by what remains unknown of the directions of
        the beams.
        """
        ranges = self._errors.ranges
        if ranges is None:
            return np.zeros((size, size))
        by_turns = self.by_errors[:size, -ranges.count :][:, TURNS]
        return np.asarray(by_turns @ ranges.turns[1] @ by_turns.T)

    def _room_for(self, size: int, lines: int, clones: int) -> Filter:
        """Arrays for a state of a size, all zero, with the anchors, clones and counts of this
        filter.
        """
        old = self.arrays
        anchors = np.zeros((lines, 2))
        numbers = np.zeros(clones, dtype=np.int64)
        known = min(lines, self.num_lines)
        open_clones = min(clones, self.num_clones)
        anchors[:known] = old.anchors[:known]
        numbers[:open_clones] = old.clones[:open_clones]
        by_errors = np.zeros((size, self._errors.count))
        P = np.zeros((size, size))
        return Filter(np.zeros(size), P, by_errors, anchors, numbers, old.counts.copy(), old.bend)

    def _correct(self, change: FloatArray) -> None:
        """Add a correction (s,) to the state, and transport the error of P to the new state."""
        size = len(change)
        none = np.zeros((0, size))
        nothing = np.zeros((size, POSE))
        update = Update(np.arange(0), none, np.zeros(0), none, none, nothing, change)
        moved = correct_state(self.arrays, update)
        self.by_errors[:] += moved @ self.by_errors[:POSE]
