"""The least-squares optimum over all poses of a run and all lines.

Every step has its own pose, and every reading that is associated with a line is one factor (F.
Dellaert and M. Kaess, "Factor Graphs for Robot Perception", 2017). The poses of a robot form a
chain, and there are few lines. Several robots are several chains that share the lines.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from limslam_agent.kernels.tables import GRAZING
from limslam_agent.slam.consistent.limits import LINE_PRIOR
from limslam_agent.slam.graph.factors import prior
from limslam_agent.slam.graph.graph import DegenerateError, Factors, Graph, Keys, Nodes
from limslam_agent.slam.line_graph.motions import motion_jacobians
from limslam_agent.slam.line_graph.problem import Expected, Problem, State, expected
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_MOST_ITERATIONS = 6  # of a solution; those that have not converged then have wrong associations
# of a step; iterations after which the set of grazing readings is fixed
_MOST_HALVINGS = 6
_CHOOSING = 2
CONVERGED = 1e-3
"""The last step of a solution, m or rad. What remains is of the order of its square."""

_BLOCK = 50  # poses of a block, about


@dataclass(frozen=True, eq=False)
class Solution:
    """An optimum of the least-squares problem.

    The poses are eliminated along each chain, and the lines last. A chain is cut into blocks, whose
    last poses are eliminated after the others: otherwise, each pose would be coupled to all lines
    that were read before it (A. George, "Nested dissection of a regular finite element mesh",
    1973).

    Attributes
    ----------
    state
        Poses, lines and calibration at the optimum.
    weights
        Weights (k,) of the readings: their inverse variances, 1/m^2; 0 for readings without a line
        and grazing ones.
    kept
        The columns that are eliminated last, in this order: last poses, calibrations and lines.
    graph
        The graph, linearised at the state before the last step.
    """

    state: State
    weights: FloatArray
    kept: IntArray
    graph: Graph

    @cached_property
    def _covariance(self) -> FloatArray:
        return self.graph.covariance_of_last(len(self.kept))

    def covariance(self, columns: IntArray) -> FloatArray:
        """Joint covariance of unknowns that are eliminated last, by their columns."""
        rows = np.searchsorted(self.kept, columns.ravel())
        return np.asarray(self._covariance[np.ix_(rows, rows)])

    @property
    def of_lines(self) -> FloatArray:
        """Joint covariance (2 m, 2 m) of all lines."""
        return self.covariance(self.graph.nodes.columns("lines"))

    @property
    def of_poses(self) -> FloatArray:
        """Covariances (n, t, 3, 3) of all poses; those of the known starts are zero."""
        return self.graph.marginals("poses").reshape(*self.state.poses.shape, 3)


def solve(problem: Problem, state: State, labels: IntArray, last: float = CONVERGED) -> Solution:
    """The optimum near a state by the Gauss-Newton method, for readings with known lines.

    ``labels`` (k,) is the line of each reading, or -1 for readings that are not used. No step
    follows one that is smaller than ``last``, m or rad.

    Raises
    ------
    DegenerateError
        If there is no line, or the equations cannot be solved.
    """
    if not len(state.lines):
        raise DegenerateError("no line has enough readings")
    nodes, kept, order = _unknowns(problem, state)
    graph = Graph(nodes, order)
    for iteration in range(_MOST_ITERATIONS):
        if iteration < _CHOOSING:
            weights = _weights(problem, state, labels)
            factors = _factors(problem, state, labels, weights)
        graph.clear()
        for each in factors:
            graph.add(each)
        # The unknowns that are eliminated last get an entry for each pair, since their joint
        # covariance is asked for.
        count = len(kept)
        graph.add_sums(kept[None], np.zeros((1, count, count)), np.zeros((1, count)))
        step = graph.solve()
        if not np.isfinite(step).all():
            raise DegenerateError("the readings do not determine the poses")
        begin = (state, factors)
        state, factors, change = _descended(problem, begin, labels, weights, nodes, step)
        if change < last:
            break
    return Solution(state, weights, kept, graph)


def _unknowns(problem: Problem, state: State) -> tuple[Nodes, IntArray, IntArray]:
    """The nodes, the columns that are eliminated last, and all columns in the order of their
    elimination. The known first poses are not among them.
    """
    robots, steps = state.poses.shape[:2]
    calibrated = 0 if problem.prior is None else state.calibration.shape[1]
    nodes = Nodes(
        poses=(robots * steps, 3), calibrations=(robots, calibrated), lines=(len(state.lines), 2)
    )
    blocks = max(1, round((steps - 1) / _BLOCK))
    ends = np.rint(np.linspace(0, steps - 1, blocks + 1)[1:]).astype(int)
    is_inner = np.ones((robots, steps), dtype=bool)
    is_inner[:, 0] = is_inner[:, ends] = False
    poses = nodes.columns("poses").reshape(robots, steps, 3)
    kept = np.append(poses[:, -1].ravel(), np.arange(poses.size, nodes.size))
    others = (poses[is_inner].ravel(), poses[:, ends[:-1]].ravel())
    return nodes, kept, np.concatenate((*others, kept))


def _weights(problem: Problem, state: State, labels: IntArray) -> FloatArray:
    """The inverse variances (k,) of the readings. What all readings of a line share by its
    curvature is a part of them.
    """
    readings = expected(problem, state, labels)
    sharing = np.bincount(labels + 1)[labels + 1]
    curved = problem.sensor.bend * 0.5 * readings.by_line[:, 1] ** 2 / readings.by_line[:, 0]
    variances = problem.variances(state, readings) + sharing * curved**2
    return np.asarray(not_grazing(readings, labels) / variances)


def _factors(
    problem: Problem, state: State, labels: IntArray, weights: FloatArray
) -> list[Factors]:
    """All factors, linearised about a state."""
    factors = [_wheels(problem, state), _ranges(problem, state, labels, weights)]
    # Each line has a wide prior, which keeps its equations regular if it was read only once.
    wide = np.diag(1.0 / np.array(LINE_PRIOR))
    factors.append(prior("lines", np.zeros_like(state.lines), wide))
    if problem.prior is not None:
        off = state.calibration - problem.prior_calibration
        factors.append(prior("calibrations", off, problem.information))
    return factors


def _wheels(problem: Problem, state: State) -> Factors:
    """The motions, as they are reported."""
    robots, steps = state.poses.shape[:2]
    reports, by_motion, by_errors = problem.reports(state.motions, state.calibration)
    jacobian = by_motion @ motion_jacobians(state.poses)
    poses = np.arange(robots * steps).reshape(robots, steps)
    keys: Keys = (("poses", poses[:, :-1].ravel()), ("poses", poses[:, 1:].ravel()))
    if problem.prior is not None:
        jacobian = np.concatenate((jacobian, by_errors), axis=-1)
        keys = (*keys, ("calibrations", np.repeat(np.arange(robots), steps - 1)))
    errors = problem.roots @ (reports - problem.motions)[..., None]
    white = problem.roots @ jacobian
    return Factors(keys, errors.reshape(-1, 3), white.reshape(-1, 3, white.shape[-1]))


def _ranges(problem: Problem, state: State, labels: IntArray, weights: FloatArray) -> Factors:
    """The readings of lines."""
    readings = expected(problem, state, labels)
    used = np.flatnonzero(labels >= 0)
    places = problem.readings.places[used]
    keys: Keys = (("poses", places), ("lines", labels[used]))
    jacobian = [readings.by_pose[used], readings.by_line[used]]
    if problem.prior is not None:
        keys = (*keys, ("calibrations", places // problem.steps))
        by_errors = np.zeros((len(used), state.calibration.shape[1]))
        by_errors[:, 3] = 1.0
        met = replace(problem.readings, distances=readings.ranges)
        by_errors[:, 4] = problem.true(met, state.calibration)[used]
        jacobian.append(by_errors)
    roots = np.sqrt(weights[used])[:, None]
    errors = -residuals(problem, readings)[used, None] * roots
    return Factors(keys, errors, (np.hstack(jacobian) * roots)[:, None])


def _descended(
    problem: Problem,
    begin: tuple[State, list[Factors]],
    labels: IntArray,
    weights: FloatArray,
    nodes: Nodes,
    step: FloatArray,
) -> tuple[State, list[Factors], float]:
    """The state after a step, which is halved until the residuals do not grow, the factors about
    it, and the largest change of a pose. ``begin`` is the state before, with its factors.

    The motions are changed, and the poses follow from them: so the wheels still drive arcs after a
    large step.
    """
    state, factors = begin
    moves = step[nodes.columns("poses")].reshape(state.poses.shape)
    pairs = np.concatenate((moves[:, :-1], moves[:, 1:]), axis=-1)
    motions = (motion_jacobians(state.poses) @ pairs[..., None])[..., 0]
    lines = step[nodes.columns("lines")]
    calibration = np.zeros_like(state.calibration)
    if problem.prior is not None:
        calibration = step[nodes.columns("calibrations")]
    largest = float(np.abs(moves).max())
    most = _chi_square(factors) * (1.0 + 1e-6) + 1e-3
    share = 1.0
    for _ in range(_MOST_HALVINGS):
        new = state.moved(share * motions, share * lines, share * calibration)
        factors = _factors(problem, new, labels, weights)
        if share * largest < CONVERGED or _chi_square(factors) <= most:
            break
        share *= 0.5
    return new, factors, share * largest


def _chi_square(factors: list[Factors]) -> float:
    """The chi-square of all factors."""
    return sum(float(each.chi2.sum()) for each in factors)


def residuals(problem: Problem, readings: Expected) -> FloatArray:
    """Measured minus expected ranges (k,), m."""
    return np.asarray(problem.readings.distances - readings.ranges)


def not_grazing(readings: Expected, labels: IntArray) -> BoolArray:
    """Which readings (k,) are of a line in front of the beam that the beam does not graze."""
    return np.asarray(
        (labels >= 0) & (np.abs(readings.cosines) >= GRAZING) & (readings.ranges > 0.0)
    )


def where_read(problem: Problem, state: State, labels: IntArray) -> State:
    """The state with each pose moved within its jitter to where its readings, of lines (k,), are
    likeliest from.
    """
    readings = expected(problem, state, labels)
    jitters = problem.jitters(state).reshape(-1, 3, 3)
    weights = not_grazing(readings, labels) / problem.stds**2
    weighted = readings.by_pose * weights[:, None]
    places = problem.readings.places
    information = np.zeros_like(jitters)
    score = np.zeros((len(jitters), 3, 1))
    np.add.at(information, places, weighted[:, :, None] * readings.by_pose[:, None])
    np.add.at(score, places, (weighted * residuals(problem, readings)[:, None])[..., None])
    moved_by = np.linalg.solve(np.eye(3) + jitters @ information, jitters @ score)
    return replace(state, poses=state.poses + moved_by.reshape(state.poses.shape))
