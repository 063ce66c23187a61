"""LineSlam: estimates the poses of robots, and the walls around them, from a few beams and odometry."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.config.published import PublishedConfig
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.consistent.map_state import MapState
from limslam_agent.slam.core.contact import Contacts
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure, Comparison, Extraction, PendingPoints
from limslam_agent.slam.core.encoder_ticks import first_jitter, jitter_of, tick_by
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Motion, OdometryCalibration, calibrated, motion_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.teammates import may_hit_others
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import Observation, RobotSpec

__all__ = ["AssociationRecord", "Extraction", "LineSlam", "RangeSensor"]


class LineSlam:
    """SLAM with line landmarks, for one robot or for several robots that share a map.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage, and which estimator is used.
    start_pose
        Start pose of the robot (3,), m, m, rad, by default the origin of the map; of several robots (n, 3).
    sensor
        How the ranges are measured, if that is known to differ from ``robot`` and ``config``. Only the consistent
        estimator uses it.

    Attributes
    ----------
    robots
        The front end of each robot.
    increments
        The motion (3,) of each robot in the latest step as its odometry reports it, without the calibration, in the
        frame of the robot before it.
    ticks
        The ticks (n, 2) of the wheels' encoders, m, as ``encoder_ticks.tick_by`` finds them.
    """

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig,
        start_pose: FloatArray | None = None,
        sensor: RangeSensor | None = None,
    ) -> None:
        self.robot, self.config = robot, config
        start = np.atleast_2d(np.zeros(3) if start_pose is None else start_pose)
        self.robots = [FrontEnd(robot) for _ in start]
        self._contacts = [Contacts(robot, config.range_std) for _ in start]
        self.increments: list[FloatArray] = []
        self.ticks = np.zeros((len(start), 2))
        self._estimator = _estimator_of(robot, config, start, sensor)

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot: predict, drop beams that may have hit teammates, and use the others.

        Raises
        ------
        ValueError
            If an observation has the wrong shape or reports no motion, or their number is not that of the robots.
        """
        if len(observations) != len(self.robots):
            raise ValueError(f"{len(observations)} observations for {len(self.robots)} robots")
        # All observations are checked before any state changes.
        for front, observation in zip(self.robots, observations, strict=True):
            front.check(observation)
        reported = [motion_of(seen, self.robot, self.config.noise, self.config.odometry) for seen in observations]
        self.increments = [motion.increment for motion in reported]
        reported = [
            self._jittering(number, *each) for number, each in enumerate(zip(reported, observations, strict=True))
        ]
        motions = [self._calibrated(number, motion) for number, motion in enumerate(reported)]
        for number, (observation, motion) in enumerate(zip(observations, motions, strict=True)):
            self.robots[number].accept(observation)
            self.robots[number].leave_out(self.range_sensor.broken)
            self._estimator.predict(self._loosened(number, motion, observation), number)
        if len(self.robots) > 1:
            self._drop_beams_on_robots()
        for number, motion in enumerate(motions):
            self._estimator.measure(number, self.robots[number], motion)

    def finish(self) -> None:
        """Use all pending readings at the end of a run."""
        self._estimator.finish(self.robots)

    def relocate(
        self, pose: FloatArray, covariance: FloatArray, robot: int = 0, ends: FloatArray | None = None
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
            If a match has found the pose: where its readings end (n, 2), m. The covariance is then that of the match,
            and the pose has the errors of the walls at these points. Otherwise it is independent of the map.
        """
        self.finish()
        by_lines = None if ends is None or not self.is_renewable else self.map_state.by_walls(pose, ends)
        self._estimator.relocate(pose, covariance, robot, by_lines)

    def close(self, pose: FloatArray, covariance: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Close a loop: readings that end at points (n, 2) have found the pose (3,) of the robot among the walls there.

        ``covariance`` (3, 3) is that of the match. Readings that are still pending are used before. Where the world has
        moved is returned: anchors (m, 2) of walls, and the rigid motion (m, 3) around each of them. It is None, and
        nothing changes, if the estimate does not explain that the robot is there.
        """
        self.finish()
        before = self.map_state
        found = before.closed(pose, covariance, ends)
        if found is None:
            return None
        self.renew(found[0])
        return before.anchors, found[1]

    def know(self, landmarks: Sequence[Landmark], segments: FloatArray) -> None:
        """Begin with the walls (k, 4), m, of an earlier map, and the landmarks that they lie on.

        Call this before the first step. Only the consistent estimator can do so.
        """
        self._estimator.know(landmarks, segments)

    def copied(self) -> "LineSlam":
        """A copy that nothing listens to. Later steps of one of the two do not change the other."""
        estimator = self._estimator
        listeners, records = (estimator.on_association, estimator.on_comparison), estimator.associations
        estimator.on_association, estimator.on_comparison, estimator.associations = None, None, []
        try:
            # The robot, the settings and associations never change, so that copies can share them.
            copied = copy.deepcopy(self, {id(shared): shared for shared in (self.robot, self.config)})
            copied.associations.extend(records)
            return copied
        finally:
            (estimator.on_association, estimator.on_comparison), estimator.associations = listeners, records

    @property
    def pose(self) -> FloatArray:
        """Estimated pose of the first robot (3,), m, m, rad."""
        return np.asarray(self.poses[0])

    @property
    def poses(self) -> FloatArray:
        """Estimated poses of all robots (n, 3), m, m, rad."""
        return self._estimator.poses

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the first robot's pose (3, 3)."""
        return np.asarray(self.covariances[0])

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3)."""
        return self._estimator.covariances

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m, in the world."""
        return self._estimator.segments

    @property
    def landmarks(self) -> list[Landmark]:
        """The walls of the map as landmarks, with covariances."""
        return self._estimator.landmarks

    @property
    def all_landmarks(self) -> list[Landmark]:
        """All landmarks, provisional ones included, by number."""
        return self._estimator.all_landmarks

    @property
    def closures(self) -> list[Closure]:
        """Pairs of landmarks that were found to be one wall, in order."""
        return self._estimator.closures

    @property
    def last_extraction(self) -> Extraction | None:
        """The lines of the latest scan; None before the first."""
        return self._estimator.last_extraction

    @property
    def association_limits(self) -> dict[str, float]:
        """The limits that decide about associations and loops, for diagnostics to show beside the values."""
        return self._estimator.association_limits

    @property
    def on_association(self) -> Callable[[AssociationRecord], None] | None:
        """Called with the association of each observed line, if set. Copies have no listener."""
        return self._estimator.on_association

    @on_association.setter
    def on_association(self, listener: Callable[[AssociationRecord], None] | None) -> None:
        self._estimator.on_association = listener

    @property
    def on_comparison(self) -> Callable[[Comparison], None] | None:
        """Called with each observed line and the landmarks that it was compared with, if set."""
        return self._estimator.on_comparison

    @on_comparison.setter
    def on_comparison(self, listener: Callable[[Comparison], None] | None) -> None:
        self._estimator.on_comparison = listener

    @property
    def associations(self) -> list[AssociationRecord]:
        """The associations of observed lines so far, in order."""
        return self._estimator.associations

    @property
    def is_renewable(self) -> bool:
        """Whether pose and map can be replaced: those of a single robot, by the consistent estimator."""
        return isinstance(self._estimator, ConsistentEstimator) and len(self.robots) == 1

    @property
    def map_state(self) -> MapState:
        """The pose and the map of a renewable estimate, without the pending readings. Later steps do not change it."""
        return self._renewable.map_state

    def renew(self, state: MapState) -> None:
        """Replace pose and map by a better estimate of both, which knows all readings so far."""
        self._renewable.renew(state, self.robots[0].step)

    @property
    def _renewable(self) -> ConsistentEstimator:
        if not (self.is_renewable and isinstance(self._estimator, ConsistentEstimator)):
            raise TypeError("only the estimate of a single robot by the consistent estimator can be renewed")
        return self._estimator

    @property
    def pending_points(self) -> list[PendingPoints]:
        """Points from which no line has been extracted yet, by robot and side."""
        return self._estimator.pending_points(self.robots)

    @property
    def odometry_calibrations(self) -> list[tuple[OdometryCalibration, FloatArray] | None]:
        """Each robot's odometry calibration and its covariance (3, 3); None while its odometry is not corrected."""
        return [self._estimator.odometry_calibration(number) for number in range(len(self.robots))]

    @property
    def odometry_calibration(self) -> tuple[OdometryCalibration, FloatArray] | None:
        """The first robot's odometry calibration and its covariance; None while its odometry is not corrected."""
        return self._estimator.odometry_calibration(0)

    def learn_from(self, other: "LineSlam") -> None:
        """Take odometry and sensor to be from now on as the same robot has found them with another SLAM."""
        self.ticks[: len(other.ticks)] = other.ticks
        if other.sensor is not None and other.sensor != self.sensor:
            self.assume(other.sensor)
        if any(found is not None for found in other.odometry_calibrations):
            self.calibrate()

    def calibrate(self, found: tuple[OdometryCalibration, FloatArray] | None = None) -> None:
        """Correct the odometry from now on, if it can be, by what the readings so far say of its constant errors.

        Before the first step, the first robot can begin with a calibration and its covariance (3, 3) that an earlier
        drive has found.
        """
        if isinstance(self._estimator, ConsistentEstimator):
            self._estimator.calibrate(found)

    @property
    def sensor(self) -> RangeSensor | None:
        """How the sensor measures, as specified or as the data require; None for the published estimator."""
        return self._estimator.sensor if isinstance(self._estimator, ConsistentEstimator) else None

    @property
    def range_sensor(self) -> RangeSensor:
        """How ranges are taken to be measured: :attr:`sensor`, or as specified for the published estimator."""
        return self.sensor or RangeSensor(self.config.range_std, cone=self.robot.cone)

    @property
    def beam_turns(self) -> FloatArray | None:
        """By what each beam is turned to the left, and its standard deviation (n_beams, 2), rad; None if no beam is."""
        estimator, turns = self._estimator, self.range_sensor.turns
        if not (turns and isinstance(estimator, ConsistentEstimator) and len(estimator.further_turns)):
            return None
        return np.asarray(estimator.further_turns + np.column_stack((turns, np.zeros(len(turns)))))

    @property
    def mounted(self) -> RobotSpec:
        """The robot with its beams as they are taken to be mounted."""
        return self.range_sensor.mounted(self.robot)

    def assume(self, sensor: RangeSensor) -> None:
        """Take the sensor to measure like this from now on, and correct the estimate for what was assumed before."""
        if isinstance(self._estimator, ConsistentEstimator):
            self._estimator.assume(sensor)

    def correct_delay(self) -> None:
        """Take the ranges to be as late as the readings say. The caller lets the wheels wait for them from then on."""
        if isinstance(self._estimator, ConsistentEstimator):
            self._estimator.correct_delay()

    def leave_out(self, beam: int) -> None:
        """Use no further readings of a broken beam of the only robot. Only the consistent estimator can do so."""
        if self.is_renewable:
            self._renewable.leave_out(beam)

    @property
    def ranges(self) -> FloatArray:
        """The first robot's latest readings (n_beams,), m."""
        return self.robots[0].ranges

    @property
    def measured(self) -> BoolArray:
        """Which of the first robot's readings (n_beams,) are new, not NaN, and from no other robot."""
        return self.robots[0].measured

    @property
    def refused_readings(self) -> int:
        """Number of readings since the start that were skipped: no readings (NaN), and negative numbers."""
        return sum(front.refused_readings for front in self.robots)

    def _calibrated(self, number: int, motion: Motion) -> Motion:
        assumed = self._estimator.assumed_calibration(number)
        return motion if assumed is None else calibrated(motion, self.robot.axle, assumed)

    def _jittering(self, number: int, motion: Motion, observation: Observation) -> Motion:
        """A motion with the jitter by the ticks, which are found by its travel, too."""
        ticks, before = self.ticks[number], self.ticks[number].copy()
        if not self.range_sensor.delay:  # otherwise parts of the travel may wait for the ranges
            for wheel, travel in enumerate(observation.get("wheels", ())):
                ticks[wheel] = tick_by(float(before[wheel]), float(travel))
        return replace(
            motion,
            covariance=motion.covariance + first_jitter(before, ticks, self.robot.axle),
            jitter=jitter_of(ticks, self.robot.axle),
        )

    def _loosened(self, number: int, motion: Motion, observation: Observation) -> Motion:
        """A motion by wheels, less certain if the robot touches something. The published estimator knows no contact."""
        if "wheels" not in observation or not isinstance(self._estimator, ConsistentEstimator):
            return motion
        front = self.robots[number]
        return self._contacts[number].loosened(motion, front.ranges, front.measured)

    def _drop_beams_on_robots(self) -> None:
        poses, covariance = self._estimator.poses, self._estimator.joint_covariance
        for number, front in enumerate(self.robots):
            ranges = np.where(front.measured, front.ranges, self.robot.max_ranges)
            front.drop(
                may_hit_others(
                    number, ranges, poses, covariance, self.robot, self.range_sensor
                )
            )  # fmt: skip


def _estimator_of(robot: RobotSpec, config: AgentConfig, start: FloatArray, sensor: RangeSensor | None) -> Estimator:
    """The estimator that the settings choose by their type, for robots at start poses (n, 3)."""
    settings, std = config.estimator, config.range_std
    if isinstance(settings, PublishedConfig):
        # Only this estimator needs filterpy, which loads all of scipy.stats.
        from limslam_agent.slam.published.published import PublishedEstimator

        return PublishedEstimator(robot, settings, std, start)
    return ConsistentEstimator(robot, settings, std, start, sensor)
