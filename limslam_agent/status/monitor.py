"""StatusMonitor: watches the estimate of one robot and says whether it can be trusted, without
ground truth.

The robot may have slipped, have drifted, or been carried to another place, before any step of the
last metres (:mod:`~limslam_agent.status.sudden_changes`). The readings since then speak for the
believed pose, or for one near it, or are no likelier there than at a random place.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import LEAST_TURNED, MOST_TURNED, READING, STEADY, TIMES
from limslam_agent.readings import TURN_LENGTH
from limslam_agent.record import Drive
from limslam_agent.slam.core.motion import unknown_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.chance import chance_mistaken, chance_off, either, in_words
from limslam_agent.status.known_map import DECIDED, DOUBTED, KnownMap
from limslam_agent.status.rays import STEPS, rays_of
from limslam_agent.status.status import Status, judged
from limslam_agent.status.sudden_changes import LONGEST_SPACING, WINDOW, Now, SuddenChanges, by_beam
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

UNIFORM_HEADING = math.pi / math.sqrt(3.0)
"""Standard deviation of a heading of which nothing is known, rad: that of a uniform distribution
over the circle.
"""

# The readings are compared with the map when the robot has moved by ``SPACING``, m, and the
# estimator extracts lines in the same step, or when it has moved by ``LONGEST_SPACING``, m. A turn
# by one radian counts like ``TURN_LENGTH``, m. The readings of a robot
# that stands are compared when there are ``STEPS`` new ones: no comparison uses more.
SPACING = 0.10
# Standard deviations that the position of a lost robot gains with each metre, m, at most, m, and
# those of its heading, rad.
POSITION_GROWTH = 2.0
POSITION_LIMIT = 10.0
_HEADING_GROWTH = 1.0
_MAX_TURN = 0.5  # rad: so it is if the standard deviation of the turn in a step is larger
_MAX_JUMP = 1.0  # m: the estimate is lost if the odometry reports a longer motion in one step

BLIND = 300
"""A beam that has seen nothing so often in succession may see nothing at all."""

CARRIED = Status(
    "lost", "the latest readings do not fit the place, as if the robot had been carried away"
)
MAYBE_CARRIED = Status("unsure", CARRIED.reason)


class Loss(NamedTuple):
    """Why a robot is lost, and since when."""

    status: Status
    step: int  # number of the step since which the estimate has been doubtful
    is_carried: bool = (
        False  # whether the readings of that step say that the robot was carried away before it
    )
    # The map before that step, near to which the readings since then fit: the robot has slipped
    known: KnownMap | None = None

    @property
    def is_dated(self) -> bool:
        """Whether the readings say in which step the motion was wrong."""
        return self.is_carried or self.known is not None


class StatusMonitor:
    """Watches one robot.

    Each time that the robot has moved far enough, the monitor compares the readings with the map.
    The chance that the pose is off (:mod:`~limslam_agent.status.chance`) follows from that and from
    its covariance, and the level from this chance and from jumps of the odometry.

    While a robot is lost, the covariance of its pose gets larger with each metre. It stays lost for
    3 m, and until nothing is doubtful any more.

    Parameters
    ----------
    robot
        Body and beams as specified.
    sensor
        How ranges are measured, and by what the beams are turned.
    drive
        The recorded drive, of which the steps from now on count.

    Attributes
    ----------
    first
        Number of the first step that may still count.
    sensor
        The same, as far as it is known now. Set it when the estimator has found out more.
    status
        The present status.
    by_readings
        The same by the doubts that the readings have raised and not yet refuted, whatever the
        covariance is.
    mistaken
        The chance by the readings that the robot is elsewhere.
    jump
        Length of the jumps of the odometry since the robot is lost, m.
    loss
        Why the robot is lost, and since when; None while it is not.
    broken
        A beam that always reads the same, and is left out from now on; None without it.
    """

    def __init__(self, robot: RobotSpec, sensor: RangeSensor, drive: Drive) -> None:
        self._robot = robot
        self.sensor = sensor
        self._drive = drive
        self.first = drive.end
        self._place = 0.0
        self._checked = -math.inf
        self._changes = SuddenChanges(robot, drive)
        self._steady = np.zeros((STEADY, len(robot.beams)))
        self._steady[READING] = math.nan
        self.jump = 0.0
        self._driven = 0.0
        self._is_unknown = False
        self.loss: Loss | None = None
        self.broken: int | None = None
        self.status = self.by_readings = Status()
        self.mistaken = 0.0

    def observe(self, *, is_busy: bool) -> bool:
        """Note the motion and the readings of the latest step.

        Parameters
        ----------
        is_busy
            Whether the estimator extracts lines in this step. Such a step takes long in any case.
            Comparisons are made in these steps if possible, so that they add little to the median
            time of a step.

        Returns
        -------
        due
            Whether :meth:`check` is to be called now.
        """
        from limslam_agent.kernels.readings import compare_with_before

        scan = self._drive.scans[-1]
        x, y, turn = scan.motion.tolist()
        distance = math.hypot(x, y)
        unknown = math.sqrt(sum(unknown_of(scan.observation)))
        self._is_unknown = unknown > _MAX_TURN * self._robot.axle
        is_jump = distance > _MAX_JUMP or self._is_unknown
        if is_jump:
            self.jump += max(distance, unknown)
            distance = 0.0
        # No wall is read with so little noise.
        limit = 0.5 * self.sensor.std
        compare_with_before(scan.ranges, self._robot.too_far, limit, turn, self._steady)
        self._place += distance + TURN_LENGTH * abs(turn)
        self._driven += distance
        moved = self._place - self._checked
        is_due = is_jump or moved >= (SPACING if is_busy else LONGEST_SPACING)
        return is_due or self._drive.end - self.first >= 2 * STEPS

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
        self._changes.look(Now(self.first, self._place, present, covariance))
        self.first = max(self.first, self._drive.end - STEPS)  # more would count no more
        self.broken = self._broken_beam(present)
        self._judge(covariance)

    def forget_map(self) -> None:
        """Forget what the map was like: a loop is closed in the step that is recorded next."""
        self._changes.forget()

    @property
    def is_suspicious(self) -> bool:
        """Whether the robot may have been carried away, so that the map since then may be wrong."""
        return self._changes.suspicion is not None

    @property
    def added_covariance(self) -> FloatArray:
        """What has to be added to the covariance (3, 3) of the pose; zero if the robot is not
        lost.
        """
        return (
            np.zeros((3, 3)) if self.loss is None else covariance_of_lost(self.jump, self._driven)
        )

    def _broken_beam(self, present: KnownMap) -> int | None:
        """The beam that has read the same while the robot turned by a right angle; None without it.

        There may be nothing to see all around, so a beam that sees nothing must contradict the map.
        """
        steady = self._steady[READING]
        turned = self._steady[MOST_TURNED] - self._steady[LEAST_TURNED]
        is_steady = np.isfinite(steady) & (turned > 0.5 * math.pi)
        is_steady[list(self.sensor.broken)] = False
        if is_steady.all():
            return None
        for beam in np.flatnonzero(is_steady).tolist():
            is_stuck = self._robot.too_near[beam] < steady[beam] < self._robot.too_far[beam]
            times = self._steady[TIMES, beam]
            if is_stuck or (times > BLIND and self._contradicts(beam, present)):
                return beam
        return None

    def _contradicts(self, beam: int, present: KnownMap) -> bool:
        """Whether the latest readings of a beam contradict the map, as it is now, at several
        places.

        The walls there were seen later by other beams, which speak for the pose.
        """
        rays = rays_of(self._drive.since(self.first), self._robot, self.sensor)
        test = by_beam(rays, present.explained(rays).by_place(rays), self._robot)
        return bool(test[beam] > 2.0 * DECIDED and test.sum() - test[beam] < 0.0)

    def _judge(self, covariance: FloatArray) -> None:
        """Find the status, for a pose with a covariance (3, 3)."""
        before = self.loss
        self.loss = self._loss()
        if self.loss is None and (self.is_suspicious or self._driven < WINDOW):
            self.loss = before
        if before is None or self.loss is None:
            self._driven = 0.0
        self.by_readings = MAYBE_CARRIED if self.is_suspicious else Status()
        if self.loss is None:
            self.jump = 0.0
        elif self.loss.known is None:  # a robot that has slipped is near
            self.by_readings = self.loss.status
        suspicion = self._changes.suspicion
        by_covariance = float(chance_off(covariance))
        self.mistaken = 0.0 if suspicion is None else chance_mistaken(suspicion.evidence)
        chance = either(by_covariance, self.mistaken)
        is_mistaken = self.mistaken > by_covariance
        reason = CARRIED.reason if is_mistaken else in_words(chance, covariance)
        is_lost = self.by_readings.level == "lost"
        self.status = self.by_readings if is_lost else judged(chance, reason)

    def _loss(self) -> Loss | None:
        """Why the robot is lost now; None if it is not."""
        if self.jump and self.loss is None:
            words = f"the odometry reports a motion of {self.jump:.1f} m in one step"
            if self._is_unknown:
                words = "how the robot moved in a gap of its odometry is not known"
            return Loss(Status("lost", words), self._drive.end - 1)
        found = self._changes.suspicion
        return self.doubt if found is not None and found.is_certain else None

    @property
    def doubt(self) -> Loss | None:
        """Why the robot is lost, and since when, if what is doubtful now is true; None without a
        doubt.
        """
        found = self._changes.suspicion
        if found is None:
            return None
        # Without a sudden change, the estimate may be wrong as well, as after a wrong association.
        change = found.change
        if found.is_slip:
            return Loss(CARRIED, change.step, known=change.known)
        return Loss(CARRIED, change.step, is_carried=change.evidence >= DOUBTED)


def covariance_of_lost(jump: float, driven: float, *, knows_heading: bool = True) -> FloatArray:
    """What is added to the covariance (3, 3) of a lost robot, by jumps of the odometry and the
    distance since, m.
    """
    position = jump + min(POSITION_GROWTH * driven, POSITION_LIMIT)
    heading = min(_HEADING_GROWTH * driven, UNIFORM_HEADING) if knows_heading else UNIFORM_HEADING
    return np.diag([position**2, position**2, heading**2])
