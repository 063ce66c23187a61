"""Agreement without ground truth: between loops, and between the observations of one place by
different visits.

Scores of right and wrong matches overlap, so that no threshold separates them. Agreement between
two loops does separate them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.graph import LocalMapConfig
from limslam_agent.slam.map_graph.chunk_graph import Loop, relations_of
from limslam_agent.slam.map_graph.key_poses import APART, KeyPoses, Trajectory
from limslam_agent.slam.map_graph.local_maps import LocalMap, chunk_middles, cut_chunks
from limslam_agent.slam.map_graph.matching import (
    FAR_CELLS,
    SEEN,
    UNKNOWN_STD,
    least_known,
    lost_along,
    search_grid,
    variance_along,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

# Two poses agree within these tolerances, m and rad.
_DISTANCE = 0.6
_TURN = math.radians(9.0)
_SUPPORT_HOPS = 3  # chunks, at most, between the ends of loops that support each other
_SLACK = 0.3  # m, by which a hop is longer or shorter, since chunks begin with key poses
_AS_WELL = 9.0  # largest variance of a loop that supports another, in variances of that one
# Loops are free along a corridor from this share of the largest variance on. They are judged with
# those of the chunks up to so many m of driving before and after, in some steps.
_FREE = 0.5
_ROW = 12.5
_SHIFTS = 3
_STRETCH = 2  # chunks before and after a chunk


def agree(predicted: FloatArray, found: FloatArray, apart: FloatArray | float = 0.0) -> BoolArray:
    """Which of the poses (..., 3) are where they are predicted.

    The prediction may bridge a distance of ``apart`` (...) m in a map, each part of which may be
    bent.
    """
    off = se2.between(predicted, found)
    near = np.hypot(off[..., 0], off[..., 1]) < _DISTANCE + _TURN * apart
    return np.asarray(near & (np.abs(off[..., 2]) < _TURN))


def supported(
    loops: Sequence[Loop], poses: FloatArray, travel: FloatArray, hop: float
) -> BoolArray:
    """Which loops (k,) are supported by another nearby loop that agrees, is known about as well,
    and belongs to another chunk.

    ``poses`` (c, 3) and ``travel`` (c,) are the poses of the chunks and the distance driven up to
    each chunk, m, which is about a ``hop`` longer for each.
    """
    if not loops:
        return np.zeros(0, dtype=np.bool_)
    first, second = np.array([(loop.first, loop.second) for loop in loops]).T
    relative = np.array([loop.relative for loop in loops])
    # Each loop (row) predicts each other one (column).
    before = se2.between(poses[first][None], poses[first][:, None])
    after = se2.between(poses[second][:, None], poses[second][None])
    predicted = se2.compose(se2.compose(before, relative[:, None]), after)
    gaps = [np.abs(travel[ends][:, None] - travel[ends][None]) for ends in (first, second)]
    most = _SUPPORT_HOPS * hop + _SLACK
    near = (gaps[0] <= most) & (gaps[1] >= hop - _SLACK) & (gaps[1] <= most)
    # A loop that is free along a corridor agrees with any place along it.
    covariances = np.linalg.inv([loop.information for loop in loops])
    variances = np.trace(covariances[:, :2, :2], axis1=1, axis2=2)
    near &= variances[:, None] <= _AS_WELL * variances
    return np.asarray((near & agree(predicted, relative[None])).any(axis=0))


def judged_together(
    loops: Sequence[Loop], poses: FloatArray, maps: Sequence[LocalMap], config: LocalMapConfig
) -> list[Loop]:
    """The loops, of which those that are free along a corridor are judged together with those
    around.

    One chunk fits beside each of many equal rooms. Several in a row contradict all places but one.

    Parameters
    ----------
    loops
        The loops that agree.
    poses
        Poses (c, 3) of the chunks with all these loops.
    maps
        The chunks.
    config
        The settings of chunks.
    """
    if not loops:
        return []
    covariances = [np.asarray(np.linalg.inv(loop.information)) for loop in loops]
    along = np.array([least_known(each) for each in covariances])
    variances = np.einsum("li,lij,lj->l", along, covariances, along)
    free = np.flatnonzero(variances >= _FREE * UNKNOWN_STD**2).tolist()
    first, second = relations_of(loops)[0].T
    relative = se2.between(poses[first], poses[second])
    headings = poses[first] * (0.0, 0.0, 1.0)
    in_world = se2.compose(headings, along)[:, :2]
    travel = np.array([maps[each].travel for each in second])
    grids = {
        each: search_grid(maps[each].grid, config.cell, 0.0)
        for each in {*first[free].tolist(), *second[free].tolist()}
    }
    # Of shifts that lose as little, the least one counts.
    nearest = np.argsort(np.abs(np.arange(2 * FAR_CELLS + 1) - FAR_CELLS), kind="stable")
    judged = list(loops)
    for number in free:
        same = np.round(in_world @ in_world[number])
        row = [each for each in free if same[each] and abs(travel[each] - travel[number]) <= _ROW]
        # Neighbours show mostly the same.
        share = config.hop / config.length * len(set(second[row])) / len(row)
        shift = 0.0
        for _ in range(_SHIFTS):
            both = np.zeros((2, 2 * FAR_CELLS + 1))
            for each in row:
                one, other = first[each], second[each]
                way = same[each] * along[each]
                back = grids[other], maps[one].points
                pose = relative[each] + shift * way
                both += share * lost_along(grids[one], maps[other].points, pose, back, way)
            seen = both[1] >= SEEN * both[1, FAR_CELLS]
            best = int(nearest[np.argmin(np.where(seen, both[0], np.inf)[nearest])]) - FAR_CELLS
            if abs(best) <= 1:
                break
            shift += best * config.cell
        variance = len(row) * variance_along(both, config.cell)
        if abs(best) <= 1 and variance < variances[number]:
            way = along[number]
            loop = loops[number]
            moved = shift + way @ (relative[number] - loop.relative)
            known = covariances[number] + (variance - variances[number]) * np.outer(way, way)
            judged[number] = replace(
                loop,
                relative=loop.relative + moved * way,
                information=np.asarray(np.linalg.inv(known)),
            )
    return judged


@dataclass(frozen=True, eq=False)
class VisitCounts:
    """Numbers of all points, of confirmed and of contradicted points (c,) of the chunks with
    middles ``middles``.
    """

    middles: IntArray
    points: IntArray
    confirmed: IntArray
    contradicted: IntArray

    @property
    def shares(self) -> tuple[float, float]:
        """Shares of confirmed and of contradicted points among all points."""
        total = max(1, int(self.points.sum()))
        return float(self.confirmed.sum() / total), float(self.contradicted.sum() / total)

    def doubtful(self, seam: int = 0) -> IntArray:
        """Middles of the chunks around which points are contradicted more often than confirmed.

        Clutter does not explain that: the stretch lies at a wrong place. A second log begins at the
        key pose ``seam``: its chunks are not around those of the first log.
        """
        log = self.middles >= seam
        around = (np.abs(np.subtract.outer(places := np.arange(len(log)), places)) <= _STRETCH) & (
            log[:, None] == log
        )
        contradicted = around @ self.contradicted
        confirmed = around @ self.confirmed
        return self.middles[contradicted > confirmed]


def visit_counts(keys: KeyPoses, trajectory: Trajectory, seam: int | None = None) -> VisitCounts:
    """How many points of each chunk other visits confirm and contradict.

    At a confirmed point at least as many other visits have seen a wall as free space, at a
    contradicted one fewer. If a second log begins at the key pose ``seam``, only visits of the
    other log count.
    """
    maps = keys.config.maps
    middles = chunk_middles(keys, maps.half)
    chunks = cut_chunks(keys, trajectory, middles)
    poses = trajectory.poses[middles]
    numbers = np.array([len(each.points) for each in chunks])
    owner = np.repeat(np.arange(len(chunks)), numbers)
    places = np.concatenate(
        [se2.transform_points(pose, each.points) for pose, each in zip(poses, chunks, strict=True)]
    )
    travel = keys.key_travel[middles] if seam is None else np.where(middles < seam, 0.0, APART)
    hits = np.zeros(len(places), dtype=np.int64)
    frees = np.zeros(len(places), dtype=np.int64)
    for number, chunk in enumerate(chunks):
        others = (np.abs(travel - travel[number]) >= maps.another_visit)[owner]
        others &= np.abs(places - poses[number, :2]).max(axis=1) < chunk.cell * len(chunk.grid)
        grid = search_grid(chunk.grid, chunk.cell, 0.0)
        cells = grid.at(se2.transform_points(se2.inverse(poses[number]), places[others]))
        hits[others] += cells > 0
        frees[others] += cells < 0
    confirmed = np.bincount(owner[(hits > 0) & (hits >= frees)], minlength=len(chunks))
    contradicted = np.bincount(owner[frees > hits], minlength=len(chunks))
    return VisitCounts(middles, numbers, confirmed, contradicted)
