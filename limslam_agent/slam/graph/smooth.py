"""From a log to its smoothed trajectory: all stages of the graph of local maps, one after the other.

Nothing in here knows the truth. Where there is a choice, the score G of :class:`MapScore` makes it: the share of points
that other visits of a place confirm, minus the share that they contradict.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import Decision, MapScore, accept_groups, prune_groups, supported
from limslam_agent.slam.graph.bundle import bundle
from limslam_agent.slam.graph.chunk_graph import (
    ChunkSolution,
    Loop,
    carry_over,
    hops_between,
    information_matrix,
    solve_annealed,
)
from limslam_agent.slam.graph.key_poses import (
    KeyPoses,
    LogData,
    Trajectory,
    choose_keys,
    event_poses,
    odometry_trajectory,
)
from limslam_agent.slam.graph.least_squares import pose_columns, relation_factor
from limslam_agent.slam.graph.local_maps import chunk_middles, cut_chunks
from limslam_agent.slam.graph.local_smoothing import link_std, local_equations, smooth_locally
from limslam_agent.slam.graph.loop_search import Chunks, loops_along_the_way
from limslam_agent.slam.graph.point_links import point_cloud
from limslam_agent.slam.graph.union_matching import match_unions
from limslam_agent.slam.graph.wide_search import search_widely
from limslam_env.geometry import FloatArray, IntArray

NO_SUPPORT = "no other loop nearby agrees"
REMOVED = "the map agrees better with itself without it"
NOT_ADDED = "the map does not agree better with itself with it"
OUTVOTED = "its weight in the graph of chunks is too low"
KEPT = "kept"


@dataclass(frozen=True, eq=False)
class LoopVerdict:
    """A loop that was found in the round of the result, and what became of it: ``KEPT``, or why it was left out."""

    loop: Loop
    reason: str

    @property
    def kept(self) -> bool:
        """Whether it is part of the result."""
        return self.reason == KEPT


@dataclass(frozen=True, eq=False)
class Round:
    """What a round has come to.

    Attributes
    ----------
    trajectory
        After the bundle.
    score
        G of the bundled map.
    verdicts
        On all loops that were found.
    middles, chunk_covariances
        (c,) key poses in the middle of the chunks; (c, 3, 3) their covariances by the graph of chunks, relative to the
        first one.
    recognised
        How many loops the wide search and the unions have brought.
    """

    trajectory: Trajectory
    score: float
    verdicts: list[LoopVerdict]
    middles: IntArray
    chunk_covariances: FloatArray
    recognised: int


@dataclass(frozen=True, eq=False)
class GraphResult:
    """The smoothed log.

    Attributes
    ----------
    poses
        (n, 3) of all events.
    score
        G of the map; the higher, the better the visits of places agree. It compares maps of one log only.
    start
        Which of the two starts it came from.
    scores
        G after each round of each start.
    verdicts
        On all loops that were found in the round that the result is from.
    chunk_events, chunk_poses, chunk_covariances
        (c,) events in the middle of the chunks, their poses (c, 3) and covariances (c, 3, 3) by the graph of chunks.
    turn_bias, scale, turn_gain
        What odometry was found to be wrong by: heading missed on each metre (rad/m), share of distances, of turns.
    keys, trajectory
        The key poses, for those who draw the points.
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


def smooth_log(data: LogData, start: FloatArray, config: GraphConfig | None = None) -> GraphResult:
    """Smooth a log that has ended.

    Parameters
    ----------
    data
        What was recorded.
    start
        Pose (3,) of the first event in the frame of the result.
    config
        The settings; they need not be changed for a log.
    """
    config = config or GraphConfig()
    keys = choose_keys(data, config.keys, config.motion)
    odometry = odometry_trajectory(keys, start)
    if len(keys) < 2 or not len(keys.point_key):
        return _result(keys, "odometry", {"odometry": [_unlooped(odometry)]})
    local = smooth_locally(keys, odometry, config, data.range_std)
    log = _Log(keys, local, data, config)
    if len(log.middles(0)) < 2:
        return _result(keys, "local", {"local": [_unlooped(local)]})
    rounds = _both_starts(log)
    best = max(rounds, key=lambda name: max(each.score for each in rounds[name]))
    return _result(keys, best, rounds, config.rounds.tie)


