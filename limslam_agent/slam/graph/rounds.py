"""One round of the smoothing of a log: the loops of its chunks are found and tested, and the bundle is solved."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import (
    CONTRADICTED,
    KEPT,
    NO_SUPPORT,
    NOT_ADDED,
    OUTVOTED,
    REMOVED,
    Decision,
    Evidence,
    LoopVerdict,
    MapScore,
    accept_groups,
    plausible_groups,
    prune_groups,
    supported,
    visit_counts,
)
from limslam_agent.slam.graph.bundle import bundle
from limslam_agent.slam.graph.chunk_graph import (
    HOP_KERNEL,
    KEPT_WEIGHT,
    ChunkSolution,
    Hops,
    Loop,
    Strain,
    carry_over,
    hop_chi_squares,
    hops_between,
    solve_annealed,
    unbent,
)
from limslam_agent.slam.graph.key_poses import (
    KeyPoses,
    LogData,
    Trajectory,
)
from limslam_agent.slam.graph.local_maps import chunk_middles, cut_chunks
from limslam_agent.slam.graph.local_smoothing import local_covariances
from limslam_agent.slam.graph.loop_search import Chunks
from limslam_agent.slam.graph.wide_search import match_unions, search_widely
from limslam_env.geometry import FloatArray, IntArray

_BENT = 25.0  # chi-square of a hop from which on it follows the local smoothing again at the beginning of a round
_GAIN = 0.001  # by how much a group of loops of the wide search must raise the score
_SETTLED = 0.002  # rounds end when the last two rounds together have raised the score by less
_STRAIN = 0.1  # by how much a mean chi-square of 1 between hops and local smoothing, after the kernel, lowers the score


@dataclass(frozen=True, eq=False)
class Round:
    """The result of a round.

    Attributes
    ----------
    trajectory
        The trajectory after the bundle.
    score
        G of the bundled map, less the strain of its path.
    evidence
        What speaks for and against the bundled map.
    verdicts
        The verdicts on all loops that were found.
    middles
        Middle key poses of the chunks (c,).
    """

    trajectory: Trajectory
    score: float
    evidence: Evidence
    verdicts: list[LoopVerdict]
    middles: IntArray


@dataclass(frozen=True, eq=False)
class LogProblem:
    """The common data of all rounds: key poses, local trajectory, recording, settings, and covariances of the hops.

    ``hop_scale`` is the factor of the hops' covariances in the search and in the strain. The status does without it.
    """

    keys: KeyPoses
    local: Trajectory
    data: LogData
    config: GraphConfig
    hop_scale: float = 1.0
    _covariances: dict[float, FloatArray] = field(default_factory=dict)

    def hop(self, number: int) -> float:
        """Distance driven between the chunks of a round, m."""
        return self.config.maps.hop * self.config.rounds.hops[number]

    def middles(self, number: int) -> IntArray:
        """Key poses in the middle of the chunks of a round."""
        return chunk_middles(self.keys, self.config.maps, self.hop(number))

    def chunks(self, trajectory: Trajectory, number: int) -> Chunks:
        """The chunks of a round, cut from a trajectory."""
        middles, config = self.middles(number), self.config
        maps = cut_chunks(self.keys, trajectory, config.maps, middles, self.data.max_range)
        poses = trajectory.poses[middles]
        hops = hops_between(poses, self._hop_covariances(number))
        hops = Hops(hops.motions, self.hop_scale * hops.covariances)
        return Chunks(maps, middles, poses, self.keys.key_travel[middles], hops, config)

    def unbent(self, trajectory: Trajectory, number: int) -> Trajectory:
        """A trajectory whose hops follow the local smoothing again where a bundle has bent them too far.

        Links between visits can pull at a segment of the path that no loop holds, and bend it more in each round.
        """
        return unbent(trajectory, self.local, self.middles(number), self.local_hops(number), _BENT)

    def evidence(self, trajectory: Trajectory) -> Evidence:
        """What speaks for and against a trajectory's map."""
        counts = visit_counts(self.keys, trajectory, self.config, self.data.max_range)
        points, confirmed, contradicted = (
            int(each.sum()) for each in (counts.points, counts.confirmed, counts.contradicted)
        )
        return Evidence(points, confirmed, contradicted, self.strain(0).total(trajectory.poses[self.middles(0)]))

    def score(self, evidence: Evidence) -> float:
        """G of a map, less the strain of its path."""
        points, hops = max(1, evidence.points), max(1, len(self.middles(0)) - 1)
        agreed = evidence.confirmed / points - evidence.contradicted / points
        return agreed - _STRAIN * evidence.bend / hops

    def strain(self, number: int) -> Strain:
        """What the chunks of a round cost where their path bends away from the local smoothing."""
        return Strain(self.local_hops(number, self.hop_scale), HOP_KERNEL, _STRAIN)

    def bends(self, trajectory: Trajectory) -> tuple[IntArray, FloatArray]:
        """The key poses (h,) at which the hops of a trajectory begin, and their chi-squares (h,) by local smoothing."""
        middles = self.middles(0)
        return middles[:-1], hop_chi_squares(trajectory.poses[middles], self.local_hops(0))

    def local_hops(self, number: int, scale: float = 1.0) -> Hops:
        """The hops of a round along the local trajectory, with covariances of the local graph times ``scale``."""
        return hops_between(self.local.poses[self.middles(number)], scale * self._hop_covariances(number))

    def _hop_covariances(self, number: int) -> FloatArray:
        """Covariances (c - 1, 3, 3) of the hops of a round, from the graph of the local smoothing."""
        hop = self.hop(number)
        if hop not in self._covariances:
            middles = self.middles(number)
            self._covariances[hop] = local_covariances(self.keys, self.local, middles, self.config, self.data.range_std)
        return self._covariances[hop]


