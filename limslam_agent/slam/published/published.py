"""The published method's estimator: buffers, Hough lines, association, update, loop closing (steps
2 to 7).

After a loop, a wall that is observed again first becomes a new landmark, because the drift of the
pose keeps it from being associated with the old one. Later observations fit the new landmark best,
and the old landmark second best if the two are close enough. If the two landmarks agree, they are
the same wall.
"""

from typing import cast

import numpy as np

from limslam_agent.config.presets import AgentConfig
from limslam_agent.config.published import PublishedConfig
from limslam_agent.slam.core.diagnostics import (
    AssociationRecord,
    Closure,
    Comparison,
    Extraction,
    PendingPoints,
)
from limslam_agent.slam.core.ekf import LineEKF
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.line_fit import ExtractedLine, extract_lines
from limslam_agent.slam.core.motion import Motion
from limslam_agent.slam.published.association import ObservedLine, associate, difference, end_gaps
from limslam_agent.slam.published.line_map import LineMap
from limslam_agent.slam.published.scan_buffer import Scan, ScanBuffer
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import Observation, RobotSpec, Side

SIDES: tuple[Side, Side] = ("left", "right")


class PublishedSlam(Estimator):
    """The published method, which treats lines from points collected by odometry as independent of
    the odometry.
    """

    filter: LineEKF

    def __init__(
        self, robot: RobotSpec, config: AgentConfig, start_pose: FloatArray | None = None
    ) -> None:
        super().__init__(robot, config, start_pose)
        self._begin()

    def step(self, *observations: Observation) -> None:
        """Process one observation of each robot."""
        motions = self._read(observations)
        for number, motion in enumerate(motions):
            self.filter.predict(motion.increment, motion.covariance, number)
        if len(self.robots) > 1:
            self._drop_beams_on_robots()
        for number, motion in enumerate(motions):
            self._measure(number, self.robots[number], motion)

    def _begin(self) -> None:
        self.filter = LineEKF(self._start)
        self._config = config = cast(PublishedConfig, self.config.estimator)
        self._map: LineMap = LineMap(self.filter, config.map)
        self._buffers = [
            {side: ScanBuffer(self.robot, side, config.buffer) for side in SIDES}
            for _ in self.robots
        ]
        association = config.association
        self._min_new_length = max(
            association.min_new_length, association.min_new_share * self.robot.reach
        )
        self._closed: set[tuple[int, int]] = set()

    @property
    def association_limits(self) -> dict[str, float]:
        """The limits that decide about associations and loops, for diagnostics to show beside the
        values.
        """
        near = self._config.association
        loop = self._config.closing
        return {
            "gate": near.gate,
            "angle": near.max_angle,
            "offset": near.max_distance,
            "gap": near.max_end_gap,
            "loop_gate": loop.gate,
            "loop_overlap": loop.min_overlap,
            "loop_offset": loop.max_distance,
        }

    def _measure(self, number: int, front: FrontEnd, motion: Motion) -> None:
        """Add points to the buffers, and use each buffer that is full."""
        for side, buffer in self._buffers[number].items():
            buffer.move(motion.increment, float(motion.covariance[2, 2]))
            for scan in buffer.add(front.ranges, front.measured, front.hits, front.step):
                self._use(number, front.step, side, scan)

    def finish(self) -> None:
        """Use the points that remain in the buffers."""
        for number, front in enumerate(self.robots):
            for side, buffer in self._buffers[number].items():
                self._use(number, front.step, side, buffer.take())

    @property
    def pending_points(self) -> list[PendingPoints]:
        """The points in the buffers, by robot and side."""
        return [
            PendingPoints(
                number, side, transform_points(pose, buffer.scan.points), self._config.buffer.size
            )
            for number, (pose, buffers) in enumerate(zip(self.poses, self._buffers, strict=True))
            for side, buffer in buffers.items()
        ]

    def _use(self, robot: int, step: int, side: Side, scan: Scan) -> None:
        lines = extract_lines(scan.points, self._config.hough, self.config.range_std)
        found = np.array([line.fit.line for line in lines]).reshape(-1, 2)
        ends = np.array([line.fit.ends for line in lines]).reshape(-1, 2, 2)
        self.last_extraction = Extraction(
            robot, side, step, self.filter.poses[robot], scan.points, found, ends
        )
        for line in lines:
            self._incorporate(robot, step, line, scan.select(line.members))

    def _incorporate(self, robot: int, step: int, line: ExtractedLine, scan: Scan) -> None:
        """Associate an observed line with a known landmark or a new one, or close a loop with
        it.
        """
        fit = line.fit
        pose = self.filter.poses[robot]
        covariance = fit.covariance + np.diag(
            [0.0, self._config.filter.drift_share * float(scan.drift.mean())]
        )
        observed = ObservedLine(fit.line, covariance, fit.ends, scan.origins, scan.points)
        tests = associate(
            observed,
            pose,
            self.filter.lines,
            self._map.every,
            lambda line, covariance, index: self.filter.innovation(line, covariance, index, robot),
            self.robot.reach,
            self._config.association,
        )
        if self.on_comparison is not None:
            ends = transform_points(pose, observed.ends)
            self.on_comparison(Comparison(robot, step, ends, scan.readings, tuple(tests)))
        possible = sorted(
            (test for test in tests if not test.excluded), key=lambda test: test.distance
        )
        matches = [test.landmark for test in possible]
        if self._closes_loop(matches, step):
            return
        if matches:
            landmark = matches[0]
            if self._config.filter.correct:
                self.filter.observe_line(fit.line, covariance, landmark, robot)
            pose = self.filter.poses[robot]
            self._map.grow(landmark, transform_points(pose, fit.ends))
        elif fit.length < self._min_new_length:
            return
        else:
            landmark = self.filter.augment(fit.line, covariance, robot)
            self._map.add(transform_points(pose, fit.ends))
        self.report(AssociationRecord(landmark, not matches, scan.readings, robot))

    def _closes_loop(self, landmarks: list[int], step: int) -> bool:
        """Whether the two landmarks nearest to an observation are one wall; then the younger is
        updated by the older.

        The observation is not used further. Each pair is closed only once: the two landmarks are
        not merged, and the older one would otherwise be used as a new measurement again and again.
        """
        # An older landmark has a smaller number.
        config = self._config.closing
        pair = (min(landmarks[:2], default=0), max(landmarks[:2], default=0))
        is_wanted = config.enabled and self._config.filter.correct
        if len(landmarks) < 2 or pair in self._closed or not is_wanted:
            return False
        (older, younger), before = pair, self._distance(*pair)
        angle, offset_before = self._off(older, younger)
        lines = self.filter.lines[[older]]
        segments = self._map.every
        gap = end_gaps(segments[younger].reshape(2, 2), lines, segments[[older]]).item()
        is_near = gap <= -config.min_overlap and offset_before <= config.max_distance
        if before > config.gate or not is_near or angle > config.max_angle:
            return False
        self.filter.observe_landmark(older, younger)
        self._closed.add(pair)
        self._map.redraw()
        offset_after = self._off(older, younger)[1]
        self.closures.append(
            Closure(
                older, younger, step, before, self._distance(*pair), offset_before, offset_after
            )
        )
        return True

    def _off(self, older: int, younger: int) -> tuple[float, float]:
        """The angle between two landmarks, rad, and the distance of the younger one's middle from
        the older one, m.
        """
        lines = self.filter.lines
        ends = self._map.every[younger].reshape(2, 2)
        angles, offsets = difference(lines[younger], ends, lines[[older]])
        return angles.item(), offsets.item()

    def _distance(self, older: int, younger: int) -> float:
        """Squared Mahalanobis distance between two landmarks.

        Without a floor, the difference of two landmarks that were always seen together would be
        known more exactly than any wall is straight.
        """
        floor = np.array([self._config.closing.floor_distance, self._config.closing.floor_angle])
        off, covariance = self.filter.difference(older, younger)
        return float(off @ np.linalg.solve(covariance + np.diag(floor**2), off))
