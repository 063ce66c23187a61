"""The base class of the estimators: what a step of any of them does, and what they tell of poses
and walls.
"""

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.kernels.tables import POSE, THROUGH_SIGMAS, THROUGH_SLACK
from limslam_agent.slam.core.diagnostics import (
    AssociationRecord,
    Closure,
    Comparison,
    Extraction,
    PendingPoints,
)
from limslam_agent.slam.core.encoder_ticks import first_jitter, known_jitter, tick_by
from limslam_agent.slam.core.front_end import FrontEnd, yaw_of
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Calibration, Motion, motion_of, steered, unknown_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.turn_meter import TurnMeter
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import Observation, RobotSpec


class Estimator:
    """SLAM for one robot, or for several robots that share a map.

    What only some estimators know, such as errors of the sensor, is None or nothing here.

    What it is made of, and its attributes, are those of ``LineSlam``.

    Attributes
    ----------
    filter
        The filter, which an estimator makes itself, as it does the map.
    """

    filter: Any
    _map: Any
    robots: list[FrontEnd]

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig,
        start_pose: FloatArray | None = None,
        sensor: RangeSensor | None = None,
    ) -> None:
        self.robot = robot
        self.config = config
        self._start = np.atleast_2d(np.zeros(POSE) if start_pose is None else start_pose)
        self._specified = RangeSensor(config.range_std, cone=robot.cone)
        self.robots = [FrontEnd(robot) for _ in self._start]
        self.increments: list[FloatArray] = []
        self.ticks = np.zeros((len(self._start), 2))
        self._turn_meters: dict[int, TurnMeter] = {}
        self.closures: list[Closure] = []
        self.last_extraction: Extraction | None = None
        self.associations: list[AssociationRecord] = []
        self.on_association: Callable[[AssociationRecord], None] | None = None
        self.on_comparison: Callable[[Comparison], None] | None = None
        self._begin(sensor)

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot: predict, drop beams that may have hit teammates,
        and use the others.

        Raises
        ------
        ValueError
            If an observation has the wrong shape or reports no motion, or their number is not that
            of the robots.
        """
        if len(observations) != len(self.robots):
            raise ValueError(f"{len(observations)} observations for {len(self.robots)} robots")
        # All observations are checked before any state changes.
        for front, observation in zip(self.robots, observations, strict=True):
            front.check(observation)
        motions = [
            motion_of(seen, self.robot, self.config.noise, self.config.odometry)
            for seen in observations
        ]
        motions = [
            self._steered(number, *each)
            for number, each in enumerate(zip(motions, observations, strict=True))
        ]
        self.increments = [motion.increment for motion in motions]
        for number, (front, observation) in enumerate(zip(self.robots, observations, strict=True)):
            motions[number] = self._jittering(number, motions[number], observation)
            front.accept(observation, motions[number].increment)
            front.correct(self.range_sensor)
            self._predict(number, motions[number], by_wheels="wheels" in observation)
        if len(self.robots) > 1:
            self._drop_beams_on_robots()
        for number, (front, motion) in enumerate(zip(self.robots, motions, strict=True)):
            self._measure(number, front, motion)

    def finish(self) -> None:
        """Use all pending readings at the end of a run."""
        raise NotImplementedError

    def relocate(
        self,
        pose: FloatArray,
        covariance: FloatArray,
        robot: int = 0,
        ends: FloatArray | None = None,
    ) -> None:
        """Put a robot at another pose (3,).

        Readings that are still pending are used before.

        Parameters
        ----------
        pose, covariance
            The pose, m, m, rad, and the covariance (3, 3) of its error.
        robot
            Which robot is put there.
        ends
            If a match has found the pose: where its readings end (n, 2), m. The covariance is then
            that of the match, and the pose has the errors of the walls at these points, if the
            estimator can be renewed. Otherwise it is independent of the map.
        """
        del ends
        self.finish()
        self.filter.relocate(pose, covariance, robot)

    def copied(self) -> Self:
        """A copy that nothing listens to. Later steps of one of the two do not change the other."""
        # The robot, the settings and associations never change, so that copies can share them.
        shared = (self.robot, self.config, self.on_association, self.on_comparison)
        known = {id(self.associations): self.associations.copy()} | {
            id(each): each for each in shared
        }
        copied = copy.deepcopy(self, known)
        copied.on_association = copied.on_comparison = None
        return copied

    @property
    def pose(self) -> FloatArray:
        """Estimated pose of the first robot (3,), m, m, rad."""
        return np.asarray(self.filter.pose)

    @property
    def poses(self) -> FloatArray:
        """Estimated poses of all robots (n, 3), m, m, rad."""
        return np.asarray(self.filter.poses)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the first robot's pose (3, 3)."""
        return np.asarray(self.covariances[0])

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3)."""
        joint = self.filter.joint_pose_covariance
        count = len(self.robots)
        if count == 1:
            return np.asarray(joint[None])
        return np.asarray(
            joint.reshape(count, POSE, count, POSE)[np.arange(count), :, np.arange(count)]
        )

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m, in the world."""
        return np.asarray(self._map.segments)

    @property
    def landmarks(self) -> list[Landmark]:
        """The walls of the map as landmarks, with covariances."""
        return list(self._map.landmarks)

    @property
    def all_landmarks(self) -> list[Landmark]:
        """All landmarks, provisional ones included, by number."""
        return list(self._map.all_landmarks)

    @property
    def pending_points(self) -> list[PendingPoints]:
        """Points from which no line has been extracted yet, by robot and side, in the world."""
        raise NotImplementedError

    @property
    def association_limits(self) -> dict[str, float]:
        """The limits that decide about associations and loops, for diagnostics to show beside the
        values.
        """
        raise NotImplementedError

    def know(self, landmarks: Sequence[Landmark], segments: FloatArray) -> None:
        """Begin with the walls (k, 4), m, of an earlier map, and the landmarks that they lie on.

        Call this before the first step. Only the consistent estimator can do so.
        """
        raise NotImplementedError

    @property
    def is_renewable(self) -> bool:
        """Whether pose and map can be replaced: those of a single robot, by the consistent
        estimator.
        """
        return False

    @property
    def odometry_calibrations(self) -> list[tuple[Calibration, FloatArray] | None]:
        """Each robot's odometry calibration and its covariance (3, 3); None while its odometry is
        not corrected.
        """
        return [None] * len(self.robots)

    @property
    def odometry_calibration(self) -> tuple[Calibration, FloatArray] | None:
        """The first robot's odometry calibration and its covariance; None while its odometry is not
        corrected.
        """
        return self.odometry_calibrations[0]

    def learn_from(self, other: "Estimator") -> None:
        """Take odometry and sensor to be from now on as the same robot has found them with another
        SLAM.
        """
        self.ticks[: len(other.ticks)] = other.ticks
        self.know_repeats(other)
        if other.sensor is not None and other.sensor != self.sensor:
            self.assume(other.sensor)
        if any(found is not None for found in other.odometry_calibrations):
            self.calibrate()

    def know_repeats(self, other: "Estimator") -> None:
        """Use each reading once, as far as another SLAM of the same robots has found which beams
        repeat theirs.
        """
        for front, known in zip(self.robots, other.robots, strict=False):
            front.know_repeats(known)

    def calibrate(self, found: tuple[Calibration, FloatArray] | None = None) -> None:
        """Correct the odometry from now on, if it can be, by what the readings so far say of its
        constant errors.

        Before the first step, the first robot can begin with a calibration and its covariance (3,
        3) that an earlier drive has found.
        """

    @property
    def sensor(self) -> RangeSensor | None:
        """How the sensor measures, as specified or as the data require; None for the published
        estimator.
        """
        return None

    @property
    def range_sensor(self) -> RangeSensor:
        """How ranges are taken to be measured: :attr:`sensor`, or as specified for the published
        estimator.
        """
        return self.sensor or self._specified

    @property
    def beam_turns(self) -> FloatArray | None:
        """By what each beam is turned to the left, and its standard deviation (n_beams, 2), rad;
        None if no beam is.
        """
        return None

    @property
    def mounted(self) -> RobotSpec:
        """The robot with its beams as they are taken to be mounted."""
        return self.range_sensor.mounted(self.robot)

    def assume(self, sensor: RangeSensor) -> None:
        """Take the sensor to measure like this from now on, and correct the estimate for what was
        assumed before.
        """

    def forget_sensor(self) -> None:
        """Take the sensor to be as specified again, since what was found about it may be due to
        readings that should not have been used. Only what is known of broken and late beams stays.
        """

    def correct_delay(self) -> None:
        """Take the ranges to be as late as the readings say. The caller lets the wheels wait for
        them from then on.
        """

    def leave_out(self, beam: int) -> None:
        """Use no further readings of a broken beam of the only robot. Only the consistent estimator
        can do so.
        """

    @property
    def ranges(self) -> FloatArray:
        """The first robot's latest readings (n_beams,), m."""
        return self.robots[0].ranges

    @property
    def measured(self) -> BoolArray:
        """Which of the first robot's readings (n_beams,) are new, not NaN, and from no other
        robot.
        """
        return self.robots[0].measured

    @property
    def refused_readings(self) -> int:
        """Number of readings since the start that were skipped: no readings (NaN), and negative
        numbers.
        """
        return sum(front.refused_readings for front in self.robots)

    def report(self, record: AssociationRecord) -> None:
        """Store an association, and tell the listener of it."""
        self.associations.append(record)
        if self.on_association is not None:
            self.on_association(record)

    def _begin(self, sensor: RangeSensor | None) -> None:
        """Make the filter and all else that an estimator needs."""
        raise NotImplementedError

    def _predict(self, number: int, motion: Motion, *, by_wheels: bool) -> None:
        """Predict the pose of a robot that has moved, as its odometry reports it, which may be the
        wheels' travel.
        """
        raise NotImplementedError

    def _measure(self, number: int, front: FrontEnd, motion: Motion) -> None:
        """Use the new readings of a robot after its motion has been predicted."""
        raise NotImplementedError

    def _jittering(self, number: int, motion: Motion, observation: Observation) -> Motion:
        """A motion with the jitter by the ticks, which are found by its travel, too."""
        before = self.ticks[number].tolist()
        axle = self.robot.axle
        covariance = motion.covariance
        if (
            "wheels" in observation
            and "wheel_variances" not in observation
            and not self.range_sensor.delay
        ):  # else parts of the travel may wait for the ranges
            self.ticks[number] = [
                tick_by(*each)
                for each in zip(before, map(float, observation["wheels"]), strict=True)
            ]
        ticks = [max(tick, 0.0) for tick in self.ticks[number].tolist()]
        if ticks != [max(tick, 0.0) for tick in before]:
            first = first_jitter(np.array(before), self.ticks[number], axle)
            if motion.turn is not None:
                first[2] = 0.0
                first[:, 2] = 0.0
            covariance = covariance + first
        jitter = known_jitter(*ticks, axle)
        if motion.turn is not None:
            jitter = np.diag([jitter.item(0), 0.0, motion.turn.jitter])
        return replace(motion, covariance=covariance, jitter=jitter)

    def _steered(self, number: int, motion: Motion, observation: Observation) -> Motion:
        """A motion by wheels with the turn by the robot's heading, once it has reported one."""
        if not math.isnan(yaw_of(observation)) and number not in self._turn_meters:
            self._turn_meters[number] = TurnMeter(self.robot, self.config.noise)
        meter = self._turn_meters.get(number)
        if meter is None or "wheels" not in observation:
            return motion
        wheels = np.asarray(observation["wheels"], dtype=float)
        more = sum(unknown_of(observation))
        turn = meter.step(yaw_of(observation), wheels, more)
        return steered(motion, wheels, turn, self.config.noise, more)

    def _drop_beams_on_robots(self) -> None:
        """Drop the beams of each robot that may end on another one, and must not become walls.

        A beam may have hit another robot if its end point is closer to that robot's estimated
        position than the body's radius plus a margin for the uncertainty of both positions, the
        same as that of beams that pass through walls.
        """
        from limslam_agent.kernels.nearness import beams_on_robot

        poses = self.poses
        covariance = self.filter.joint_pose_covariance
        robot = self.robot
        margins = (float(robot.radius), THROUGH_SIGMAS, THROUGH_SLACK)
        numbers = range(len(poses))
        for number, front in enumerate(self.robots):
            ranges = np.where(front.measured, front.ranges, robot.max_ranges)
            found = np.zeros(len(robot.beams), bool)
            for other in (other for other in numbers if other != number):
                beams_on_robot(
                    poses[number],
                    poses[other],
                    ranges,
                    robot.beam_table,
                    self.range_sensor.numbers,
                    covariance,
                    POSE * number,
                    POSE * other,
                    margins,
                    found,
                )
            front.drop(found)
