"""Sections 2.4 and 2.5: the step of the published method, and its loop closing."""

import math
from typing import cast

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.config.published import PublishedConfig
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure, PendingPoints
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.line_comparison import apart
from limslam_agent.slam.core.line_map import EndPoints
from limslam_agent.slam.published.association import Associate, Landmarks, PaperAssociation
from limslam_agent.slam.published.features import Scan, ScanBuffer, observed_lines
from limslam_agent.slam.published.filter import LineFilter
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import Observation, RobotSpec, Side


class PublishedSlam(Estimator):
    """The method of the paper, with its association by default: see ``LineSlam``."""

    filter: LineFilter
    _map: EndPoints

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig,
        start_pose: FloatArray | None = None,
        associate: Associate | None = None,
    ) -> None:
        super().__init__(robot, config, start_pose)
        self._config = settings = cast(PublishedConfig, config.estimator)
        self.filter = LineFilter(self._start)
        self._map = EndPoints(self.filter, settings.map)
        sides: tuple[Side, Side] = ("left", "right")
        self._buffers = [
            {side: ScanBuffer(robot, side, settings.buffer) for side in sides} for _ in self.robots
        ]
        self._associate = associate or PaperAssociation(settings.association, robot.reach)
        self._least_length = settings.association.least_new_length(robot.reach)
        self._closed: set[tuple[int, int]] = set()

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot: see the base class."""
        motions = self._read(observations)
        for robot, motion in enumerate(motions):  # 2.4, action update
            self.filter.move(motion, robot)
        self._drop_beams_on_robots()  # 3.2, discern other robots from obstacles
        for robot, motion in enumerate(motions):
            for side, buffer in self._buffers[robot].items():  # 2.2, two buffers
                buffer.move(motion)
                for scan in buffer.add(self.robots[robot]):
                    self._use(robot, side, scan)

    def finish(self) -> None:
        """Use the points that remain in the buffers."""
        for robot, buffers in enumerate(self._buffers):
            for side, buffer in buffers.items():
                self._use(robot, side, buffer.take())

    def _use(self, robot: int, side: Side, scan: Scan) -> None:
        """Correct pose and map by the lines in the points of a buffer."""
        lines = observed_lines(scan, self._config, self.config.range_std)  # 2.2, Hough transform
        self._note_extraction(robot, side, scan.points, lines)
        for seen in lines:
            pose = self.filter.poses[robot]
            known = Landmarks(self.filter.lines, self._map.every)
            match = self._associate(  # 2.4, eq. 4
                seen, pose, known, lambda seen, index: self.filter.innovation(seen, index, robot)
            )
            ends = transform_points(pose, seen.ends)
            self._note_comparison(robot, ends, seen.scan.readings, match.tests)
            if self._closes_loop(match.landmarks):  # 2.5: the observation is discarded
                continue
            if match.landmarks:  # 2.4: a correction of pose and landmarks by the nearest one
                landmark = match.landmarks[0]
                if self._config.filter.correct:
                    self.filter.observe(seen, landmark, robot)
                self._map.grow(landmark, transform_points(self.filter.poses[robot], seen.ends))
            elif math.dist(*seen.ends) >= self._least_length:  # 2.4: a new landmark
                landmark = self.filter.augment(seen, robot)
                self._map.add(ends)
            else:
                continue
            self.report(AssociationRecord(landmark, not match.landmarks, seen.scan.readings, robot))

    def _closes_loop(self, landmarks: tuple[int, ...]) -> bool:
        """Whether the two landmarks nearest to an observation are one wall; then the younger is
        corrected by the older. They are not merged, so each pair is used once.
        """
        config = self._config.closing
        # An older landmark has a smaller index.
        pair = (min(landmarks[:2], default=0), max(landmarks[:2], default=0))
        is_wanted = config.enabled and self._config.filter.correct
        if len(landmarks) < 2 or pair in self._closed or not is_wanted:
            return False
        distance, angle, offset, gap = self._apart(*pair)
        is_near = offset <= config.max_distance and angle <= config.max_angle
        if distance > config.gate or gap > -config.min_overlap or not is_near:
            return False
        self.filter.observe_landmark(*pair)
        self._closed.add(pair)
        self._map.redraw()
        distance_after, _, offset_after, _ = self._apart(*pair)
        step = self.robots[0].step
        self.closures.append(Closure(*pair, step, distance, distance_after, offset, offset_after))
        return True

    def _apart(self, older: int, younger: int) -> tuple[float, float, float, float]:
        """Squared Mahalanobis distance of two landmarks, angle, rad, offset and gap, m."""
        y, covariance = self.filter.difference(older, younger)
        squared = float(y @ np.linalg.solve(covariance + self._config.closing.floor, y))
        lines = self.filter.lines
        walls = self._map.every
        ends = walls[younger].reshape(2, 2)
        angles, offsets, gaps = apart(lines[younger], ends, lines[[older]], walls[[older]])
        return squared, angles.item(), offsets.item(), gaps.item()

    @property
    def pending_points(self) -> list[PendingPoints]:
        """The points in the buffers, by robot and side."""
        size = self._config.buffer.size
        return [
            PendingPoints(robot, side, transform_points(pose, buffer.scan.points), size)
            for robot, pose in enumerate(self.poses)
            for side, buffer in self._buffers[robot].items()
        ]

    @property
    def association_limits(self) -> dict[str, float]:
        """The limits that decide about associations and loops."""
        return self._config.limits
