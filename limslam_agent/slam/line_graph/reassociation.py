"""Association of all readings with lines, repeated after each improvement of the poses. No association is final.

Each round merges lines that are one wall, assigns each reading to the line that predicts it best, solves, and divides
the lines that are more than one wall.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from limslam_agent.slam.core.carried_anchors import KNOWN_PLACE
from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE, SURE, THICKEST, board_odds
from limslam_agent.slam.line_graph import line_kernels as kernels
from limslam_agent.slam.line_graph import line_merging as merging
from limslam_agent.slam.line_graph.chain_kernels import COSINE
from limslam_agent.slam.line_graph.elimination import POSE, DegenerateError
from limslam_agent.slam.line_graph.line_smoother import GRAZING, Solution, range_residuals, solve
from limslam_agent.slam.line_graph.problem import FEWEST_READINGS, Problem, State, rows_of
from limslam_agent.slam.line_graph.straightness import straight_labels
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import direction, normal

ROUNDS = 8
"""Largest number of rounds of merging, association and solving."""
_SETTLED = 2e-3  # m: the last round is the first one that moves no pose farther
GATE = 3.5
"""A line explains a reading that it predicts within this number of standard deviations."""
BEYOND = 0.10
"""How far beyond a line's ends a beam may meet it, m."""
_MARGIN = 3.0  # standard deviations by which the second-best line must predict a reading worse
# Readings close to an end of their line do not count for the final poses, since they may be of the next wall. The guard
# is this many times the excess of the standard deviation of a range over a length, m. Two walls that meet at 25 degrees
# differ by less than the gate over 7.5 standard deviations of their length, which ``BEYOND`` covers for exact ranges.
_END_GUARD, _EXACT_STD = 4.0, 0.02
_MOST_MERGES = 30
_LEAST_SPREAD = 100.0  # 1/rad^2: keeps the direction of a line whose readings are all in one place
_FITS = 2
_FEWEST_OF_SIDE = 4  # readings
_MOST_MOVED = (0.10, 0.05)  # m and rad: the largest change of a line by merging before the problem is linearised again
_LOOSE, _EXACT = 1e-3, 1e-4  # m or rad: convergence tolerances between moves and at the end


class OneWall(NamedTuple):
    """Criteria that two lines are one wall: upper bounds of chi-square, offset (m), angle (rad); least overlap (m).

    ``weakest`` is an upper bound of chi-square plus the logarithm of the determinant of the covariance (m^2 rad^2) of
    the lines' difference. Two lines of which little is known pass every other test.
    """

    gate: float
    max_offset: float
    max_angle: float
    min_overlap: float
    weakest: float = math.inf

    def wider(self, max_offset: float, max_angle: float, min_overlap: float) -> "OneWall":
        """Criteria with wider limits, for pairs that are more likely one wall than two walls within these limits.

        The difference of one wall's two lines is normally distributed, and that of two walls is uniform. Both
        densities are equal where chi-square plus the logarithm of the determinant is ``weakest``.
        """
        weakest = 2.0 * math.log(4.0 * max_offset * max_angle / (2.0 * math.pi))
        return OneWall(self.gate, max_offset, max_angle, min_overlap, weakest)


ONE_WALL = OneWall(16.0, 0.15, 0.12, 0.15)


@dataclass(frozen=True, eq=False)
class Association:
    """A solution, and the line (k,) of each reading in this solution; -1 for readings that were not used."""

    solution: Solution
    labels: IntArray

    @property
    def state(self) -> State:
        """Poses and lines."""
        return self.solution.state


def reassociate(problem: Problem, state: State, labels: IntArray, rounds: int = ROUNDS) -> Association:
    """Poses, lines and associations, from approximate poses and the first associations of some readings.

    Parameters
    ----------
    state
        Initial poses; the lines of the state are not used.
    labels
        The initial line of each reading, in any numbering, or -1.
    rounds
        Largest number of rounds.

    Raises
    ------
    DegenerateError
        If the readings do not determine the poses.
    """
    return reassociate_from(problem, solve_labels(problem, state, labels), rounds)


def with_kinds(problem: Problem, state: State, labels: IntArray) -> tuple[Problem, IntArray]:
    """The problem with the kinds of walls by first associations, and these associations.

    Unless the walls are boards for sure, each side of a line is a line of its own. Merging decides about it anew.
    """
    found = solve_labels(problem, state, labels)
    limits = np.array([np.inf, THICKEST, ONE_WALL.max_angle, ONE_WALL.min_overlap])
    ends, seen = ends_of(problem, found.state, found.labels), seen_ends(problem, found.state, found.labels)
    covariance = with_anchors(problem, found, ONE_WALL.max_angle)
    kinds = merging.wall_kinds(found.state.lines, found.state.anchors, ends, seen, covariance, limits)
    if are_boards(kinds):
        return replace(problem, kinds=kinds), labels
    sided = 2 * found.labels + sides_of(problem, found.state, found.labels)
    return replace(problem, kinds=kinds), np.where(found.labels >= 0, sided, -1)


