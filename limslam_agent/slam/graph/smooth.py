"""The smoothing of a log: all stages of the graph of local maps in order.

No stage uses the ground truth. Alternatives are compared by the score G of :class:`MapScore`: the share of points that
other visits of a place confirm, minus the share that other visits contradict.

The log is solved in frames in which it begins at the origin, and the result is then transformed to the start pose. The
result therefore does not depend on the start pose. The heading of the frame determines the positions of the bins of the
Hough transforms, and can thereby change which loops are found. The search is therefore run with several headings.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import (
    KEPT,
    NO_SUPPORT,
    NOT_ADDED,
    OUTVOTED,
    REMOVED,
    Decision,
    LoopVerdict,
    MapScore,
    accept_groups,
    distances_after_alignment,
    prune_groups,
    supported,
)
from limslam_agent.slam.graph.bundle import bundle
from limslam_agent.slam.graph.chunk_graph import (
    ChunkSolution,
    Loop,
    carry_over,
    hops_between,
    information_matrix,
    solve_annealed,
    unbent,
)
from limslam_agent.slam.graph.key_poses import (
    KeyPoses,
    LogData,
    Trajectory,
    choose_keys,
    corrected_odometry,
    event_poses,
    joined_bias,
    odometry_trajectory,
)
from limslam_agent.slam.graph.local_maps import chunk_middles, cut_chunks
from limslam_agent.slam.graph.local_smoothing import local_covariances, smooth_locally
from limslam_agent.slam.graph.loop_search import Chunks, loops_along_the_way
from limslam_agent.slam.graph.union_matching import match_unions
from limslam_agent.slam.graph.wide_search import search_widely
from limslam_env.geometry import FloatArray, IntArray, se2

_MOST = 0.9  # share of a path that has to agree with another path


@dataclass(frozen=True, eq=False)
class Round:
    """The result of a round.

    Attributes
    ----------
    trajectory
        The trajectory after the bundle.
    score
        G of the bundled map.
    verdicts
        The verdicts on all loops that were found.
    middles, chunk_covariances
        Middle key poses of the chunks (c,); their covariances (c, 3, 3) from the graph of chunks, relative to the first
        chunk.
    """

    trajectory: Trajectory
    score: float
    verdicts: list[LoopVerdict]
    middles: IntArray
    chunk_covariances: FloatArray


@dataclass(frozen=True, eq=False)
class GraphResult:
    """The smoothed log.

    Attributes
    ----------
    poses
        Poses (n, 3) of all events.
    score
        G of the map; a higher score means better agreement of the visits. It compares maps of the same log only.
    start
        The search of the result: its start, and the heading of its frame.
    scores
        G after each round of each search.
    verdicts
        The verdicts on all loops that were found in the round of the result.
    chunk_events, chunk_poses, chunk_covariances
        Middle events of the chunks (c,), their poses (c, 3), and covariances (c, 3, 3) from the graph of chunks.
    turn_bias, scale, turn_gain
        The estimated errors of odometry: missing heading per metre (rad/m), share of distances, share of turns.
    keys, trajectory
        The key poses and their trajectory, from which the points can be drawn.
    """

    poses: FloatArray
    score: float
    start: str
    scores: dict[str, list[float]]
    verdicts: list[LoopVerdict]
    chunk_events: IntArray
    chunk_poses: FloatArray
    chunk_covariances: FloatArray
    turn_bias: float
    scale: float
    turn_gain: float
    keys: KeyPoses = field(repr=False)
    trajectory: Trajectory = field(repr=False)


Report = Callable[[str], None]
"""Called with the stage that begins, in words."""


def smooth_log(
    data: LogData, start: FloatArray, config: GraphConfig | None = None, report: Report | None = None
) -> GraphResult:
    """Smooth a log after its end.

    Parameters
    ----------
    data
        The recorded log.
    start
        Pose (3,) of the first event in the frame of the result.
    config
        The settings; the defaults serve all logs.
    report
        Called at the start of each frame and of each round, with the number of loops found so far.
    """
    config = config or GraphConfig()
    report = report or _silent
    best, known = _smoothed(data, start, config, report), np.zeros(3)
    for _ in range(config.rounds.restarts):
        found = best.trajectory.bias
        if abs(found[0]) < config.rounds.restart:
            break
        # The loops of a path that bends by several degrees a metre are not recognised, and then its bias is too small.
        data = replace(data, odometry=corrected_odometry(data.odometry, found))
        again = _smoothed(data, start, config, partial(_say, report, "odometry corrected"))
        if again.score <= best.score:
            break
        best, known = again, joined_bias(known, found)
    turn_bias, scale, turn_gain = joined_bias(known, best.trajectory.bias).tolist()
    return replace(best, turn_bias=turn_bias, scale=scale, turn_gain=turn_gain)


def _smoothed(data: LogData, start: FloatArray, config: GraphConfig, report: Report) -> GraphResult:
    """Smooth a log with odometry as it is."""
    keys = choose_keys(data, config.keys, config.motion)
    if len(keys) < 2 or not len(keys.point_key):
        return _unlooped(keys, "odometry", odometry_trajectory(keys, start))
    if len(chunk_middles(keys, config.maps, config.maps.hop * config.rounds.hops[0])) < 2:
        return _unlooped(keys, "local", _moved(_local(keys, data, config, 0.0), start))
    searches = _searched(_frames(keys, data, config, report))
    best = max(searches, key=_score)
    found = _placed_at(_best(best.rounds, config.rounds.tie), start, best.turn)
    scores = {search.name: [each.score for each in search.rounds] for search in searches}
    return _result(keys, best.name, found, scores)


def _silent(_: str) -> None:
    """Report nothing."""


def _say(report: Report, where: str, what: str) -> None:
    report(f"{where}, {what}")


def _local(keys: KeyPoses, data: LogData, config: GraphConfig, turn: float) -> Trajectory:
    """The trajectory after the local smoothing, in the frame in which the first heading is ``turn`` (rad)."""
    odometry = odometry_trajectory(keys, np.array([0.0, 0.0, turn]))
    return smooth_locally(keys, odometry, config, data.range_std)


@dataclass(frozen=True, eq=False)
class _Log:
    """The common data of all rounds: key poses, local trajectory, recording, settings, and covariances of the hops."""

    keys: KeyPoses
    local: Trajectory
    data: LogData
    config: GraphConfig
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
        hops = hops_between(poses, self._hop_covariances(number), config.chunks)
        return Chunks(maps, middles, poses, self.keys.key_travel[middles], hops, config)

    def unbent(self, trajectory: Trajectory, number: int) -> Trajectory:
        """A trajectory whose hops follow the local smoothing again where a bundle has bent them too far.

        Links between visits can pull at a segment of the path that no loop holds, and bend it more in each round.
        """
        middles, covariances = self.middles(number), self._hop_covariances(number)
        hops = hops_between(self.local.poses[middles], covariances, self.config.chunks)
        return unbent(trajectory, self.local, middles, hops, self.config.chunks.bent)

    def score(self, trajectory: Trajectory) -> float:
        """G of a trajectory's map, for chunks whose middles are ``config.maps.half`` apart."""
        middles = chunk_middles(self.keys, self.config.maps, self.config.maps.half)
        maps = cut_chunks(self.keys, trajectory, self.config.maps, middles, self.data.max_range)
        return MapScore.of(maps, self.config.agreement)(trajectory.poses[middles])

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


