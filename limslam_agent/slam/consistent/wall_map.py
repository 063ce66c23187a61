"""The landmarks of the consistent estimator, without their lines: extents, and numbers of
readings.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from limslam_agent.config.consistent import ExtentConfig
from limslam_agent.kernels.tables import (
    CHANGES,
    GROUPS,
    HITS,
    LEAST,
    LENGTH,
    LOW,
    MISSES,
    MOST,
    NEXT_NUMBER,
    NUMBER,
    READINGS,
    Filter,
    Walls,
    clones_from,
    empty_walls,
    line_at,
)
from limslam_agent.slam.consistent.limits import (
    MAX_GAP,
    ONE_WALL_GATE,
    STRAIGHTNESS,
    THROUGH_TOLERANCE,
)
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import at, direction
from limslam_env.geometry.segment import lengths

if TYPE_CHECKING:
    from limslam_agent.slam.consistent.clone_ekf import CloneEKF

NEW = -1
"""Number of a landmark that has not got its number yet."""

_LANDMARKS = 24
_BINS = 128
"""Room for landmarks, and for bins of each, that is made at once."""


@dataclass(frozen=True, eq=False)
class WallExtent:
    """Counts along a line, in bins of ``kernels.extents.BIN``.

    Attributes
    ----------
    low
        Number of the first bin.
    counted
        Beams that ended in each bin, and beams that passed (2, n).
    reached
        Least and largest position of a hit in each bin (2, n), m along the line.
    """

    low: int
    counted: IntArray
    reached: FloatArray

    @property
    def ends(self) -> tuple[float, float]:
        """Positions of the outermost hits, m along the line."""
        return float(self.reached[LEAST].min()), float(self.reached[MOST].max())

    def intervals(self, max_gap: float, tolerance: float) -> FloatArray:
        """Intervals (k, 2), m, in which there is wall.

        A gap between two hits is drawn as wall up to ``max_gap``, m, if no beam has passed through
        it, and up to ``tolerance`` beams may pass through a bin for each beam that ended in it.
        """
        hits, misses, (least, most) = self.counted[HITS], self.counted[MISSES], self.reached
        is_wall = (hits > 0) & (misses <= tolerance * hits)
        bins = np.nonzero(is_wall)[0]
        if not len(bins):
            return np.zeros((0, 2))
        passed = np.concatenate(([0], np.cumsum((misses > 0) & ~is_wall)))
        between = passed[bins[1:]] - passed[bins[:-1] + 1]
        gaps = least[bins[1:]] - most[bins[:-1]]
        cuts = np.nonzero((between > 0) | (gaps > max_gap))[0] + 1
        parts = np.split(bins, cuts)
        return np.array([(least[part[0]], most[part[-1]]) for part in parts])


@dataclass(frozen=True, eq=False)
class Wall:
    """One landmark at one moment.

    Attributes
    ----------
    number
        Identifies the landmark; an older landmark has a smaller number.
    extent
        Where along the line there is wall.
    groups, readings
        Number of updates by a wall segment, and of readings in them.
    known_as
        Number of the landmark that a ``NEW`` one was recognised as while it was seen; ``NEW`` if
        none.
    """

    number: int
    extent: WallExtent
    groups: int
    readings: int
    known_as: int = NEW

    @property
    def is_wall(self) -> bool:
        """Whether there is a place along the landmark where beams have ended and at most as many
        have passed.
        """
        return bool(len(self.extent.intervals(MAX_GAP, THROUGH_TOLERANCE)))


class WallMap:
    """The landmarks, in the order in which the filter holds their lines.

    Parameters
    ----------
    belief
        The filter, which holds the lines.
    config
        When a landmark is a wall of the map.

    Attributes
    ----------
    arrays
        The landmarks as the decisions of a step read and change them.
    """

    def __init__(self, belief: "CloneEKF", config: ExtentConfig) -> None:
        self._belief = belief
        self._config = config
        self.arrays = empty_walls(_LANDMARKS, _BINS)
        self._intervals: dict[int, tuple[int, FloatArray]] = {}
        self._drawn: tuple[bytes, FloatArray, IntArray] = (
            b"",
            np.zeros((0, 4)),
            np.zeros(0, dtype=int),
        )

    def __len__(self) -> int:
        return self._belief.num_lines

    @property
    def numbers(self) -> IntArray:
        """Numbers (n,) of the landmarks."""
        return np.asarray(self.arrays.table[: len(self), NUMBER])

    def make_room(self, landmarks: int) -> None:
        """Make room for further landmarks, and for each landmark to grow."""
        room = self.arrays.counted.shape[0]
        bins = self.arrays.counted.shape[2]
        longest = int(self.arrays.table[: len(self), LENGTH].max(initial=0))
        if len(self) + landmarks > room or 2 * longest + _BINS > bins:
            more = landmarks + _LANDMARKS if len(self) + landmarks > room else 0
            old = self.arrays
            self.arrays = empty_walls(room + more, max(bins, 3 * longest + _BINS))
            pairs: list[tuple[Any, Any]] = list(zip(old, self.arrays, strict=True))
            for before, after in pairs:
                after[tuple(slice(size) for size in before.shape)] = before

    def add_known(self, points: FloatArray) -> None:
        """Add a landmark of an earlier map, as if beams had ended at points (n, 2), m.

        Its line is the one that was last added to the filter.
        """
        from limslam_agent.kernels.extents import add_wall, count_hits

        self.make_room(1)
        index = len(self) - 1
        add_wall(self.arrays, index)
        count_hits(self.arrays, index, self.along(index, points))

    @property
    def walls(self) -> list[Wall]:
        """The landmarks at this moment."""
        return [
            Wall(
                int(row[NUMBER]),
                extent_of(self.arrays, index),
                int(row[GROUPS]),
                int(row[READINGS]),
            )
            for index, row in enumerate(self.arrays.table[: len(self)])
        ]

    def up_to_date(self, walls: list[Wall]) -> list[Wall]:
        """Landmarks of an earlier moment with what all beams until now say of them, if they still
        exist.
        """
        present = {wall.number: wall for wall in self.walls}
        return [replace(wall, extent=present.get(wall.number, wall).extent) for wall in walls]

    def replace(self, walls: list[Wall]) -> list[int]:
        """Replace all landmarks, after the filter has replaced their lines.

        Landmarks with the number ``NEW`` get their numbers, which are returned.
        """
        new = []
        number = int(self.arrays.tally[NEXT_NUMBER])
        longest = max((len(wall.extent.counted[0]) for wall in walls), default=0)
        self.arrays = empty_walls(len(walls) + _LANDMARKS, 3 * longest + _BINS)
        for index, wall in enumerate(walls):
            low = wall.extent.low
            length = len(wall.extent.counted[0])
            extent = wall.extent
            if wall.number == NEW:
                new.append(number)
                number += 1
            own = new[-1] if wall.number == NEW else wall.number
            self.arrays.table[index] = low, length, wall.groups, wall.readings, own, 0
            self.arrays.counted[index, :, :length] = extent.counted
            self.arrays.ends[index] = extent.ends
            self.arrays.reached[index, :, :length] = extent.reached
        self.arrays.tally[NEXT_NUMBER] = number
        self._intervals = {}
        self._drawn = (b"outdated", *self._drawn[1:])
        return new

    def along(self, index: int, points: FloatArray) -> FloatArray:
        """Positions (...) of points (..., 2) along a landmark, m from its anchor."""
        return np.asarray(
            (points - self._belief.anchors[index]) @ direction(self._belief.line(index))
        )

    def agreeing(self, pairs: list[tuple[int, int]]) -> list[int]:
        """Which pairs of landmarks may all be one wall each, of pairs that are likely to be.

        Each of them must agree with all others: the pair that they contradict most is left out,
        until the squared Mahalanobis distance of each pair, given that the others are equal, is at
        most ``ONE_WALL_GATE``.
        """
        off, covariance = self._belief.differences(pairs)
        covariance += np.diag(np.tile(STRAIGHTNESS, len(pairs)))
        chosen = np.arange(len(pairs))
        while len(chosen):
            rows = (2 * chosen[:, None] + np.arange(2)).ravel()
            each = np.arange(len(chosen))
            information = np.linalg.inv(covariance[np.ix_(rows, rows)])
            residuals = (information @ off[rows]).reshape(-1, 2, 1)
            own = information.reshape(len(each), 2, len(each), 2)[each, :, each]
            squared = np.sum(residuals * np.linalg.solve(own, residuals), axis=(1, 2))
            if squared.max() <= ONE_WALL_GATE:
                break
            chosen = np.delete(chosen, squared.argmax())
        return [int(number) for number in chosen]

    def ends(self, index: int) -> FloatArray:
        """The outermost points (2, 2) of a landmark, m."""
        return np.asarray(
            self._belief.anchors[index] + at(self._belief.line(index), self.arrays.ends[index])
        )

    @property
    def segments(self) -> FloatArray:
        """The walls of the map (N, 4), m: where beams ended, and none passed. A copy."""
        return self._segments()[0].copy()

    @property
    def landmarks(self) -> list[Landmark]:
        """The landmarks that are walls of the map."""
        owners = self._segments()[1]
        is_shown = self._is_shown
        intervals = self._wall_intervals()
        return [
            replace(mark, segments=tuple(np.flatnonzero(owners == index).tolist()))
            for index, mark in enumerate(self.all_landmarks)
            if is_shown[index] and len(intervals[index])
        ]

    @property
    def all_landmarks(self) -> list[Landmark]:
        """All landmarks, provisional ones included, by number."""
        lines = self._belief.lines
        return [
            Landmark(
                float(lines[index, 0]),
                float(lines[index, 1]),
                self._belief.line_covariance(index),
                self.ends(index),
                int(row[GROUPS]),
                int(row[NUMBER]),
            )
            for index, row in enumerate(self.arrays.table[: len(self)])
        ]

    @property
    def _is_shown(self) -> IntArray:
        """Which landmarks (n,) have enough readings."""
        return np.asarray(self.arrays.table[: len(self), READINGS] >= self._config.min_readings)

    def _wall_intervals(self) -> list[FloatArray]:
        """Where along each landmark there is wall (k, 2), m; kept until the landmark changes."""
        found = []
        for index, (number, changes) in enumerate(
            self.arrays.table[: len(self), [NUMBER, CHANGES]].tolist()
        ):
            known = self._intervals.get(number)
            if known is None or known[0] != changes:
                known = self._intervals[number] = changes, intervals_of(self.arrays, index)
            found.append(known[1])
        return found

    def _segments(self) -> tuple[FloatArray, IntArray]:
        """The walls of the map (N, 4), m, and the index of the landmark that each lies on (N,).

        They are kept until a landmark changes, because every step asks for them.
        """
        key = self.arrays.table[: len(self)].tobytes()
        if self._drawn[0] != key:
            ekf = self._belief.arrays
            self._drawn = key, *drawn_walls(ekf, self.arrays, self._wall_intervals(), self._config)
        return self._drawn[1:]


def extent_of(walls: Walls, index: int) -> WallExtent:
    """The extent of a landmark, a copy."""
    low, length = walls.table[index, [LOW, LENGTH]].tolist()
    counted = walls.counted[index, :, :length]
    reached = walls.reached[index, :, :length]
    return WallExtent(low, counted.copy(), reached.copy())


def intervals_of(walls: Walls, index: int) -> FloatArray:
    """Where along a landmark there is wall (k, 2), m."""
    return extent_of(walls, index).intervals(MAX_GAP, THROUGH_TOLERANCE)


def drawn_walls(
    ekf: Filter, walls: Walls, intervals: list[FloatArray], config: ExtentConfig
) -> tuple[FloatArray, IntArray]:
    """The walls of a map (N, 4), m, and the index of the landmark that each lies on (N,), from
    where there is wall along each landmark (k, 2), m.
    """
    owners = np.repeat(np.arange(len(intervals)), [len(each) for each in intervals])
    along = np.concatenate((np.zeros((0, 2)), *intervals))
    anchors = ekf.anchors[owners]
    lines = ekf.x[line_at(ekf.counts, 0) : clones_from(ekf.counts)].reshape(-1, 2)[owners]
    cos = np.cos(lines[:, 1:])
    sin = np.sin(lines[:, 1:])
    points = np.empty((len(owners), 4))
    points[:, ::2] = anchors[:, :1] + (lines[:, :1] * cos - along * sin)
    points[:, 1::2] = anchors[:, 1:] + (lines[:, :1] * sin + along * cos)
    is_shown = walls.table[owners, READINGS] >= config.min_readings
    is_shown &= lengths(points) >= config.min_length
    return points[is_shown], owners[is_shown]