def are_boards(kinds: tuple[float, float]) -> bool:
    """Whether the walls are boards for sure, by the lengths of known boards and walls, m."""
    return board_odds(0.0, *kinds) > SURE


def reassociate_from(problem: Problem, found: Association, rounds: int) -> Association:
    """Merge lines, re-associate readings, solve and divide bent lines, for at most ``rounds`` rounds."""
    for _ in range(rounds):
        before = found.state.poses
        merged, has_merged = merge(problem, found)
        labels = assigned(problem, merged.state, faces_of(problem, merged.state, merged.labels))
        found = solve_again(problem, merged.state, labels)
        found = straightened(problem, found)
        if np.abs(found.state.poses - before)[..., :2].max() < _SETTLED and not has_merged:
            break
    return without_ends(problem, found)


def without_ends(problem: Problem, found: Association) -> Association:
    """The solution without the readings beside the ends of lines, which may be of the next wall.

    The readings keep their lines, which are fitted to all of them at the end. Lines with too few other readings are
    removed.
    """
    guard, count = _END_GUARD * (problem.range_std - _EXACT_STD), len(found.state.lines)
    if guard <= 0.0:
        return found
    along, ends = places_along(problem, found.state, found.labels), ends_of(problem, found.state, found.labels)
    low, high = ends[found.labels].T + np.array([[guard], [-guard]])
    is_inner = (found.labels >= 0) & (along >= low) & (along <= high)
    is_short = np.bincount(found.labels[is_inner], minlength=count) < FEWEST_READINGS
    labels = np.where((found.labels >= 0) & is_short[found.labels], -1, found.labels)
    found = solve_again(problem, found.state, labels, shares=is_inner.astype(float))
    return replace(found, solution=replace(found.solution, state=with_all_readings(problem, found)))


def with_all_readings(problem: Problem, found: Association) -> State:
    """The state with every line fitted to all of its readings, at the same poses.

    The poses are estimated without the readings beside the ends of lines, and these readings say most about the
    directions of short lines.
    """
    state, (lines, anchors) = found.state, fitted_lines(problem, found.state, found.labels)
    lines[:, 0] += np.sum(normal(lines) * (anchors - state.anchors), axis=1)
    state = replace(state, lines=lines)
    for _ in range(_FITS):
        state = _fitted_again(problem, state, found.labels)
    return state


def _fitted_again(problem: Problem, state: State, labels: IntArray) -> State:
    """The state with every line moved to the weighted least-squares line through its readings, linearised."""
    rows, own, count = rows_of(problem, state, labels), labels >= 0, len(state.lines)
    cosines, along = rows[own, COSINE], places_along(problem, state, labels)[own]
    off = range_residuals(problem, state, rows)[own] * cosines
    weights = (problem.range_std * problem.noise[own] * np.maximum(np.abs(cosines), GRAZING)) ** -2.0
    total = [np.bincount(labels[own], each, count) for each in (weights, weights * along, weights * off)]
    middle, mean = total[1] / total[0], total[2] / total[0]
    lever = along - middle[labels[own]]
    spread = np.bincount(labels[own], weights * lever**2, count) + _LEAST_SPREAD
    turn = -np.bincount(labels[own], weights * lever * off, count) / spread
    return replace(state, lines=state.lines + np.column_stack((mean + turn * middle, turn)))


def solve_labels(problem: Problem, state: State, labels: IntArray, iterations: int = 8) -> Association:
    """The optimum for given associations. The lines are first fitted to their readings at the poses of a state.

    Lines with too few readings are left out.
    """
    labels, _ = renumbered(labels)
    lines, anchors = fitted_lines(problem, state, labels)
    state = replace(state, lines=lines, anchors=anchors)
    return Association(solve(problem, state, labels, iterations=iterations, tolerance=_EXACT), labels)


def solve_again(
    problem: Problem,
    state: State,
    labels: IntArray,
    *,
    iterations: int = 5,
    tolerance: float = _EXACT,
    shares: FloatArray | None = None,
) -> Association:
    """The optimum for associations with the lines of a state; lines with too few readings are removed.

    Raises
    ------
    DegenerateError
        If no line is left, or the equations cannot be solved.
    """
    labels, kept = renumbered(labels)
    if not len(kept):
        raise DegenerateError("no line has enough readings")
    state = replace(state, lines=state.lines[kept], anchors=state.anchors[kept])
    return Association(solve(problem, state, labels, iterations=iterations, tolerance=tolerance, shares=shares), labels)


