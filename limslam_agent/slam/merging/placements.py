"""Placements of a second log in a first one: groups of local maps whose places agree, compared by free ground.

A placement is judged by what both logs say of the same ground. A point of a wall is confirmed where the other log has
seen a wall, and contradicted where the other log has looked through. Placements with few confirmed points, with many
contradicted points, or with another placement that is nearly as good do not count.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from limslam_agent.slam.graph.agreement import MapScore
from limslam_agent.slam.graph.chunk_graph import Hops, Loop, solve_annealed
from limslam_agent.slam.merging.chains import APART
from limslam_agent.slam.merging.placing import Candidate, Pieces
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

# Two local maps agree if the place of one predicts the place of the other within this distance, m, which grows by a
# share of the distance between them, and within this turn, rad.
_AGREE_DISTANCE, _AGREE_GROWTH, _AGREE_TURN = 0.7, 0.05, math.radians(9.0)
_MOST_PLACEMENTS = 30  # that are compared
_CONTRADICTION = 2.0  # price of a contradicted point, in confirmed points
_HOP_STD = np.array([0.15, 0.15, np.radians(1.5)])
_SEAM_STD = np.array([100.0, 100.0, 10.0])
_LOOP_STD = np.array([0.15, 0.15, np.radians(2.0)])
_GROWTHS = 3


@dataclass(frozen=True, eq=False)
class Placement:
    """A placement of the second log.

    Attributes
    ----------
    poses
        Poses (c, 3) of the second log's local maps in the first log's frame.
    members
        The places of its local maps that agree with it.
    confirmed, contradicted
        Points of both logs that the other log confirms and contradicts.
    """

    poses: FloatArray
    members: list[Candidate]
    confirmed: int
    contradicted: int

    @property
    def contradicted_share(self) -> float:
        """Share of the contradicted points among those that the other log has seen."""
        return self.contradicted / max(self.confirmed + self.contradicted, 1)

    @property
    def value(self) -> float:
        """Confirmed points less the price of contradicted points."""
        return self.confirmed - _CONTRADICTION * self.contradicted


def placements(known: Pieces, local: Pieces, found: Sequence[Candidate]) -> list[Placement]:
    """The placements of the second log, the best one first."""
    if not found:
        return []
    agree = _agreements(local, found)
    pieces, scores = np.array([each.piece for each in found]), np.array([each.score for each in found])
    support = np.array([_support(row, pieces, scores) for row in agree])
    judge, placed = CrossScore.of(known, local), list[Placement]()
    free = support > 0.0
    while free.any() and len(placed) < _MOST_PLACEMENTS:
        seed = int(np.argmax(np.where(free, support, -1.0)))
        members = [found[seed], *(found[k] for k in _members(agree[seed], pieces, scores))]
        placement = _grown(members, known, local, found, judge)
        if not any(_same(placement, other) for other in placed):
            placed.append(placement)
        free &= ~agree[seed]
        free[seed] = False
    return sorted(placed, key=lambda each: -each.value)


def _agreements(local: Pieces, found: Sequence[Candidate]) -> BoolArray:
    """Which places (k, k) of local maps agree, those of the same local map excluded."""
    pieces, poses = np.array([each.piece for each in found]), np.array([each.pose for each in found])
    between = se2.between(local.poses[pieces][:, None], local.poses[pieces][None])
    off = se2.between(se2.compose(poses[:, None], between), np.broadcast_to(poses[None], between.shape))
    far = _AGREE_DISTANCE + _AGREE_GROWTH * np.hypot(between[..., 0], between[..., 1])
    agree = (np.hypot(off[..., 0], off[..., 1]) < far) & (np.abs(off[..., 2]) < _AGREE_TURN)
    return np.asarray(agree & agree.T & (pieces[:, None] != pieces[None]))


def _support(agree: BoolArray, pieces: IntArray, scores: FloatArray) -> float:
    best = np.zeros(pieces.max() + 1)
    np.maximum.at(best, pieces[agree], scores[agree])
    return float(best.sum())


def _members(chosen: BoolArray, pieces: IntArray, scores: FloatArray) -> list[int]:
    """The best of the chosen places of each local map."""
    best: dict[int, int] = {}
    for k in np.flatnonzero(chosen)[np.argsort(-scores[chosen], kind="stable")]:
        best.setdefault(int(pieces[k]), int(k))
    return list(best.values())


def _grown(
    members: list[Candidate],
    known: Pieces,
    local: Pieces,
    found: Sequence[Candidate],
    judge: "CrossScore",
) -> Placement:
    """A placement by the graph of both logs' local maps, and of the places that agree with the solution."""
    pieces, scores = np.array([each.piece for each in found]), np.array([each.score for each in found])
    places = np.array([each.pose for each in found])
    poses = local.poses
    for _ in range(_GROWTHS):
        poses = solved(known, local.poses, members)
        off = se2.between(poses[pieces], places)
        near = (np.hypot(off[:, 0], off[:, 1]) < _AGREE_DISTANCE) & (np.abs(off[:, 2]) < _AGREE_TURN)
        if not near.any():
            break
        members = [found[k] for k in _members(near, pieces, scores)]
    return Placement(poses, members, *judge(poses))


def solved(known: Pieces, local: FloatArray, members: Sequence[Candidate]) -> FloatArray:
    """Poses (c, 3) of the second log's local maps by the places of some of them.

    The motions between the local maps are those between the poses ``local`` (c, 3). The first log stays where it is.
    """
    # The first log is one fixed pose, and the second log a chain that the places of its members hold.
    best = max(members, key=lambda each: each.score)
    motion = se2.compose(best.pose, se2.inverse(local[best.piece]))
    poses = np.vstack((known.poses[:1], se2.compose(motion, local)))
    covariances = np.tile(np.diag(_HOP_STD**2), (len(poses) - 1, 1, 1))
    covariances[0] = np.diag(_SEAM_STD**2)
    information = np.diag(_LOOP_STD**-2.0)
    loops = [
        Loop(0, each.piece + 1, se2.between(poses[0], each.pose), information, each.score, "placement")
        for each in members
    ]
    hops = Hops(se2.between(poses[:-1], poses[1:]), covariances)
    return solve_annealed(poses[0], hops, loops).poses[1:]


def _same(one: Placement, other: Placement) -> bool:
    """Whether two placements put most of the second log at the same place."""
    off = se2.between(one.poses, other.poses)
    return float(np.median(np.hypot(off[:, 0], off[:, 1]))) < 2.0 * _AGREE_DISTANCE and (
        float(np.median(np.abs(off[:, 2]))) < _AGREE_TURN
    )


@dataclass(frozen=True, eq=False)
class CrossScore:
    """Counts the points of each log that the other log confirms and contradicts."""

    score: MapScore
    known: FloatArray

    @classmethod
    def of(cls, known: Pieces, local: Pieces) -> "CrossScore":
        """The counts for two logs. Points of overlapping local maps count once for each of them."""
        score = MapScore.of([*known.maps, *local.maps])
        travel = np.append(np.zeros(len(known.maps)), np.full(len(local.maps), APART))
        return cls(
            MapScore(score.grids, score.low, score.cell, score.points, score.starts, travel),
            known.poses,
        )

    def __call__(self, poses: FloatArray) -> tuple[int, int]:
        """Confirmed and contradicted points for poses (c, 3) of the second log's local maps."""
        confirmed, contradicted = self.score.verdicts(np.vstack((self.known, poses)))
        return int(confirmed.sum()), int(contradicted.sum())
