"""The smoothing of a log: all stages of the graph of local maps in order.

No stage uses the ground truth. Alternatives are compared by the score G of :class:`MapScore`: the share of points that
other visits of a place confirm, minus the share that other visits contradict, minus the strain of a path that is bent.

The log is solved in frames in which it begins at the origin, and the result is then transformed to the start pose. The
result therefore does not depend on the start pose. The heading of the frame determines the positions of the bins of the
Hough transforms, and can thereby change which loops are found. The search is therefore run with several headings.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.agreement import (
    DOUBTFUL_SHARE,
    NOT_ADDED,
    Evidence,
    LoopVerdict,
    distances_after_alignment,
)
from limslam_agent.slam.graph.key_poses import (
    ERRORS,
    KeyPoses,
    LogData,
    Trajectory,
    choose_keys,
    corrected,
    delayed,
    event_poses,
    joined_bias,
    odometry_trajectory,
)
from limslam_agent.slam.graph.local_maps import chunk_middles
from limslam_agent.slam.graph.local_smoothing import smooth_locally
from limslam_agent.slam.graph.loop_search import loops_along_the_way, scale_of_hops
from limslam_agent.slam.graph.rounds import STARTS, Candidates, LogProblem, Round, do_round, is_settled
from limslam_env.geometry import FloatArray, IntArray, se2

_MOST, _SAME_PATH = 0.9, 0.5  # share of a path that has to agree with another path, and how well, m
# Searches with the highest scores after the first round do the trial rounds, and the best of these do all rounds. Their
# scores are worse than the best one by less than the last number.
_TRIED, _TRIAL_ROUNDS, _FINISHED, _HOPELESS = 3, 2, 2, 0.02
_TIE = 0.003  # scores within this distance of the best score are equal; the last such round is taken
# How often the delay of the ranges is estimated and corrected before the search. A correction of less, s, is the last.
_SYNCHRONISATIONS, _SYNCHRONOUS = 3, 0.02
# If odometry misses more heading than this, rad/m, its errors are corrected and the log is smoothed again, at most this
# often. The result is kept if its score is higher.
_MUCH_MISSED, _RESTARTS = math.radians(3.0), 3


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
    chunk_events
        Middle events of the chunks (c,).
    errors
        The estimated constant errors (5,) of odometry, as in :class:`Trajectory`.
    keys, trajectory
        The key poses and their trajectory, from which the points can be drawn.
    hop_events, hop_errors
        First events (h,) of the hops between chunks, and how far each hop is from the local smoothing, as a chi-square
        (h,).
    further
        Searches the frames that were left out as well, and returns the best result of all frames. None if all frames
        were searched.
    """

    poses: FloatArray
    score: float
    start: str
    scores: dict[str, list[float]]
    verdicts: list[LoopVerdict]
    chunk_events: IntArray
    errors: FloatArray
    keys: KeyPoses = field(repr=False)
    trajectory: Trajectory = field(repr=False)
    hop_events: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64), repr=False)
    hop_errors: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    further: "Callable[[], GraphResult] | None" = field(default=None, repr=False)


Report = Callable[[str], None]
"""Called with the stage that begins, in words."""


def saying(where: str, report: Report) -> Report:
    """A report that names the place before each stage."""
    return lambda stage: report(f"{where}, {stage}")


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
    data, known = _synchronised(data, config)
    best = _smoothed(data, start, config, report)
    for _ in range(_RESTARTS):
        found = best.trajectory.bias
        if abs(found[0]) < _MUCH_MISSED:
            break
        # The loops of a path that bends by several degrees a metre are not recognised, and then its bias is too small.
        data = corrected(data, found)
        again = _smoothed(data, start, config, saying("odometry corrected", report))
        if again.score <= best.score:
            break
        best, known = again, joined_bias(known, found)
    return _with_errors(best, known)


def _with_errors(found: GraphResult, known: FloatArray) -> GraphResult:
    """The result of a log whose odometry was corrected for the errors ``known`` (5,), with the errors of the log."""
    further = found.further
    return replace(
        found,
        errors=joined_bias(known, found.trajectory.bias),
        further=None if further is None else lambda: _with_errors(further(), known),
    )


def _synchronised(data: LogData, config: GraphConfig) -> tuple[LogData, FloatArray]:
    """The log with its odometry at the times of the ranges, and the constant errors (5,) that were corrected by it.

    The motions between key poses are linear in the delay for short delays only, so the delay is estimated repeatedly.
    """
    known = np.zeros(ERRORS)
    for _ in range(_SYNCHRONISATIONS):
        keys = choose_keys(data, config.keys)
        if len(keys) < 2 or not len(keys.point_key):
            break
        delay = float(_local(keys, data, config, 0.0).bias[3])
        data, known = delayed(data, delay), known + np.array([0.0, 0.0, 0.0, delay, 0.0])
        if abs(delay) < _SYNCHRONOUS:
            break
    return data, known