def renumbered(labels: IntArray, fewest: int = FEWEST_READINGS) -> tuple[IntArray, IntArray]:
    """Labels of the lines in the order of first readings, and the old numbers (m,).

    Lines with fewer than ``fewest`` readings are left out.
    """
    known, firsts, inverse, counts = np.unique(labels, return_index=True, return_inverse=True, return_counts=True)
    is_line = (known >= 0) & (counts >= fewest)
    order = np.argsort(np.where(is_line, firsts, len(labels)), kind="stable")[: int(is_line.sum())]
    numbers = np.full(len(known), -1)
    numbers[order] = np.arange(len(order))
    return numbers[inverse], known[order]


def fitted_lines(problem: Problem, state: State, labels: IntArray) -> tuple[FloatArray, FloatArray]:
    """Lines and anchors (m, 2) through the readings of each label 0 to m - 1."""
    order = np.argsort(labels, kind="stable")
    order = order[labels[order] >= 0]
    count = int(labels.max(initial=-1)) + 1
    points = hit_points(problem, state, order)
    lines, anchors = np.empty((count, 2)), np.empty((count, 2))
    firsts = np.searchsorted(labels[order], np.arange(count + 1))
    kernels.fit_lines(points, firsts, problem.range_std, lines, anchors)
    return lines, anchors


def hit_points(problem: Problem, state: State, chosen: IntArray) -> FloatArray:
    """The end points of chosen readings and the directions of their beams: rows x, y, angle (k, 3), m and rad."""
    readings, points = problem.readings, np.empty((len(chosen), 4))
    places, distances = readings.places[chosen], readings.distances[chosen]
    kernels.hit_points(state.flat_poses, places, problem.beams[chosen], distances, points)
    return points


def places_along(problem: Problem, state: State, labels: IntArray) -> FloatArray:
    """Where each reading's beam meets its line (k,), m from the line's anchor; 0 for readings of no line."""
    along = np.zeros(len(labels))
    kernels.places_along(
        state.flat_poses, problem.readings.places, problem.beams, labels, state.lines, state.anchors, along
    )
    return along


def ends_of(problem: Problem, state: State, labels: IntArray, spared: int = 1) -> FloatArray:
    """The ends of each line's readings (m, 2), m, without the outermost ``spared`` readings on each side."""
    along = places_along(problem, state, labels)
    order = np.lexsort((along, labels))
    order = order[labels[order] >= 0]
    count = len(state.lines)
    firsts = np.searchsorted(labels[order], np.arange(count + 1))
    lengths = np.diff(firsts)
    left_out = np.where(lengths > 4 * spared, spared, 0)
    sorted_along = along[order]
    return np.column_stack((sorted_along[firsts[:-1] + left_out], sorted_along[firsts[1:] - 1 - left_out]))


def sides_of(problem: Problem, state: State, labels: IntArray) -> IntArray:
    """The side (k,) of its line that each reading was taken from: ``POSITIVE`` or ``NEGATIVE``."""
    headings = state.flat_poses[problem.readings.places, 2] + problem.beams[:, 2]
    return np.where(np.cos(state.lines[labels, 1] - headings) < 0.0, POSITIVE, NEGATIVE)


def seen_ends(problem: Problem, state: State, labels: IntArray) -> FloatArray:
    """The ends of each line's readings from each side (m, 2, 2), m, without the outermost reading at each end.

    Where a side has few readings, these may be of another wall, and the side counts as not seen.
    """
    sided = np.where(labels >= 0, 2 * labels + sides_of(problem, state, labels), -1)
    along, count = places_along(problem, state, labels), 2 * len(state.lines)
    order = np.lexsort((along, sided))
    order = order[sided[order] >= 0]
    firsts = np.searchsorted(sided[order], np.arange(count + 1))
    ends, is_seen = np.tile([np.inf, -np.inf], (count, 1)), np.diff(firsts) > _FEWEST_OF_SIDE
    ends[is_seen, 0] = along[order][firsts[:-1][is_seen] + 1]
    ends[is_seen, 1] = along[order][firsts[1:][is_seen] - 2]
    return ends.reshape(-1, 2, 2)


def faces_of(problem: Problem, state: State, labels: IntArray) -> FloatArray:
    """The ends of each line from each side (m, 2, 2), m. Both sides of a line are equal where all walls are boards."""
    if are_boards(problem.kinds):
        return np.repeat(ends_of(problem, state, labels)[:, None], 2, axis=1)
    return seen_ends(problem, state, labels)


def assigned(problem: Problem, state: State, ends: FloatArray) -> IntArray:
    """For each reading, the line that predicts it, or -1 if no line or two lines predict it."""
    best, misfits = best_lines(problem, state, ends)
    is_clear = (misfits[:, 0] < GATE) & (misfits[:, 1] - misfits[:, 0] > _MARGIN)
    return np.where(is_clear, best, -1)


