"""The base class of the estimators: what a step of any of them begins with, and what they tell of
poses and walls.
"""

import copy
from collections.abc import Callable, Sequence
from typing import Any, Self

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.kernels.tables import POSE, THROUGH_SIGMAS, THROUGH_SLACK
from limslam_agent.slam.core.diagnostics import (
    AssociationRecord,
    CandidateTest,
    Closure,
    Comparison,
    Extraction,
    PendingPoints,
)
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Calibration, Motion, motion_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import Observation, RobotSpec, Side


class Estimator:
    """SLAM with line landmarks, for one robot or for several robots that share a map.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage.
    start_pose
        Start pose of the robot (3,), m, m, rad, by default the origin of the map; of several robots
        (n, 3).

    Attributes
    ----------
    robots
        The front end of each robot.
    increments
        The motion (3,) of each robot in the latest step as its odometry reports it, without the
        calibration, in the frame of the robot before it.
    closures
        Pairs of landmarks that were found to be one wall, in order.
    last_extraction
        The lines of the latest scan; None before the first.
    associations
        The associations of observed lines so far, in order.
    on_association, on_comparison
        Called with the association of each observed line, and with each observed line and the
        landmarks that it was compared with before it is used, if set. Copies have no listeners.
    filter
        The filter, which an estimator makes itself, as it does the map.
    """

    filter: Any
    _map: Any

    def __init__(
        self, robot: RobotSpec, config: AgentConfig, start_pose: FloatArray | None = None
    ) -> None:
        self.robot = robot
        self.config = config
        self._start = np.atleast_2d(np.zeros(POSE) if start_pose is None else start_pose)
        self._specified = RangeSensor(config.range_std, cone=robot.cone)
        self.robots = [FrontEnd(robot, config.noise) for _ in self._start]
        self.increments: list[FloatArray] = []
        self.closures: list[Closure] = []
        self.last_extraction: Extraction | None = None
        self.associations: list[AssociationRecord] = []
        self.on_association: Callable[[AssociationRecord], None] | None = None
        self.on_comparison: Callable[[Comparison], None] | None = None

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot.

        Raises
        ------
        ValueError
            If an observation has the wrong shape or reports no motion, or their number is not that
            of the robots.
        """
        raise NotImplementedError

    def finish(self) -> None:
        """Use all pending readings at the end of a run."""
        raise NotImplementedError

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
        return np.asarray(self.poses[0])

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
        each = np.arange(count)
        return np.asarray(joint.reshape(count, POSE, count, POSE)[each, :, each])

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

    @property
    def sensor(self) -> RangeSensor:
        """How ranges are taken to be measured: as specified, unless an estimator finds more."""
        return self._specified

    @property
    def mounted(self) -> RobotSpec:
        """The robot with its beams as they are taken to be mounted."""
        return self.sensor.mounted(self.robot)

    @property
    def beam_turns(self) -> FloatArray | None:
        """By what each beam is turned to the left, and its standard deviation (n_beams, 2), rad;
        None if no beam is.
        """
        return None

    @property
    def odometry_calibrations(self) -> list[tuple[Calibration, FloatArray] | None]:
        """Each robot's odometry calibration and its covariance (3, 3); None while its odometry is
        not corrected.
        """
        return [None] * len(self.robots)

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

    def learn_from(self, other: "Estimator") -> None:
        """Take robots and sensor to be from now on as another SLAM of the same robots has found
        them.
        """
        for front, known in zip(self.robots, other.robots, strict=False):
            front.know_repeats(known)
            front.ticks = known.ticks

    def report(self, record: AssociationRecord) -> None:
        """Store an association, and tell the listener of it."""
        self.associations.append(record)
        if self.on_association is not None:
            self.on_association(record)

    def _note_extraction(
        self, robot: int, side: Side, points: FloatArray, lines: Sequence[Any]
    ) -> None:
        """Store the lines, each with ``line`` (2,) and ``ends`` (2, 2), of a scan (n, 2), m, all in
        the frame of a robot.
        """
        found = np.array([each.line for each in lines]).reshape(-1, 2)
        ends = np.array([each.ends for each in lines]).reshape(-1, 2, 2)
        step = self.robots[robot].step
        self.last_extraction = Extraction(robot, side, step, self.poses[robot], points, found, ends)

    def _note_comparison(
        self, robot: int, ends: FloatArray, readings: IntArray, tests: tuple[CandidateTest, ...]
    ) -> None:
        """Tell the listener of the landmarks that a line was compared with."""
        if self.on_comparison is not None:
            step = self.robots[robot].step
            self.on_comparison(Comparison(robot, step, ends, readings, tests))

    def _read(self, observations: Sequence[Observation]) -> list[Motion]:
        """The motions of the robots in the next step, whose readings the front ends accept."""
        if len(observations) != len(self.robots):
            raise ValueError(f"{len(observations)} observations for {len(self.robots)} robots")
        # All observations are checked before any state changes.
        for front, observation in zip(self.robots, observations, strict=True):
            front.check(observation)
        reported = [
            motion_of(seen, self.robot, self.config.noise, self.config.odometry)
            for seen in observations
        ]
        motions = [
            front.accept(observation, motion, self.sensor)
            for front, observation, motion in zip(self.robots, observations, reported, strict=True)
        ]
        self.increments = [motion.increment for motion in motions]
        return motions

    def _drop_beams_on_robots(self) -> None:
        """Drop the beams of each robot that may end on another one, and must not become walls.

        A beam may have hit another robot if its end point is closer to that robot's estimated
        position than the body's radius plus a margin for the uncertainty of both positions, the
        same as that of beams that pass through walls.
        """
        from limslam_agent.kernels.nearness import beams_on_robots

        if len(self.robots) == 1:
            return
        poses = self.poses
        covariance = self.filter.joint_pose_covariance
        robot = self.robot
        sizes = (*self.sensor.numbers, float(robot.radius), THROUGH_SIGMAS, THROUGH_SLACK)
        for number, front in enumerate(self.robots):
            ranges = np.where(front.measured, front.ranges, robot.max_ranges)
            found = np.zeros(len(robot.beams), bool)
            beams_on_robots(poses, covariance, number, ranges, robot.beam_table, sizes, found)
            front.drop(found)
