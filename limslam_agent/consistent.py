"""The consistent estimator: the published stages, with nothing counted twice.

Readings wait beside clones of the poses that they were taken from until Hough's transform finds a line in them and it
is clear which wall that is. Then each of them corrects the filter as what it is, one range from one pose.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from limslam_agent.beam_model import Readings, expected_ranges, hit_points
from limslam_agent.clone_ekf import GRAZING, CloneEKF
from limslam_agent.config import AgentConfig
from limslam_agent.estimator import Estimator
from limslam_agent.front_end import FrontEnd
from limslam_agent.hough import ExtractedLine, extract_lines
from limslam_agent.line_map import Landmark
from limslam_agent.loop_closing import Closure
from limslam_agent.motion import Motion
from limslam_agent.records import AssociationRecord, Extraction, Waiting
from limslam_agent.straight import Piece, straight_pieces
from limslam_agent.wall_extent import WallExtent
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import at, direction, distance
from limslam_env.geometry.se2 import inverse, transform_points
from limslam_env.interface import RobotSpec, Side

_SIDES: tuple[Side, ...] = ("left", "right", "none")
_NOISY = 0.01
_FEWEST = 6
_BESIDE_CORNER = 0.15


class _Reading(NamedTuple):
    """One reading that waits: its clone, step, beam, range (m), and how far the robot had driven (m)."""

    clone: int
    step: int
    beam: int
    range: float
    driven: float


@dataclass(eq=False)
class _Wall:
    """What is known of a landmark besides its line."""

    number: int
    extent: WallExtent = field(default_factory=WallExtent)
    groups: int = 0
    readings: int = 0


@dataclass(eq=False)
class _Track:
    """How far a robot has come, and what of each of its sides waits."""

    driven: float = 0.0
    turned: float = 0.0
    cloned_at: tuple[float, float] = (-math.inf, -math.inf)
    waiting: dict[Side, list[_Reading]] = field(default_factory=lambda: {side: [] for side in _SIDES})
    fresh: dict[Side, int] = field(default_factory=lambda: dict.fromkeys(_SIDES, 0))
    last_hit: dict[Side, float] = field(default_factory=lambda: dict.fromkeys(_SIDES, 0.0))


class _Candidate(NamedTuple):
    """A landmark that readings may be of: how badly they fit it, and its index."""

    of_line: float
    left: float
    count: int
    index: int


class ConsistentEstimator(Estimator):
    """Each reading corrects, once, the pose that it was taken from.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage.
    start
        Where the robots begin (n, 3), m, m, rad.
    """

    def __init__(self, robot: RobotSpec, config: AgentConfig, start: FloatArray) -> None:
        belief = CloneEKF(start)
        super().__init__(robot, config, belief)
        self._filter, self._settings = belief, config.clones
        self._walls: list[_Wall] = []
        self._numbers = 0
        self._tracks = [_Track() for _ in start]
        self._sides = _beams_by_side(robot, config.clones.beams)
        is_noisy = config.range_std >= _NOISY
        self._new_length = config.clones.new_length_noisy if is_noisy else config.clones.new_length
        self._drawn: list[FloatArray] | None = None

    def predict(self, motion: Motion, robot: int) -> None:
        """A robot has moved."""
        super().predict(motion, robot)
        self._tracks[robot].driven += math.hypot(float(motion.increment[0]), float(motion.increment[1]))
        self._tracks[robot].turned += abs(float(motion.increment[2]))

    def measure(self, number: int, front: FrontEnd, motion: Motion) -> None:
        """Let the new readings wait with those before them, and use a side when there are enough."""
        del motion
        self._see_through(number, front)
        self._collect(number, front)
        track = self._tracks[number]
        for side in _SIDES:
            has_ended = bool(track.waiting[side]) and track.driven - track.last_hit[side] > self._settings.wall_end
            if track.fresh[side] >= self._settings.batch or has_ended:
                self._use(number, side, front.step, has_ended=has_ended)

    def finish(self, fronts: Sequence[FrontEnd]) -> None:
        """Use the readings that still wait."""
        for number, front in enumerate(fronts):
            for side in _SIDES:
                self._use(number, side, front.step, has_ended=True)

    def waiting(self, fronts: Sequence[FrontEnd]) -> list[Waiting]:
        """The readings that wait, where they are believed to have ended."""
        del fronts
        return [
            Waiting(number, side, self._readings(readings)[1], self._settings.batch)
            for number, track in enumerate(self._tracks)
            for side, readings in track.waiting.items()
        ]

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m, in the world: where beams ended, and none went through."""
        shown = [pieces for wall, pieces in zip(self._walls, self._pieces, strict=True) if self._is_shown(wall)]
        every = np.concatenate((np.zeros((0, 4)), *shown))
        return np.asarray(every[np.hypot(*(every[:, 2:] - every[:, :2]).T) >= self._settings.shown_length])

    @property
    def landmarks(self) -> list[Landmark]:
        """The landmarks that are walls of the map."""
        every = self.all_landmarks
        return [
            mark
            for mark, wall, pieces in zip(every, self._walls, self._pieces, strict=True)
            if self._is_shown(wall) and len(pieces)
        ]

    @property
    def all_landmarks(self) -> list[Landmark]:
        """The same, and those that are provisional, by number."""
        lines = self._filter.lines
        return [
            Landmark(
                float(lines[index, 0]), float(lines[index, 1]), self._filter.line_covariance(index),
                self._ends(index), wall.groups, wall.number,
            )
            for index, wall in enumerate(self._walls)
        ]  # fmt: skip

    def _is_shown(self, wall: _Wall) -> bool:
        return wall.readings >= self._settings.shown_readings

    @property
    def _pieces(self) -> list[FloatArray]:
        # Lines only change when one is observed, and the map is asked for at every step.
        if self._drawn is None:
            settings = self._settings
            self._drawn = [
                self._points_on(index, wall.extent.pieces(settings.max_gap, settings.through_tolerance)).reshape(-1, 4)
                for index, wall in enumerate(self._walls)
            ]
        return self._drawn

    def _ends(self, index: int) -> FloatArray:
        return self._points_on(index, np.array(self._walls[index].extent.ends))

    def _points_on(self, index: int, along: FloatArray) -> FloatArray:
        """Points (..., 2) of the world at places (...) along a landmark."""
        line, anchor = self._filter.anchored[index], self._filter.anchors[index]
        return np.asarray(anchor + at(line, along))

    def _along(self, index: int, points: FloatArray) -> FloatArray:
        """Where points (n, 2) fall along a landmark (n,), m from its anchor."""
        return np.asarray((points - self._filter.anchors[index]) @ direction(self._filter.anchored[index]))

    # Readings

    def _collect(self, number: int, front: FrontEnd) -> None:
        """Let the hits of a robot that has moved wait, with a clone of its pose."""
        track, buffer = self._tracks[number], self.config.buffer
        hits, clone = front.hits, None
        for side, beams in self._sides.items():
            if hits[beams].any():
                track.last_hit[side] = track.driven
        driven, turned = track.cloned_at
        if track.driven - driven < buffer.min_distance and track.turned - turned < buffer.min_turn:
            return
        for side, beams in self._sides.items():
            chosen = beams[hits[beams]]
            if len(chosen) and clone is None:
                clone = self._filter.clone(number)
                track.cloned_at = track.driven, track.turned
            for beam in chosen.tolist():
                assert clone is not None
                track.waiting[side].append(
                    _Reading(clone, front.step, beam, float(front.ranges[beam]), track.driven)
                )  # fmt: skip
            track.fresh[side] += len(chosen)

    def _readings(self, waiting: Sequence[_Reading]) -> tuple[Readings, FloatArray]:
        """Readings for the filter, and where they are believed to have ended (n, 2), m."""
        if not waiting:
            none = np.zeros(0, dtype=int)
            return Readings(none, np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 2), int)), np.zeros((0, 2))
        clones, steps, beams, ranges, _ = (np.array(column) for column in zip(*waiting, strict=True))
        readings = Readings(
            clones, self.robot.beam_origins[beams], self.robot.beam_angles[beams], ranges,
            np.column_stack((steps, beams)),
        )  # fmt: skip
        return readings, hit_points(self._filter.clone_poses(clones), readings)

    def _use(self, number: int, side: Side, step: int, *, has_ended: bool) -> None:
        """Find lines in what waits, and let go of what is dealt with, or too old."""
        track, settings = self._tracks[number], self._settings
        waiting, track.fresh[side] = track.waiting[side], 0
        readings, points = self._readings(waiting)
        # Beams ahead meet a wall far apart, with nothing between them.
        hough = replace(settings.hough, max_gap=settings.gap_ahead) if side == "none" else settings.hough
        lines = extract_lines(points, hough, self.config.range_std)
        self._show(number, side, step, points, lines)
        dealt_with = np.zeros(len(waiting), dtype=bool)
        driven = np.array([reading.driven for reading in waiting])
        for members in self._uncontested(points, lines):
            line = lines[members.line].fit.line
            pieces = straight_pieces(
                readings, members.readings, line, self._filter, self.config.range_std, settings.straight
            )
            for piece in pieces:
                is_complete = has_ended or track.driven - driven[piece.members].max() > settings.passed
                if self._incorporate(number, step, readings.select(piece.members), piece, is_complete=is_complete):
                    dealt_with[piece.members] = True
        oldest = math.inf if has_ended else track.driven - settings.max_age
        track.waiting[side] = [
            reading
            for reading, is_done in zip(waiting, dealt_with.tolist(), strict=True)
            if not is_done and reading.driven >= oldest
        ]
        self._let_go()

    def _let_go(self) -> None:
        """Keep only the clones that readings wait for, and not too many."""
        wanted = sorted(
            {reading.clone for track in self._tracks for each in track.waiting.values() for reading in each}
        )
        if len(wanted) > self._settings.max_clones:
            oldest = wanted[-self._settings.max_clones]
            for track in self._tracks:
                for side, each in track.waiting.items():
                    track.waiting[side] = [reading for reading in each if reading.clone >= oldest]
            wanted = [clone for clone in wanted if clone >= oldest]
        self._filter.keep_clones(set(wanted))

    def _uncontested(self, points: FloatArray, lines: list[ExtractedLine]) -> "list[_Members]":
        """The readings of each line, without those near a corner that could as well be another's."""
        near = max(self.config.hough.max_offset, 2.5 * self.config.range_std)
        result = []
        for number, line in enumerate(lines):
            members = np.sort(line.members)
            for other in lines:
                if other is line:
                    continue
                places = np.sort(other.fit.ends @ direction(other.fit.line))
                along = points[members] @ direction(other.fit.line)
                beside = (along > places[0] - _BESIDE_CORNER) & (along < places[1] + _BESIDE_CORNER)
                members = members[~(beside & (np.abs(distance(other.fit.line, points[members])) < near))]
            if len(members) >= _FEWEST:
                result.append(_Members(number, members))
        return result

    # Landmarks

    def _incorporate(self, robot: int, step: int, readings: Readings, piece: Piece, *, is_complete: bool) -> bool:
        """Take a piece of wall for a landmark that is known, or for a new one; whether it has been dealt with."""
        settings = self._settings
        candidates = self._candidates(readings, piece)
        good = [candidate for candidate in candidates if candidate.of_line <= settings.gate]
        while len(good) > 1:
            if not self._closes_loop(good[0].index, good[1].index, step):
                break
            candidates = self._candidates(readings, piece)
            good = [candidate for candidate in candidates if candidate.of_line <= settings.gate]
        if len(good) > 1 and good[1].of_line - good[0].of_line < settings.ambiguity:
            return True
        if good:
            return self._is_known(robot, step, readings, piece, good[0])
        if candidates and candidates[0].of_line < settings.far_gate:
            return False
        least = settings.new_length_complete if is_complete else self._new_length
        if piece.length < least or piece.angle_std > settings.max_angle_std:
            return False
        self._add(robot, step, readings, piece)
        return True

    def _candidates(self, readings: Readings, piece: Piece) -> list[_Candidate]:
        """Landmarks that a piece of wall may be of, best first."""
        if not self._walls:
            return []
        settings = self._settings
        lines, anchors = self._filter.anchored, self._filter.anchors
        turn = np.abs((lines[:, 1] - piece.theta + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
        loose = 2.0 * math.atan2(2.0 * self.config.range_std, max(piece.length, 0.1))
        off = np.abs(np.sum((piece.middle - anchors) * _normals(lines), axis=1) - lines[:, 0])
        found = []
        for index in np.nonzero((turn < settings.max_angle + loose) & (off < settings.max_offset))[0].tolist():
            along, (low, high) = self._along(index, piece.points), self._walls[index].extent.ends
            if max(along.min() - high, low - along.max()) > settings.max_end_gap:
                continue
            disagreement = self._filter.disagreement(readings, index, self.config.range_std)
            if disagreement is not None:
                found.append(_Candidate(*disagreement, index))
        return sorted(found)

    def _is_known(self, robot: int, step: int, readings: Readings, piece: Piece, known: _Candidate) -> bool:
        """Correct the filter by a piece of a landmark, if it is good enough for that; whether it was."""
        settings, wall = self._settings, self._walls[known.index]
        free = max(known.count - 2, 1)
        if known.left > free + settings.left_sigmas * math.sqrt(2.0 * free) + 2.0 or piece.length < settings.min_length:
            return False
        along, (low, high) = self._along(known.index, piece.points), wall.extent.ends
        is_inside = np.mean((along > low - settings.end_slack) & (along < high + settings.end_slack)) >= 0.5
        is_clear = (
            piece.length >= settings.beyond_length
            and known.of_line <= settings.beyond_gate
            and piece.angle_std <= settings.beyond_angle_std
        )
        if not is_inside and not is_clear:
            return False
        self._filter.observe(readings, known.index, self.config.range_std, settings.iterations, settings.huber)
        self._grow(known.index, readings)
        self._note(AssociationRecord(wall.number, False, readings.sources, robot))
        self._close_loops_of(wall, step)
        return True

    def _add(self, robot: int, step: int, readings: Readings, piece: Piece) -> None:
        settings, wall = self._settings, _Wall(self._numbers)
        index = self._filter.add_line(piece.theta, piece.middle)
        self._filter.observe(readings, index, self.config.range_std, settings.first_iterations, settings.huber)
        self._walls.append(wall)
        self._numbers += 1
        self._grow(index, readings)
        self._note(AssociationRecord(wall.number, True, readings.sources, robot))
        self._close_loops_of(wall, step)

    def _grow(self, index: int, readings: Readings) -> None:
        wall = self._walls[index]
        wall.extent.hit(self._along(index, hit_points(self._filter.clone_poses(readings.clones), readings)))
        wall.groups += 1
        wall.readings += len(readings)
        self._drawn = None

    # Loops

    def _close_loops_of(self, wall: _Wall, step: int) -> None:
        """Look for a landmark that is the same wall as one that has just changed, until there is none."""
        found = True
        while found and wall in self._walls:
            found, index = False, self._walls.index(wall)
            lines, anchors = self._filter.anchored, self._filter.anchors
            turn = np.abs((lines[:, 1] - lines[index, 1] + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
            off = np.abs((anchors - anchors[index]) @ _normals(lines[index]) - lines[index, 0])
            near = (turn < self._settings.max_angle) & (off < 2.0 * self._settings.max_offset)
            near[index] = False
            for other in np.nonzero(near)[0].tolist():
                if self._closes_loop(other, index, step):
                    found = True
                    break

    def _closes_loop(self, first: int, second: int, step: int) -> bool:
        """Whether two landmarks are one wall; then they are made one, and the younger is no more."""
        settings, (older, younger) = self._settings, sorted((first, second))
        if not self.config.closing.enabled:
            return False
        ends = self._ends(younger)
        places, (low, high) = np.sort(self._along(older, ends)), self._walls[older].extent.ends
        if min(places[1], high) - max(places[0], low) < settings.min_overlap:
            return False
        line, anchor = self._filter.anchored[older], self._filter.anchors[older]
        offset = abs(float(distance(line, ends - anchor).mean()))
        off, covariance = self._filter.difference(older, younger)
        squared = float(off @ np.linalg.solve(covariance + np.diag([1e-6, 1e-8]), off))
        if squared > settings.one_wall_gate or abs(off[1]) > settings.max_angle or offset > settings.max_offset:
            return False
        wall, other = self._walls[older], self._walls[younger]
        origin, tangent = self._filter.anchors[younger].copy(), direction(self._filter.anchored[younger])
        self._filter.unite(older, younger)
        del self._walls[younger]
        factor = 1.0 if tangent @ direction(self._filter.anchored[older]) > 0.0 else -1.0
        shift = float(self._along(older, origin[None])[0])
        wall.extent.absorb(other.extent, np.array([factor, shift]))
        wall.groups += other.groups
        wall.readings += other.readings
        self._drawn = None
        self.closures.append(Closure(wall.number, other.number, step, squared, 0.0, offset, 0.0))
        return True

    # What beams go through

    def _see_through(self, number: int, front: FrontEnd) -> None:
        """Take back the walls that beams have gone through."""
        beams = np.nonzero(front.measured & (front.ranges > self.robot.too_near))[0]
        if not self._walls or not len(beams):
            return
        pose, settings = self._filter.poses[number], self._settings
        variance = np.diag(self._filter.joint_pose_covariance)[3 * number : 3 * number + 3]
        ranges = np.minimum(front.ranges[beams], self.robot.max_ranges[beams])
        unsure = self.config.range_std**2 + variance[:2].sum() + variance[2] * ranges**2
        origins = transform_points(pose, self.robot.beam_origins[beams])
        headings = pose[2] + self.robot.beam_angles[beams]
        towards = np.column_stack((np.cos(headings), np.sin(headings)))
        lines, anchors = self._filter.anchored, self._filter.anchors
        normals = _normals(lines)
        cosines = towards @ normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            ahead = (lines[:, 0] - origins @ normals.T + np.sum(anchors * normals, axis=1)) / cosines
        margin = settings.through_sigmas * np.sqrt(unsure)[:, None] / np.maximum(np.abs(cosines), GRAZING)
        went_on = (
            (np.abs(cosines) > GRAZING) & (ahead > 0.0) & (ahead + margin + settings.through_slack < ranges[:, None])
        )
        for beam, index in np.argwhere(went_on).tolist():
            place = origins[beam] + ahead[beam, index] * towards[beam]
            along, (low, high) = self._along(index, place[None]), self._walls[index].extent.ends
            if low < along[0] < high:
                self._walls[index].extent.passed(along)
                self._drawn = None

    def _show(self, number: int, side: Side, step: int, points: FloatArray, lines: list[ExtractedLine]) -> None:
        """Note down what was found, in the robot's frame, for those who watch."""
        back = inverse(self._filter.poses[number])
        local = transform_points(back, points)
        found = np.array([line.fit.line for line in lines]).reshape(-1, 2)
        ends = np.array([transform_points(back, line.fit.ends) for line in lines]).reshape(-1, 2, 2)
        normals = _normals(found) if len(found) else np.zeros((0, 2))
        turned = found[:, 1] + back[2]
        distances = found[:, 0] + transform_points(back, np.zeros((1, 2)))[0] @ np.stack(
            (np.cos(turned), np.sin(turned))
        )
        del normals
        pose = self._filter.poses[number]
        lines_seen = np.column_stack((distances, turned))
        self.last_extraction = Extraction(number, side, step, pose, local, lines_seen, ends)


class _Members(NamedTuple):
    """Which line, and which readings (n,) are on it."""

    line: int
    readings: IntArray


def _normals(lines: FloatArray) -> FloatArray:
    return np.stack((np.cos(lines[..., 1]), np.sin(lines[..., 1])), axis=-1)


def _beams_by_side(robot: RobotSpec, most: int) -> dict[Side, IntArray]:
    """The beams to the left, to the right and ahead or behind, thinned out evenly to ``most`` each."""
    result: dict[Side, IntArray] = {}
    for side in _SIDES:
        beams = np.array([number for number, beam in enumerate(robot.beams) if beam.side == side], dtype=int)
        chosen = np.unique(np.linspace(0, len(beams) - 1, min(most, len(beams))).round().astype(int))
        result[side] = beams[chosen]
    return result