def best_lines(problem: Problem, state: State, ends: FloatArray) -> tuple[IntArray, FloatArray]:
    """The best line (k,) of each reading, or -1, and the misfits of the best and second line (k, 2), in deviations.

    A line can explain the readings from a side between the ends (m, 2, 2) on this side, and up to ``BEYOND``
    outside.
    """
    readings = problem.readings
    best, misfits = np.empty(len(readings), dtype=np.int64), np.empty((len(readings), 2))
    biases = state.calibration[readings.places // problem.steps, 3]
    kernels.best_lines(
        state.flat_poses, readings.places, problem.beams, readings.distances - biases, state.lines, state.anchors,
        ends, BEYOND, problem.beam_width, best, misfits,
    )  # fmt: skip
    return best, misfits / problem.range_std / problem.noise[:, None]


def straightened(problem: Problem, found: Association) -> Association:
    """The solution with bent lines divided, and without runs of readings that lie on one side of their line."""
    along = places_along(problem, found.state, found.labels)
    labels = straight_labels(problem, found.solution, found.labels, along)
    return found if np.array_equal(labels, found.labels) else solve_labels(problem, found.state, labels)


def merge(problem: Problem, found: Association, limits: OneWall = ONE_WALL) -> tuple[Association, bool]:
    """Merge the lines that may be one wall, and return whether there were such lines.

    Each merge updates all lines through their joint covariance. Poses and lines are solved for again when a line has
    moved far. This repeats until no pair can merge.
    """
    has_merged = False
    for _ in range(_MOST_MERGES if len(found.state.lines) else 0):
        state = found.state
        merged_into = np.empty(len(state.lines), dtype=np.int64)
        lines, ends = state.lines.copy(), ends_of(problem, state, found.labels)
        covariance = with_anchors(problem, found, limits.max_angle)
        seen = seen_ends(problem, state, found.labels)
        count = merging.merge_lines(
            lines, state.anchors, ends, seen, covariance, np.array(limits), np.array(problem.kinds),
            np.array(_MOST_MOVED), merged_into,
        )  # fmt: skip
        if not count:
            break
        has_merged = True
        labels = np.where(found.labels >= 0, rooted(merged_into)[found.labels], -1)
        found = solve_again(problem, state, labels, tolerance=_LOOSE)
    return found, has_merged


def with_anchors(problem: Problem, found: Association, max_angle: float) -> FloatArray:
    """Joint covariance of the lines (2 m), and of the places of their anchors along them (m) where these are uncertain.

    :mod:`limslam_agent.slam.core.carried_anchors` says why two lines are compared at a place that moves with the world.
    In the filter it moves with the robot. Here it moves with a pose near the last reading of the line: of the poses
    that the elimination keeps, the first one after this reading. The places are left out if lines that differ by at
    most ``max_angle``, rad, are compared exactly enough without them.
    """
    factored = found.solution.factored
    covariance, first_line = factored.covariance, factored.first_line
    poses, by_pose = carriers(problem, found)
    moved = np.einsum("mi,mij->mj", by_pose, covariance[poses])
    places = np.einsum("mnj,nj->mn", moved[:, poses], by_pose)
    if max_angle**2 * np.diag(places).max(initial=0.0) < KNOWN_PLACE:
        return factored.lines.copy()
    beside = moved[:, first_line:]
    return np.block([[factored.lines, beside.T], [beside, places]])


def carriers(problem: Problem, found: Association) -> tuple[IntArray, FloatArray]:
    """Indices (m, 3) of the pose with which each line's anchor moves, among the variables that the elimination keeps.

    Also the derivative (m, 3) of the anchor's place along its line by this pose, when pose and world move together.
    """
    state, blocks, used = found.state, found.solution.factored.blocks, found.labels >= 0
    last = np.zeros(len(state.lines), dtype=np.int64)
    np.maximum.at(last, found.labels[used], problem.readings.places[used])
    ends = np.array([block.robot * problem.steps + block.last for block in blocks])
    chosen = np.minimum(np.searchsorted(ends, last), len(blocks) - 1)
    away = state.anchors - state.flat_poses[ends[chosen], :2]
    by_pose = np.column_stack((direction(state.lines), np.sum(normal(state.lines) * away, axis=1)))
    return POSE * chosen[:, None] + np.arange(POSE), by_pose


def rooted(merged_into: IntArray) -> IntArray:
    """The final line (m,) of each line, by following the merges in ``merged_into``."""
    while True:
        further = merged_into[merged_into]
        if np.array_equal(further, merged_into):
            return merged_into
        merged_into = further
