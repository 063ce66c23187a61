"""LineSlam: where the robots are and where the walls are, from a few beams and odometry."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from limslam_agent.association import ObservedLine, associate
from limslam_agent.config import AgentConfig
from limslam_agent.ekf import LineEKF
from limslam_agent.front_end import FrontEnd
from limslam_agent.hough import ExtractedLine, extract_lines
from limslam_agent.line_map import Landmark, LineMap
from limslam_agent.loop_closing import Closure, agree, closing_pair, offset, squared_distance
from limslam_agent.motion import motion_of
from limslam_agent.scan_buffer import Scan
from limslam_agent.teammates import may_hit_others
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import Observation, RobotSpec, Side


@dataclass(frozen=True, eq=False)
class AssociationRecord:
    """What became of one observed line.

    Attributes
    ----------
    landmark
        The landmark that it was taken for, or that it became.
    is_new
        Whether it became a new landmark.
    readings
        (n, 2): step and beam of each point on it.
    robot
        Whose readings they are.
    """

    landmark: int
    is_new: bool
    readings: IntArray
    robot: int = 0


@dataclass(frozen=True, eq=False)
class Extraction:
    """The lines that were found in one scan, for those who want to watch.

    Attributes
    ----------
    robot, side, step
        Whose scan it was, of which side, and when.
    pose
        Where the robot believed to be (3,).
    points
        The scan (n, 2), m, in the robot's frame.
    lines, ends
        What was found in it (k, 2): r and theta, in the robot's frame, and the end points (k, 2, 2), m.
    """

    robot: int
    side: Side
    step: int
    pose: FloatArray
    points: FloatArray
    lines: FloatArray
    ends: FloatArray


class LineSlam:
    """The mapping half of the agent, for one robot or for several that share a map.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage.
    start_pose
        Where the robot begins (3,), m, m, rad: the origin of the map unless it is told. Of several robots (n, 3).

    Attributes
    ----------
    robots
        The front end of each robot.
    closures
        The loops that were closed, in order.
    last_extraction
        What was found in the latest scan; None before the first.
    on_association
        Told what became of each observed line, for those who keep a record.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, start_pose: FloatArray | None = None) -> None:
        self.robot, self.config = robot, config
        self._filter = LineEKF(np.zeros(3) if start_pose is None else start_pose)
        self._map = LineMap()
        self.robots = [FrontEnd(robot, config) for _ in self._filter.poses]
        association = config.association
        self._min_new_length = max(association.min_new_length, association.min_new_share * robot.reach)
        self._closed: set[tuple[int, int]] = set()
        self._drawn: FloatArray | None = None
        self.closures: list[Closure] = []
        self.last_extraction: Extraction | None = None
        self.on_association: Callable[[AssociationRecord], None] | None = None

    def step(self, *observations: Observation) -> None:
        """Take in one observation of each robot: predict, collect points, and use each buffer that is full.

        Raises
        ------
        ValueError
            If an observation has the wrong shape or reports no motion, or there is not one for each robot.
        """
        if len(observations) != len(self.robots):
            raise ValueError(f"{len(observations)} observations for {len(self.robots)} robots")
        # Nothing is taken in before all of it can be.
        for front, observation in zip(self.robots, observations, strict=True):
            front.check(observation)
        motions = [motion_of(seen, self.robot, self.config.noise, self.config.odometry) for seen in observations]
        for number, (observation, motion) in enumerate(zip(observations, motions, strict=True)):
            self.robots[number].accept(observation)
            self._filter.predict(motion.increment, motion.covariance, number)
        if len(self.robots) > 1:
            self._drop_beams_on_robots()
        for number, motion in enumerate(motions):
            for side, scan in self.robots[number].collect(motion.increment, float(motion.covariance[2, 2])):
                self._use(number, side, scan)

    def finish(self) -> None:
        """Use the points that are left in the buffers: nothing more will come."""
        for number, front in enumerate(self.robots):
            for side, buffer in front.buffers.items():
                self._use(number, side, buffer.take())

    @property
    def pose(self) -> FloatArray:
        """The believed pose of the first robot (3,), m, m, rad."""
        return self._filter.pose

    @property
    def poses(self) -> FloatArray:
        """The believed poses of all robots (n, 3)."""
        return self._filter.poses

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the first robot's pose (3, 3)."""
        return self._filter.pose_covariance

    @property
    def covariances(self) -> FloatArray:
        """Covariance of each robot's pose (n, 3, 3)."""
        joint, count = self._filter.joint_pose_covariance, len(self.robots)
        return np.array([joint[3 * number : 3 * number + 3, 3 * number : 3 * number + 3] for number in range(count)])

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m, in the world."""
        return self._all_segments[self._confirmed]

    @property
    def landmarks(self) -> list[Landmark]:
        """The walls of the map with all that is known of them."""
        every = self.all_landmarks
        return [every[index] for index in self._confirmed.tolist()]

    @property
    def all_landmarks(self) -> list[Landmark]:
        """The walls of the map, and those that are provisional, by number."""
        lines, segments = self._filter.lines, self._all_segments
        return [
            Landmark(
                float(lines[index, 0]), float(lines[index, 1]), self._filter.line_covariance(index),
                segments[index].reshape(2, 2).copy(), self._map.observations(index), index,
            )
            for index in range(len(lines))
        ]  # fmt: skip

    @property
    def ranges(self) -> FloatArray:
        """The first robot's latest readings (n_beams,), m."""
        return self.robots[0].ranges

    @property
    def measured(self) -> BoolArray:
        """Which of the first robot's readings (n_beams,) are new, finite, and from no other robot."""
        return self.robots[0].measured

    @property
    def refused_readings(self) -> int:
        """How many readings were not finite, since the start."""
        return sum(front.refused_readings for front in self.robots)

    @property
    def _all_segments(self) -> FloatArray:
        # Lines only change when one is observed, and the map is asked for at every step.
        if self._drawn is None:
            self._drawn = self._map.segments(self._filter.lines)
        return self._drawn

    @property
    def _confirmed(self) -> IntArray:
        return self._map.confirmed(self._all_segments, self.config.map)

    def _drop_beams_on_robots(self) -> None:
        poses, covariance = self._filter.poses, self._filter.joint_pose_covariance
        for number, front in enumerate(self.robots):
            ranges = np.where(front.measured, front.ranges, self.robot.max_ranges)
            front.drop(
                may_hit_others(
                    number, ranges, poses, covariance, self.robot, self.config.range_std, self.config.team
                )
            )  # fmt: skip

    def _use(self, robot: int, side: Side, scan: Scan) -> None:
        lines = extract_lines(scan.points, self.config.hough, self.config.range_std)
        found = np.array([line.fit.line for line in lines]).reshape(-1, 2)
        ends = np.array([line.fit.ends for line in lines]).reshape(-1, 2, 2)
        step, pose = self.robots[robot].step, self._filter.poses[robot]
        self.last_extraction = Extraction(robot, side, step, pose, scan.points, found, ends)
        for line in lines:
            self._incorporate(robot, line, scan.select(line.members))

    def _incorporate(self, robot: int, line: ExtractedLine, scan: Scan) -> None:
        """Take an observed line for a landmark that is known, or for a new one; or close a loop with it."""
        fit, pose = line.fit, self._filter.poses[robot]
        covariance = fit.covariance + np.diag([0.0, self.config.filter.drift_share * float(scan.drift.mean())])
        matches = associate(
            ObservedLine(fit.line, covariance, fit.ends, scan.origins, scan.points), pose, self._filter.lines,
            self._all_segments, lambda line, covariance, index: self._filter.innovation(line, covariance, index, robot),
            self.robot.reach, self.config.association,
        )  # fmt: skip
        if self._closes_loop([match.landmark for match in matches], self.robots[robot].step):
            return
        if matches:
            landmark = matches[0].landmark
            if self.config.filter.correct:
                self._filter.observe_line(fit.line, covariance, landmark, robot)
            pose = self._filter.poses[robot]
            self._map.grow(landmark, self._filter.lines[landmark], transform_points(pose, fit.ends))
        elif fit.length < self._min_new_length:
            return
        else:
            landmark = self._filter.augment(fit.line, covariance, robot)
            self._map.add(transform_points(pose, fit.ends))
        self._drawn = None
        if self.on_association is not None:
            self.on_association(AssociationRecord(landmark, not matches, scan.readings, robot))

    def _closes_loop(self, landmarks: list[int], step: int) -> bool:
        """Whether the two landmarks nearest to an observation are one wall; then the younger is corrected by the older.

        The observation has done its duty by that. A pair is closed once: the two are not merged, but the older one
        would otherwise be taken for a new measurement again and again.
        """
        config, pair = self.config.closing, closing_pair(landmarks)
        if pair is None or pair in self._closed or not (config.enabled and self.config.filter.correct):
            return False
        before = self._distance(*pair)
        lines, segments = self._filter.lines, self._all_segments
        if not agree(*pair, lines, segments, before, config):
            return False
        older, younger = pair
        offset_before = offset(lines[older], segments[younger])
        self._filter.observe_landmark(older, younger)
        self._closed.add(pair)
        self._drawn = None
        offset_after = offset(self._filter.lines[older], self._all_segments[younger])
        self.closures.append(
            Closure(older, younger, step, before, self._distance(*pair), offset_before, offset_after)
        )  # fmt: skip
        return True

    def _distance(self, older: int, younger: int) -> float:
        floor = np.array([self.config.closing.floor_distance, self.config.closing.floor_angle])
        return squared_distance(*self._filter.difference(older, younger), floor)
