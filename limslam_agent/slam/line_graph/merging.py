"""Merging of lines that may be one wall, and which walls are thin boards.

A beam hits a wall from one side. A thin board is one line from both sides. A wall of a building is
two lines, which are as far apart as the wall is thick. What was measured decides between the two
hypotheses, together with the kind of the walls for which this is known already: most buildings have
walls of one kind. The rows "drive 4 cm" and "thick walls" of the scoreboard feel the numbers of
this test.

Lines are (d, alpha) about one anchor each, as in :mod:`limslam_agent.slam.line_graph.factors`. A
place along a line is its distance from the anchor, m.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from limslam_agent.slam.consistent.limits import MIN_OVERLAP, ONE_WALL_GATE, STRAIGHTNESS
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import angle_between, direction, normal

POSITIVE = 0
NEGATIVE = 1
"""Sides of a line from which beams hit it. Its normal points to the positive side."""

THINNEST = 0.05
THICKEST = 0.35
"""Thicknesses of walls, m, within which all thicknesses are equally likely."""

PRIOR_LENGTH = 0.05
"""Length of boards and of walls that is taken as known before any is, m (a Beta distribution).

A small length says that most buildings have one kind.
"""

LEAST_SHARE = 1.0 / 3.0
"""Least prior odds of a board: however many walls a building has, it also has doors and
partitions.
"""

SURE = math.log(100.0)
"""Least logarithm of the odds of a board. A false board bends the map, and a missed one is found
later.
"""

SURE_OF_WALL = math.log(10.0)
"""Least logarithm of the Bayes factor of a wall against a board."""

ELSEWHERE = 0.1
"""Density of lines that are something else than this wall, 1/m: a line in front of a face is no
proof of a board.
"""

# m and rad: two lines that differ by more are not merged
_MAX_OFFSET = 0.15
_MAX_ANGLE = 0.12
# m and rad: the largest change of a line by merging before the problem is linearised again
_MOST_MOVED = (0.10, 0.05)


class Pairs(NamedTuple):
    """Pairs of lines (k,) that are near each other, and the first line of each about the second
    line's anchor, minus the second line.
    """

    # first, second: indices of the lines
    first: IntArray
    second: IntArray
    # Ends (k, 2, 2) of the parts of the first line that were read from each side, as sides of the
    # second line and places along it, m
    seen: FloatArray
    # own, opposite: the longest stretches that both lines share: read from the same side, and from
    # opposite sides, m
    own: FloatArray
    opposite: FloatArray
    is_positive: BoolArray  # whether the opposite stretch was read from the second line's positive
    # values: offset and angle (k, 2), m and rad
    values: FloatArray
    # What they depend on: unknowns (k, 4) of the joint covariance, and derivatives (k, 2, 4)
    columns: IntArray
    jacobian: FloatArray
    information: FloatArray  # inverse covariances (k, 2, 2)

    @property
    def squared(self) -> FloatArray:
        """Squared Mahalanobis distances (k,)."""
        return np.asarray(np.einsum("ki,kij,kj->k", self.values, self.information, self.values))

    @property
    def volumes(self) -> FloatArray:
        """Logarithms (k,) of the determinants of the covariances."""
        return np.asarray(-np.log(np.linalg.det(self.information)))

    @property
    def behind(self) -> FloatArray:
        """How far the first lines lie behind the second ones (k,), m, if both are parallel and the
        opposite stretch was read from behind.
        """
        offset = self.values[:, 0] + (
            self.information[:, 0, 1] / self.information[:, 0, 0] * self.values[:, 1]
        )
        return np.where(self.is_positive, -offset, offset)

    @property
    def evidence(self) -> FloatArray:
        """The evidence (k,) of boards in lines that were read from opposite sides."""
        return board_evidence(self.behind, 1.0 / self.information[:, 0, 0])


@dataclass(eq=False)
class Lines:
    """Lines with their joint covariance, which are merged one pair after the other.

    Every merged pair is a constraint that updates all other lines through their joint covariance.
    """

    # lines, anchors: lines (m, 2) and their anchors (m, 2)
    lines: FloatArray
    anchors: FloatArray
    # Ends (m, 2, 2) of the parts that were read from each side, m; (inf, -inf) where there is no
    # such part
    seen: FloatArray
    covariance: FloatArray  # joint covariance (2 m, 2 m) of the lines
    # For each line (m,), the line that it was merged into, or the line itself
    merged_into: IntArray = field(init=False)

    def __post_init__(self) -> None:
        self.merged_into = np.arange(len(self.lines))

    def near_pairs(self, max_offset: float = _MAX_OFFSET) -> Pairs:
        """The pairs of lines that are nearly parallel, at most so far apart, m, and cover the same
        stretch.
        """
        ends = _ends(self.seen)
        is_left = self.merged_into == np.arange(len(ends))
        left = np.flatnonzero(is_left & (ends[:, 0] < ends[:, 1]))
        pairs = left[np.array(np.triu_indices(len(left), 1))]
        turn = self.lines[pairs[0], 1] - self.lines[pairs[1], 1]
        first, second = pairs[:, np.abs(angle_between(turn)) <= _MAX_ANGLE]
        seen = self._seen_along(first, second)
        middle = self._points(second, ends[second].mean(axis=1))
        across = np.sum((middle - self.anchors[first]) * normal(self.lines[first]), axis=1)
        is_near = np.abs(across - self.lines[first, 0]) <= max_offset
        is_near &= _shared(_ends(seen), ends[second]) >= MIN_OVERLAP
        first = first[is_near]
        second = second[is_near]
        seen = seen[is_near]
        there = self.seen[second]
        opposite = _shared(seen[:, ::-1], there)
        values, jacobian = self._differences(first, second)
        columns = 2 * np.column_stack((first, first, second, second)) + np.array([0, 1, 0, 1])
        joint = self.covariance[columns[:, :, None], columns[:, None, :]]
        covariance = jacobian @ joint @ jacobian.swapaxes(1, 2) + np.diag(STRAIGHTNESS)
        return Pairs(
            first,
            second,
            seen,
            own=_shared(seen, there).max(axis=1),
            opposite=opposite.max(axis=1),
            is_positive=opposite[:, POSITIVE] >= opposite[:, NEGATIVE],
            values=values,
            columns=columns,
            jacobian=jacobian,
            information=np.linalg.inv(covariance),
        )

    def merge(self, pairs: Pairs, which: int) -> None:
        """Make the lines of a pair equal, by a Kalman update of all lines with their difference,
        which is zero.
        """
        crossed = self.covariance[:, pairs.columns[which]] @ pairs.jacobian[which].T
        gain = crossed @ pairs.information[which]
        self.lines -= (gain @ pairs.values[which]).reshape(-1, 2)
        self.covariance -= gain @ crossed.T
        own = self.seen[pairs.second[which]]
        own[:, 0] = np.minimum(own[:, 0], pairs.seen[which, :, 0])
        own[:, 1] = np.maximum(own[:, 1], pairs.seen[which, :, 1])
        self.merged_into[self.merged_into == pairs.first[which]] = pairs.second[which]

    def _differences(self, first: IntArray, second: IntArray) -> tuple[FloatArray, FloatArray]:
        """First lines about the anchors of second ones, minus these: offsets and angles (k, 2), and
        derivatives (k, 2, 4).
        """
        one = self.lines[first]
        other = self.lines[second]
        away = self.anchors[second] - self.anchors[first]
        sign = np.where(np.cos(one[:, 1] - other[:, 1]) < 0.0, -1.0, 1.0)
        offset = sign * (one[:, 0] - np.sum(away * normal(one), axis=1)) - other[:, 0]
        jacobian = np.zeros((len(first), 2, 4))
        jacobian[:, 0, 0] = sign
        jacobian[:, 0, 1] = -sign * np.sum(away * direction(one), axis=1)
        jacobian[:, 0, 2] = jacobian[:, 1, 3] = -1.0
        jacobian[:, 1, 1] = 1.0
        return np.column_stack((offset, angle_between(one[:, 1] - other[:, 1]))), jacobian

    def _points(self, chosen: IntArray, places: FloatArray) -> FloatArray:
        """Points (k, 2) at places (k,) along chosen lines (k,)."""
        lines = self.lines[chosen]
        return np.asarray(
            self.anchors[chosen] + lines[:, :1] * normal(lines) + places[:, None] * direction(lines)
        )

    def _seen_along(self, first: IntArray, second: IntArray) -> FloatArray:
        """Ends (k, 2, 2) of the parts of first lines read from each side, as sides and places of
        second lines, m.
        """
        feet = self._points(first, np.zeros(len(first))) - self.anchors[second]
        middle = np.sum(feet * direction(self.lines[second]), axis=1)[:, None, None]
        is_turned = np.cos(self.lines[first, 1] - self.lines[second, 1]) < 0.0
        turned = middle - self.seen[first][:, ::-1, ::-1]
        return np.asarray(np.where(is_turned[:, None, None], turned, middle + self.seen[first]))


def merge_lines(known: Lines, kinds: tuple[float, float]) -> bool:
    """Merge lines that may be one wall, in the order of likelihood; return whether there were any.

    The pair with the greatest likelihood is merged first: a pair with a large covariance passes the
    chi-square test easily. Two lines share a stretch that was read from one side, or they are
    merged if they are a board. Merging ends when a line has moved far: the problem must then be
    linearised again. ``kinds`` are the lengths of the known boards and walls, m.
    """
    begin = known.lines.copy()
    has_merged = False
    most = np.array(_MOST_MOVED) + np.sqrt(known.covariance.diagonal()).reshape(-1, 2)
    while True:
        pairs = known.near_pairs()
        is_one = pairs.own >= np.minimum(MIN_OVERLAP, pairs.opposite)
        is_one |= pairs.evidence + prior_odds(*kinds) > SURE
        squared = pairs.squared
        cost = np.where(is_one & (squared < ONE_WALL_GATE), squared + pairs.volumes, np.inf)
        if not np.isfinite(cost).any():
            return has_merged
        known.merge(pairs, int(cost.argmin()))
        has_merged = True
        is_left = known.merged_into == np.arange(len(begin))
        if (np.abs(known.lines - begin) > most)[is_left].any():
            return True


def wall_kinds(known: Lines) -> tuple[float, float]:
    """Length of the lines that are boards, and length of the walls with two faces, m."""
    boards = np.maximum(known.seen[..., 1].min(axis=1) - known.seen[..., 0].max(axis=1), 0.0).sum()
    pairs = known.near_pairs(THICKEST)
    are_walls = (pairs.opposite > 0.0) & is_wall(pairs.evidence, pairs.behind)
    behind = np.zeros(len(known.lines))
    for line in (pairs.first, pairs.second):
        np.maximum.at(behind, line[are_walls], pairs.opposite[are_walls])
    return float(boards), 0.5 * float(behind.sum())


def board_evidence(behind: FloatArray, variance: FloatArray) -> FloatArray:
    """Logarithm (k,) of the Bayes factor of a board against a wall.

    Parameters
    ----------
    behind, variance
        How far the line that is seen from one side lies behind the line that is seen from the other
        side (k,), m, and the variance of that, m^2.
    """
    std = np.sqrt(variance)
    nearer = ndtr((THINNEST - behind) / std)
    farther = ndtr((THICKEST - behind) / std)
    wall = (farther - nearer) / (THICKEST - THINNEST) + ELSEWHERE
    return np.asarray(
        -0.5 * behind * behind / variance - np.log(math.sqrt(2.0 * math.pi) * std) - np.log(wall)
    )


def prior_odds(boards: float, walls: float) -> float:
    """Logarithm of the prior odds of a board, by the lengths of known boards and walls, m."""
    return math.log(max((boards + PRIOR_LENGTH) / (walls + PRIOR_LENGTH), LEAST_SHARE))


def is_wall(evidence: FloatArray, behind: FloatArray) -> BoolArray:
    """Whether two lines (k,) that are seen from opposite sides are the two faces of one wall, by
    their evidence alone.
    """
    return np.asarray((evidence < -SURE_OF_WALL) & (behind > 0.0) & (behind < THICKEST))


def _ends(seen: FloatArray) -> FloatArray:
    """Ends (k, 2) of the parts (k, 2, 2) of lines that were read from any side."""
    return np.column_stack((seen[..., 0].min(axis=1), seen[..., 1].max(axis=1)))


def _shared(one: FloatArray, other: FloatArray) -> FloatArray:
    """Lengths (...) of the stretches that parts (..., 2) of a line share, m; below 0 if they share
    none.
    """
    return np.asarray(
        np.minimum(one[..., 1], other[..., 1]) - np.maximum(one[..., 0], other[..., 0])
    )