@dataclass(frozen=True, eq=False)
class _Search:
    """The rounds of one start in one frame.

    Attributes
    ----------
    log
        The log in this frame.
    start, turn
        The name of the start, and the first heading in this frame, rad.
    report
        Called at the start of each round.
    rounds
        The completed rounds.
    """

    log: _Log
    start: str
    turn: float
    report: Report
    rounds: list[Round]

    @property
    def name(self) -> str:
        """The name of the search in a result."""
        return f"{self.start}, turned by {math.degrees(self.turn):.3g} deg" if self.turn else self.start

    @property
    def score(self) -> float:
        """The highest score of the search's rounds."""
        return max(each.score for each in self.rounds)

    def finds_the_path_of(self, other: "_Search") -> bool:
        """Whether both searches have found the same path, which may begin with another heading."""
        poses, others = self.rounds[-1].trajectory.poses, other.rounds[-1].trajectory.poses
        same = self.log.config.rounds.same_path
        return float(np.quantile(distances_after_alignment(poses, others), _MOST)) <= same

    def advanced(self, end: int) -> "_Search":
        """The search after ``end`` rounds."""
        return replace(self, rounds=_rounds(self, end))


@dataclass(eq=False)
class _Candidates:
    """The chunks of a round, and the loops that were found among them.

    Both starts of the first round share the result of the wide search.
    """

    chunks: Chunks
    loops: list[Loop]
    _groups: list[list[Loop]] | None = None

    def groups(self, placed: _Placed) -> list[list[Loop]]:
        """The groups of the wide search, which begins with the graph ``placed`` when it is asked for first."""
        if self._groups is None:
            self._groups = search_widely(self.chunks, placed.solution, placed.loops)
        return self._groups


