"""Agreement without ground truth: between loops, and between the observations of one place by different visits.

Scores of right and wrong matches overlap, so that no threshold separates them. Agreement between two loops does
separate them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.chunk_graph import (
    KEPT_WEIGHT,
    ChunkSolution,
    Hops,
    Loop,
    Strain,
    refine,
    solve_annealed,
)
from limslam_agent.slam.graph.key_poses import KeyPoses, Trajectory
from limslam_agent.slam.graph.local_maps import LocalMap, chunk_middles, cut_chunks
from limslam_env.compilation import entry_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

NO_SUPPORT = "no other loop nearby agrees"
REMOVED = "the map agrees better with itself without it"
NOT_ADDED = "the map does not agree better with itself with it"
CONTRADICTED = "visits contradict each other where it joins them"
OUTVOTED = "its weight in the graph of chunks is too low"
KEPT = "kept"

# Two loops agree if one predicts the other within these tolerances, m and rad. A loop is supported by loops that begin
# and end so far from it, m driven.
_AGREE_DISTANCE, _AGREE_TURN = 0.6, math.radians(9.0)
_SUPPORT_FROM, _SUPPORT_TO = 2.2, 7.8
# Tolerances of agreement within a group, m and rad, and largest distance between its loops, in chunks.
_GROUP_DISTANCE, _GROUP_TURN, _GROUP_CHUNKS = 0.7, math.radians(10.0), 3
_MIN_TRAVEL, _MAX_DISTANCE = 13.5, 13.0  # m: visits are compared from this distance driven on, up to this distance
_MAX_GROUPS, MAX_GROUP = 40, 8  # groups that are tried, and loops in a group
_MOST_DOUBTS = 8  # groups whose removal is tried in a pass
PRUNE_GAIN = 0.002
"""A group of loops is removed if its removal raises the score by this."""
DOUBTFUL_SHARE = 0.12
"""A group of loops is refused if visits contradict a larger share of the points that are judged because of it, and much
more than is usual."""

_MUCH_MORE = 8.0
"""A stretch is wrong rather than cluttered if it is contradicted this many times as often as the rest of the log."""

_LEAST_USUAL = 0.01  # the share of contradicted points that is expected at least
_LEAST_JUDGED = 100  # fewer points are not judged
# A group that bends the path by this chi-square (99 % of three degrees of freedom) must not add more contradictions
# than this many times what is usual.
_BENT, _MORE = 11.3, 2.0
_LEAST_SEEN = 0.2  # share of the log's points that other visits must have seen, to know what is usual
_OFTEN_USUAL = 0.04  # what is taken as usual until then; 2 to 8 % in most logs
_STRETCH = 2  # chunks before and after a chunk
_USUAL = 0.75  # quantile of the shares of all stretches
_MOSTLY = 0.5  # a stretch of which a larger share is contradicted is wrong, whatever is usual


@dataclass(frozen=True, eq=False)
class LoopVerdict:
    """A loop that was found in the round of the result, and its status: ``KEPT``, or the reason for its rejection."""

    loop: Loop
    reason: str

    @property
    def kept(self) -> bool:
        """Whether the loop is part of the result."""
        return self.reason == KEPT


def agreements(loops: Sequence[Loop], poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors with which each loop (row) predicts each other loop (column).

    Returns distances (k, k), m, and angles (k, k), rad.

    The relative poses between the ends of the loops are computed from ``poses`` (c, 3).
    """
    first, second = np.array([loop.first for loop in loops]), np.array([loop.second for loop in loops])
    relative = np.array([loop.relative for loop in loops])
    before = se2.between(poses[first][None], poses[first][:, None])
    after = se2.between(poses[second][:, None], poses[second][None])
    predicted = se2.compose(se2.compose(before, relative[:, None]), after)
    apart = se2.between(predicted, np.broadcast_to(relative[None], predicted.shape))
    return np.hypot(apart[..., 0], apart[..., 1]), np.abs(apart[..., 2])


