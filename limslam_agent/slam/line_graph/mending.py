"""Correction of wrong associations that re-association alone cannot correct: lines are cut, dropped and created anew.

Each move changes the associations of the best solution so far, and then re-associates and solves. The result is kept if
its score is higher. The score needs no ground truth.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from limslam_agent.slam.line_graph import line_merging as merging
from limslam_agent.slam.line_graph.elimination import DegenerateError
from limslam_agent.slam.line_graph.map_score import LINE_PRICE, Score, explained_readings, line_values, score, tally
from limslam_agent.slam.line_graph.problem import (
    FEWEST_READINGS,
    Problem,
    State,
    first_steps,
    moved,
    state_from_motions,
    state_from_poses,
    thinned,
    thinning_nodes,
)
from limslam_agent.slam.line_graph.reassociation import (
    ONE_WALL,
    ROUNDS,
    Association,
    ends_of,
    faces_of,
    hit_points,
    merge,
    reassociate_from,
    rooted,
    solve_again,
    solve_labels,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2

_ROUNDS = 3  # of moves
_LAST_ROUNDS = 4  # of re-association after new lines were created
_GAIN = 5.0  # by how much a move must raise the score
# A correction is tried if beams contradict more than this share of all looks. It is kept if at most a share of the
# contradictions remains, or if there are no more of them than in correct maps, as a share of all looks.
_CONTRADICTED, _REMAINING, _UNAVOIDABLE = 0.01, 0.6, 0.002
_CUT = 3.0  # m driven without a reading of a line, where the line is cut
_LIMITS = ONE_WALL.wider(max_offset=0.8, max_angle=0.4, min_overlap=0.10)  # of segments that may be one wall
# Moves that begin with more lines are not tried, because their time grows with the third power of this number.
_MOST_LINES = 600
# A line is dropped if more beams contradict it than this number, and than this share of its readings.
_DROPPED_LEAST, _DROPPED_SHARE = 5, 0.2
_UNEXPLAINED = 4.0  # standard deviations from every line: such readings may create new lines
_FEWEST_REBORN = 8  # readings of a new line
# Two lines that share a stretch of wall are merged within these distances, in standard deviations of a range and in m,
# of which the larger one counts, and within this angle, rad.
_DOUBLED_SIGMAS, _DOUBLED_OFFSET, _DOUBLED_ANGLE = 3.0, 0.03, math.radians(10.0)
_RUN_GAP = 0.15  # m of driving without a reading that ends a run
_POINT_GAP = 0.30  # m between the ends of two readings of one wall

# A drive is continued without a filter in stretches of this length, m. A stretch may cross a hall without a wall, so
# its walls may be far from where the wheels place them.
_STRETCH, _STRETCH_ROUNDS, _FEWEST_OF_PIECE = 10.0, 2, 5
_FAR_LIMITS = ONE_WALL.wider(max_offset=2.5, max_angle=0.6, min_overlap=0.10)
_KNOWN_AGAIN = 0.5  # least share of the later readings that are of walls of the beginning

MOVES = ("anew", "cut", "drop", "reborn")
"""``anew``: only straight wall segments, found along the path of the wheel odometry. ``cut``: lines cut where they were
not read for a while. ``drop``: as ``cut``, without the lines that beams contradict. ``reborn``: with new lines through
readings that no line explains. Every other move is also tried together with ``reborn``."""

_LATER_MOVES = MOVES[1:]  # of a solution that does not come from the filter: *anew* would only forget it


@dataclass(frozen=True, eq=False)
class Candidate:
    """A solution, its score, and the move that led to it."""

    association: Association
    score: Score
    move: str


def mend(problem: Problem, found: Association, first_moves: tuple[str, ...] = MOVES) -> list[Candidate]:
    """The accepted solutions in order, from the initial solution to the best solution.

    A round ends with the first move after which beams no longer contradict the map. From then on, only missing lines
    are added.
    """
    kept = [Candidate(found, score(problem, found), "start")]
    for number in range(_ROUNDS):
        moves = _LATER_MOVES if number else first_moves
        if number and not is_contradicted(problem, kept[-1].association):
            moves = ("reborn",)
        best = _best_of_round(problem, kept[-1], moves)
        if best is kept[-1]:
            break
        kept.append(best)
    return kept


def continued(problem: Problem, known: State, labels: IntArray) -> Association | None:
    """The association of one robot's whole drive, from that of its beginning, without a filter.

    The drive goes on by its wheels, some metres at a time. Its readings are cut into straight pieces, and the pieces
    are merged with the lines so far, the surest first. At first, only poses some way apart take part.

    Parameters
    ----------
    problem
        The measurements of the whole drive.
    known, labels
        The poses and the calibration of its beginning, and the lines of the readings there, which are the first ones of
        the problem.

    Returns
    -------
    Association
        None if beams contradict the result, or if few of the later readings are of walls of the beginning: then nothing
        says that the robot is where its wheels report.
    """
    begin = known.poses.shape[1]
    nodes = thinning_nodes(problem, [begin - 1])
    thin, kept = thinned(problem, nodes, known.calibration), np.flatnonzero(np.isin(problem.readings.places, nodes))
    first, travel = int(np.searchsorted(nodes, begin)), driven_at(thin)
    part, done = first_steps(thin, first), first
    state = state_from_poses(part, known.poses[0, nodes[:first], None], known.calibration)
    try:
        found = solve_labels(part, state, labels[kept[: len(part.readings)]])
        while done < thin.steps:
            done = min(int(np.searchsorted(travel, travel[done - 1] + _STRETCH)) + 1, thin.steps)
            part = first_steps(thin, done)
            found = _with_stretch(part, found)
        if is_contradicted(part, found):
            found = mend(part, found, _LATER_MOVES)[-1].association
        if not _is_supported(part, found, first):
            return None
        found = _refined(problem, found, nodes, kept)
        return found if _is_supported(problem, found, begin) else None
    except DegenerateError:
        return None


def _with_stretch(part: Problem, found: Association) -> Association:
    """The association of a longer part of a drive, whose last poses follow from the wheels alone."""
    before = found.state
    motions = part.motions(before.calibration)
    motions[:, : before.motions.shape[1]] = before.motions
    state = moved(part, motions, before.lines[:0], before.anchors[:0], before.calibration)
    labels = np.full(len(part.readings), -1)
    labels[: len(found.labels)] = found.labels
    pieces = straight_runs(part, state, labels < 0, _FEWEST_OF_PIECE)
    labels = np.where(pieces >= 0, pieces + int(labels.max(initial=-1)) + 1, labels)
    merged, _ = merge(part, solve_labels(part, state, labels), _FAR_LIMITS)
    return reassociate_from(part, merged, _STRETCH_ROUNDS)


def _is_supported(problem: Problem, found: Association, begin: int) -> bool:
    """Whether no more beams than usual contradict a drive, and enough readings from a step on are of lines that were
    also read before it.
    """
    used, later = found.labels >= 0, problem.readings.places >= begin
    again = np.isin(found.labels, np.unique(found.labels[used & ~later])) & used & later
    is_known_again = int(again.sum()) >= _KNOWN_AGAIN * max(int(later.sum()), 1)
    return is_known_again and not is_contradicted(problem, found)


def _refined(problem: Problem, found: Association, nodes: IntArray, kept: IntArray) -> Association:
    """The association of all poses and readings, from that of the poses at nodes, whose readings are those ``kept``."""
    state, steps = found.state, np.arange(problem.steps)
    free = state_from_motions(problem, state.calibration).poses[0]
    # Between two nodes, the wheels say where the robot was.
    before = np.searchsorted(nodes, steps, side="right") - 1
    poses = se2.compose(state.poses[0][before], se2.between(free[nodes[before]], free))
    labels = np.full(len(problem.readings), -1)
    labels[kept] = found.labels
    whole = state_from_poses(problem, poses[:, None], state.calibration)
    return reassociate_from(problem, solve_labels(problem, whole, labels), ROUNDS)


def is_contradicted(problem: Problem, found: Association) -> bool:
    """Whether more beams pass through walls than in a correct map."""
    return tally(problem, found).contradictions > _CONTRADICTED * len(problem.looks)


def is_repaired(problem: Problem, before: Association, after: Association) -> bool:
    """Whether clearly fewer beams contradict the map after a correction.

    A correction can raise the score by fitting noise, and bend the whole map. It then leaves most contradictions.
    """
    remaining = tally(problem, after).contradictions
    most = max(_REMAINING * tally(problem, before).contradictions, _UNAVOIDABLE * len(problem.looks))
    return remaining <= most


def _best_of_round(problem: Problem, begin: Candidate, moves: tuple[str, ...]) -> Candidate:
    """The best solution that the moves lead to, or the solution at the beginning of the round."""
    best, mender = begin, _Mender(problem, begin)
    for move in moves:
        for candidate in mender.tried(move):
            if candidate.score.total > best.score.total + _GAIN:
                best = candidate
        if best is not begin and not is_contradicted(problem, best.association):
            break
    return best


class _Mender:
    """The moves that start from one solution."""

    def __init__(self, problem: Problem, begin: Candidate) -> None:
        self._problem, self._begin = problem, begin

    def tried(self, move: str) -> Iterator[Candidate]:
        """The results of a move, and the results with new lines for unexplained readings."""
        try:
            state, labels = self._begun(move)
            if np.count_nonzero(np.bincount(labels[labels >= 0])) > _MOST_LINES:
                return
            settled = self._settled(state, labels, ROUNDS)
            first = list(self._both(settled, move))
            yield from first
            # Missing lines cannot repair a solution whose score is much lower.
            if move != "reborn" and max(each.score.total for each in first) > self._begin.score.total:
                again = self._settled(settled.state, self._reborn(settled), _LAST_ROUNDS)
                yield from self._both(again, f"{move}, reborn")
        except DegenerateError:
            return

    def _begun(self, move: str) -> tuple[State, IntArray]:
        """The initial poses and associations of a move."""
        begin = self._begin.association
        if move == "anew":
            return state_from_motions(self._problem), self._anew()
        if move == "cut":
            return begin.state, split(self._problem, begin.labels, _CUT)
        if move == "drop":
            return begin.state, split(self._problem, np.where(self._is_dropped(), -1, begin.labels), _CUT)
        return begin.state, self._reborn(begin)

    def _is_dropped(self) -> BoolArray:
        """Mask (k,) of the readings whose lines are contradicted by too many beams."""
        counted = tally(self._problem, self._begin.association)
        least = np.maximum(_DROPPED_LEAST, _DROPPED_SHARE * counted.hits.sum(axis=1))
        return np.isin(self._begin.association.labels, np.flatnonzero(counted.against > least))

    def _both(self, found: Association, move: str) -> Iterator[Candidate]:
        """A solution, and the same solution without unnecessary lines."""
        yield self._candidate(found, move)
        yield self._candidate(self._pruned(found), f"{move}, pruned")

    def _candidate(self, found: Association, move: str) -> Candidate:
        return Candidate(found, score(self._problem, found), move)

    def _settled(self, state: State, labels: IntArray, rounds: int) -> Association:
        begin = solve_labels(self._problem, state, labels)
        merged, _ = merge(self._problem, begin, _LIMITS)
        return reassociate_from(self._problem, merged, rounds)

    def _pruned(self, found: Association) -> Association:
        """The solution without doubled lines, and without lines that raise the score by less than their price."""
        doubled = doubled_lines(self._problem, found)
        labels = np.where(found.labels >= 0, doubled[found.labels], -1)
        worthless = line_values(self._problem, found) < LINE_PRICE
        labels = np.where(np.isin(labels, np.flatnonzero(worthless)), -1, labels)
        begin = solve_again(self._problem, found.state, labels)
        return reassociate_from(self._problem, begin, 2)

    def _anew(self) -> IntArray:
        """Associations with only straight wall segments, found along the path of the wheel odometry."""
        reported = state_from_motions(self._problem)
        everything = np.ones(len(self._problem.readings), dtype=bool)
        return straight_runs(self._problem, reported, everything, FEWEST_READINGS)

    def _reborn(self, found: Association) -> IntArray:
        """The associations with new lines through readings that no line explains."""
        unexplained = explained_readings(self._problem, found) > _UNEXPLAINED
        pieces = straight_runs(self._problem, found.state, unexplained, _FEWEST_REBORN)
        return np.where(pieces >= 0, pieces + int(found.labels.max(initial=-1)) + 1, found.labels)


def doubled_lines(problem: Problem, found: Association) -> IntArray:
    """For each line (m,), the line with more readings that runs along it, or the line itself.

    Each reading belongs to the nearer of two lines that run along each other. This separates the two lines, so that
    their covariances never allow a merge.
    """
    state, labels = found.state, found.labels
    apart = max(_DOUBLED_SIGMAS * problem.range_std, _DOUBLED_OFFSET)
    limits = np.array([np.inf, apart, _DOUBLED_ANGLE, _LIMITS.min_overlap])
    pairs = merging.near_pairs(state.lines, state.anchors, ends_of(problem, state, labels), limits)
    pairs = pairs[merging.share_side(pairs, state.lines, state.anchors, faces_of(problem, state, labels))]
    counts = np.bincount(labels[labels >= 0], minlength=len(state.lines))
    result = np.arange(len(state.lines))
    for first, second in pairs.tolist():
        few, many = sorted((first, second), key=counts.__getitem__)
        if result[few] == few and result[many] == many:
            result[few] = many
    return rooted(result)


def split(problem: Problem, labels: IntArray, gap: float) -> IntArray:
    """Labels that are cut wherever a line was not read for ``gap`` (m) of a robot's path."""
    driven = driven_at(problem)
    order = np.lexsort((np.arange(len(labels)), labels))
    order = order[labels[order] >= 0]
    place = problem.readings.places[order]
    is_new = np.diff(labels[order], prepend=-1) != 0
    is_new |= np.diff(place // problem.steps, prepend=-1) != 0
    is_new |= np.diff(driven[place], prepend=0.0) > gap
    result = np.full(len(labels), -1)
    result[order] = np.cumsum(is_new) - 1
    return result


def driven_at(problem: Problem) -> FloatArray:
    """Distance driven by each robot up to each pose (n t,), by its wheels, m."""
    travel = np.abs(problem.wheels[..., :2]).mean(axis=2)
    start = np.zeros((len(travel), 1))
    return np.concatenate((start, np.cumsum(travel, axis=1)), axis=1).ravel()


def straight_runs(problem: Problem, state: State, chosen: BoolArray, fewest: int) -> IntArray:
    """Straight wall segments among chosen readings: the number of the segment of each reading (k,), or -1.

    The successive readings of one beam are divided at gaps and at bends.
    """
    readings, driven = problem.readings, driven_at(problem)
    order = np.lexsort((readings.places, readings.beams, readings.places // problem.steps))
    order = order[chosen[order]]
    points = hit_points(problem, state, order)[:, :2]
    place, beam = readings.places[order], readings.beams[order]
    breaks = (np.diff(beam) != 0) | (np.diff(driven[place]) > _RUN_GAP) | (np.diff(driven[place]) < 0.0)
    breaks |= np.linalg.norm(np.diff(points, axis=0), axis=1) > _POINT_GAP
    result, number = np.full(len(readings), -1), 0
    for run in np.split(np.arange(len(order)), np.flatnonzero(breaks) + 1):
        for piece in _unbent(points, run, 4.0 * problem.range_std, fewest):
            result[order[piece]] = number
            number += 1
    return result


def _unbent(points: FloatArray, run: IntArray, tolerance: float, fewest: int) -> list[IntArray]:
    """The parts of a run whose points lie within a tolerance (m) of a line: split-and-merge without the merge step."""
    if len(run) < fewest:
        return []
    off = points[run] - points[run].mean(axis=0)
    away = np.abs(off @ np.linalg.svd(off, full_matrices=False)[2][1])
    if away.max() <= tolerance:
        return [run]
    cut = min(max(int(away.argmax()), 1), len(run) - 1)
    return _unbent(points, run[:cut], tolerance, fewest) + _unbent(points, run[cut:], tolerance, fewest)