def _frames(keys: KeyPoses, data: LogData, config: GraphConfig, report: Report) -> list[_Search]:
    """The first rounds of all searches, in frame after frame, until two frames have led to the same path.

    Further frames would most probably lead to this path as well.
    """
    turns, searches, best = config.rounds.orientations, list[_Search](), list[_Search]()
    for number, turn in enumerate(turns, start=1):
        begun = _begun(keys, data, config, turn, partial(_say, report, f"frame {number} of {len(turns)}"))
        searches += begun
        best = sorted([*best, max(begun, key=_score)], key=_score, reverse=True)
        if any(best[0].finds_the_path_of(other) for other in best[1:]):
            break
    return searches


def _score(search: _Search) -> float:
    return search.score


def _begun(keys: KeyPoses, data: LogData, config: GraphConfig, turn: float, report: Report) -> list[_Search]:
    """The first round of both starts, in the frame in which the first heading is ``turn`` (rad)."""
    report("local smoothing")
    log = _Log(keys, _local(keys, data, config, turn), data, config)
    chunks = log.chunks(log.local, 0)
    candidates = _Candidates(chunks, loops_along_the_way(chunks))
    searches = []
    for start in _STARTS:
        _say_round(report, log, start, 0, len(candidates.loops))
        searches.append(_Search(log, start, turn, report, [_round(log, log.local, 0, candidates, start)]))
    return searches


def _say_round(report: Report, log: _Log, start: str, number: int, loops: int) -> None:
    report(f"start {start}, round {number + 1} of at most {len(log.config.rounds.hops)}, {loops} loops")


def _searched(searches: list[_Search]) -> list[_Search]:
    """All searches. Only the best searches do the trial rounds, and only the best of these do all rounds.

    Of searches that have found the same path after the trial, one goes on.
    """
    config = searches[0].log.config.rounds
    tried = _continued(searches, config.trial, config.tried, math.inf)
    best = max(tried, key=_score)
    same = [each for each in tried if each is not best and each.finds_the_path_of(best)]
    others = [each for each in tried if each not in same]
    return same + _continued(others, len(config.hops), config.finished, config.hopeless)


def _continued(searches: list[_Search], end: int, most: int, hopeless: float) -> list[_Search]:
    """Continue at most ``most`` searches, none worse than the best search by ``hopeless``, up to round ``end``."""
    best = sorted(searches, key=_score, reverse=True)[:most]
    least = best[0].score - hopeless
    return [each.advanced(end) if each in best and each.score >= least else each for each in searches]


