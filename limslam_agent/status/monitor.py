"""StatusMonitor: watches the estimate of one robot and says whether it can be trusted."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.contradictions import KnownMap, Sight, compared, log_likelihood_ratio
from limslam_agent.status.status import LEVELS, Level, Status
from limslam_agent.status.sudden_changes import LASTING, UNSURE, Moment, SuddenChanges, Suspicion
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

UNIFORM_HEADING = math.pi / math.sqrt(3.0)
"""Standard deviation of a heading of which nothing is known, rad: that of a uniform distribution over the circle."""

# The readings are compared with the map when the robot has moved by ``SPACING``, m, and the estimator extracts lines in
# the same step, or when it has moved by ``LONGEST_SPACING``, m. A turn by one radian counts like ``TURN_LENGTH``, m.
SPACING, LONGEST_SPACING, TURN_LENGTH = 0.10, 0.30, 0.40
_WINDOW = 3.0  # m: the last part of the drive that counts
_FEWEST, _FEWEST_PLACES = 25, 8  # readings that give a share, and the places from which they are
_UNSURE_SHARE, _LOST_SHARE = 0.03, 0.06  # of the readings contradict the map
# Contradicting readings of a lost estimate. They must be of two beams, and two of them must be this far apart, m.
_FEWEST_CONTRADICTIONS, _APART = 3, 0.3
_UNSURE_HEADING = math.radians(4.0)  # rad: standard deviation of the heading
# A lost robot is found again after this distance, m, over which at least so many readings should have ended at walls of
# the earlier map, if at least this share of them did so.
RECOVERY_WINDOW, _FEWEST_EXPECTED, _FITTING = 10.0, 150, 0.95
# Standard deviations that the position of a lost robot gains with each metre, m, at most, m, and those of its heading,
# rad.
POSITION_GROWTH, POSITION_LIMIT, _HEADING_GROWTH = 2.0, 10.0, 1.0
_MOST_SIGHTS = 100
_FEWEST_BEAMS = 2
_MAX_JUMP = 1.0  # m: the estimate is lost if the odometry reports a longer motion in one step
_RATES = 0.02, 0.12  # shares of readings that contradict the map at the right pose, and at a wrong one


@dataclass(frozen=True, eq=False)
class _Check:
    """One comparison with the map.

    Attributes
    ----------
    place
        Where in the drive the comparison was made, m.
    counts
        Numbers of beams: compared, contradicting the map, expected to end at a wall, and fitting that wall.
    beams, points
        The beams (k,) that contradict the map, and where (k, 2), m: at the wall that the beam passed through, or where
        it ended in free space.
    step
        Number of the step.
    """

    place: float
    counts: tuple[int, int, int, int]
    beams: IntArray
    points: FloatArray
    step: int


class StatusMonitor:
    """Watches one robot.

    At each step the monitor gets the motion that the odometry reports, and the readings. Each time that the robot has
    moved far enough, the monitor compares the readings with the map. The level follows from the share of contradictions
    in the last metres, from the uncertainty of the heading, and from jumps of the odometry.

    A robot that is lost is compared with the map of the moment when it became lost. Otherwise the wrong pose would
    erase the walls that contradict it. Until the readings fit that map again, the status stays ``lost`` and the
    covariance of the pose gets larger with each metre.

    Parameters
    ----------
    robot
        Body, and beams as they are taken to be mounted.
    sensor
        How ranges are measured.
    free_space_counts
        Whether a reading that ends in free space contradicts the map.

    Attributes
    ----------
    sensor
        The same, as far as it is known now. Set it when the estimator has found out more.
    status
        The present status.
    by_readings
        The same by the readings alone, however uncertain the heading is.
    """

    def __init__(self, robot: RobotSpec, sensor: RangeSensor, *, free_space_counts: bool = True) -> None:
        self._robot, self.sensor, self._free_space_counts = robot, sensor, free_space_counts
        self._step, self._place, self._checked = -1, 0.0, -math.inf
        # The latest steps that no comparison has used.
        self._sights: deque[tuple[int, Sight]] = deque(maxlen=_MOST_SIGHTS)
        self._checks: deque[_Check] = deque()
        self._reference: KnownMap | None = None
        self._jump, self._driven, self._since = 0.0, 0.0, 0.0
        self._doubted, self._contradicted = 0, 0
        self._sudden_changes = SuddenChanges(robot, free_space_counts=free_space_counts)
        self.status = self.by_readings = Status()

    def mount(self, robot: RobotSpec, sensor: RangeSensor) -> None:
        """The beams are known to be mounted otherwise, as those of this robot. All doubts remain."""
        self._robot = self._sudden_changes.robot = robot
        self.sensor = sensor

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
        self._step += 1
        x, y, turn = sight.increment.tolist()
        distance = math.hypot(x, y)
        is_jump = distance > _MAX_JUMP
        if is_jump:
            self._jump, distance = self._jump + distance, 0.0
        self._place += distance + TURN_LENGTH * abs(turn)
        self._driven += distance
        self._sights.append((self._step, sight))
        spacing = SPACING if is_busy else LONGEST_SPACING
        return is_jump or self._place - self._checked >= spacing

    def check(self, covariance: FloatArray, present: KnownMap) -> None:
        """Compare the readings since the last comparison with the map, and update the status.

        Parameters
        ----------
        covariance
            Covariance of the pose (3, 3). It counts for all these readings.
        present
            The map as it is now, without the latest readings in its grid.
        """
        self._checked, usable = self._place, self._usable()
        if self._reference is None:
            self._look_for_sudden_changes(covariance, present, usable)
        self._compare(covariance, self._reference or present, usable)
        self._sights.clear()
        while self._place - self._checks[0].place > RECOVERY_WINDOW:
            self._checks.popleft()
        if self._reference is None:
            self._judge(float(covariance[2, 2]), present)
        elif self._fits_again():
            self._reference, self._jump, self.status = None, 0.0, Status()
            self.by_readings = self.status

    @property
    def jump(self) -> float:
        """Length of the jumps of the odometry since the robot is lost, m."""
        return self._jump

    @property
    def added_covariance(self) -> FloatArray:
        """What has to be added to the covariance (3, 3) of the pose; zero if the robot is not lost."""
        if self._reference is None:
            return np.zeros((3, 3))
        return covariance_of_lost(self._jump, self._driven)

    @property
    def doubted(self) -> int:
        """For how many steps the estimate of a lost robot has been doubtful; 0 if the doubt began in this step."""
        return self._step - self._doubted

    @property
    def contradicted(self) -> int:
        """The same by the share of contradictions alone, even if readings changed suddenly before."""
        return self._step - self._contradicted

    @property
    def carried(self) -> Suspicion | None:
        """The suspicion by which the robot was carried away; None if nothing suffices to say so.

        If the contradictions already say that the robot is lost, no further comparison has to confirm a suspicion.
        """
        changes = self._sudden_changes
        return changes.probable if self.status.level == "lost" else changes.certain

    def changes(self, steps: int) -> list[tuple[int, Suspicion]]:
        """The sudden changes of the readings in the latest steps, each with the number of steps ago."""
        latest = [(self._step - each.step, each) for each in self._sudden_changes.latest]
        return [(ago, each) for ago, each in latest if ago < steps]

    def _first_doubt(self) -> int:
        """The step since which the readings of the last metres contradict the map, or the present step."""
        if self._jump:
            return self._step
        return self._contradicted if self.carried is None else self.carried.step

    def _likeliest_change(self) -> int:
        """The step at which the share of contradictions has most likely changed. One long before it says nothing."""
        recent = self._recent(_WINDOW)
        sums = np.cumsum([_contradiction_evidence(check) for check in reversed(recent)])[::-1]
        return recent[int(sums.argmax())].step

    def _look_for_sudden_changes(self, covariance: FloatArray, known: KnownMap, usable: BoolArray) -> None:
        """Follow the suspicions that the robot was carried away, until it is lost."""
        if len(self._sights) == self._sights.maxlen:
            self._sudden_changes.forget()
        seen = [(check.step, check.points) for check in self._checks if len(check.points)]
        moment = Moment(self._place, covariance, known, self.sensor, usable, seen)
        self._sudden_changes.note(list(self._sights), moment)

    def _usable(self) -> BoolArray:
        """The latest readings (n_beams,) that can be compared with a map.

        A reading that saw nothing, shortly after one that saw a wall, may be a dropout of the sensor.
        """
        sights = list(self._sights)[-LASTING:]
        nothing = np.array([sight.ranges >= self._robot.too_far for _, sight in sights])
        return np.asarray(sights[-1][1].measured & ~(nothing[-1] & ~nothing.all(axis=0)))

    def _compare(self, covariance: FloatArray, known: KnownMap, usable: BoolArray) -> None:
        """Compare the latest readings with a map, and note the outcome.

        Readings of neighbouring steps show nearly the same, so that only the latest ones count.
        """
        robot, last = self._robot, self._sights[-1][1]
        outcome, expected = compared(
            robot, last, usable, known, covariance, self.sensor, free_space_counts=self._free_space_counts
        )
        beams = np.flatnonzero(outcome.through | outcome.in_free)
        reached = np.where(outcome.through, np.minimum(expected.ranges[0], robot.max_ranges), last.ranges)[beams]
        points = transform_points(
            last.pose, robot.beam_origins[beams] + reached[:, None] * robot.beam_directions[beams]
        )
        self._checks.append(_Check(self._place, outcome.counts, beams, points, self._step))

    def _judge(self, heading_variance: float, present: KnownMap) -> None:
        """Find the status of a robot that was not lost so far. If it is lost now, keep the map of this moment."""
        self.status = self.by_readings = self._status()
        heading_std = math.sqrt(max(heading_variance, 0.0))
        if self.status.level == "ok" and heading_std > _UNSURE_HEADING:
            words = f"the heading's standard deviation is {math.degrees(heading_std):.1f} deg"
            self.status = Status("unsure", words)
        if self.status.level == "lost":
            self._contradicted = self._likeliest_change()
            self._doubted = self._first_doubt()
            self._reference = self.carried.known if self.carried is not None else present.frozen
            self._driven, self._since = 0.0, self._place
            self._checks.clear()

    def _status(self) -> Status:
        """The status by the readings of the last metres of the drive, with the most serious reason."""
        if self._jump:
            return Status("lost", f"the odometry reports a motion of {self._jump:.1f} m in one step")
        if self.carried is not None:
            return Status("lost", self.carried.words)
        contradictions = self._by_contradictions()
        if contradictions.level != "ok":
            return contradictions
        suspicion = self._sudden_changes.strongest
        if suspicion is not None and suspicion.evidence >= UNSURE:
            return Status("unsure", suspicion.words)
        return Status()

    def _by_contradictions(self) -> Status:
        """The status by the share of readings that contradict the map.

        Contradictions make a robot lost only when it is known whether the readings changed suddenly before: that says
        when the robot was carried away, and which map was right.
        """
        recent = self._recent(_WINDOW)
        found = self._by_share(recent)
        if found.level == "lost":
            weighed = [check for check in recent if check.step <= self._sudden_changes.weighed]
            return found if weighed and self._by_share(weighed).level == "lost" else Status("unsure", found.reason)
        return found

    def _by_share(self, recent: list[_Check]) -> Status:
        count, contradicting, _, _ = _sums(recent)
        beams = np.unique(np.concatenate([check.beams for check in recent]))
        # A few wrong readings are no proof, however few there are in all. A beam alone may be broken, and at a single
        # place a short wall may be missing.
        is_proof = (
            contradicting >= _FEWEST_CONTRADICTIONS
            and len(beams) >= min(_FEWEST_BEAMS, len(self._robot.beams))
            and _has_places(np.concatenate([check.points for check in recent]), _APART)
        )
        limits = (0.0, _UNSURE_SHARE, _LOST_SHARE if is_proof else math.inf)
        is_enough = count >= _FEWEST and len(recent) >= _FEWEST_PLACES
        share = contradicting / count if is_enough else 0.0
        level: Level = LEVELS[max(number for number, limit in enumerate(limits) if share >= limit)]
        if level == "ok":
            return Status()
        alone = ""
        if len(beams) == 1 and contradicting >= _FEWEST_CONTRADICTIONS:
            alone = f", all of the beam at {math.degrees(self._robot.beam_angles[beams[0]]):.0f} deg"
        return Status(level, f"{contradicting} of {count} readings contradict the map{alone}")

    def _fits_again(self) -> bool:
        """Whether the readings of the last metres fit the map of the moment when the robot became lost."""
        count, contradicting, expected, fitting = _sums(self._recent(RECOVERY_WINDOW))
        return (
            self._place - self._since >= RECOVERY_WINDOW
            and expected >= _FEWEST_EXPECTED
            and fitting >= _FITTING * expected
            and contradicting < _UNSURE_SHARE * count
        )

    def _recent(self, window: float) -> list[_Check]:
        return [check for check in self._checks if self._place - check.place <= window]


def covariance_of_lost(jump: float, driven: float, *, knows_heading: bool = True) -> FloatArray:
    """What is added to the covariance (3, 3) of a lost robot, by jumps of the odometry and the distance since, m."""
    position = jump + min(POSITION_GROWTH * driven, POSITION_LIMIT)
    heading = min(_HEADING_GROWTH * driven, UNIFORM_HEADING) if knows_heading else UNIFORM_HEADING
    return np.diag([position**2, position**2, heading**2])


def _sums(checks: list[_Check]) -> tuple[int, ...]:
    """The sums of ``_Check.counts``."""
    return tuple(map(sum, zip(*(check.counts for check in checks), strict=True)))


def _contradiction_evidence(check: _Check) -> float:
    """Logarithm of the likelihood ratio of the contradictions of a comparison: of a wrong pose and of the right one."""
    count, contradicting, _, _ = check.counts
    right, wrong = _RATES
    return log_likelihood_ratio(contradicting, count, wrong, right)


def _has_places(points: FloatArray, apart: float) -> bool:
    """Whether two of the points (n, 2) are at least so far ``apart``, m."""
    return bool(len(points)) and float(np.hypot(*(points - points[0]).T).max()) >= apart