def supported(loops: Sequence[Loop], poses: FloatArray, travel: FloatArray) -> BoolArray:
    """Which loops (k,) are supported by another nearby loop that agrees and belongs to another chunk.

    ``travel`` (c,) is the distance driven up to each chunk, m.
    """
    if not loops:
        return np.zeros(0, dtype=np.bool_)
    distance, angle = agreements(loops, poses)
    first = travel[[loop.first for loop in loops]]
    second = travel[[loop.second for loop in loops]]
    gap = np.abs(second[:, None] - second[None])
    near = (gap >= _SUPPORT_FROM) & (gap <= _SUPPORT_TO)
    near &= np.abs(first[:, None] - first[None]) <= _SUPPORT_TO
    agree = (distance < _AGREE_DISTANCE) & (angle < _AGREE_TURN)
    return np.asarray((near & agree).any(axis=0))


def groups_of(loops: Sequence[Loop], poses: FloatArray) -> list[list[int]]:
    """Groups of loops that agree, directly or through other loops. The first loop of the group comes first."""
    distance, angle = agreements(loops, poses)
    first, second = np.array([loop.first for loop in loops]), np.array([loop.second for loop in loops])
    near = np.abs(first[:, None] - first[None]) <= _GROUP_CHUNKS
    near &= np.abs(second[:, None] - second[None]) <= _GROUP_CHUNKS
    joined = near & (distance < _GROUP_DISTANCE) & (angle < _GROUP_TURN)
    label = np.arange(len(loops))
    for row in range(len(loops)):
        for column in np.nonzero(joined[row] | joined[:, row])[0]:
            label[label == label[column]] = label[row]
    return [list(map(int, np.nonzero(label == each)[0])) for each in dict.fromkeys(label.tolist())]


def distances_after_alignment(poses: FloatArray, others: FloatArray) -> FloatArray:
    """Distances (m,) between the positions of two paths (m, 3), after the rigid motion that fits them best."""
    places, targets = poses[:, :2] - poses[:, :2].mean(axis=0), others[:, :2] - others[:, :2].mean(axis=0)
    products = places.T @ targets
    angle = np.arctan2(products[0, 1] - products[1, 0], products[0, 0] + products[1, 1])
    moved = se2.transform_points(np.array([0.0, 0.0, angle]), places)
    return np.asarray(np.hypot(*(moved - targets).T))


