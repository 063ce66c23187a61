"""The consistent estimator: SLAM with lines in which each range is used once, as a measurement of a cloned pose.

Readings are pending, beside clones of the poses that they were taken from, until the Hough transform finds a line in
them and it is clear which wall the line is. Then each reading updates the filter as one range from one pose.
"""

import copy
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.kernels.tables import MIN_KINK, TURN_SIGMAS
from limslam_agent.slam.consistent import limits
from limslam_agent.slam.consistent.assumed_sensor import AssumedSensor
from limslam_agent.slam.consistent.beam_model import Disagreement, Readings
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.explanation import comparison
from limslam_agent.slam.consistent.map_state import MapState
from limslam_agent.slam.consistent.pending_readings import AHEAD, SIDES, PendingReadings
from limslam_agent.slam.consistent.segmentation import WallSegment, uncontested, wall_segments
from limslam_agent.slam.consistent.wall_map import STRAIGHTNESS, Wall, WallMap, moved_along, shared, squared_difference
from limslam_agent.slam.core.diagnostics import AssociationRecord, Closure, Extraction, PendingPoints
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.core.estimator import Estimator
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_agent.slam.core.hough import extract_lines, max_distance
from limslam_agent.slam.core.line_map import Landmark
from limslam_agent.slam.core.motion import AS_SPECIFIED, Motion, OdometryCalibration
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE, SURE, board_evidence, board_odds, is_wall
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import angle_between, direction
from limslam_env.geometry.segment import sample
from limslam_env.interface import RobotSpec, Side

RENEWAL_ITERATIONS = 3
"""Iterations of each merge when a map is renewed, since that merges all walls of the map at once."""

KNOWN_SPACING = 0.01
"""Distance, m, between the points by which a wall of an earlier map is counted, as if beams had ended there."""

KNOWN_VARIANCES = (0.01**2, math.radians(0.2) ** 2)
"""Variances, m^2 and rad^2, that are added to those of an earlier map's lines, whose correlations are not known."""

_CALIBRATION_GATE = 8.0  # twice the logarithm of the Bayes factor for wheels and axle of other sizes

SHORTEST = 0.1
"""Least length of a wall segment, m, that the error of its direction is based on."""


class _Candidate(NamedTuple):
    """A landmark that readings may show: the fields of ``Disagreement``, and the landmark's index."""

    of_line: float
    left: float
    used: int
    landmark: int


