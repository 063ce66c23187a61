"""The landmarks of the consistent estimator, without their lines: extents, and numbers of readings."""

import copy
import math
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from limslam_agent.config.consistent import ExtentConfig
from limslam_agent.kernels.tables import GRAZING
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.limits import MAX_GAP, THROUGH_SIGMAS, THROUGH_SLACK, THROUGH_TOLERANCE
from limslam_agent.slam.consistent.wall_extent import WallExtent
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import at, direction, distance
from limslam_env.geometry.segment import lengths

STRAIGHTNESS = (1e-3**2, 1e-4**2)
"""Variances, m^2 and rad^2, by which one real wall deviates from a line.

They bound the difference of two landmarks from below, because landmarks that were always seen together may have a
difference that is known more exactly than any wall is straight.
"""

NEW = -1
"""Number of a landmark that has not got its number yet."""


def moved_along(seen: FloatArray, factor: float, shift: float) -> FloatArray:
    """The outermost hits from each side (2, 2), m, of a line whose position s is ``factor`` (1 or -1) s + ``shift``."""
    return seen + shift if factor > 0.0 else shift - seen[::-1, ::-1]


def shared(first: FloatArray, second: FloatArray) -> FloatArray:
    """Length (2,) of the stretch between the outermost hits (2, 2) of two lines from each side, m; below 0 if none."""
    return np.asarray(np.minimum(first[:, 1], second[:, 1]) - np.maximum(first[:, 0], second[:, 0]))


def squared_difference(off: FloatArray, covariance: FloatArray) -> float:
    """Squared Mahalanobis distance of two landmarks by their difference (2,), m and rad, with its covariance (2, 2)."""
    return float(off @ np.linalg.solve(covariance + np.diag(STRAIGHTNESS), off))


@dataclass(eq=False)
class Wall:
    """One landmark.

    Attributes
    ----------
    number
        Identifies the landmark; an older landmark has a smaller number.
    extent
        Where along the line there is wall.
    groups, readings
        Number of updates by a wall segment, and of readings in them.
    seen
        Positions of the outermost hits from each side of the line (2, 2), m along the line: rows ``POSITIVE`` and
        ``NEGATIVE`` of ``core.wall_faces``.
    behind
        Length of the stretch with another face behind it, m, if the landmark is a face of a wall.
    is_known
        Whether the landmark is from an earlier map, which does not say from which sides it was seen.
    known_as
        Number of the landmark that a ``NEW`` one was recognised as while it was seen; ``NEW`` if none.
    """

    number: int
    extent: WallExtent = field(default_factory=WallExtent)
    groups: int = 0
    readings: int = 0
    seen: FloatArray = field(default_factory=lambda: np.array([[math.inf, -math.inf]] * 2))
    behind: float = 0.0
    is_known: bool = False
    known_as: int = NEW

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # Copies of the map are made all the time, so that a lost robot can go back to one.
        return replace(self, extent=copy.deepcopy(self.extent, memo), seen=self.seen.copy())

    @property
    def board(self) -> float:
        """Length of the stretch that is seen from both sides, m."""
        return 0.0 if self.is_known else max(float(self.seen[:, 1].min() - self.seen[:, 0].max()), 0.0)


