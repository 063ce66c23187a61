"""StatusMonitor: watches the estimate of one robot and says whether it can be trusted, without ground truth.

Two sequential tests compare the readings with the map (A. Wald, "Sequential tests of statistical hypotheses", 1945):

- *Contradictions.* Of the readings of the last metres, as few contradict the map as at the right pose, or as many as at
  a wrong one.
- *Carried away.* Each step at which readings changed suddenly may be the one before which the robot was carried to
  another place. All readings since then are weighed with the map of that moment, which a wrong pose cannot change any
  more. They speak for the believed pose, or one near it, or are no likelier there than at a random place.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import RAY_BEAM, RAY_LENGTH, RAY_TO_X
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.known_map import KnownMap, contradiction_test, near_fit
from limslam_agent.status.rays import LASTING, moved, rays_of, step_rays
from limslam_agent.status.status import Status
from limslam_agent.status.sudden_changes import Change, Sight, SuddenChanges
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import compose
from limslam_env.interface import RobotSpec

UNIFORM_HEADING = math.pi / math.sqrt(3.0)
"""Standard deviation of a heading of which nothing is known, rad: that of a uniform distribution over the circle."""

# The readings are compared with the map when the robot has moved by ``SPACING``, m, and the estimator extracts lines in
# the same step, or when it has moved by ``LONGEST_SPACING``, m. A turn by one radian counts like ``TURN_LENGTH``, m.
SPACING, LONGEST_SPACING, TURN_LENGTH = 0.10, 0.30, 0.40
_WINDOW = 3.0  # m: the last part of the drive that counts
_DOUBTFUL, _REFUTED = math.log(100.0), math.log(1000.0)  # a wrong pose is so much likelier than the right one
_APART = 0.3  # m: contradictions of a lost estimate are of two beams, and two of them are so far apart
_UNSURE_HEADING = math.radians(4.0)  # rad: standard deviation of the heading
RECOVERY_WINDOW = 10.0
"""Distance after which a lost robot may be found again where it believes to be, m."""
# Standard deviations that the position of a lost robot gains with each metre, m, at most, m, and those of its heading,
# rad.
POSITION_GROWTH, POSITION_LIMIT, _HEADING_GROWTH = 2.0, 10.0, 1.0
_MAX_JUMP = 1.0  # m: the estimate is lost if the odometry reports a longer motion in one step
_CORRECTED = 0.4  # m: an estimator that corrects the pose by more has closed a loop, and moves the map with it

SUSPECTED, _CARRIED = 6.0, 10.0
"""Evidence that a robot was carried away, with which it is unsure or lost: it outweighs the small prior probability."""
_SUPPORTED = 15.0  # evidence of the readings since a change for the believed pose, which ends the suspicion
_LONGEST, _MOST = 1500, 8  # number of steps that a change is suspected, and number of changes
_DATED = 3.0  # evidence of a change that says when the robot was carried away

CARRIED = Status("lost", "readings changed at once, and those since then do not fit the place")
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
    """

    status: Status
    ago: int
    is_dated: bool = False
    is_carried: bool = False


@dataclass(frozen=True, eq=False)
class _Check:
    """One comparison with the map.

    Attributes
    ----------
    place, step
        Where in the drive the comparison was made, m, and the number of the step.
    tested
        Number of beams that could contradict the map.
    beams, points
        The beams (k,) that contradict the map, and where (k, 2), m: at the wall that the beam passed through, or where
        it ended in free space.
    """

    place: float
    step: int
    tested: int
    beams: IntArray
    points: FloatArray

    @property
    def evidence(self) -> float:
        """Logarithm of the likelihood ratio of a wrong pose and of the right one."""
        return contradiction_test(len(self.beams), self.tested)


