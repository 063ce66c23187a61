"""The consistent estimator: the published stages, with nothing counted twice.

Readings wait beside clones of the poses that they were taken from until Hough's transform finds a line in them and it
is clear which wall that is. Then each of them corrects the filter as what it is, one range from one pose.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.slam.consistent.beam_model import Readings, hit_points
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.pending_readings import SIDES, Track
from limslam_agent.slam.consistent.segmentation import Piece, straight_pieces
from limslam_agent.slam.consistent.wall_map import Wall, WallMap
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure, Extraction, Waiting
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.hough import ExtractedLine, extract_lines
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import Factors, Motion
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import direction, distance, normal, to_frame
from limslam_env.geometry.se2 import inverse, transform_points
from limslam_env.interface import RobotSpec, Side

_FEWEST = 6
_BESIDE_CORNER = 0.15  # m

# Two landmarks that were seen together all the time are known to differ more exactly than any wall is straight.
_STRAIGHTNESS = np.array([1e-3, 1e-4]) ** 2


class _Candidate(NamedTuple):
    """A landmark that readings may be of: how badly they fit it, how many could tell, and its index."""

    of_line: float
    left: float
    used: int
    landmark: int


class ConsistentEstimator(Estimator):
    """Each reading corrects, once, the pose that it was taken from.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage.
    range_std
        Standard deviation of a range that is assumed, m.
    start
        Where the robots begin (n, 3), m, m, rad.
    """

    def __init__(self, robot: RobotSpec, config: ConsistentConfig, range_std: float, start: FloatArray) -> None:
        calibration, self._std = config.self_calibration, range_std
        self._filter = CloneEKF(start, calibration.covariance if calibration.enabled else None)
        self._settings = config.for_ranges(self._std)
        super().__init__(robot, self._filter)
        self._map = WallMap(self._filter, config.extents)
        self._tracks = [Track(robot, config.pending, config.pending.beams) for _ in start]

    def factors(self, robot: int) -> tuple[Factors, FloatArray] | None:
        """What a robot's odometry is wrong by, and the covariance (3, 3); None where that is not estimated."""
        found = self._filter.factors(robot)
        return (Factors(*found[0].tolist()), found[1]) if found else None

    def predict(self, motion: Motion, robot: int) -> None:
        """A robot has moved."""
        self._filter.predict(motion.increment, motion.covariance, robot, motion.by_factors)
        self._tracks[robot].move(motion.increment)

    def measure(self, number: int, front: FrontEnd, motion: Motion) -> None:
        """Let the new readings wait with those before them, and use a side when there are enough."""
        del motion
        self._see_through(number, front)
        track = self._tracks[number]
        if track.wants(front):
            track.collect(front, self._filter.clone(number))
        for side in SIDES:
            has_ended = track.has_ended(side, self._settings.pending.wall_end)
            if track.fresh[side] >= self._settings.pending.batch or has_ended:
                self._use(number, side, front.step, has_ended=has_ended)

    def finish(self, fronts: Sequence[FrontEnd]) -> None:
        """Use the readings that still wait."""
        for number, front in enumerate(fronts):
            for side in SIDES:
                self._use(number, side, front.step, has_ended=True)

    def waiting(self, fronts: Sequence[FrontEnd]) -> list[Waiting]:
        """The readings that wait, where they are believed to have ended."""
        del fronts
        return [
            Waiting(number, side, self._points(track.readings(side)), self._settings.pending.batch)
            for number, track in enumerate(self._tracks)
            for side in SIDES
        ]

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m, in the world."""
        return self._map.segments

    @property
    def landmarks(self) -> list[Landmark]:
        """The landmarks that are walls of the map."""
        return self._map.landmarks

    @property
    def all_landmarks(self) -> list[Landmark]:
        """The same, and those that are provisional, by number."""
        return self._map.all_landmarks

    def _points(self, readings: Readings) -> FloatArray:
        """Where readings are believed to have ended (n, 2), m."""
        return hit_points(self._filter.clone_poses(readings.clones), readings)

    def _see_through(self, number: int, front: FrontEnd) -> None:
        beams = np.nonzero(front.measured & (front.ranges > self.robot.too_near))[0]
        pose = self._filter.poses[number]
        variance = np.diag(self._filter.joint_pose_covariance)[3 * number : 3 * number + 3]
        ranges = np.minimum(front.ranges[beams], self.robot.max_ranges[beams])
        headings = pose[2] + self.robot.beam_angles[beams]
        self._map.see_through(
            transform_points(pose, self.robot.beam_origins[beams]),
            np.column_stack((np.cos(headings), np.sin(headings))),
            ranges,
            np.sqrt(self._std**2 + variance[:2].sum() + variance[2] * ranges**2),
        )

    def _use(self, number: int, side: Side, step: int, *, has_ended: bool) -> None:
        """Find lines in what waits, and let go of what is dealt with, or too old."""
        track, settings = self._tracks[number], self._settings
        waiting, track.fresh[side] = track.waiting[side], 0
        readings = track.readings(side)
        points = self._points(readings)
        # Beams ahead meet a wall far apart, with nothing between them.
        hough = replace(settings.hough, max_gap=settings.segmentation.gap_ahead) if side == "none" else settings.hough
        lines = extract_lines(points, hough, self._std)
        self._show(number, side, step, points, lines)
        dealt_with = np.zeros(len(waiting), dtype=bool)
        driven = np.array([reading.driven for reading in waiting])
        for line, members in self._uncontested(points, lines):
            for piece in straight_pieces(readings, members, line, self._filter, self._std, settings.segmentation):
                is_complete = has_ended or track.driven - driven[piece.members].max() > settings.pending.complete_after
                own = readings.select(piece.members)
                dealt_with[piece.members] = self._incorporate(number, step, own, piece, is_complete=is_complete)
        oldest = math.inf if has_ended else track.driven - settings.pending.max_age
        track.waiting[side] = [
            reading
            for reading, is_done in zip(waiting, dealt_with.tolist(), strict=True)
            if not is_done and reading.driven >= oldest
        ]
        self._let_go()

    def _let_go(self) -> None:
        """Keep only the clones that readings wait for, and not too many."""
        everything = [each for track in self._tracks for each in track.waiting.values()]
        wanted = sorted({reading.clone for each in everything for reading in each})
        if len(wanted) > self._settings.pending.max_clones:
            oldest = wanted[-self._settings.pending.max_clones]
            for track in self._tracks:
                for side, each in track.waiting.items():
                    track.waiting[side] = [reading for reading in each if reading.clone >= oldest]
            wanted = [clone for clone in wanted if clone >= oldest]
        self._filter.keep_clones(set(wanted))

    def _uncontested(self, points: FloatArray, lines: list[ExtractedLine]) -> list[tuple[FloatArray, IntArray]]:
        """The lines and the readings on each, without those near a corner that could as well be another's."""
        near, result = max(self._settings.hough.max_offset, 2.5 * self._std), []
        for line in lines:
            members = np.sort(line.members)
            for other in lines:
                if other is line:
                    continue
                places = np.sort(other.fit.ends @ direction(other.fit.line))
                along = points[members] @ direction(other.fit.line)
                beside = (along > places[0] - _BESIDE_CORNER) & (along < places[1] + _BESIDE_CORNER)
                members = members[~(beside & (np.abs(distance(other.fit.line, points[members])) < near))]
            if len(members) >= _FEWEST:
                result.append((line.fit.line, members))
        return result

    def _incorporate(self, robot: int, step: int, readings: Readings, piece: Piece, *, is_complete: bool) -> bool:
        """Take a piece of wall for a landmark that is known, or for a new one; whether it has been dealt with."""
        settings, creation = self._settings.association, self._settings.creation
        candidates = self._candidates(readings, piece)
        while len(candidates) > 1 and candidates[1].of_line <= settings.gate:
            if not self._closes_loop(candidates[0].landmark, candidates[1].landmark, step):
                break
            candidates = self._candidates(readings, piece)
        best, second = ([candidate.of_line for candidate in candidates] + [math.inf, math.inf])[:2]
        if second <= settings.gate and second - best < settings.ambiguity:
            return True
        if best <= settings.gate:
            return self._observe(robot, step, readings, piece, candidates[0])
        least = creation.min_length_complete if is_complete else creation.min_length
        is_enough = len(piece.members) >= creation.readings_per_std * self._std
        is_sure = is_enough and piece.angle_std <= creation.max_angle_std
        if best < settings.far_gate or piece.length < least or not is_sure:
            return False
        self._add(robot, step, readings, piece)
        return True

    def _candidates(self, readings: Readings, piece: Piece) -> list[_Candidate]:
        """Landmarks that a piece of wall may be of, best first."""
        settings = self._settings.association
        loose = 2.0 * math.atan2(2.0 * self._std, max(piece.length, 0.1))
        found = []
        for index in self._near(piece.theta, piece.middle, settings.max_angle + loose, settings.max_offset):
            along, (low, high) = self._map.along(index, piece.points), self._map[index].extent.ends
            if max(along.min() - high, low - along.max()) > settings.max_end_gap:
                continue
            disagreement = self._filter.disagreement(readings, index, self._std)
            if disagreement is not None:
                found.append(_Candidate(*disagreement, index))
        return sorted(found)

    def _near(self, theta: float, point: FloatArray, angle: float, offset: float) -> list[int]:
        """Landmarks whose direction differs by no more than ``angle`` (rad) and that pass a point (2,) within (m)."""
        lines = self._filter.anchored
        turn = np.abs((lines[:, 1] - theta + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
        off = np.abs(np.sum((point - self._filter.anchors) * normal(lines), axis=1) - lines[:, 0])
        return [int(index) for index in np.nonzero((turn < angle) & (off < offset))[0]]

    def _observe(self, robot: int, step: int, readings: Readings, piece: Piece, known: _Candidate) -> bool:
        """Correct the filter by a piece of a known landmark, if it is good enough for that; whether it was."""
        settings, wall = self._settings.update, self._map[known.landmark]
        free = max(known.used - 2, 1)
        if (
            known.left > free + settings.residual_sigmas * math.sqrt(2.0 * free) + 2.0
            or piece.length < settings.min_length
        ):
            return False
        along, (low, high) = self._map.along(known.landmark, piece.points), wall.extent.ends
        is_inside = np.mean((along > low - settings.end_slack) & (along < high + settings.end_slack)) >= 0.5
        is_clear = (
            piece.length >= settings.beyond_length
            and known.of_line <= settings.beyond_gate
            and piece.angle_std <= settings.beyond_angle_std
        )
        if is_inside or is_clear:
            self._update(robot, step, readings, wall, settings.iterations)
        return bool(is_inside or is_clear)

    def _add(self, robot: int, step: int, readings: Readings, piece: Piece) -> None:
        self._filter.add_line(piece.theta, piece.middle)
        self._update(robot, step, readings, self._map.add(), self._settings.creation.iterations)

    def _update(self, robot: int, step: int, readings: Readings, wall: Wall, iterations: int) -> None:
        index, is_new = self._map.walls.index(wall), not wall.groups
        self._filter.observe(readings, index, self._std, iterations, self._settings.update.huber)
        self._map.grow(index, self._points(readings))
        if self.on_association is not None:
            self.on_association(AssociationRecord(wall.number, is_new, readings.sources, robot))
        self._close_loops_of(wall, step)

    def _close_loops_of(self, wall: Wall, step: int) -> None:
        """Look for landmarks that are the same wall as one that has just changed, until there is none."""
        found, limits = True, self._settings.association
        while found and wall in self._map.walls:
            index = self._map.walls.index(wall)
            theta, anchor = float(self._filter.anchored[index, 1]), self._filter.anchors[index]
            near = self._near(theta, anchor, limits.max_angle, 2.0 * limits.max_offset)
            found = any(self._closes_loop(other, index, step) for other in near if other != index)

    def _closes_loop(self, first: int, second: int, step: int) -> bool:
        """Whether two landmarks are one wall; then they are made one, and the younger is no more."""
        settings, (older, younger) = self._settings.merging, sorted((first, second))
        ends = self._map.ends(younger)
        places, (low, high) = np.sort(self._map.along(older, ends)), self._map[older].extent.ends
        overlap = min(places[1], high) - max(places[0], low)
        if not settings.enabled or overlap < settings.min_overlap:
            return False
        offset = abs(float(distance(self._filter.anchored[older], ends - self._filter.anchors[older]).mean()))
        off, covariance = self._filter.difference(older, younger)
        squared = float(off @ np.linalg.solve(covariance + np.diag(_STRAIGHTNESS), off))
        limits = self._settings.association
        if squared > settings.gate or abs(off[1]) > limits.max_angle or offset > limits.max_offset:
            return False
        numbers = self._map[older].number, self._map[younger].number
        origin, tangent = self._filter.anchors[younger].copy(), direction(self._filter.anchored[younger])
        self._filter.unite(older, younger)
        self._map.unite(older, younger, origin, tangent)
        self.closures.append(Closure(*numbers, step, squared, 0.0, offset, 0.0))
        return True

    def _show(self, number: int, side: Side, step: int, points: FloatArray, lines: list[ExtractedLine]) -> None:
        """Note down what was found, in the robot's frame, for those who watch."""
        pose = self._filter.poses[number]
        back = inverse(pose)
        found = np.array([line.fit.line for line in lines]).reshape(-1, 2)
        ends = np.array([transform_points(back, line.fit.ends) for line in lines]).reshape(-1, 2, 2)
        self.last_extraction = Extraction(
            number, side, step, pose, transform_points(back, points), to_frame(found, pose), ends
        )  # fmt: skip