def _best(rounds: list[Round], tie: float) -> Round:
    """The last round whose score is within ``tie`` of the highest score. The last round has tested most loops."""
    highest = max(each.score for each in rounds)
    return [each for each in rounds if each.score >= highest - tie][-1]


def _rounds(search: _Search, end: int) -> list[Round]:
    """Do rounds, each with new chunks and new tests of all loops, until nothing changes."""
    log, start, rounds = search.log, search.start, list(search.rounds)
    for number in range(len(rounds), end):
        if _settled(rounds, log.config):
            break
        kept = sum(verdict.kept for verdict in rounds[-1].verdicts)
        _say_round(search.report, log, start, number, kept)
        trajectory = log.unbent(rounds[-1].trajectory, number)
        chunks = log.chunks(trajectory, number)
        candidates = _Candidates(chunks, loops_along_the_way(chunks))
        rounds.append(_round(log, trajectory, number, candidates, start))
    return rounds


def _settled(rounds: list[Round], config: GraphConfig) -> bool:
    """Whether the last two rounds, which differ in the hop of their chunks, have not raised the score."""
    scores = [each.score for each in rounds]
    return len(scores) > 2 and max(scores[-2:]) < max(scores[:-2]) + config.rounds.settled


def _round(log: _Log, trajectory: Trajectory, number: int, candidates: _Candidates, start: str) -> Round:
    """Do one round: support, wide search, unions from the second round on, and the bundle."""
    config, chunks = log.config, candidates.chunks
    placed, score = _supported(chunks, candidates.loops), MapScore.of(chunks.maps, config.agreement)
    if number < config.rounds.wide_search:
        placed = _STARTS[start](candidates, placed, score)
    elif start == "guard":
        placed = _pruned(chunks, placed, score)
    if number > 0:
        unions = [[loop] for loop in match_unions(chunks, placed.solution.poses, placed.loops)]
        placed = placed.after(_accept(chunks, placed, unions, score, 0.0, near=True), NOT_ADDED)
    return _bundled(log, trajectory, chunks, placed, config.rounds.iterations[number])


def _supported(chunks: Chunks, loops: list[Loop]) -> _Placed:
    good = supported(loops, chunks.poses, chunks.travel, chunks.config.loops)
    kept = [loop for loop, agreed in zip(loops, good, strict=True) if agreed]
    dropped = [LoopVerdict(loop, NO_SUPPORT) for loop, agreed in zip(loops, good, strict=True) if not agreed]
    return _Placed(kept, solve_annealed(chunks.poses[0], chunks.hops, kept, chunks.config.chunks), dropped)


def _place_guarded(candidates: _Candidates, placed: _Placed, score: MapScore) -> _Placed:
    """The guarded start: groups of the wide search must raise G, and doubtful groups are removed."""
    chunks = candidates.chunks
    placed = _pruned(chunks, placed, score)
    groups = candidates.groups(placed)
    decision = _accept(chunks, placed, groups, score, chunks.config.agreement.gain, near=False)
    gained = len(decision.loops) > len(placed.loops)
    placed = placed.after(decision, NOT_ADDED)
    return _pruned(chunks, placed, score) if gained else placed


def _place_all(candidates: _Candidates, placed: _Placed, _: MapScore) -> _Placed:
    """The unguarded start: all groups of the wide search are added, and only the robust kernels reject loops."""
    chunks, groups = candidates.chunks, candidates.groups(placed)
    loops = placed.loops + [loop for group in groups for loop in group]
    solution = solve_annealed(chunks.poses[0], chunks.hops, loops, chunks.config.chunks)
    return _Placed(loops, solution, placed.dropped)


_STARTS: dict[str, Callable[[_Candidates, _Placed, MapScore], _Placed]] = {"guard": _place_guarded, "all": _place_all}