class StatusMonitor:
    """Watches one robot.

    At each step the monitor gets the motion that the odometry reports, and the readings. Each time that the robot has
    moved far enough, it compares the readings with the map. The level follows from the two tests, from the uncertainty
    of the heading, and from jumps of the odometry.

    A robot that is lost is compared with the map of the moment when it became lost. Otherwise the wrong pose would
    erase the walls that contradict it. Until the readings fit that map again, the status stays ``lost`` and the
    covariance of the pose gets larger with each metre.

    Parameters
    ----------
    robot
        Body and beams as specified.
    sensor
        How ranges are measured, and by what the beams are turned.
    free_space_counts
        Whether a reading that ends in free space counts; it does not if a body may be anywhere.

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
    """

    def __init__(self, robot: RobotSpec, sensor: RangeSensor, *, free_space_counts: bool = True) -> None:
        self._robot, self.sensor, self._free_space_counts = robot, sensor, free_space_counts
        self._step, self._place, self._checked, self._weighed = -1, 0.0, -math.inf, -math.inf
        self._sights, self._first = list[Sight](), 0  # the latest steps, and the number of the first of them
        self._checks: list[_Check] = []
        self._finder, self._changes = SuddenChanges(robot), list[Change]()
        self._suspect: tuple[Change, Status] | None = None
        self._reference: KnownMap | None = None
        self.jump, self._driven, self._lost_at = 0.0, 0.0, 0.0
        self.loss: Loss | None = None
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
            if math.hypot(*(sight.pose - expected)[:2].tolist()) > _CORRECTED:
                self._changes, self._suspect = [], None
        if is_jump:
            self.jump, distance = self.jump + distance, 0.0
        self._step += 1
        self._sights.append(sight)
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
        if self._reference is None:
            self._look_for_changes(covariance, present)
        self._compare(covariance, self._reference or present)
        oldest = min([each.step for each in self._changes], default=self._step)
        begin = max(min(oldest, self._step - 2 * LASTING) - self._first, 0)
        self._sights, self._first = self._sights[begin:], self._first + begin
        self._checks = self._recent(RECOVERY_WINDOW)
        if self._reference is None:
            self._judge(float(covariance[2, 2]), present)
        elif self._fits_again():
            self._reference, self.loss, self.jump = None, None, 0.0
            self.status = self.by_readings = Status()

    @property
    def is_suspicious(self) -> bool:
        """Whether the robot may have been carried away, so that the map since then may be wrong."""
        return self._suspect is not None

    @property
    def added_covariance(self) -> FloatArray:
        """What has to be added to the covariance (3, 3) of the pose; zero if the robot is not lost."""
        return np.zeros((3, 3)) if self._reference is None else covariance_of_lost(self.jump, self._driven)

    def _look_for_changes(self, covariance: FloatArray, known: KnownMap) -> None:
        """Look for new changes, and weigh all of them now and then, and when there is a new one."""
        found = self._finder.find(self._sights, self._first, known, covariance)
        self._changes = (self._changes + found)[-_MOST:]
        if found or self._place - self._weighed >= LONGEST_SPACING:
            self._weighed = self._place
            self._weigh_changes(covariance)

    def _weigh_changes(self, covariance: FloatArray) -> None:
        """Weigh the changes by the readings since then, and find the likeliest one that makes the robot doubtful.

        Both the evidence of the readings and the test of their contradictions can speak for a change. A doubt remains
        until the readings clearly fit.
        """
        kept, least, before, self._suspect = list[Change](), SUSPECTED, self._suspect, None
        for change in self._changes:
            change.known.sensor = self.sensor
            rays = rays_of(self._sights[change.step - self._first :], self._robot, self.sensor)
            rays = self._that_count(rays, change.known)
            here = change.known.explained(rays)
            if self._step - change.step > _LONGEST or here.evidence.sum() > _SUPPORTED:
                continue
            kept.append(change)
            by_ray = max(-here.evidence, here.test, key=np.sum)
            evidence = change.evidence + float(by_ray.sum())
            if evidence >= least:  # or it has drifted
                near = near_fit(change.known, rays, covariance)
                there = max(-near.evidence, contradiction_test(near.fit.contradictions, near.fit.tested))
                evidence = min(evidence, change.evidence + there)
            if evidence >= least:
                # A beam alone may be broken.
                by_beam = change.by_beam + np.bincount(rays[:, RAY_BEAM].astype(int), by_ray, len(change.by_beam))
                is_lost = evidence >= _CARRIED and by_beam.sum() - by_beam.max() >= SUSPECTED
                least, self._suspect = evidence, (change, CARRIED if is_lost else MAYBE_CARRIED)
        self._changes = kept
        if self._suspect is None and before is not None and before[0] in kept:
            self._suspect = before[0], MAYBE_CARRIED

    def _compare(self, covariance: FloatArray, known: KnownMap) -> None:
        """Compare the latest readings with a map, and note the outcome.

        Readings of neighbouring steps show nearly the same, so that only the latest ones count. A reading that saw
        nothing, shortly after one that saw a wall, may be a dropout of the sensor.
        """
        last, known.sensor = self._sights[-1], self.sensor
        nothing = np.array([sight.ranges >= self._robot.too_far for sight in self._sights[-LASTING:]])
        ranges = np.where(nothing[-1] & ~nothing.all(axis=0), np.nan, last.ranges)
        rays = moved(step_rays(ranges, self.sensor.mounted(self._robot), self.sensor.bias), last.pose)
        rays = self._that_count(rays, known, covariance)
        found = known.explained(rays, covariance)
        contradicts = found.against > 0.0
        points = rays[contradicts, :2] + found.against[contradicts, None] * rays[contradicts, RAY_TO_X:RAY_LENGTH]
        tested, beams = int(np.count_nonzero(found.tested)), rays[contradicts, RAY_BEAM].astype(int)
        self._checks.append(_Check(self._place, self._step, tested, beams, points))

    def _that_count(self, rays: FloatArray, known: KnownMap, covariance: FloatArray | None = None) -> FloatArray:
        """Those of the rays (n, 7) that say something about the pose: what ends in free space may be a moving body."""
        if self._free_space_counts:
            return rays
        return rays[known.explained(rays, covariance).against < rays[:, RAY_LENGTH]]

    def _judge(self, heading_variance: float, present: KnownMap) -> None:
        """Find the status of a robot that was not lost so far. If it is lost now, keep the map of this moment."""
        self.loss = self._loss()
        self.status = self.by_readings = self._doubts() if self.loss is None else self.loss.status
        heading_std = math.sqrt(max(heading_variance, 0.0))
        if self.status.level == "ok" and heading_std > _UNSURE_HEADING:
            words = f"the heading's standard deviation is {math.degrees(heading_std):.1f} deg"
            self.status = Status("unsure", words)
        if self.loss is not None:
            self._reference = present.frozen if self._suspect is None else self._suspect[0].known
            self._driven, self._lost_at = 0.0, self._place
            self._checks = []

    def _loss(self) -> Loss | None:
        """Why the robot is lost now; None if it is not."""
        if self.jump:
            return Loss(Status("lost", f"the odometry reports a motion of {self.jump:.1f} m in one step"), 0)
        recent = self._recent(_WINDOW)
        # Contradictions alone make a robot lost only when it is known whether the readings changed suddenly before.
        is_refuted = _refutes([check for check in recent if check.step <= self._finder.weighed], self._robot)
        if self._suspect is not None and (is_refuted or self._suspect[1].level == "lost"):
            change, _ = self._suspect
            return Loss(CARRIED, self._step - change.step, change.evidence >= _DATED, is_carried=True)
        if is_refuted and _refutes(recent, self._robot):
            sums = np.cumsum([check.evidence for check in reversed(recent)])[::-1]
            return Loss(Status("lost", _words(recent)), self._step - recent[int(sums.argmax())].step)
        return None

    def _doubts(self) -> Status:
        """The status of a robot that is not lost by its readings."""
        if self._suspect is not None:
            return MAYBE_CARRIED
        recent = self._recent(_WINDOW)
        if sum(check.evidence for check in recent) < _DOUBTFUL:
            return Status()
        beams, words = np.unique(_beams(recent)), _words(recent)
        if len(beams) == 1 and len(_beams(recent)) > 1:
            words += f", all of the beam at {math.degrees(self._robot.beam_angles[beams[0]]):.0f} deg"
        return Status("unsure", words)

    def _fits_again(self) -> bool:
        """Whether the readings of the last metres fit the map of the moment when the robot became lost."""
        fits = sum(check.evidence for check in self._checks) < -_REFUTED
        return self._place - self._lost_at >= RECOVERY_WINDOW and fits

    def _recent(self, window: float) -> list[_Check]:
        return [check for check in self._checks if self._place - check.place <= window]


