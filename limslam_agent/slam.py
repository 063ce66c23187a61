"""LineSlam: where the robot is and where the walls are, from a few beams and odometry."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from limslam_agent.association import ObservedLine, associate
from limslam_agent.config import AgentConfig
from limslam_agent.ekf import LineEKF
from limslam_agent.hough import ExtractedLine, extract_lines
from limslam_agent.line_map import Landmark, LineMap
from limslam_agent.motion import motion_of
from limslam_agent.scan_buffer import Scan, ScanBuffer
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import Observation, RobotSpec


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
    """

    landmark: int
    is_new: bool
    readings: IntArray


class LineSlam:
    """The mapping half of the agent.

    Parameters
    ----------
    robot
        Body and beams.
    config
        Settings of every stage.
    start_pose
        Where the robot begins (3,), m, m, rad: the origin of the map unless it is told.

    Attributes
    ----------
    ranges, measured
        The latest readings (n_beams,), m, and which of them are new and finite.
    refused_readings
        How many readings were not finite, since the start.
    on_association
        Told what became of each observed line, for those who keep a record.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, start_pose: FloatArray | None = None) -> None:
        self.robot, self.config = robot, config
        self._filter = LineEKF(np.zeros(3) if start_pose is None else start_pose)
        self._map = LineMap()
        self._buffers = [ScanBuffer(robot, "left", config.buffer), ScanBuffer(robot, "right", config.buffer)]
        association = config.association
        self._min_new_length = max(association.min_new_length, association.min_new_share * robot.reach)
        self._step = -1
        self.ranges: FloatArray = robot.max_ranges
        self.measured: BoolArray = np.zeros(len(robot.beams), dtype=bool)
        self.refused_readings = 0
        self.on_association: Callable[[AssociationRecord], None] | None = None

    def step(self, observation: Observation) -> None:
        """Take in one observation: predict, collect points, and use each buffer that is full.

        Raises
        ------
        ValueError
            If the observation has the wrong shape or reports no motion.
        """
        self._step += 1
        self._accept(observation)
        motion = motion_of(observation, self.robot, self.config.noise, self.config.odometry)
        self._filter.predict(motion.increment, motion.covariance)
        hits = self._hits()
        for buffer in self._buffers:
            buffer.carry(motion.increment)
            for scan in buffer.add(self.ranges, self.measured, hits, self._step):
                self._use(scan)

    def finish(self) -> None:
        """Use the points that are left in the buffers: nothing more will come."""
        for buffer in self._buffers:
            self._use(buffer.take())

    @property
    def pose(self) -> FloatArray:
        """The believed pose (3,), m, m, rad."""
        return self._filter.pose

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the believed pose (3, 3)."""
        return self._filter.pose_covariance

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m, in the world."""
        return self._map.segments(self._filter.lines)

    @property
    def landmarks(self) -> list[Landmark]:
        """The walls of the map with all that is known of them."""
        lines, segments = self._filter.lines, self.segments
        return [
            Landmark(
                float(lines[index, 0]), float(lines[index, 1]), self._filter.line_covariance(index),
                segments[index].reshape(2, 2), self._map.observations(index),
            )
            for index in range(len(lines))
        ]  # fmt: skip

    def _accept(self, observation: Observation) -> None:
        if "ranges" not in observation:
            self.measured = np.zeros(len(self.robot.beams), dtype=bool)
            return
        ranges = np.asarray(observation["ranges"], dtype=float)
        if ranges.shape != (len(self.robot.beams),):
            raise ValueError(f"ranges must be {len(self.robot.beams)} numbers, not of shape {ranges.shape}")
        finite = np.isfinite(ranges)
        self.refused_readings += int(np.count_nonzero(~finite))
        self.ranges, self.measured = ranges, finite & self.robot.measures(self._step)

    def _hits(self) -> BoolArray:
        """Readings that show a wall: neither nothing seen, nor too near to be measured."""
        return np.asarray(self.measured & (self.ranges > self.robot.too_near) & (self.ranges < self.robot.too_far))

    def _use(self, scan: Scan) -> None:
        for line in extract_lines(scan.points, self.config.hough, self.config.range_std):
            self._incorporate(line, scan.select(line.members))

    def _incorporate(self, line: ExtractedLine, scan: Scan) -> None:
        fit = line.fit
        observed = ObservedLine(fit.line, fit.covariance, fit.ends, scan.origins, scan.points)
        matches = associate(
            observed, self.pose, self._filter.lines, self.segments, self._filter.innovation,
            self.robot.reach, self.config.association,
        )  # fmt: skip
        if matches:
            landmark = matches[0].landmark
            if self.config.filter.correct:
                self._filter.observe_line(fit.line, fit.covariance, landmark)
            self._map.grow(landmark, self._filter.lines[landmark], transform_points(self.pose, fit.ends))
        elif fit.length < self._min_new_length:
            return
        else:
            landmark = self._filter.augment(fit.line, fit.covariance)
            self._map.add(transform_points(self.pose, fit.ends))
        if self.on_association is not None:
            self.on_association(AssociationRecord(landmark, not matches, scan.readings))