@dataclass(frozen=True, eq=False)
class _Log:
    """What all rounds share: the key poses, local trajectory, recording, settings, and the hops' covariances."""

    keys: KeyPoses
    local: Trajectory
    data: LogData
    config: GraphConfig
    _covariances: dict[float, FloatArray] = field(default_factory=dict)

    def hop(self, number: int) -> float:
        """Driving between the chunks of a round, m."""
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

    def score(self, trajectory: Trajectory) -> float:
        """G of a trajectory's map, with chunks side by side."""
        middles = chunk_middles(self.keys, self.config.maps, self.config.maps.half)
        maps = cut_chunks(self.keys, trajectory, self.config.maps, middles, self.data.max_range)
        return MapScore.of(maps, self.config.agreement)(trajectory.poses[middles])

    def _hop_covariances(self, number: int) -> FloatArray:
        """Covariances (c - 1, 3, 3) of the hops of a round, by the graph of the local smoothing."""
        hop = self.hop(number)
        if hop not in self._covariances:
            middles = self.middles(number)
            self._covariances[hop] = local_covariances(self.keys, self.local, middles, self.config, self.data.range_std)
        return self._covariances[hop]


def local_covariances(
    keys: KeyPoses, trajectory: Trajectory, middles: IntArray, config: GraphConfig, range_std: float
) -> FloatArray:
    """Covariances (c - 1, 3, 3) of the motions between key poses (c,), by odometry and links along the way."""
    cloud = point_cloud(keys, trajectory, config.links, range_std)
    std = config.bundle.link_inflation * link_std(config, range_std)
    equations = local_equations(keys, trajectory, cloud, config, std)
    first, second = middles[:-1], middles[1:]
    _, jacobian = relation_factor(trajectory.poses, first, second, np.zeros((len(first), 3)))
    return equations.covariances(np.hstack((pose_columns(first), pose_columns(second))), jacobian)


@dataclass(frozen=True, eq=False)
class _Placed:
    """The graph of chunks at the end of a round's search: its loops, their solution, and what was left out and why."""

    loops: list[Loop]
    solution: ChunkSolution
    dropped: list[LoopVerdict]
    recognised: int = 0

    def after(self, decision: Decision, reason: str) -> "_Placed":
        """What it is after a decision that left loops out for a reason."""
        dropped = self.dropped + [LoopVerdict(loop, reason) for loop in decision.dropped]
        gained = max(0, len(decision.loops) - len(self.loops))
        return _Placed(decision.loops, decision.solution, dropped, self.recognised + gained)


def _both_starts(log: _Log) -> dict[str, list[Round]]:
    """The rounds of both starts; one that is far behind after its trial is given up."""
    config = log.config.rounds
    found = loops_along_the_way(log.chunks(log.local, 0))
    rounds = {name: _rounds(log, [], found, name, config.trial) for name in _STARTS}
    best = max(each.score for several in rounds.values() for each in several)
    for name, done in rounds.items():
        if max(each.score for each in done) > best - config.hopeless:
            rounds[name] = _rounds(log, done, found, name, len(config.hops))
    return rounds


def _best(rounds: list[Round], tie: float) -> Round:
    """The round with the highest score; of rounds within ``tie`` of it the last one, in which most has been tested."""
    highest = max(each.score for each in rounds)
    return [each for each in rounds if each.score >= highest - tie][-1]