@dataclass(frozen=True, eq=False)
class MapScore:
    """The score G of a set of chunks, as a function of their poses.

    Attributes
    ----------
    grids
        Cells (c, n, n) of the grids of all chunks.
    low, cell
        Lowest coordinate and cell side of the grids, m.
    points, starts
        Points (p, 2) of all chunks, m, sorted by chunk; and the index (c + 1,) of each chunk's first point.
    travel
        Distance (c,) driven up to each chunk, m.
    strain
        What is subtracted because the path bends away from the local smoothing. None for nothing.
    """

    grids: NDArray[np.int8]
    low: float
    cell: float
    points: FloatArray
    starts: IntArray
    travel: FloatArray
    strain: Strain | None = None

    @classmethod
    def of(cls, maps: Sequence[LocalMap]) -> "MapScore":
        """The score of these chunks."""
        return cls(
            grids=np.stack([each.grid for each in maps]),
            low=maps[0].low,
            cell=maps[0].cell,
            points=np.concatenate([each.points for each in maps]),
            starts=np.cumsum([0, *[len(each.points) for each in maps]]),
            travel=np.array([each.travel for each in maps]),
        )

    def verdicts(self, poses: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Masks (p,) of the confirmed and of the contradicted points.

        At a confirmed point more other visits have seen a wall than free space, at a contradicted point fewer.
        """
        far = np.array([_MIN_TRAVEL, _MAX_DISTANCE])
        hits, frees = _votes(
            self.grids, self.low, self.cell, self.points, self.starts, np.ascontiguousarray(poses), self.travel, far
        )
        return (hits > 0) & (hits >= frees), frees > hits

    def __call__(self, poses: FloatArray) -> float:
        """Share of points that other visits confirm, minus the share that they contradict, minus the strain.

        ``poses`` (c, 3) are those of the chunks.
        """
        confirmed, contradicted = self.verdicts(poses)
        agreed = float(confirmed.mean() - contradicted.mean())
        return agreed if self.strain is None else agreed - self.strain(poses)


@dataclass(frozen=True)
class Evidence:
    """What speaks for and against a map.

    Attributes
    ----------
    points, confirmed, contradicted
        Numbers of all points, and of those that other visits confirm and contradict.
    bend
        By how much the path is bent away from the local smoothing, as a chi-square.
    """

    points: int
    confirmed: int
    contradicted: int
    bend: float

    @property
    def known(self) -> int:
        """Number of the points that other visits have seen."""
        return self.confirmed + self.contradicted

    @property
    def says_what_is_usual(self) -> bool:
        """Whether other visits have seen so many points that their contradictions say what is usual in this log."""
        return self.known > _LEAST_SEEN * self.points

    def adds_contradictions(self, other: "Evidence", least: float) -> bool:
        """Whether visits contradict each other much more where they meet in this map, but not in another one.

        The walls of two similar corridors confirm each other, so the score of a map rises if they are laid onto each
        other. But then a larger share of the additional points is contradicted than in the other map: more than
        ``least`` and much more than is usual there, or, if this path is bent more, more than twice what is usual.
        """
        usual = other.contradicted / other.known if other.says_what_is_usual else _OFTEN_USUAL
        bent = self.bend - other.bend > _BENT
        most = _MORE * max(usual, _LEAST_USUAL) if bent else _largest_usual(usual, least)
        judged = self.known - other.known
        return judged >= _LEAST_JUDGED and self.contradicted - other.contradicted > most * judged


@dataclass(frozen=True, eq=False)
class VisitCounts:
    """Numbers of all points, of confirmed and of contradicted points (c,) of the chunks with middles ``middles``."""

    middles: IntArray
    points: IntArray
    confirmed: IntArray
    contradicted: IntArray

    @property
    def shares(self) -> tuple[float, float]:
        """Shares of confirmed and of contradicted points among all points."""
        total = max(1, int(self.points.sum()))
        return float(self.confirmed.sum() / total), float(self.contradicted.sum() / total)

    def doubtful(self, least: float, seam: int = 0) -> IntArray:
        """Middles of the chunks around which points are contradicted much more often than in the rest of the log.

        There, a larger share than ``least`` of the points that other visits have seen is contradicted. In a cluttered
        building, points are contradicted everywhere. Where a corridor was laid onto a similar corridor, visits
        contradict each other there only. Where points are contradicted more often than confirmed, the stretch lies at a
        wrong place: clutter does not explain that, and in a short log such a stretch makes many contradictions look
        usual. A second log begins at the key pose ``seam``: its chunks are not around those of the first log.
        """
        log = self.middles >= seam
        around = (np.abs(np.subtract.outer(places := np.arange(len(log)), places)) <= _STRETCH) & (log[:, None] == log)
        contradicted = around @ self.contradicted
        judged = contradicted + around @ self.confirmed
        share = np.where(judged >= _LEAST_JUDGED, contradicted / np.maximum(judged, 1), 0.0)
        return self.middles[share > min(_MOSTLY, _largest_usual(float(np.quantile(share, _USUAL)), least))]


def _largest_usual(usual: float, least: float) -> float:
    """The largest share of contradicted points that clutter explains in a log with this usual share."""
    return max(least, _MUCH_MORE * max(usual, _LEAST_USUAL))


def visit_counts(keys: KeyPoses, trajectory: Trajectory, config: GraphConfig, max_range: float) -> VisitCounts:
    """How many points of each chunk other visits confirm and contradict.

    The chunks have middles that are ``config.maps.half`` apart.
    """
    middles = chunk_middles(keys, config.maps, config.maps.half)
    score = MapScore.of(cut_chunks(keys, trajectory, config.maps, middles, max_range))
    points = np.diff(score.starts)
    owner = np.repeat(np.arange(len(middles)), points)
    verdicts = score.verdicts(trajectory.poses[middles])
    confirmed, contradicted = (np.bincount(owner[each], minlength=len(middles)) for each in verdicts)
    return VisitCounts(middles, points, confirmed, contradicted)


@kernel
def _votes(
    grids: NDArray[np.int8],
    low: float,
    cell: float,
    points: FloatArray,
    starts: IntArray,
    poses: FloatArray,
    travel: FloatArray,
    far: FloatArray,
) -> tuple[IntArray, IntArray]:
    hits, frees = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    size = grids.shape[1]
    for q in range(len(poses)):
        for p in range(len(poses)):
            dx, dy = poses[q, 0] - poses[p, 0], poses[q, 1] - poses[p, 1]
            if abs(travel[p] - travel[q]) < far[0] or dx * dx + dy * dy > far[1] * far[1]:
                continue
            cos, sin = np.cos(poses[p, 2]), np.sin(poses[p, 2])
            x, y = cos * dx + sin * dy, cos * dy - sin * dx
            cos, sin = np.cos(poses[q, 2] - poses[p, 2]), np.sin(poses[q, 2] - poses[p, 2])
            for k in range(starts[q], starts[q + 1]):
                i = int(np.floor((cos * points[k, 0] - sin * points[k, 1] + x - low) / cell))
                j = int(np.floor((sin * points[k, 0] + cos * points[k, 1] + y - low) / cell))
                if 0 <= i < size and 0 <= j < size:
                    hits[k] += 1 if grids[p, i, j] > 0 else 0
                    frees[k] += 1 if grids[p, i, j] < 0 else 0
    return hits, frees


@dataclass(frozen=True, eq=False)
class Decision:
    """The result of a decision about groups of loops.

    Attributes
    ----------
    loops
        The loops of the graph after the decision.
    solution
        The solution of the graph with these loops.
    dropped
        Loops that were rejected or removed.
    """

    loops: list[Loop]
    solution: ChunkSolution
    dropped: list[Loop]


def prune_groups(poses: FloatArray, hops: Hops, loops: list[Loop], score: MapScore) -> Decision:
    """Remove small groups of loops if the score of the map rises without them.

    The groups with the largest share of contradicted points around them are tried. The loops are grouped by ``poses``
    (c, 3), the poses of the chunks in the trajectory.
    """
    dropped = list[Loop]()
    solution = solve_annealed(poses[0], hops, loops)
    value = score(solution.poses)
    for _ in range(3):
        groups = [each for each in groups_of(loops, poses) if len(each) <= MAX_GROUP]
        doubts = _contradictions(groups, loops, score, solution.poses)
        best: tuple[float, list[int], ChunkSolution] | None = None
        for place in np.argsort(-doubts, kind="stable")[:_MOST_DOUBTS]:
            rest = [loop for number, loop in enumerate(loops) if number not in groups[place]]
            if not rest:
                continue
            trial = solve_annealed(poses[0], hops, rest)
            gained = score(trial.poses)
            if gained > (best[0] if best else value + PRUNE_GAIN):
                best = gained, groups[place], trial
        if best is None:
            break
        value, out, solution = best
        dropped += [loops[number] for number in out]
        loops = [loop for number, loop in enumerate(loops) if number not in out]
    return Decision(loops, solution, dropped)


def _contradictions(groups: list[list[int]], loops: Sequence[Loop], score: MapScore, poses: FloatArray) -> FloatArray:
    """For each group, the share of contradicted points among all confirmed or contradicted points around its loops."""
    confirmed, contradicted = score.verdicts(poses)
    shares = np.zeros(len(groups))
    for row, group in enumerate(groups):
        around = np.zeros(len(confirmed), dtype=np.bool_)
        for number in group:
            for end in (loops[number].first, loops[number].second):
                low, high = max(0, end - 4), min(len(poses), end + 5)
                around[score.starts[low] : score.starts[high]] = True
        judged = ((confirmed | contradicted) & around).sum()
        shares[row] = (contradicted & around).sum() / max(1, judged)
    return shares


def plausible_groups(
    chain: tuple[FloatArray, Hops],
    placed: Decision,
    new: Sequence[Sequence[Loop]],
    score: MapScore,
) -> tuple[list[list[Loop]], list[Loop]]:
    """New groups of loops that may be right, and the loops of the other groups.

    A group is refused if it adds contradictions, as :meth:`Evidence.adds_contradictions` says. ``chain`` has the poses
    (c, 3) of the chunks in the trajectory and their hops. ``placed`` is the graph without the groups.
    """
    found = [loop for group in new for loop in group]
    if not found:
        return [], []
    before = _evidence(score, placed.solution.poses)
    kept, refused = list[list[Loop]](), list[Loop]()
    for members in groups_of(found, chain[0]):
        group = [found[number] for number in members]
        chosen = sorted(group, key=lambda loop: -loop.score)[:MAX_GROUP]
        trial = solve_annealed(chain[0][0], chain[1], [*placed.loops, *chosen])
        if _evidence(score, trial.poses).adds_contradictions(before, DOUBTFUL_SHARE):
            refused += group
        else:
            kept.append(group)
    return kept, refused


def _evidence(score: MapScore, poses: FloatArray) -> Evidence:
    """The evidence about a map of chunks with poses (c, 3)."""
    confirmed, contradicted = (int(each.sum()) for each in score.verdicts(poses))
    bend = 0.0 if score.strain is None else score.strain.total(poses)
    return Evidence(len(score.points), confirmed, contradicted, bend)


def accept_groups(
    poses: FloatArray,
    hops: Hops,
    loops: list[Loop],
    new: Sequence[Sequence[Loop]],
    score: MapScore,
    gain: float,
    *,
    near: bool,
) -> Decision:
    """Add groups of loops in the order of their support, each only if the score rises by ``gain``.

    Groups that agree are merged. ``poses`` (c, 3) are the poses of the chunks in the trajectory. With ``near``, each
    trial starts from the current solution with narrower kernels, which is faster.
    """
    waiting = _ranked([loop for group in new for loop in group], poses)
    solution = solve_annealed(poses[0], hops, loops)
    value = score(solution.poses) if waiting else 0.0
    for _ in range(2):
        rest = []
        for group in waiting:
            problem = hops, [*loops, *group]
            trial = refine(solution.poses, *problem) if near else solve_annealed(poses[0], *problem)
            gained = score(trial.poses)
            if gained > value + gain and trial.weights[len(loops) :].mean() > KEPT_WEIGHT:
                loops, solution, value = [*loops, *group], trial, gained
            else:
                rest.append(group)
        if len(rest) == len(waiting):
            break
        waiting = rest
    return Decision(loops, solution, [loop for group in waiting for loop in group])


def _ranked(loops: list[Loop], poses: FloatArray) -> list[list[Loop]]:
    """Groups of loops in the order of their evidence, with at most one loop for each pair of chunks."""
    if not loops:
        return []
    ranked = []
    for group in groups_of(loops, poses):
        pairs: dict[tuple[int, int], Loop] = {}
        for number in sorted(group, key=lambda each: -loops[each].score):
            loop = loops[number]
            pairs.setdefault((min(loop.first, loop.second), max(loop.first, loop.second)), loop)
        chosen = list(pairs.values())[:MAX_GROUP]
        ranked.append((len(group) * float(np.mean([loop.score for loop in chosen])), chosen))
    ranked.sort(key=lambda each: -each[0])
    return [chosen for _, chosen in ranked[:_MAX_GROUPS]]