class WallMap:
    """The landmarks, in the order in which the filter holds their lines.

    Parameters
    ----------
    belief
        The filter, which holds the lines.
    config
        When a landmark is a wall of the map.
    """

    def __init__(self, belief: CloneEKF, config: ExtentConfig) -> None:
        self._belief, self._config = belief, config
        self.walls: list[Wall] = []
        self._numbers = 0
        self._drawn: tuple[FloatArray, IntArray] | None = None
        self._shown: tuple[tuple[FloatArray, IntArray], FloatArray, IntArray] | None = None

    def __len__(self) -> int:
        return len(self.walls)

    def __getitem__(self, index: int) -> Wall:
        return self.walls[index]

    def add(self) -> Wall:
        """Add a landmark for the line that was last added to the filter."""
        self.walls.append(Wall(self._numbers))
        self._numbers += 1
        return self.walls[-1]

    def count_in(self, walls: list[Wall]) -> None:
        """Give landmarks of an earlier moment what all beams until now say of them, if they still exist."""
        present = {wall.number: wall for wall in self.walls}
        for wall in walls:
            newest = present.get(wall.number, wall)
            wall.extent, wall.seen, wall.behind = newest.extent, newest.seen, newest.behind

    def is_wall(self, wall: Wall) -> bool:
        """Whether there is a place along a landmark where beams have ended and at most as many have passed."""
        return bool(len(wall.extent.intervals(MAX_GAP, THROUGH_TOLERANCE)))

    def replace(self, walls: list[Wall]) -> list[Wall]:
        """Replace all landmarks, after the filter has replaced their lines; the new ones, which get their numbers."""
        self.walls, self._drawn = list(walls), None
        new = [wall for wall in walls if wall.number == NEW]
        for wall in new:
            wall.number, self._numbers = self._numbers, self._numbers + 1
        return new

    @property
    def kinds(self) -> tuple[float, float]:
        """Length of the landmarks that are boards, and of the walls that have two faces, m."""
        return sum(wall.board for wall in self.walls), 0.5 * sum(wall.behind for wall in self.walls)

    def grow(self, index: int, points: FloatArray, *sides: int) -> None:
        """Count beams that ended on a landmark at points (n, 2), m, from given sides, and that corrected the filter."""
        wall, along = self.walls[index], self.along(index, points)
        for side in sides:
            low, high = wall.seen[side]
            wall.seen[side] = min(low, along.min()), max(high, along.max())
        wall.extent.hit(along)
        wall.groups += 1
        wall.readings += len(points)
        self._drawn = None

    def merge(self, older: int, younger: int, origin: FloatArray, tangent: FloatArray) -> None:
        """Merge two landmarks into the older one, after the filter has merged their lines.

        Parameters
        ----------
        older, younger
            Indices of the landmarks. The younger one is removed.
        origin, tangent
            Point of the world (2,), m, from which the younger landmark's positions counted, and their direction (2,).
        """
        wall, other = self.walls[older], self.walls.pop(younger)
        factor = 1.0 if tangent @ direction(self._belief.anchored[older]) > 0.0 else -1.0
        shift = float(self.along(older, origin))
        wall.extent.absorb(other.extent, factor, shift)
        seen = moved_along(other.seen, factor, shift)
        wall.seen = np.column_stack((np.minimum(wall.seen[:, 0], seen[:, 0]), np.maximum(wall.seen[:, 1], seen[:, 1])))
        wall.behind = max(wall.behind, other.behind)
        wall.groups += other.groups
        wall.readings += other.readings
        self._drawn = None

    def along(self, index: int, points: FloatArray) -> FloatArray:
        """Positions (...) of points (..., 2) along a landmark, m from its anchor."""
        return np.asarray((points - self._belief.anchors[index]) @ direction(self._belief.anchored[index]))

    def offset(self, older: int, younger: int) -> float:
        """Distance of the middle of a landmark from the line of another one, m."""
        ends = self.ends(younger) - self._belief.anchors[older]
        return abs(float(distance(self._belief.anchored[older], ends).mean()))

    def agreeing(self, pairs: list[tuple[int, int]], gate: float) -> list[int]:
        """Which pairs of landmarks may all be one wall each, of pairs that are likely to be.

        Each of them must agree with all others: the pair that they contradict most is left out, until the squared
        Mahalanobis distance of each pair, given that the others are equal, is at most the gate.
        """
        off, covariance = self._belief.differences(pairs)
        covariance += np.diag(np.tile(STRAIGHTNESS, len(pairs)))
        chosen = np.arange(len(pairs))
        while len(chosen):
            rows, each = (2 * chosen[:, None] + np.arange(2)).ravel(), np.arange(len(chosen))
            information = np.linalg.inv(covariance[np.ix_(rows, rows)])
            residuals = (information @ off[rows]).reshape(-1, 2, 1)
            own = information.reshape(len(each), 2, len(each), 2)[each, :, each]
            squared = np.sum(residuals * np.linalg.solve(own, residuals), axis=(1, 2))
            if squared.max() <= gate:
                break
            chosen = np.delete(chosen, squared.argmax())
        return [int(number) for number in chosen]

    def ends(self, index: int) -> FloatArray:
        """The outermost points (2, 2) of a landmark, m."""
        return self._points(index, np.array(self.walls[index].extent.ends))

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m: where beams ended, and none passed. A copy."""
        return self._shown_segments[0].copy()

    @property
    def landmarks(self) -> list[Landmark]:
        """The landmarks that are walls of the map."""
        owners, drawn = self._shown_segments[1], set(self._segments[1].tolist())
        return [
            replace(mark, segments=tuple(np.flatnonzero(owners == index).tolist()))
            for index, (mark, wall) in enumerate(zip(self.all_landmarks, self.walls, strict=True))
            if self._is_shown(wall) and index in drawn
        ]

    @property
    def all_landmarks(self) -> list[Landmark]:
        """All landmarks, provisional ones included, by number."""
        lines = self._belief.lines
        return [
            Landmark(
                float(lines[index, 0]), float(lines[index, 1]), self._belief.line_covariance(index), self.ends(index),
                wall.groups, wall.number,
            )
            for index, wall in enumerate(self.walls)
        ]  # fmt: skip

    def clear_along_beams(self, origins: FloatArray, towards: FloatArray, ranges: FloatArray, stds: FloatArray) -> None:
        """Count the places of landmarks that beams have passed through.

        Parameters
        ----------
        origins, towards
            Where the beams begin (n, 2), m, and their unit directions (n, 2), in the world.
        ranges, stds
            How far the beams went (n,), and the standard deviations of that (n,), m.
        """
        from limslam_agent.kernels.nearness import passed_lines

        if not self.walls:
            return
        most = len(ranges) * len(self.walls)
        numbers, places = np.empty(most, dtype=np.int64), np.empty(most)
        count = passed_lines(
            origins, towards, ranges, THROUGH_SIGMAS * stds, self._belief.anchored, self._belief.anchors,
            THROUGH_SLACK, GRAZING, numbers, places,
        )  # fmt: skip
        for index, place in zip(numbers[:count].tolist(), places[:count].tolist(), strict=True):
            if self.walls[index].extent.pass_at(place):
                self._drawn = None

    def _is_shown(self, wall: Wall) -> bool:
        return wall.readings >= self._config.min_readings

    @property
    def _segments(self) -> tuple[FloatArray, IntArray]:
        """Segments (n, 4), m, of all landmarks, and the index of the landmark that each lies on (n,).

        They are kept until a landmark changes, because every step asks for them.
        """
        if self._drawn is None:
            pieces = [wall.extent.intervals(MAX_GAP, THROUGH_TOLERANCE) for wall in self.walls]
            owners = np.repeat(np.arange(len(pieces)), [len(each) for each in pieces])
            along, lines = np.concatenate((np.zeros((0, 2)), *pieces)), self._belief.anchored[owners]
            anchors, (cos, sin) = self._belief.anchors[owners], (np.cos(lines[:, 1:]), np.sin(lines[:, 1:]))
            points = np.empty((len(owners), 4))
            points[:, ::2] = anchors[:, :1] + (lines[:, :1] * cos - along * sin)
            points[:, 1::2] = anchors[:, 1:] + (lines[:, :1] * sin + along * cos)
            self._drawn = points, owners
        return self._drawn

    @property
    def _shown_segments(self) -> tuple[FloatArray, IntArray]:
        """Those of :attr:`_segments` that are walls of the map. They are kept as long as all segments are."""
        segments = self._segments
        if self._shown is None or self._shown[0] is not segments:
            points, owners = segments
            is_shown = np.array([self._is_shown(wall) for wall in self.walls], dtype=bool)
            is_shown = is_shown[owners] & (lengths(points) >= self._config.min_length)
            self._shown = segments, points[is_shown], owners[is_shown]
        return self._shown[1:]

    def _points(self, index: int, along: FloatArray) -> FloatArray:
        """Points (..., 2) of the world, m, at positions (...) along a landmark."""
        return np.asarray(self._belief.anchors[index] + at(self._belief.anchored[index], along))
