"""Agreement without ground truth: of loops along a corridor, and of what different visits of one
place have observed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from limslam_agent.config.graph import LocalMapConfig
from limslam_agent.slam.map_graph.key_poses import APART, KeyPoses, Trajectory
from limslam_agent.slam.map_graph.local_maps import LocalMap, chunk_middles, cut_chunks
from limslam_agent.slam.map_graph.loops import Loop, relations_of
from limslam_agent.slam.map_graph.matching import (
    FAR_CELLS,
    SEEN,
    UNKNOWN_STD,
    least_known,
    lost_along,
    search_grid,
    variance_along,
)
from limslam_env.geometry import FloatArray, IntArray, se2

# Loops are free along a corridor from this share of the largest variance on. They are judged with
# those of the chunks up to so many m of driving before and after, in some steps.
_FREE = 0.5
_ROW = 12.5
_SHIFTS = 3
_STRETCH = 2  # chunks before and after a chunk


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