class ConsistentEstimator(Estimator):
    """SLAM in which each reading updates, once, the pose that it was taken from.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage.
    range_std
        Standard deviation of a range, m.
    start
        Start poses of the robots (n, 3), m, m, rad.
    sensor
        How the ranges are measured, if that is known to differ from robot and ``range_std``.
    """

    def __init__(
        self,
        robot: RobotSpec,
        config: ConsistentConfig,
        range_std: float,
        start: FloatArray,
        sensor: RangeSensor | None = None,
    ) -> None:
        calibration, errors = config.self_calibration, config.range_errors
        stds = errors.stds(len(robot.beams) if len(start) == 1 else 0) if errors.enabled else None
        self._filter = CloneEKF(start, None if calibration.calibrate == "never" else calibration.covariance, stds)
        if calibration.calibrate == "always":
            self._filter.calibrate()
        self._config = config
        super().__init__(robot, self._filter)
        specified = RangeSensor(range_std, cone=robot.cone)
        self._sensor = AssumedSensor(specified, float(robot.max_ranges.max()), errors)
        self._assume(sensor or specified)
        self._map = WallMap(self._filter, config.extents)
        self._pending = [PendingReadings(robot, config.pending, config.pending.beams) for _ in start]

    @property
    def association_limits(self) -> dict[str, float]:
        """The limits that decide about associations and loops, for diagnostics to show beside the values."""
        return {
            "gate": self._settings.association.gate, "far_gate": limits.FAR_GATE, "angle": limits.MAX_ANGLE,
            "offset": limits.MAX_OFFSET, "gap": limits.MAX_END_GAP,
            "loop_gate": limits.ONE_WALL_GATE, "loop_overlap": limits.MIN_OVERLAP, "loop_offset": limits.MAX_OFFSET,
        }  # fmt: skip

    def know(self, landmarks: Sequence[Landmark], segments: FloatArray) -> None:
        """Begin with the walls (k, 4), m, of an earlier map, and the landmarks that they lie on."""
        for mark in landmarks:
            if mark.segments:
                points, _ = sample(segments[list(mark.segments)], KNOWN_SPACING)
                spread = mark.covariance + np.diag(KNOWN_VARIANCES)
                index = self._filter.add_known_line(np.array([mark.r, mark.theta]), spread, points.mean(axis=0))
                self._map.add()
                self._map.grow(index, points, POSITIVE, NEGATIVE)
                self._map[index].is_known = True

    def odometry_calibration(self, robot: int) -> tuple[OdometryCalibration, FloatArray] | None:
        """A robot's odometry calibration and its covariance (3, 3); None if its odometry is not corrected."""
        found = self._filter.calibration(robot)
        return (OdometryCalibration(*found[0].tolist()), found[1]) if found else None

    def calibrate(self, found: tuple[OdometryCalibration, FloatArray] | None = None) -> None:
        """Correct the odometry from now on, by the readings so far or by what another drive of the robot has found."""
        self._filter.calibrate()
        if found is not None:
            self._filter.know_calibration(np.array(found[0]), found[1])

    def assumed_calibration(self, robot: int) -> OdometryCalibration | None:
        """The odometry calibration by which a robot's next motion is corrected; None if it is never estimated."""
        if self._filter.calibration_evidence is not None:
            return AS_SPECIFIED
        found = self.odometry_calibration(robot)
        return found and found[0]

    @property
    def sensor(self) -> RangeSensor:
        """How the sensor measures, as specified or as the data require."""
        return self._sensor.sensor

    @property
    def further_turns(self) -> FloatArray:
        """By what beams are turned beyond ``sensor``, with standard deviations (n_beams, 2), rad; empty if unknown."""
        return np.zeros((0, 2)) if self._filter.range_errors is None else self._filter.range_errors.turns

    @property
    def map_state(self) -> MapState:
        """The pose of the robot and the map, without the pending readings. Later steps do not change it."""
        ekf = self._filter
        return MapState(ekf.pose, ekf.anchored, ekf.anchors.copy(), ekf.marginal(), copy.deepcopy(self._map.walls))

    def renew(self, state: MapState, step: int) -> None:
        """Replace the pose of the only robot and the map, and forget the pending readings, which the new map knows.

        Landmarks with the number ``NEW`` get new numbers, and those that are a known wall are merged with it: at first
        those that were recognised, since another wall may be as near to where a landmark seems to be. Landmarks through
        which most beams have passed by now are left out.
        """
        self._map.count_in(state.walls)
        state = state.select([index for index, wall in enumerate(state.walls) if self._map.is_wall(wall)])
        self._filter.restart(state.pose, state.lines, state.anchors, state.covariance)
        new = self._map.replace(state.walls)
        self._merge_recognised(new, step)
        for wall in new:
            self._close_loops_of(wall, step, RENEWAL_ITERATIONS)
        self._pending[0].forget()

    def predict(self, motion: Motion, robot: int) -> None:
        """Predict the pose of a robot that has moved."""
        self._filter.predict(motion.increment, motion.covariance, robot, motion.by_calibration)
        self._pending[robot].move(motion.increment)

    def measure(self, number: int, front: FrontEnd, motion: Motion) -> None:
        """Collect the new readings of a robot, and process each side that has enough of them."""
        del motion
        self._clear_along_beams(number, front)
        pending = self._pending[number]
        if pending.is_due(front):
            pending.collect(front, self._filter.clone(number))
        for side in SIDES:
            has_ended = pending.has_ended(side, limits.WALL_END)
            if pending.fresh[side] >= self._settings.pending.batch or has_ended:
                self._process(number, side, front.step, has_ended=has_ended)
        if (self._filter.calibration_evidence or 0.0) > _CALIBRATION_GATE:
            self.calibrate()
        self._correct_sensor()

    def finish(self, fronts: Sequence[FrontEnd]) -> None:
        """Process all pending readings."""
        for number, front in enumerate(fronts):
            for side in SIDES:
                self._process(number, side, front.step, has_ended=True)

    def pending_points(self, fronts: Sequence[FrontEnd]) -> list[PendingPoints]:
        """End points of the pending readings, by robot and side."""
        del fronts
        batch = self._settings.pending.batch
        return [
            PendingPoints(number, side, self._points(self._readings(pending, side)), batch, pending.fresh[side])
            for number, pending in enumerate(self._pending)
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
        """All landmarks, provisional ones included, by number."""
        return self._map.all_landmarks

    def _assume(self, sensor: RangeSensor) -> None:
        """Take the sensor to measure like this from now on."""
        self._sensor.assume(sensor)
        self._mounted, self._filter.has_turned_beams = sensor.mounted(self.robot), bool(sensor.turns)
        self._std, self._usual_std = sensor.std, self._sensor.usual_std
        self._settings = self._config.for_ranges(self._usual_std)

    def assume(self, sensor: RangeSensor) -> None:
        """Take the sensor to measure like this from now on, and correct the state for what was assumed before."""
        self._filter.correct_ranges(sensor.change_from(self.sensor))
        self._assume(sensor)

    def _correct_sensor(self) -> None:
        """Take the sensor's errors as estimated, if the readings say that they are not as assumed."""
        found = self._sensor.correction(self._filter.range_errors)
        if found is not None:
            self.assume(found)

    def _readings(self, pending: PendingReadings, side: Side) -> Readings:
        """The pending readings of a side, as the sensor takes them."""
        readings, sensor = pending.readings(side), self.sensor
        readings = readings._replace(ranges=readings.ranges - sensor.bias, growth=sensor.growth, cone=sensor.cone)
        return readings._replace(angles=self._mounted.beam_angles[readings.sources[:, 1]])

    def _points(self, readings: Readings, theta: float | None = None) -> FloatArray:
        """Estimated end points of readings in the world (n, 2), m, on a wall with its normal at ``theta``, rad, or any.

        Where the wall is not known, they are on the middle of each beam.
        """
        places = self._filter.places(readings.clones)
        return self._filter.points(places, readings.rows, math.nan if theta is None else theta)

    def _clear_along_beams(self, number: int, front: FrontEnd) -> None:
        """Count the places of landmarks that a robot's new beams have passed through."""
        from limslam_agent.kernels.nearness import aim_beams

        if not len(self._map):
            return
        beams, at, sensor = len(front.ranges), POSE * number, self.sensor
        rays = np.empty((beams, 2)), np.empty((beams, 2)), np.empty(beams), np.empty(beams)
        x, y, heading = self._filter.P.diagonal()[at : at + POSE].tolist()
        pose, variances = self._filter.x[at : at + POSE], (sensor.std**2, float(sensor.growth), x + y, heading)
        count = aim_beams(pose, front.ranges, front.measured, self._mounted.beam_table, variances, *rays)
        origins, towards, ranges, stds = (each[:count] for each in rays)
        self._map.clear_along_beams(origins, towards, ranges, stds)

    def _process(self, number: int, side: Side, step: int, *, has_ended: bool) -> None:
        """Find wall segments in the pending readings of a side, use them, and drop what is consumed or too old."""
        pending, settings = self._pending[number], self._settings
        pending.fresh[side] = 0
        readings = self._readings(pending, side)
        points = self._points(readings)
        # Beams ahead meet a wall at points far apart, with nothing in between.
        hough = replace(settings.hough, max_gap=limits.GAP_AHEAD) if side == SIDES[AHEAD] else settings.hough
        lines = extract_lines(points, hough, self._usual_std)
        fits = tuple(line.fit for line in lines)
        self.last_extraction = Extraction(
            number, side, step, self._filter.poses[number], points, fits, is_in_world=True
        )  # fmt: skip
        consumed = np.zeros(len(points), dtype=bool)
        driven = np.array([reading.driven for reading in pending.by_side[side]])
        for line, members in uncontested(points, lines, max_distance(settings.hough, self._usual_std)):
            for segment in wall_segments(readings, members, line, self._filter, self._std):
                since = pending.driven - driven[segment.members].max()
                is_complete = has_ended or since > limits.COMPLETE_AFTER
                own = readings.select(segment.members)
                consumed[segment.members] = self._incorporate(number, step, own, segment, is_complete=is_complete)
        oldest = math.inf if has_ended else pending.driven - settings.pending.max_age
        pending.by_side[side] = [
            reading
            for reading, is_consumed in zip(pending.by_side[side], consumed.tolist(), strict=True)
            if not is_consumed and reading.driven >= oldest
        ]
        self._prune()

    def _prune(self) -> None:
        """Marginalise clones without pending readings, and the oldest clones if there are too many."""
        everything = [each for pending in self._pending for each in pending.by_side.values()]
        wanted = sorted({reading.clone for each in everything for reading in each})
        if len(wanted) > self._settings.pending.max_clones:
            oldest = wanted[-self._settings.pending.max_clones]
            for pending in self._pending:
                for side, each in pending.by_side.items():
                    pending.by_side[side] = [reading for reading in each if reading.clone >= oldest]
            wanted = [clone for clone in wanted if clone >= oldest]
        self._filter.keep_clones(set(wanted))

    def _incorporate(
        self, robot: int, step: int, readings: Readings, segment: WallSegment, *, is_complete: bool
    ) -> bool:
        """Associate a wall segment with a known landmark, or add a new one; whether the readings are consumed."""
        usual_gate = self._settings.association.gate
        candidates = self._candidates(readings, segment)
        while len(candidates) > 1 and candidates[1].of_line <= usual_gate:
            if not self._closes_loop(candidates[0].landmark, candidates[1].landmark, step):
                break
            candidates = self._candidates(readings, segment)
        best, second = ([candidate.of_line for candidate in candidates] + [math.inf, math.inf])[:2]
        is_sure = self._is_sure(segment)
        # A filter that is more wrong than it states refuses the right walls, unless nothing else can be meant.
        gate = limits.FAR_GATE if is_sure and second >= limits.FAR_GATE else usual_gate
        if self.on_comparison is not None:
            known = {each.landmark: each.of_line for each in candidates}
            other_side = {index for index, _ in self._comparable(readings, segment)} - known.keys()
            self.on_comparison(
                comparison(robot, step, readings, segment, known, other_side, self._filter, self._map, gate)
            )
        if best <= gate:
            return self._observe(robot, step, readings, segment, candidates[0])
        least = limits.LENGTH_IF_COMPLETE if is_complete else self._settings.creation.min_length
        if best < limits.FAR_GATE or segment.length < least or not is_sure:
            return False
        self._add(robot, step, readings, segment)
        return True

    def _candidates(self, readings: Readings, segment: WallSegment) -> list[_Candidate]:
        """Landmarks that a wall segment may show, best first.

        A landmark that was only seen from the other side is one of them if it is a board, and not the other face.
        """
        return sorted(
            _Candidate(known.of_line, known.left, known.used, index)
            for index, known in self._comparable(readings, segment)
            if self._may_show(index, readings, segment, known)
        )

    def _comparable(self, readings: Readings, segment: WallSegment) -> Iterator[tuple[int, Disagreement]]:
        """Landmarks near a wall segment that its readings can be compared with, seen from whichever side."""
        loose = 2.0 * math.atan2(2.0 * self._usual_std, max(segment.length, SHORTEST))
        for index in self._near(segment.theta, segment.middle, limits.MAX_ANGLE + loose, limits.MAX_OFFSET):
            along, (low, high) = self._map.along(index, segment.points), self._map[index].extent.ends
            if max(along.min() - high, low - along.max()) > limits.MAX_END_GAP:
                continue
            disagreement = self._filter.disagreement(readings, index, self._std)
            if disagreement is not None:
                yield index, disagreement

    def _may_show(self, index: int, readings: Readings, segment: WallSegment, known: Disagreement) -> bool:
        """Whether a landmark was seen from the side of readings near them, or it is a board."""
        side, along = self._filter.side(readings, index), self._map.along(index, segment.points)
        slack, seen = limits.END_SLACK, self._map[index].seen
        is_inside = (along[:, None] > seen[:, 0] - slack) & (along[:, None] < seen[:, 1] + slack)
        own, other = is_inside.mean(axis=0)[[side, 1 - side]]
        gap = max(along.min() - seen[side, 1], seen[side, 0] - along.max())
        if own >= 0.5 or (other < 0.5 and gap <= limits.MAX_END_GAP):
            return True
        return self._is_board(1 - side, known.offset, known.variance)[0]

    def _is_board(self, side: int, offset: float, variance: float) -> tuple[bool, bool]:
        """Whether a line that is seen from one side, and a line seen from the other side, are a board; or a wall.

        Parameters
        ----------
        side
            The side from which the line is seen.
        offset, variance
            How far along the line's normal the other line is, m, if the two are parallel, and the variance, m^2.
        """
        behind = -offset if side == POSITIVE else offset
        evidence = board_evidence(behind, variance + STRAIGHTNESS[0])
        return board_odds(evidence, *self._map.kinds) > SURE, is_wall(evidence, behind)

    def _near(self, theta: float, point: FloatArray, angle: float, offset: float) -> list[int]:
        """Landmarks with a direction within ``angle``, rad, that pass a point (2,) at less than ``offset``, m."""
        from limslam_agent.kernels.nearness import lines_near

        found, place = np.empty(len(self._map), dtype=np.int64), (float(point[0]), float(point[1]))
        count = lines_near(
            self._filter.anchored, self._filter.anchors, float(theta), place, float(angle), float(offset), found
        )
        near: list[int] = found[:count].tolist()
        return near

    def _observe(self, robot: int, step: int, readings: Readings, segment: WallSegment, known: _Candidate) -> bool:
        """Update by a wall segment of a known landmark, if it fits; whether it did."""
        fits = self._fits(segment, known)
        if fits:
            self._sensor.count(segment)
            self._update(robot, step, readings, self._map[known.landmark], limits.ITERATIONS)
        return fits

    def _fits(self, segment: WallSegment, known: _Candidate) -> bool:
        """Whether a wall segment of a known landmark is good enough to update by."""
        free = max(known.used - 2, 1)
        most = free + limits.RESIDUAL_SIGMAS * math.sqrt(2.0 * free) + 2.0
        # A filter that is unsure of its heading would take the next facet of a curved wall for this one, and turn.
        turn = abs(angle_between(float(self._filter.anchored[known.landmark, 1]) - segment.theta))
        largest = max(MIN_KINK, TURN_SIGMAS * segment.angle_std)
        if known.left > most or segment.length < limits.LEAST_LENGTH or turn > largest:
            return False
        along, (low, high) = self._map.along(known.landmark, segment.points), self._map[known.landmark].extent.ends
        is_inside = np.mean((along > low - limits.END_SLACK) & (along < high + limits.END_SLACK)) >= 0.5
        is_clear = (
            segment.length >= limits.BEYOND_LENGTH
            and known.of_line <= limits.BEYOND_GATE
            and segment.angle_std <= limits.BEYOND_ANGLE_STD
        )
        return bool(is_inside or is_clear)

    def _is_sure(self, segment: WallSegment) -> bool:
        """Whether a segment is good enough for a new landmark, but for its length."""
        is_enough = len(segment.members) >= self._settings.creation.readings_per_std * self._usual_std
        return bool(is_enough and segment.angle_std <= limits.MAX_ANGLE_STD)

    def _add(self, robot: int, step: int, readings: Readings, segment: WallSegment) -> None:
        self._sensor.count(segment)
        self._filter.add_line(segment.theta, segment.middle)
        self._update(robot, step, readings, self._map.add(), limits.FIRST_ITERATIONS)

    def _update(self, robot: int, step: int, readings: Readings, wall: Wall, iterations: int) -> None:
        """Update filter and map by readings of a landmark, and merge it with others that are the same wall."""
        index, is_new = self._map.walls.index(wall), not wall.groups
        self._filter.observe(readings, index, self._std, iterations, limits.HUBER)
        points = self._points(readings, float(self._filter.anchored[index, 1]))
        self._map.grow(index, points, self._filter.side(readings, index))
        self.report(AssociationRecord(wall.number, is_new, readings.sources, robot))
        self._close_loops_of(wall, step)

    def _close_loops_of(self, wall: Wall, step: int, iterations: int = 1) -> None:
        """Merge a landmark that has just changed with all landmarks that are the same wall."""
        found = True
        while found and wall in self._map.walls:
            index = self._map.walls.index(wall)
            theta, anchor = float(self._filter.anchored[index, 1]), self._filter.anchors[index]
            near = self._near(theta, anchor, limits.MAX_ANGLE, 2.0 * limits.MAX_OFFSET)
            found = any(self._closes_loop(other, index, step, iterations) for other in near if other != index)

    def _closes_loop(self, first: int, second: int, step: int, iterations: int = 1) -> bool:
        """Whether two landmarks are one wall; then they are merged, and the younger one is removed."""
        older, younger = sorted((first, second))
        ends = self._map.ends(younger)
        places, (low, high) = np.sort(self._map.along(older, ends)), self._map[older].extent.ends
        overlap = min(places[1], high) - max(places[0], low)
        if not self._settings.merging.enabled or overlap < limits.MIN_OVERLAP:
            return False
        off, covariance = self._filter.difference(older, younger)
        if abs(off[1]) > limits.MAX_ANGLE or self._map.offset(older, younger) > limits.MAX_OFFSET:
            return False
        squared = squared_difference(off, covariance)
        if not self._is_one_line(older, younger, off, covariance) or squared > limits.ONE_WALL_GATE:
            return False
        self._merge(older, younger, step, squared, iterations)
        return True

    def _merge_recognised(self, walls: Sequence[Wall], step: int) -> None:
        """Merge new landmarks with the known ones that they were recognised as, as far as all of them agree."""
        places = {wall.number: place for place, wall in enumerate(self._map.walls)}
        recognised = [wall for wall in walls if self._settings.merging.enabled and wall.known_as in places]
        pairs = [(places[wall.known_as], places[wall.number]) for wall in recognised]
        for number in self._map.agreeing(pairs, limits.ONE_WALL_GATE):
            older, younger = pairs[number][0], self._map.walls.index(recognised[number])
            squared = squared_difference(*self._filter.difference(older, younger))
            self._merge(older, younger, step, squared, RENEWAL_ITERATIONS)

    def _merge(self, older: int, younger: int, step: int, squared: float, iterations: int) -> None:
        """Merge two landmarks, and remove the younger one."""
        offset = self._map.offset(older, younger)
        numbers = self._map[older].number, self._map[younger].number
        origin, tangent = self._filter.anchors[younger].copy(), direction(self._filter.anchored[younger])
        self._filter.merge(older, younger, iterations)
        self._map.merge(older, younger, origin, tangent)
        self.closures.append(Closure(*numbers, step, squared, 0.0, offset, 0.0))

    def _is_one_line(self, older: int, younger: int, off: FloatArray, covariance: FloatArray) -> bool:
        """Whether two landmarks share a stretch that is seen from one side, or are a board.

        Their difference (2,) has a covariance (2, 2). It is noted if they are the two faces of a wall.
        """
        wall, other, lines = self._map[older], self._map[younger], self._filter.anchored
        factor = 1.0 if math.cos(lines[older, 1] - lines[younger, 1]) > 0.0 else -1.0
        seen = moved_along(wall.seen, factor, float(self._map.along(younger, self._filter.anchors[older])))
        own, opposite = shared(seen, other.seen).max(), shared(seen[::-1], other.seen)
        if own >= min(limits.MIN_OVERLAP, opposite.max()):
            return True
        # The difference of two parallel lines is their offset alone, given that their directions are equal.
        share = covariance[0, 1] / covariance[1, 1]
        offset, variance = float(off[0] - share * off[1]), float(covariance[0, 0] - share * covariance[0, 1])
        is_board, is_face = self._is_board(int(opposite.argmax()), offset, variance)
        if is_face:
            wall.behind, other.behind = max(wall.behind, opposite.max()), max(other.behind, opposite.max())
        return is_board
