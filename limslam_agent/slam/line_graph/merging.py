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

from limslam_agent.slam.consistent.limits import MIN_OVERLAP, ONE_WALL_GATE, STRAIGHTNESS
from limslam_env.geometry import FloatArray, IntArray
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
_MOST_MOVED = (
    0.10,
    0.05,
)  # m and rad: the largest change of a line by merging before the problem is linearised again


class Pairs(NamedTuple):
    """Pairs of lines (k,) that are near each other."""

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
    side: IntArray  # the side of the second line that the opposite stretch was read from


class Difference(NamedTuple):
    """The first line of each pair about the second line's anchor, minus the second line.

    Attributes
    ----------
    values
        Offset and angle (k, 2), m and rad.
    columns, jacobian
        What they depend on: unknowns (k, 4) of the joint covariance, and derivatives (k, 2, 4).
    information
        Inverse covariances (k, 2, 2).
    """

    values: FloatArray
    columns: IntArray
    jacobian: FloatArray
    information: FloatArray

    @property
    def squared(self) -> FloatArray:
        """Squared Mahalanobis distances (k,)."""
        return np.asarray(np.einsum("ki,kij,kj->k", self.values, self.information, self.values))

    @property
    def volumes(self) -> FloatArray:
        """Logarithms (k,) of the determinants of the covariances."""
        return np.asarray(-np.log(np.linalg.det(self.information)))


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
        left = np.flatnonzero(
            (self.merged_into == np.arange(len(ends))) & (ends[:, 0] < ends[:, 1])
        )
        first, second = (left[each] for each in np.triu_indices(len(left), 1))
        is_parallel = (
            np.abs(angle_between(self.lines[first, 1] - self.lines[second, 1])) <= _MAX_ANGLE
        )
        first = first[is_parallel]
        second = second[is_parallel]
        seen = self._seen_along(first, second)
        there = self.seen[second]
        middle = self._points(second, ends[second].mean(axis=1))
        offset = (
            np.sum((middle - self.anchors[first]) * normal(self.lines[first]), axis=1)
            - self.lines[first, 0]
        )
        is_near = (np.abs(offset) <= max_offset) & (
            _shared(_ends(seen), ends[second]) >= MIN_OVERLAP
        )
        first = first[is_near]
        second = second[is_near]
        seen = seen[is_near]
        there = there[is_near]
        opposite = _shared(seen[:, ::-1], there)
        return Pairs(
            first,
            second,
            seen,
            _shared(seen, there).max(axis=1),
            opposite.max(axis=1),
            np.where(opposite[:, POSITIVE] >= opposite[:, NEGATIVE], POSITIVE, NEGATIVE),
        )

    def differences(self, pairs: Pairs) -> Difference:
        """The differences of the lines of each pair."""
        (one, other), count = (self.lines[pairs.first], self.lines[pairs.second]), len(pairs.first)
        away = self.anchors[pairs.second] - self.anchors[pairs.first]
        sign = np.where(np.cos(one[:, 1] - other[:, 1]) < 0.0, -1.0, 1.0)
        offset = sign * (one[:, 0] - np.sum(away * normal(one), axis=1)) - other[:, 0]
        jacobian = np.zeros((count, 2, 4))
        jacobian[:, 0, 0] = sign
        jacobian[:, 0, 2] = -1.0
        jacobian[:, 0, 1] = -sign * np.sum(away * direction(one), axis=1)
        jacobian[:, 1, 1] = 1.0
        jacobian[:, 1, 3] = -1.0
        columns = 2 * np.column_stack(
            (pairs.first, pairs.first, pairs.second, pairs.second)
        ) + np.array([0, 1, 0, 1])
        joint = self.covariance[columns[:, :, None], columns[:, None, :]]
        covariance = jacobian @ joint @ jacobian.swapaxes(1, 2) + np.diag(STRAIGHTNESS)
        values = np.column_stack((offset, angle_between(one[:, 1] - other[:, 1])))
        return Difference(values, columns, jacobian, np.linalg.inv(covariance))

    def merge(self, pairs: Pairs, difference: Difference, which: int) -> None:
        """Make the lines of a pair equal, by a Kalman update of all lines with their difference,
        which is zero.
        """
        crossed = self.covariance[:, difference.columns[which]] @ difference.jacobian[which].T
        gain = crossed @ difference.information[which]
        moves = gain @ difference.values[which]
        self.lines -= moves.reshape(-1, 2)
        self.covariance -= gain @ crossed.T
        own = self.seen[pairs.second[which]]
        own[:, 0] = np.minimum(own[:, 0], pairs.seen[which, :, 0])
        own[:, 1] = np.maximum(own[:, 1], pairs.seen[which, :, 1])
        self.merged_into[self.merged_into == pairs.first[which]] = pairs.second[which]

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
    chi-square test easily. Two lines that were read from opposite sides only are merged if they are
    a board. Merging ends when a line has moved far: the problem must then be linearised again.

    Parameters
    ----------
    known
        The lines, which are changed.
    kinds
        The lengths of the known boards and walls, m.
    """
    begin = known.lines.copy()
    has_merged = False
    most = np.array(_MOST_MOVED) + np.sqrt(known.covariance.diagonal()).reshape(-1, 2)
    while True:
        pairs = known.near_pairs()
        difference = known.differences(pairs)
        squared = difference.squared
        cost = squared + difference.volumes
        likely = np.flatnonzero(squared < ONE_WALL_GATE)
        ordered = likely[np.argsort(cost[likely])].tolist()
        best = next((k for k in ordered if _is_one_line(pairs, difference, k, kinds)), None)
        if best is None:
            return has_merged
        known.merge(pairs, difference, best)
        has_merged = True
        is_left = known.merged_into == np.arange(len(begin))
        if (np.abs(known.lines - begin) > most)[is_left].any():
            return has_merged


def wall_kinds(known: Lines) -> tuple[float, float]:
    """Length of the lines that are boards, and length of the walls with two faces, m."""
    boards = np.maximum(known.seen[..., 1].min(axis=1) - known.seen[..., 0].max(axis=1), 0.0).sum()
    pairs = known.near_pairs(THICKEST)
    difference = known.differences(pairs)
    behind = np.zeros(len(known.lines))
    for k in np.flatnonzero(pairs.opposite > 0.0).tolist():
        if is_wall(*_compared(pairs, difference, k)):
            own = [pairs.first[k], pairs.second[k]]
            behind[own] = np.maximum(behind[own], pairs.opposite[k])
    return float(boards), 0.5 * float(behind.sum())


def _is_one_line(
    pairs: Pairs, difference: Difference, which: int, kinds: tuple[float, float]
) -> bool:
    """Whether the lines of a pair share a stretch that was read from one side, or are a board."""
    if pairs.own[which] >= min(MIN_OVERLAP, pairs.opposite[which]):
        return True
    return board_odds(_compared(pairs, difference, which)[0], *kinds) > SURE


def _compared(pairs: Pairs, difference: Difference, which: int) -> tuple[float, float]:
    """Evidence of a board in two lines that were read from opposite sides, and how far behind the
    first one lies, m.

    The two lines are taken to be parallel.
    """
    (offset, angle), information = difference.values[which].tolist(), difference.information[which]
    offset += float(information[0, 1] / information[0, 0]) * angle
    behind = -offset if pairs.side[which] == POSITIVE else offset
    return board_evidence(behind, 1.0 / float(information[0, 0])), behind


def board_evidence(behind: float, variance: float) -> float:
    """Logarithm of the Bayes factor of a board against a wall.

    Parameters
    ----------
    behind, variance
        How far the line that is seen from one side lies behind the line that is seen from the other
        side, m, and the variance of that, m^2.
    """
    std = math.sqrt(variance)
    nearer = math.erf((THINNEST - behind) / (math.sqrt(2.0) * std))
    farther = math.erf((THICKEST - behind) / (math.sqrt(2.0) * std))
    wall = 0.5 * (farther - nearer) / (THICKEST - THINNEST) + ELSEWHERE
    return (
        -0.5 * behind * behind / variance
        - math.log(math.sqrt(2.0 * math.pi) * std)
        - math.log(wall)
    )


def board_odds(evidence: float, boards: float, walls: float) -> float:
    """Logarithm of the posterior odds of a board, given its evidence and the lengths of known
    boards and walls, m.
    """
    return evidence + math.log(max((boards + PRIOR_LENGTH) / (walls + PRIOR_LENGTH), LEAST_SHARE))


def is_wall(evidence: float, behind: float) -> bool:
    """Whether two lines that are seen from opposite sides are the two faces of one wall, by their
    evidence alone.
    """
    return evidence < -SURE_OF_WALL and 0.0 < behind < THICKEST


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
