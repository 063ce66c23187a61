"""Agreement without ground truth: between loops, and between the observations of one place by
different visits.

Scores of right and wrong matches overlap, so that no threshold separates them. Agreement between
two loops does separate them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.map_graph.chunk_graph import Loop
from limslam_agent.slam.map_graph.key_poses import ANOTHER_VISIT, APART, KeyPoses, Trajectory
from limslam_agent.slam.map_graph.local_maps import chunk_middles, cut_chunks
from limslam_env.compilation import entry_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

AGREE_DISTANCE = 0.6
AGREE_TURN = math.radians(9.0)
"""Two loops agree if one predicts the other within these tolerances, m and rad."""

# A loop is supported by loops that begin and end so far from it, m driven.
_SUPPORT_FROM = 2.2
_SUPPORT_TO = 7.8
_STRETCH = 2  # chunks before and after a chunk


def supported(loops: Sequence[Loop], poses: FloatArray, travel: FloatArray) -> BoolArray:
    """Which loops (k,) are supported by another nearby loop that agrees and belongs to another
    chunk.

    ``poses`` (c, 3) and ``travel`` (c,) are the poses of the chunks and the distance driven up to
    each chunk, m.
    """
    if not loops:
        return np.zeros(0, dtype=np.bool_)
    first, second = np.array([(loop.first, loop.second) for loop in loops]).T
    relative = np.array([loop.relative for loop in loops])
    # Each loop (row) predicts each other one (column).
    before = se2.between(poses[first][None], poses[first][:, None])
    after = se2.between(poses[second][:, None], poses[second][None])
    predicted = se2.compose(se2.compose(before, relative[:, None]), after)
    apart = se2.between(predicted, np.broadcast_to(relative[None], predicted.shape))
    agree = (np.hypot(apart[..., 0], apart[..., 1]) < AGREE_DISTANCE) & (
        np.abs(apart[..., 2]) < AGREE_TURN
    )
    gaps = [np.abs(travel[ends][:, None] - travel[ends][None]) for ends in (first, second)]
    near = (gaps[0] <= _SUPPORT_TO) & (gaps[1] >= _SUPPORT_FROM) & (gaps[1] <= _SUPPORT_TO)
    return np.asarray((near & agree).any(axis=0))


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


def visit_counts(
    keys: KeyPoses,
    trajectory: Trajectory,
    config: GraphConfig,
    max_range: float,
    seam: int | None = None,
) -> VisitCounts:
    """How many points of each chunk other visits confirm and contradict.

    At a confirmed point at least as many other visits have seen a wall as free space, at a
    contradicted one fewer. If a second log begins at the key pose ``seam``, only visits of the
    other log count.
    """
    maps = config.maps
    middles = chunk_middles(keys, maps, maps.half)
    chunks = cut_chunks(keys, trajectory, maps, middles, max_range)
    points = np.array([len(each.points) for each in chunks])
    travel = keys.key_travel[middles] if seam is None else np.where(middles < seam, 0.0, APART)
    hits, frees = _votes(
        np.stack([each.grid for each in chunks]),
        chunks[0].low,
        maps.cell,
        np.concatenate([each.points for each in chunks]),
        np.append(0, np.cumsum(points)),
        trajectory.poses[middles],
        travel,
        ANOTHER_VISIT,
    )
    owner = np.repeat(np.arange(len(middles)), points)
    count = len(middles)
    confirmed = np.bincount(owner[(hits > 0) & (hits >= frees)], minlength=count)
    return VisitCounts(
        middles, points, confirmed, np.bincount(owner[frees > hits], minlength=count)
    )


@kernel
def _votes(
    grids: NDArray[np.int8],
    low: float,
    cell: float,
    points: FloatArray,
    starts: IntArray,
    poses: FloatArray,
    travel: FloatArray,
    another: float,
) -> tuple[IntArray, IntArray]:
    hits = np.zeros(len(points), np.int64)
    frees = np.zeros(len(points), np.int64)
    size = grids.shape[1]
    for q in range(len(poses)):
        for p in range(len(poses)):
            if abs(travel[p] - travel[q]) < another:
                continue
            dx = poses[q, 0] - poses[p, 0]
            dy = poses[q, 1] - poses[p, 1]
            cos = np.cos(poses[p, 2])
            sin = np.sin(poses[p, 2])
            x = cos * dx + sin * dy
            y = cos * dy - sin * dx
            cos = np.cos(poses[q, 2] - poses[p, 2])
            sin = np.sin(poses[q, 2] - poses[p, 2])
            for k in range(starts[q], starts[q + 1]):
                i = int(np.floor((cos * points[k, 0] - sin * points[k, 1] + x - low) / cell))
                j = int(np.floor((sin * points[k, 0] + cos * points[k, 1] + y - low) / cell))
                if 0 <= i < size and 0 <= j < size:
                    hits[k] += 1 if grids[p, i, j] > 0 else 0
                    frees[k] += 1 if grids[p, i, j] < 0 else 0
    return hits, frees