@dataclass(frozen=True, eq=False)
class _Placed:
    """The graph of chunks after a round's search: its loops, their solution, and the rejected loops."""

    loops: list[Loop]
    solution: ChunkSolution
    dropped: list[LoopVerdict]

    def after(self, decision: Decision, reason: str) -> "_Placed":
        """The graph after a decision that rejected loops for a reason."""
        dropped = self.dropped + [LoopVerdict(loop, reason) for loop in decision.dropped]
        return _Placed(decision.loops, decision.solution, dropped)


@dataclass(eq=False)
class Candidates:
    """The chunks of a round, and the loops that were found among them.

    The starts of the first round with a wide search share its result.
    """

    chunks: Chunks
    loops: list[Loop]
    _groups: tuple[list[list[Loop]], list[Loop]] | None = None

    def groups(self, placed: _Placed, score: MapScore) -> tuple[list[list[Loop]], _Placed]:
        """The plausible groups of the wide search, and the graph with the verdicts on the other groups.

        The search begins with the graph ``placed`` when it is asked for first.
        """
        if self._groups is None:
            chunks = self.chunks
            found = search_widely(chunks, placed.solution, placed.loops)
            known = Decision(placed.loops, placed.solution, [])
            self._groups = plausible_groups((chunks.poses, chunks.hops), known, found, score)
        kept, refused = self._groups
        return kept, placed.after(Decision(placed.loops, placed.solution, refused), CONTRADICTED)


def do_round(log: LogProblem, trajectory: Trajectory, number: int, candidates: Candidates, start: str) -> Round:
    """Do one round: support, the wide search if the start has one, unions from the second round on, and the bundle."""
    config, chunks = log.config, candidates.chunks
    placed = _supported(chunks, candidates.loops)
    score = replace(MapScore.of(chunks.maps), strain=log.strain(number))
    placed = STARTS[start](candidates, placed, score)
    if number > 0:
        unions = [[loop] for loop in match_unions(chunks, placed.solution.poses, placed.loops)]
        placed = placed.after(_accept(chunks, placed, unions, score, 0.0, near=True), NOT_ADDED)
    return _bundled(log, trajectory, chunks, placed, config.rounds.iterations[number])