def covariance_of_lost(jump: float, driven: float, *, knows_heading: bool = True) -> FloatArray:
    """What is added to the covariance (3, 3) of a lost robot, by jumps of the odometry and the distance since, m."""
    position = jump + min(POSITION_GROWTH * driven, POSITION_LIMIT)
    heading = min(_HEADING_GROWTH * driven, UNIFORM_HEADING) if knows_heading else UNIFORM_HEADING
    return np.diag([position**2, position**2, heading**2])


def _refutes(checks: list[_Check], robot: RobotSpec) -> bool:
    """Whether comparisons say that the pose is wrong.

    A beam alone may be broken, and at a single place a short wall may be missing.
    """
    if sum(check.evidence for check in checks) < _REFUTED:
        return False
    points = np.concatenate([check.points for check in checks])
    is_wide = float(np.hypot(*(points - points[0]).T).max()) >= _APART
    return is_wide and len(np.unique(_beams(checks))) >= min(2, len(robot.beams))


def _beams(checks: list[_Check]) -> IntArray:
    """The beams (k,) that contradict the map."""
    return np.concatenate([check.beams for check in checks])


def _words(checks: list[_Check]) -> str:
    """How many readings contradict the map."""
    return f"{len(_beams(checks))} of {sum(check.tested for check in checks)} readings contradict the map"