def _smoothed(data: LogData, start: FloatArray, config: GraphConfig, report: Report) -> GraphResult:
    """Smooth a log with odometry as it is."""
    keys = choose_keys(data, config.keys)
    if len(keys) < 2 or not len(keys.point_key):
        return _unlooped(keys, "odometry", odometry_trajectory(keys, start))
    if len(chunk_middles(keys, config.maps, config.maps.hop * config.rounds.hops[0])) < 2:
        return _unlooped(keys, "local", _local(keys, data, config, 0.0).moved(start))
    turns = config.rounds.orientations
    frames = [
        partial(_begun, keys, data, config, turn, saying(f"frame {number} of {len(turns)}", report))
        for number, turn in enumerate(turns, start=1)
    ]
    return _best_result([], frames, start)


def _best_result(
    searches: list["_Search"], frames: Sequence[Callable[[], list["_Search"]]], start: FloatArray
) -> GraphResult:
    """The best result of the completed searches and of those in further frames, as many as are needed."""
    begun = _frames(frames)
    searches, rest = searches + _searched(begun), frames[len(begun) // len(STARTS) :]
    best, found = _most_credible(searches)
    log, found = best.log, _placed_at(found, start, best.turn)
    scores = {search.name: [each.score for each in search.rounds] for search in searches}
    begins, errors = log.bends(found.trajectory)
    return replace(
        _result(log.keys, best.name, found, scores),
        hop_events=log.keys.first_event[begins],
        hop_errors=errors,
        further=partial(_best_result, searches, rest, start) if rest else None,
    )


def _silent(_: str) -> None:
    """Report nothing."""


def _local(keys: KeyPoses, data: LogData, config: GraphConfig, turn: float) -> Trajectory:
    """The trajectory after the local smoothing, in the frame in which the first heading is ``turn`` (rad)."""
    odometry = odometry_trajectory(keys, np.array([0.0, 0.0, turn]))
    return smooth_locally(keys, odometry, config, data.range_std)


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

    log: LogProblem
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
        return float(np.quantile(distances_after_alignment(poses, others), _MOST)) <= _SAME_PATH

    def advanced(self, end: int) -> "_Search":
        """The search after ``end`` rounds."""
        return replace(self, rounds=_rounds(self, end))


def _frames(frames: Sequence[Callable[[], list[_Search]]]) -> list[_Search]:
    """The first rounds of all searches, in frame after frame, until two frames have led to the same path.

    Further frames would most probably lead to this path as well.
    """
    searches, best = list[_Search](), list[_Search]()
    for frame in frames:
        begun = frame()
        searches += begun
        best = sorted([*best, max(begun, key=_score)], key=_score, reverse=True)
        if any(best[0].finds_the_path_of(other) for other in best[1:]):
            break
    return searches


def _score(search: _Search) -> float:
    return search.score


def _begun(keys: KeyPoses, data: LogData, config: GraphConfig, turn: float, report: Report) -> list[_Search]:
    """The first round of all starts, in the frame in which the first heading is ``turn`` (rad)."""
    report("local smoothing")
    log = LogProblem(keys, _local(keys, data, config, turn), data, config)
    chunks = log.chunks(log.local, 0)
    loops = loops_along_the_way(chunks)
    scale = scale_of_hops(chunks, loops)
    if scale < 1.0:
        log = replace(log, hop_scale=scale)
        chunks = log.chunks(log.local, 0)
        loops = loops_along_the_way(chunks)
    candidates = Candidates(chunks, loops)
    searches = []
    for start in STARTS:
        _say_round(report, log, start, 0, len(candidates.loops))
        searches.append(_Search(log, start, turn, report, [do_round(log, log.local, 0, candidates, start)]))
    return searches


def _say_round(report: Report, log: LogProblem, start: str, number: int, loops: int) -> None:
    report(f"start {start}, round {number + 1} of at most {len(log.config.rounds.hops)}, {loops} loops")


def _searched(searches: list[_Search]) -> list[_Search]:
    """All searches. Only the best searches do the trial rounds, and only the best of these do all rounds.

    Of searches that have found the same path after the trial, one goes on.
    """
    tried = _continued(searches, _TRIAL_ROUNDS, _TRIED, math.inf)
    best = max(tried, key=_score)
    same = [each for each in tried if each is not best and each.finds_the_path_of(best)]
    others = [each for each in tried if each not in same]
    return same + _continued(others, len(searches[0].log.config.rounds.hops), _FINISHED, _HOPELESS)


def _continued(searches: list[_Search], end: int, most: int, hopeless: float) -> list[_Search]:
    """Continue at most ``most`` searches, none worse than the best search by ``hopeless``, up to round ``end``."""
    best = sorted(searches, key=_score, reverse=True)[:most]
    least = best[0].score - hopeless
    return [each.advanced(end) if each in best and each.score >= least else each for each in searches]


def _best(rounds: list[Round]) -> Round:
    """The last round whose score is nearly the highest score. The last round has tested most loops."""
    highest = max(each.score for each in rounds)
    return [each for each in rounds if each.score >= highest - _TIE][-1]


def _most_credible(searches: list[_Search]) -> tuple[_Search, Round]:
    """The search with the highest score, and its best round, among the rounds that add no contradictions to others.

    They are also compared with the paths without loops. A map in which few places were seen again does not say how many
    contradictions are usual, and none is refused because of it. If all rounds add contradictions, all are considered.
    """
    others = [each.evidence for search in searches for each in search.rounds]
    others += [log.evidence(log.local) for log in {id(search.log): search.log for search in searches}.values()]
    others = [each for each in others if each.says_what_is_usual]

    def is_credible(each: Round) -> bool:
        return not any(each.evidence.adds_contradictions(other, DOUBTFUL_SHARE) for other in others)

    credible = [replace(search, rounds=list(filter(is_credible, search.rounds))) for search in searches]
    best = max([each for each in credible if each.rounds] or searches, key=_score)
    return best, _best(best.rounds)


def _rounds(search: _Search, end: int) -> list[Round]:
    """Do rounds, each with new chunks and new tests of all loops, until nothing changes."""
    log, start, rounds = search.log, search.start, list(search.rounds)
    for number in range(len(rounds), end):
        if is_settled(rounds):
            break
        kept = sum(verdict.kept for verdict in rounds[-1].verdicts)
        _say_round(search.report, log, start, number, kept)
        rounds.append(_next_round(log, rounds[-1].trajectory, number, start))
    return rounds


def _next_round(log: LogProblem, trajectory: Trajectory, number: int, start: str) -> Round:
    """Do a round with chunks of its own, whose grids are freed at its end."""
    trajectory = log.unbent(trajectory, number)
    chunks = log.chunks(trajectory, number)
    return do_round(log, trajectory, number, Candidates(chunks, loops_along_the_way(chunks)), start)


def _placed_at(found: Round, start: FloatArray, turn: float) -> Round:
    """The round, transformed from the frame in which the log begins at (0, 0, ``turn``) to the frame of the result."""
    motion = se2.compose(np.asarray(start, dtype=float), np.array([0.0, 0.0, -turn]))
    return replace(found, trajectory=found.trajectory.moved(motion))


def without_loops(
    found: GraphResult, start: FloatArray, config: GraphConfig, range_std: float
) -> tuple[GraphResult, GraphResult]:
    """The results by odometry alone, and by odometry and the walls along the way, with all loops rejected.

    Both paths begin at the pose ``start`` (3,).
    """
    verdicts = [replace(each, reason=NOT_ADDED if each.kept else each.reason) for each in found.verdicts]
    odometry = odometry_trajectory(found.keys, start)
    local = smooth_locally(found.keys, odometry, config, range_std)
    first, second = (
        replace(
            _unlooped(found.keys, name, path), scores=found.scores, verdicts=verdicts, chunk_events=found.chunk_events
        )
        for name, path in (("odometry", odometry), ("local", local))
    )
    return first, second


def _unlooped(keys: KeyPoses, name: str, trajectory: Trajectory) -> GraphResult:
    """The result of a log that is too short for chunks."""
    found = Round(trajectory, 0.0, Evidence(0, 0, 0, 0.0), [], np.zeros(1, dtype=np.int64))
    return _result(keys, name, found, {name: [0.0]})


def _result(keys: KeyPoses, name: str, best: Round, scores: dict[str, list[float]]) -> GraphResult:
    return GraphResult(
        poses=event_poses(keys, best.trajectory),
        score=best.score,
        start=name,
        scores=scores,
        verdicts=best.verdicts,
        chunk_events=keys.first_event[best.middles],
        errors=best.trajectory.bias,
        keys=keys,
        trajectory=best.trajectory,
    )
