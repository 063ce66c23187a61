"""The placement of a second log in the first one: places of its local maps that agree, compared with other placements.

The second log may bend: its local maps are a chain, and their places hold it like loops. A point of either log is
confirmed where the other log has seen a wall, and contradicted where the other log has looked through.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.slam.graph.agreement import MapScore
from limslam_agent.slam.graph.chunk_graph import Hops, Loop, solve_annealed
from limslam_agent.slam.graph.key_poses import APART
from limslam_agent.slam.merging.placing import Candidate, Pieces
from limslam_env.geometry import BoolArray, FloatArray, se2

# Two local maps agree if the place of one predicts the place of the other within this distance, m, which grows by a
# share of the distance between them, and within this turn, rad.
_AGREE_DISTANCE, _AGREE_GROWTH, _AGREE_TURN = 0.7, 0.05, math.radians(9.0)
_MOST_PLACEMENTS = 30  # that are compared
_CONTRADICTION = 2.0  # price of a contradicted point, in confirmed points
# Standard deviations of a motion between local maps, of the unknown start, and of a place: m, m, rad.
_HOP_STD = np.array([0.15, 0.15, np.radians(1.5)])
_SEAM_STD = np.array([100.0, 100.0, 10.0])
_PLACE_STD = np.array([0.15, 0.15, np.radians(2.0)])


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
    pieces = np.array([each.piece for each in found])
    support = np.array([len(np.unique(pieces[row])) for row in agree])
    placed, free = list[Placement](), support > 0
    while free.any() and len(placed) < _MOST_PLACEMENTS:
        seed = int(np.argmax(np.where(free, support, -1)))
        members = _best_of_each([found[seed], *(found[k] for k in np.flatnonzero(agree[seed]).tolist())])
        poses = _solved(known, local.poses, members)
        if not any(_same(poses, other.poses) for other in placed):
            placed.append(Placement(poses, members, *cross_counts(known, local, poses)))
        free &= ~agree[seed]
        free[seed] = False
    return sorted(placed, key=lambda each: -each.value)


def cross_counts(known: Pieces, local: Pieces, poses: FloatArray) -> tuple[int, int]:
    """Numbers of points of both logs that the other log confirms and contradicts, with the second log at ``poses``.

    Points of overlapping local maps count once for each of them.
    """
    travel = np.append(np.zeros(len(known.maps)), np.full(len(local.maps), APART))
    score = replace(MapScore.of([*known.maps, *local.maps]), travel=travel)
    confirmed, contradicted = score.verdicts(np.vstack((known.poses, poses)))
    return int(confirmed.sum()), int(contradicted.sum())


def _agreements(local: Pieces, found: Sequence[Candidate]) -> BoolArray:
    """Which places (k, k) of local maps agree, those of the same local map excluded."""
    pieces, poses = np.array([each.piece for each in found]), np.array([each.pose for each in found])
    between = se2.between(local.poses[pieces][:, None], local.poses[pieces][None])
    off = se2.between(se2.compose(poses[:, None], between), np.broadcast_to(poses[None], between.shape))
    far = _AGREE_DISTANCE + _AGREE_GROWTH * np.hypot(between[..., 0], between[..., 1])
    agree = (np.hypot(off[..., 0], off[..., 1]) < far) & (np.abs(off[..., 2]) < _AGREE_TURN)
    return np.asarray(agree & agree.T & (pieces[:, None] != pieces[None]))


def _best_of_each(places: Sequence[Candidate]) -> list[Candidate]:
    """The best place of each local map."""
    best = {each.piece: each for each in sorted(places, key=lambda each: each.score)}
    return list(best.values())


def _solved(known: Pieces, local: FloatArray, members: Sequence[Candidate]) -> FloatArray:
    """Poses (c, 3) of the second log's local maps by the places of some of them.

    The motions between the local maps are those between the poses ``local`` (c, 3). The first log stays where it is.
    """
    # The first log is one fixed pose, and the second log a chain that the places of its members hold.
    best = max(members, key=lambda each: each.score)
    motion = se2.compose(best.pose, se2.inverse(local[best.piece]))
    poses = np.vstack((known.poses[:1], se2.compose(motion, local)))
    covariances = np.tile(np.diag(_HOP_STD**2), (len(poses) - 1, 1, 1))
    covariances[0] = np.diag(_SEAM_STD**2)
    information = np.diag(_PLACE_STD**-2.0)
    loops = [Loop(0, each.piece + 1, se2.between(poses[0], each.pose), information, each.score) for each in members]
    hops = Hops(se2.between(poses[:-1], poses[1:]), covariances)
    return solve_annealed(poses[0], hops, loops).poses[1:]


def _same(one: FloatArray, other: FloatArray) -> bool:
    """Whether two placements put most of the second log's local maps (c, 3) at the same places."""
    off = se2.between(one, other)
    return float(np.median(np.hypot(off[:, 0], off[:, 1]))) < 2.0 * _AGREE_DISTANCE and (
        float(np.median(np.abs(off[:, 2]))) < _AGREE_TURN
    )
