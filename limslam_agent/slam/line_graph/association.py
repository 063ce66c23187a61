"""Association of all readings with lines, repeated after each improvement of the poses. No
association is final.

Each round merges lines that are one wall, assigns each reading to the line that predicts it best,
solves, and divides the lines that are more than one wall. Where two walls meet, readings of one
wall can be assigned to the line of the other, as long as they lie within the gate. The residuals of
one wall are independent, and those of two are systematic along the line.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from limslam_agent.kernels.crossings import choose_lines
from limslam_agent.kernels.tables import FEWEST
from limslam_agent.slam.core.line_fit import fit_line
from limslam_agent.slam.line_graph.merging import (
    NEGATIVE,
    POSITIVE,
    SURE,
    Lines,
    merge_lines,
    prior_odds,
    wall_kinds,
)
from limslam_agent.slam.line_graph.new_lines import faces
from limslam_agent.slam.line_graph.problem import Problem, State, expected
from limslam_agent.slam.line_graph.solution import (
    CONVERGED,
    Solution,
    not_grazing,
    residuals,
    solve,
)
from limslam_env.geometry import FloatArray, IntArray

_ROUNDS = 8  # of merging, association and solving, at most
_SETTLED = 2e-3  # m: the last round is the first one that moves no pose farther
# m or rad: the last step of the solutions in between, after which associations hardly change
_NEARLY = 1e-2
_GATE = (
    3.5  # standard deviations, within which a line explains a reading: 0.9995 of its own readings
)
_BEYOND = 0.10  # m: how far beyond a line's ends a beam may meet it
_MARGIN = 3.0  # standard deviations by which the second-best line must predict a reading worse
_FEWEST_OF_SIDE = 4  # readings
_FEWEST_APART = 3  # readings; two of them fit any line
# Chi-square by which two lines fit the readings of one line better where it is divided. Felt by the
# rows "noise told as half" and "bumping" of the scoreboard.
_BEND_GATE = 16.0


@dataclass(frozen=True, eq=False)
class Association:
    """A problem, its solution, and the line (k,) of each reading in it; -1 for readings that were
    not used.
    """

    problem: Problem
    solution: Solution
    labels: IntArray

    @property
    def state(self) -> State:
        """Poses and lines."""
        return self.solution.state

    @cached_property
    def along(self) -> FloatArray:
        """Where each reading's beam meets its line (k,), m from the line's anchor; 0 for readings
        of no line.

        A beam with an opening angle meets its line at the nearest point inside of it.
        """
        met = expected(self.problem, self.state, self.labels).along
        return np.where(self.labels >= 0, met, 0.0)

    @cached_property
    def seen(self) -> FloatArray:
        """The ends of each line's readings from each side (m, 2, 2), m, without the outermost
        reading at each end.

        Where a side has few readings, these may be of another wall, and the side counts as not
        seen.
        """
        problem = self.problem
        state = self.state
        headings = state.flat_poses[problem.readings.places, 2] + problem.beams[:, 2]
        cosines = np.cos(state.lines[self.labels, 1] - headings)
        side = np.where(cosines < 0.0, POSITIVE, NEGATIVE)
        sided = np.where(self.labels >= 0, 2 * self.labels + side, -1)
        count = 2 * len(state.lines)
        order = np.lexsort((self.along, sided))
        order = order[sided[order] >= 0]
        firsts = np.searchsorted(sided[order], np.arange(count + 1))
        ends = np.tile([np.inf, -np.inf], (count, 1))
        is_seen = np.diff(firsts) > _FEWEST_OF_SIDE
        ends[is_seen, 0] = self.along[order][firsts[:-1][is_seen] + 1]
        ends[is_seen, 1] = self.along[order][firsts[1:][is_seen] - 2]
        return ends.reshape(-1, 2, 2)


def reassociate(problem: Problem, state: State, labels: IntArray) -> Association:
    """Poses, lines and associations, from approximate poses and the first associations of some
    readings.

    Parameters
    ----------
    state
        Initial poses; the lines of the state are not used.
    labels
        The initial line of each reading, in any numbering, or -1.

    Raises
    ------
    DegenerateError
        If the readings do not determine the poses.
    """
    association = settled(solve_labels(problem, state, labels))
    _, best = assigned(association, association.seen)
    unexplained = np.flatnonzero((best < 0) & (association.labels < 0))
    labels = association.labels.copy()
    for number, face in enumerate(
        faces(problem, association.state, unexplained), len(association.state.lines)
    ):
        labels[face] = number
    if not np.array_equal(labels, association.labels):
        association = settled(with_new_lines(association, labels))
    return relabelled(association, association.labels)


def settled(association: Association) -> Association:
    """Rounds of merging, assignment, solution and division until nothing changes any more."""
    for _ in range(_ROUNDS):
        before = association.state.poses
        merged, has_merged, kinds = merge(association)
        seen = merged.seen
        if prior_odds(*kinds) > SURE:
            # The walls are boards for sure: what was read from one side can be read from the other
            # side.
            low = seen[..., 0].min(axis=1)
            high = seen[..., 1].max(axis=1)
            seen = np.tile(np.stack((low, high), axis=-1)[:, None], (1, 2, 1))
        labels, _ = assigned(merged, seen)
        association = straightened(relabelled(merged, labels, last=_NEARLY))
        if np.abs(association.state.poses - before)[..., :2].max() < _SETTLED and not has_merged:
            break
    return association


def solve_labels(problem: Problem, state: State, labels: IntArray) -> Association:
    """The optimum for given associations. The lines are first fitted to their readings at the poses
    of a state.

    Lines with too few readings are left out.
    """
    labels, _ = renumbered(labels)
    state = with_lines(problem, state.select(np.arange(0)), labels)
    return Association(problem, solve(problem, state, labels), labels)


def relabelled(
    association: Association,
    labels: IntArray,
    state: State | None = None,
    last: float = CONVERGED,
) -> Association:
    """The optimum for other associations with the lines of a state; lines with too few readings are
    removed.

    Raises
    ------
    DegenerateError
        If no line is left, or the equations cannot be solved.
    """
    labels, kept = renumbered(labels)
    state = (state or association.state).select(kept)
    solution = solve(association.problem, state, labels, last)
    return Association(association.problem, solution, labels)


def with_new_lines(association: Association, labels: IntArray) -> Association:
    """The optimum for associations with further lines, numbered after those of a solution."""
    return relabelled(
        association,
        labels,
        with_lines(association.problem, association.state, labels),
        last=_NEARLY,
    )


def renumbered(labels: IntArray) -> tuple[IntArray, IntArray]:
    """Labels of the lines with enough readings, from 0 on, and the old numbers (m,) of these
    lines.
    """
    known, inverse, counts = np.unique(labels, return_inverse=True, return_counts=True)
    is_line = (known >= 0) & (counts >= FEWEST)
    return np.where(is_line, np.cumsum(is_line) - 1, -1)[inverse], known[is_line]


def with_lines(problem: Problem, state: State, labels: IntArray) -> State:
    """The state with further lines, through the readings of each label from the number of its lines
    on.
    """
    known = len(state.lines)
    count = max(int(labels.max(initial=-1)) + 1 - known, 0)
    lines = np.zeros((count, 2))
    anchors = np.zeros((count, 2))
    distances = problem.true(problem.readings, state.calibration)
    rays = state.rays(problem.readings.places, problem.beams, distances)
    ends = rays[:, :2] + distances[:, None] * rays[:, 2:4]
    for number in np.unique(labels[labels >= known]).tolist():
        points = ends[labels == number]
        lines[number - known, 1] = fit_line(points, 1.0).line[1]
        anchors[number - known] = points.mean(axis=0)
    return replace(
        state, lines=np.vstack((state.lines, lines)), anchors=np.vstack((state.anchors, anchors))
    )


def assigned(association: Association, ends: FloatArray) -> tuple[IntArray, IntArray]:
    """For each reading (k,), the line that predicts it, or -1 if none or two do; and the best one,
    or -1 if none does.

    A line can explain the readings from a side between the ends (m, 2, 2) on this side, and up to
    ``_BEYOND`` outside.
    """
    problem = association.problem
    state = association.state
    distances = problem.true(problem.readings, state.calibration)
    rays = state.rays(problem.readings.places, problem.beams, distances)
    best = np.empty(len(rays), dtype=np.int64)
    misfits = np.empty((len(rays), 2))
    within = ends + np.array([-_BEYOND, _BEYOND])
    choose_lines(rays, state.line_rows, within, problem.sensor.cone, best, misfits)
    misfits /= np.sqrt(problem.variances(state, expected(problem, state, best)))[:, None]
    is_explained = misfits[:, 0] < _GATE
    is_clear = is_explained & (misfits[:, 1] > misfits[:, 0] + _MARGIN)
    return np.where(is_clear, best, -1), np.where(is_explained, best, -1)


def straightened(association: Association) -> Association:
    """The optimum with bent lines divided. Parts with too few readings for a line have no line."""
    readings = expected(association.problem, association.state, association.labels)
    cosines = readings.cosines
    # The distance of a reading from its line is the residual along the beam times the cosine.
    variances = np.maximum(
        association.problem.variances(association.state, readings) * cosines**2, 1e-18
    )
    points = np.stack(
        (association.along, residuals(association.problem, readings) * cosines, 1.0 / variances)
    )
    order = np.lexsort((association.along, association.labels))
    order = order[not_grazing(readings, association.labels)[order]]
    labels = association.labels.copy()
    count = len(association.state.lines)
    for line in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1):
        for part in _straight_parts(points, line)[1:]:
            labels[part] = count
            count += 1
    few = np.bincount(labels[labels >= 0], minlength=count) < FEWEST
    labels = np.where(few[labels], -1, labels)
    return (
        association
        if np.array_equal(labels, association.labels)
        else with_new_lines(association, labels)
    )


def _straight_parts(points: FloatArray, line: IntArray) -> list[IntArray]:
    """The readings of a line, sorted along the line, in the parts into which the line is
    divided.
    """
    if len(line) < FEWEST + _FEWEST_APART:
        return [line]
    s, y, w = points[:, line]
    s = s - s.mean()
    sums = np.cumsum(np.stack((w, w * s, w * s * s, w * y, w * s * y, w * y * y)), axis=1)
    before = sums[:, _FEWEST_APART - 1 : -_FEWEST_APART]
    gains = _misfits(sums[:, -1:]) - _misfits(before) - _misfits(sums[:, -1:] - before)
    best = int(gains.argmax())
    if gains[best] < _BEND_GATE:
        return [line]
    cut = best + _FEWEST_APART
    return _straight_parts(points, line[:cut]) + _straight_parts(points, line[cut:])


def _misfits(sums: FloatArray) -> FloatArray:
    """Chi-square (k,) of the best line through points, from the sums (6, k) of w, w s, w s s, w y,
    w s y, w y y.
    """
    w, ws, wss, wy, wsy, wyy = sums
    spread = np.maximum(wss - ws * ws / w, 1e-9 * w)
    return np.asarray(wyy - wy * wy / w - (wsy - ws * wy / w) ** 2 / spread)


def merge(association: Association) -> tuple[Association, bool, tuple[float, float]]:
    """Merge the lines that may be one wall; whether there were such lines, and the lengths of
    boards and walls, m.

    Each merge updates all lines through their joint covariance. Poses and lines are solved for
    again when a line has moved far. This repeats until no pair can merge.
    """
    has_merged = False
    while True:
        state = association.state
        lines = Lines(
            state.lines.copy(),
            state.anchors,
            association.seen.copy(),
            association.solution.of_lines,
        )
        kinds = wall_kinds(lines)
        if not merge_lines(lines, kinds):
            return association, has_merged, kinds
        association = relabelled(
            association,
            np.where(association.labels >= 0, lines.merged_into[association.labels], -1),
            last=_NEARLY,
        )
        has_merged = True