def _pruned(chunks: Chunks, placed: _Placed, score: MapScore) -> _Placed:
    if not placed.loops:
        return placed
    return placed.after(prune_groups(chunks.poses, chunks.hops, placed.loops, score, chunks.config), REMOVED)


def _accept(
    chunks: Chunks, placed: _Placed, groups: list[list[Loop]], score: MapScore, gain: float, *, near: bool
) -> Decision:
    return accept_groups(chunks.poses, chunks.hops, placed.loops, groups, score, chunks.config, gain, near=near)


def _bundled(log: _Log, trajectory: Trajectory, chunks: Chunks, placed: _Placed, iterations: int) -> Round:
    """Transfer the poses of the chunks to the key poses, solve the bundle, and give a verdict on each loop."""
    config, solution = log.config, placed.solution
    strong = solution.weights > config.chunks.kept
    kept = [loop for loop, good in zip(placed.loops, strong, strict=True) if good]
    moved = carry_over(log.keys, trajectory, chunks.middles, solution.poses)
    ends = np.array([(loop.first, loop.second) for loop in kept], dtype=np.int64).reshape(-1, 2)
    relative = np.array([loop.relative for loop in kept]).reshape(-1, 3)
    information = np.array([loop.information for loop in kept]).reshape(-1, 3, 3)
    relations = chunks.middles[ends], relative, information
    bundled = bundle(log.keys, moved, relations, config, log.data.range_std, iterations)
    verdicts = [LoopVerdict(loop, KEPT if good else OUTVOTED) for loop, good in zip(placed.loops, strong, strict=True)]
    return Round(
        trajectory=bundled,
        score=log.score(bundled),
        verdicts=verdicts + placed.dropped,
        middles=chunks.middles,
        chunk_covariances=_covariances(chunks, placed),
    )


def _covariances(chunks: Chunks, placed: _Placed) -> FloatArray:
    """Covariances (c, 3, 3) of the chunks relative to the first chunk, from the graph of chunks."""
    count = len(chunks)
    solution = placed.solution
    joint = np.linalg.inv(information_matrix(solution.poses, chunks.hops, placed.loops, solution.weights))
    return np.asarray(joint.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)])


def _moved(trajectory: Trajectory, motion: FloatArray) -> Trajectory:
    """The trajectory after a motion (3,) of its frame."""
    return Trajectory(se2.compose(motion, trajectory.poses), trajectory.bias)


def _placed_at(found: Round, start: FloatArray, turn: float) -> Round:
    """The round, transformed from the frame in which the log begins at (0, 0, ``turn``) to the frame of the result."""
    motion = se2.compose(np.asarray(start, dtype=float), np.array([0.0, 0.0, -turn]))
    cos, sin = math.cos(motion[2]), math.sin(motion[2])
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    covariances = rotation @ found.chunk_covariances @ rotation.T
    return replace(found, trajectory=_moved(found.trajectory, motion), chunk_covariances=covariances)


def _unlooped(keys: KeyPoses, name: str, trajectory: Trajectory) -> GraphResult:
    """The result of a log that is too short for chunks."""
    found = Round(trajectory, 0.0, [], np.zeros(1, dtype=np.int64), np.zeros((1, 3, 3)))
    return _result(keys, name, found, {name: [0.0]})


def _result(keys: KeyPoses, name: str, best: Round, scores: dict[str, list[float]]) -> GraphResult:
    turn_bias, scale, turn_gain = (float(value) for value in best.trajectory.bias)
    return GraphResult(
        poses=event_poses(keys, best.trajectory),
        score=best.score,
        start=name,
        scores=scores,
        verdicts=best.verdicts,
        chunk_events=keys.first_event[best.middles],
        chunk_poses=best.trajectory.poses[best.middles],
        chunk_covariances=best.chunk_covariances,
        turn_bias=turn_bias,
        scale=scale,
        turn_gain=turn_gain,
        keys=keys,
        trajectory=best.trajectory,
    )