def _rounds(log: _Log, done: list[Round], found: list[Loop], start: str, end: int) -> list[Round]:
    """Rounds in which chunks are cut anew and everything is tested anew, until nothing changes."""
    rounds = list(done)
    for number in range(len(done), end):
        trajectory = rounds[-1].trajectory if rounds else log.local
        rounds.append(_round(log, trajectory, number, None if rounds else found, start))
        if (
            number >= 2
            and rounds[-1].score < rounds[-2].score + log.config.rounds.settled
            and not rounds[-1].recognised
        ):
            break
    return rounds


def _round(log: _Log, trajectory: Trajectory, number: int, found: list[Loop] | None, start: str) -> Round:
    """Loops along the way, their support, the wide search, unions from the second round on, and the bundle."""
    config, chunks = log.config, log.chunks(trajectory, number)
    loops = loops_along_the_way(chunks) if found is None else found
    placed, score = _supported(chunks, loops), MapScore.of(chunks.maps, config.agreement)
    if number < config.rounds.wide_search:
        placed = _STARTS[start](chunks, placed, score)
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


def _place_guarded(chunks: Chunks, placed: _Placed, score: MapScore) -> _Placed:
    """The careful start: groups of the wide search must raise G, and doubtful groups are taken out."""
    placed = _pruned(chunks, placed, score)
    groups = search_widely(chunks, placed.solution, placed.loops)
    decision = _accept(chunks, placed, groups, score, chunks.config.agreement.gain, near=False)
    gained = len(decision.loops) > len(placed.loops)
    placed = placed.after(decision, NOT_ADDED)
    return _pruned(chunks, placed, score) if gained else placed


def _place_all(chunks: Chunks, placed: _Placed, _: MapScore) -> _Placed:
    """The bold start: all groups of the wide search come in, and only the robust kernels judge them."""
    groups = search_widely(chunks, placed.solution, placed.loops)
    loops = placed.loops + [loop for group in groups for loop in group]
    solution = solve_annealed(chunks.poses[0], chunks.hops, loops, chunks.config.chunks)
    return _Placed(loops, solution, placed.dropped, len(loops) - len(placed.loops))


_STARTS: dict[str, Callable[[Chunks, _Placed, MapScore], _Placed]] = {"guard": _place_guarded, "all": _place_all}


def _pruned(chunks: Chunks, placed: _Placed, score: MapScore) -> _Placed:
    if not placed.loops:
        return placed
    return placed.after(prune_groups(chunks.poses, chunks.hops, placed.loops, score, chunks.config), REMOVED)


def _accept(
    chunks: Chunks, placed: _Placed, groups: list[list[Loop]], score: MapScore, gain: float, *, near: bool
) -> Decision:
    return accept_groups(chunks.poses, chunks.hops, placed.loops, groups, score, chunks.config, gain, near=near)


def _bundled(log: _Log, trajectory: Trajectory, chunks: Chunks, placed: _Placed, iterations: int) -> Round:
    """Carry the graph of chunks over to the key poses, bundle, and say what became of each loop."""
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
        recognised=placed.recognised,
    )


def _covariances(chunks: Chunks, placed: _Placed) -> FloatArray:
    """Covariances (c, 3, 3) of the chunks relative to the first one, by the graph of chunks."""
    count = len(chunks)
    solution = placed.solution
    joint = np.linalg.inv(information_matrix(solution.poses, chunks.hops, placed.loops, solution.weights))
    return np.asarray(joint.reshape(count, 3, count, 3)[np.arange(count), :, np.arange(count)])


def _unlooped(trajectory: Trajectory) -> Round:
    """A log that is too short for chunks."""
    return Round(trajectory, 0.0, [], np.zeros(1, dtype=np.int64), np.zeros((1, 3, 3)), 0)


def _result(keys: KeyPoses, start: str, rounds: dict[str, list[Round]], tie: float = 0.0) -> GraphResult:
    best = _best(rounds[start], tie)
    turn_bias, scale, turn_gain = (float(value) for value in best.trajectory.bias)
    return GraphResult(
        poses=event_poses(keys, best.trajectory),
        score=best.score,
        start=start,
        scores={name: [each.score for each in several] for name, several in rounds.items()},
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
