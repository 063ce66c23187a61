"""StatusMonitor: watches the estimate of one robot and says whether it can be trusted, without ground truth.

Two sequential tests compare the readings with the map (A. Wald, "Sequential tests of statistical hypotheses", 1945):

- *Contradictions.* Of the readings of the last metres, as few contradict the map as at the right pose, or as many as at
  a wrong one.
- *Moved.* The robot may have slipped, or been carried to another place, before any step of the last metres
  (:mod:`~limslam_agent.status.sudden_changes`). The readings since then speak for the believed pose, or for one near
  it, or are no likelier there than at a random place.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import RAY_BEAM
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import DECIDED, DOUBTED, KnownMap
from limslam_agent.status.rays import LASTING, moved, rays_of, step_rays
from limslam_agent.status.status import LARGE_CORRECTION, UNSURE_HEADING, Status
from limslam_agent.status.sudden_changes import (
    LONGEST_SPACING,
    PLACE,
    WINDOW,
    Sight,
    SuddenChanges,
    by_beam,
    places_test,
    without_the_worst,
)
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import RobotSpec

UNIFORM_HEADING = math.pi / math.sqrt(3.0)
"""Standard deviation of a heading of which nothing is known, rad: that of a uniform distribution over the circle."""

# The readings are compared with the map when the robot has moved by ``SPACING``, m, and the estimator extracts lines in
# the same step, or when it has moved by ``LONGEST_SPACING``, m. A turn by one radian counts like ``TURN_LENGTH``, m.
SPACING, TURN_LENGTH = 0.10, 0.40
# Standard deviations that the position of a lost robot gains with each metre, m, at most, m, and those of its heading,
# rad.
POSITION_GROWTH, POSITION_LIMIT, _HEADING_GROWTH = 2.0, 10.0, 1.0
_MAX_JUMP = 1.0  # m: the estimate is lost if the odometry reports a longer motion in one step

BLIND = 300
"""A beam that has seen nothing so often in succession may see nothing at all."""

CARRIED = Status("lost", "the latest readings do not fit the place, as if the robot had been carried away")
MAYBE_CARRIED = Status("unsure", CARRIED.reason)


class Loss(NamedTuple):
    """Why a robot is lost, and since when.

    Attributes
    ----------
    status
        The status.
    ago
        Number of steps for which the estimate has been doubtful; 0 if the doubt began in this step.
    is_dated
        Whether the readings of that step say so themselves.
    is_carried
        Whether the readings say that the robot was carried away before that step.
    known
        The map before that step, near to which the readings since then fit: the robot has slipped.
    """

    status: Status
    ago: int
    is_dated: bool = False
    is_carried: bool = False
    known: KnownMap | None = None


@dataclass(frozen=True, eq=False)
class _Check:
    """One comparison with the map.

    Attributes
    ----------
    place, step
        Where in the drive the comparison was made, m, and the number of the step.
    test
        What each beam (n_beams,) contributes to the test of contradictions.
    tested
        Number of beams that could contradict the map.
    beams, points
        The beams (k,) that contradict the map, and where (k, 2), m: at the wall that the beam passed through, or where
        it ended in free space.
    """

    place: float
    step: int
    test: FloatArray
    tested: int
    beams: IntArray
    points: FloatArray

    @property
    def evidence(self) -> float:
        """Logarithm of the likelihood ratio of a wrong pose and of the right one."""
        return float(self.test.sum())


class StatusMonitor:
    """Watches one robot.

    At each step the monitor gets the motion that the odometry reports, and the readings. Each time that the robot has
    moved far enough, it compares the readings with the map. The level follows from the two tests, from the uncertainty
    of the heading, and from jumps of the odometry.

    While a robot is lost, the covariance of its pose gets larger with each metre. It stays lost for 3 m, and until no
    test doubts its pose any more.

    Parameters
    ----------
    robot
        Body and beams as specified.
    sensor
        How ranges are measured, and by what the beams are turned.

    Attributes
    ----------
    sensor
        The same, as far as it is known now. Set it when the estimator has found out more.
    status
        The present status.
    by_readings
        The same by the readings alone, however uncertain the heading is.
    jump
        Length of the jumps of the odometry since the robot is lost, m.
    loss
        Why the robot is lost, and since when; None while it is not.
    broken
        A beam that always reads the same, and is left out from now on; None without it.
    """

    def __init__(self, robot: RobotSpec, sensor: RangeSensor) -> None:
        self._robot, self.sensor = robot, sensor
        self._step, self._place, self._checked = -1, 0.0, -math.inf
        self._sights, self._first = list[Sight](), 0  # the latest steps, and the number of the first of them
        self._checks: list[_Check] = []
        self._changes = SuddenChanges(robot)
        # The reading of each beam that has not changed since, how often it was read, and the least and the largest
        # heading since then.
        self._turned, beams = 0.0, len(robot.beams)
        self._steady, self._times, self._headings = np.full(beams, math.nan), np.zeros(beams), np.zeros((2, beams))
        self.jump, self._driven = 0.0, 0.0
        self.loss: Loss | None = None
        self.broken: int | None = None
        self.status = self.by_readings = Status()

    def observe(self, sight: Sight, *, is_busy: bool) -> bool:
        """Note the motion and the readings of one step.

        Parameters
        ----------
        sight
            What the robot believes and reads in this step.
        is_busy
            Whether the estimator extracts lines in this step. Such a step takes long in any case. Comparisons are made
            in these steps if possible, so that they add little to the median time of a step.

        Returns
        -------
        due
            Whether :meth:`check` is to be called now.
        """
        x, y, turn = sight.increment.tolist()
        distance = math.hypot(x, y)
        is_jump = distance > _MAX_JUMP
        if self._sights and not is_jump:
            expected = compose(self._sights[-1].pose, sight.increment)
            if math.hypot(*(sight.pose - expected)[:2].tolist()) > LARGE_CORRECTION:
                self._changes.forget()
        if is_jump:
            self.jump, distance = self.jump + distance, 0.0
        self._step += 1
        self._sights.append(sight)
        self._turned += turn
        # No wall is read with so little noise.
        is_same = np.abs(sight.ranges - self._steady) < 0.5 * self.sensor.std
        is_same &= (sight.ranges >= self._robot.too_far) == (self._steady >= self._robot.too_far)
        has_changed = np.isfinite(sight.ranges) & ~is_same
        self._steady[has_changed], self._headings[:, has_changed] = sight.ranges[has_changed], self._turned
        self._times = np.where(has_changed, 0.0, self._times + np.isfinite(sight.ranges))
        self._headings[0] = np.minimum(self._headings[0], self._turned)
        self._headings[1] = np.maximum(self._headings[1], self._turned)
        self._place += distance + TURN_LENGTH * abs(turn)
        self._driven += distance
        return is_jump or self._place - self._checked >= (SPACING if is_busy else LONGEST_SPACING)

    def check(self, covariance: FloatArray, present: KnownMap) -> None:
        """Compare the readings since the last comparison with the map, and update the status.

        Parameters
        ----------
        covariance
            Covariance of the pose (3, 3). It counts for all these readings.
        present
            The map as it is now, without the latest readings in its grid.
        """
        self._checked = self._place
        present.sensor = self.sensor
        self._changes.look(self._sights, self._first, self._place, present, covariance)
        self._compare(covariance, present)
        begin = max(min(self._changes.oldest, self._step - 2 * LASTING) - self._first, 0)
        self._sights, self._first = self._sights[begin:], self._first + begin
        self._checks = [check for check in self._checks if self._place - check.place <= WINDOW]
        self.broken = self._broken_beam(present)
        self._judge(float(covariance[2, 2]))

    @property
    def is_suspicious(self) -> bool:
        """Whether the robot may have been carried away, so that the map since then may be wrong."""
        return self._changes.suspicion is not None

    @property
    def added_covariance(self) -> FloatArray:
        """What has to be added to the covariance (3, 3) of the pose; zero if the robot is not lost."""
        return np.zeros((3, 3)) if self.loss is None else covariance_of_lost(self.jump, self._driven)

    def _compare(self, covariance: FloatArray, known: KnownMap) -> None:
        """Compare the latest readings with a map, and note the outcome.

        Readings of neighbouring steps show nearly the same, so that only the latest ones count. A reading that saw
        nothing, shortly after one that saw a wall, may be a dropout of the sensor.
        """
        last = self._sights[-1]
        nothing = np.array([sight.ranges >= self._robot.too_far for sight in self._sights[-LASTING:]])
        ranges = np.where(nothing[-1] & ~nothing.all(axis=0), np.nan, last.ranges)
        rays = moved(step_rays(ranges, self.sensor.mounted(self._robot), self.sensor.bias), last.pose)
        rays = known.counting(rays, covariance)
        found = known.explained(rays, covariance)
        contradicts = found.against > 0.0
        points = found.contradicted_at(rays)
        tested, beams = int(np.count_nonzero(found.tested)), rays[contradicts, RAY_BEAM].astype(int)
        self._checks.append(
            _Check(self._place, self._step, by_beam(rays, found.test, self._robot), tested, beams, points)
        )

    def _broken_beam(self, present: KnownMap) -> int | None:
        """The beam that has read the same while the robot turned by a right angle; None without it.

        There may be nothing to see all around, so a beam that sees nothing must contradict the map.
        """
        is_steady = np.isfinite(self._steady) & (np.ptp(self._headings, axis=0) > 0.5 * math.pi)
        is_steady[list(self.sensor.broken)] = False
        if is_steady.all():
            return None
        for beam in np.flatnonzero(is_steady).tolist():
            is_stuck = self._robot.too_near[beam] < self._steady[beam] < self._robot.too_far[beam]
            if is_stuck or (self._times[beam] > BLIND and self._contradicts(beam, present)):
                return beam
        return None

    def _contradicts(self, beam: int, present: KnownMap) -> bool:
        """Whether the latest readings of a beam contradict the map, as it is now, at several places.

        The walls there were seen later by other beams, which speak for the pose.
        """
        test = np.sum([check.test for check in self._checks], axis=0)
        if test.sum() - test[beam] >= 0.0:
            return False
        rays = rays_of(self._sights, self._robot, self.sensor)
        rays = rays[rays[:, RAY_BEAM] == beam]
        return bool(places_test(rays, present.explained(rays)).sum() > 2.0 * DECIDED)

    def _judge(self, heading_variance: float) -> None:
        """Find the status."""
        doubts, found = self._doubts(), self._loss()
        if found is None and (self._driven < WINDOW or doubts.level != "ok"):
            found = self.loss
        if found is None or self.loss is None:
            self._driven = 0.0
        if found is None:
            self.jump = 0.0
        self.loss = found
        self.status = self.by_readings = doubts if found is None else found.status
        heading_std = math.sqrt(max(heading_variance, 0.0))
        if self.status.level == "ok" and heading_std > UNSURE_HEADING:
            words = f"the heading's standard deviation is {math.degrees(heading_std):.1f} deg"
            self.status = Status("unsure", words)

    def _loss(self) -> Loss | None:
        """Why the robot is lost now; None if it is not."""
        if self.jump and self.loss is None:
            return Loss(Status("lost", f"the odometry reports a motion of {self.jump:.1f} m in one step"), 0)
        recent = self._checks
        # Contradictions alone make a robot lost only when it is known whether the readings changed suddenly before.
        is_refuted = _refutes([check for check in recent if check.step <= self._changes.weighed])
        found = self._changes.suspicion
        if found is not None and (is_refuted or found.is_certain):
            change, is_slip = found.change, found.is_slip
            # Without a sudden change, the estimate may be wrong as well, as after a wrong association.
            return Loss(
                CARRIED, self._step - change.step, change.evidence >= DOUBTED or is_slip,
                is_carried=change.evidence > 0.0 and not is_slip, known=change.known if is_slip else None,
            )  # fmt: skip
        if is_refuted and _refutes(recent):
            sums = np.cumsum([check.evidence for check in reversed(recent)])[::-1]
            return Loss(Status("lost", _words(recent)), self._step - recent[int(sums.argmax())].step)
        return None

    def _doubts(self) -> Status:
        """The status of a robot that is not lost by its readings."""
        if self._changes.suspicion is not None:
            return MAYBE_CARRIED
        recent = self._checks
        if sum(check.evidence for check in recent) < DOUBTED:
            return Status()
        beams, words = np.unique(_beams(recent)), _words(recent)
        if len(beams) == 1 and len(_beams(recent)) > 1:
            words += f", all of the beam at {math.degrees(self._robot.beam_angles[beams[0]]):.0f} deg"
        return Status("unsure", words)


def covariance_of_lost(jump: float, driven: float, *, knows_heading: bool = True) -> FloatArray:
    """What is added to the covariance (3, 3) of a lost robot, by jumps of the odometry and the distance since, m."""
    position = jump + min(POSITION_GROWTH * driven, POSITION_LIMIT)
    heading = min(_HEADING_GROWTH * driven, UNIFORM_HEADING) if knows_heading else UNIFORM_HEADING
    return np.diag([position**2, position**2, heading**2])


def _refutes(checks: list[_Check]) -> bool:
    """Whether comparisons say that the pose is wrong.

    A beam alone may be broken, and at a single place a short wall may be missing.
    """
    if sum(check.evidence for check in checks) < DECIDED:
        return False
    points, test = np.concatenate([check.points for check in checks]), np.sum([check.test for check in checks], axis=0)
    is_wide = float(np.hypot(*(points - points[0]).T).max()) >= PLACE
    return is_wide and (len(test) == 1 or without_the_worst(test) > 0.0)


def _beams(checks: list[_Check]) -> IntArray:
    """The beams (k,) that contradict the map."""
    return np.concatenate([check.beams for check in checks])


def _words(checks: list[_Check]) -> str:
    """How many readings contradict the map."""
    return f"{len(_beams(checks))} of {sum(check.tested for check in checks)} readings contradict the map"