def is_settled(rounds: Sequence[Round]) -> bool:
    """Whether the last two rounds, which differ in the hop of their chunks, have not raised the score."""
    scores = [each.score for each in rounds]
    return len(scores) > 2 and max(scores[-2:]) < max(scores[:-2]) + _SETTLED


def _supported(chunks: Chunks, loops: list[Loop]) -> _Placed:
    good = supported(loops, chunks.poses, chunks.travel)
    kept = [loop for loop, agreed in zip(loops, good, strict=True) if agreed]
    dropped = [LoopVerdict(loop, NO_SUPPORT) for loop, agreed in zip(loops, good, strict=True) if not agreed]
    return _Placed(kept, solve_annealed(chunks.poses[0], chunks.hops, kept), dropped)


def _place_guarded(candidates: Candidates, placed: _Placed, score: MapScore) -> _Placed:
    """The guarded start: groups of the wide search must raise G, and doubtful groups are removed."""
    chunks = candidates.chunks
    placed = _pruned(chunks, placed, score)
    groups, placed = candidates.groups(placed, score)
    decision = _accept(chunks, placed, groups, score, _GAIN, near=False)
    gained = len(decision.loops) > len(placed.loops)
    placed = placed.after(decision, NOT_ADDED)
    return _pruned(chunks, placed, score) if gained else placed


def _place_near(candidates: Candidates, placed: _Placed, score: MapScore) -> _Placed:
    """The start without the wide search. Where many places look alike, it finds wrong loops only."""
    return _pruned(candidates.chunks, placed, score)


def _place_all(candidates: Candidates, placed: _Placed, score: MapScore) -> _Placed:
    """The unguarded start: all groups of the wide search are added, and only the robust kernels reject loops."""
    chunks = candidates.chunks
    groups, placed = candidates.groups(placed, score)
    loops = placed.loops + [loop for group in groups for loop in group]
    solution = solve_annealed(chunks.poses[0], chunks.hops, loops)
    return _Placed(loops, solution, placed.dropped)


STARTS: dict[str, Callable[[Candidates, _Placed, MapScore], _Placed]] = {
    "guard": _place_guarded, "all": _place_all, "near": _place_near,
}  # fmt: skip


def _pruned(chunks: Chunks, placed: _Placed, score: MapScore) -> _Placed:
    if not placed.loops:
        return placed
    return placed.after(prune_groups(chunks.poses, chunks.hops, placed.loops, score), REMOVED)


def _accept(
    chunks: Chunks, placed: _Placed, groups: list[list[Loop]], score: MapScore, gain: float, *, near: bool
) -> Decision:
    return accept_groups(chunks.poses, chunks.hops, placed.loops, groups, score, gain, near=near)


def _bundled(log: LogProblem, trajectory: Trajectory, chunks: Chunks, placed: _Placed, iterations: int) -> Round:
    """Transfer the poses of the chunks to the key poses, solve the bundle, and give a verdict on each loop."""
    config, solution = log.config, placed.solution
    strong = solution.weights > KEPT_WEIGHT
    kept = [loop for loop, good in zip(placed.loops, strong, strict=True) if good]
    moved = carry_over(log.keys, trajectory, chunks.middles, solution.poses)
    ends = np.array([(loop.first, loop.second) for loop in kept], dtype=np.int64).reshape(-1, 2)
    relative = np.array([loop.relative for loop in kept]).reshape(-1, 3)
    information = np.array([loop.information for loop in kept]).reshape(-1, 3, 3)
    relations = chunks.middles[ends], relative, information
    bundled = bundle(log.keys, moved, relations, config, log.data.range_std, iterations)
    evidence = log.evidence(bundled)
    verdicts = [LoopVerdict(loop, KEPT if good else OUTVOTED) for loop, good in zip(placed.loops, strong, strict=True)]
    return Round(
        trajectory=bundled,
        score=log.score(evidence),
        evidence=evidence,
        verdicts=verdicts + placed.dropped,
        middles=chunks.middles,
    )
