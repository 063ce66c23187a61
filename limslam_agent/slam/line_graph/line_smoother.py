"""The line smoother: least squares over all poses of a run and all lines.

Every step has its own pose, and every reading that is associated with a line is one factor (F.
Dellaert and M. Kaess, "Factor Graphs for Robot Perception", 2017). The poses of a robot form a
chain, and there are few lines. Several robots are several chains that share the lines.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse.linalg import SuperLU

from limslam_agent.kernels.tables import GRAZING
from limslam_agent.slam.consistent.limits import LINE_PRIOR
from limslam_agent.slam.graph.factors import prior
from limslam_agent.slam.graph.graph import DegenerateError, Factors, Graph, Keys, Nodes
from limslam_agent.slam.line_graph.factors import motion_jacobians
from limslam_agent.slam.line_graph.problem import Expected, Problem, State, expected, moved
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_MOST_ITERATIONS = 6  # of a solution; those that have not converged then have wrong associations
# of a step; iterations after which the set of grazing readings is fixed
_MOST_HALVINGS = 6
_CHOOSING = 2
_CONVERGED = 1e-3  # m or rad: the last step; what remains is of the order of its square
_BLOCK = 150  # poses of a block, about


@dataclass(frozen=True, eq=False)
class Unknowns:
    """The columns of the unknowns: three for each pose, four for each calibration if there is one,
    two for each line.

    The poses are eliminated along each chain, and the lines last. A chain is cut into blocks, whose
    last poses are eliminated after the others: otherwise, each pose would be coupled to all lines
    that were read before it (A. George, "Nested dissection of a regular finite element mesh",
    1973).

    Attributes
    ----------
    robots, steps, calibrated, lines
        Number of robots, of poses of each robot, of parameters of a calibration, and of lines.
    """

    robots: int
    steps: int
    calibrated: int
    lines: int

    @cached_property
    def nodes(self) -> Nodes:
        """The nodes of the graph."""
        return Nodes(
            poses=(self.robots * self.steps, 3),
            calibrations=(self.robots, self.calibrated),
            lines=(self.lines, 2),
        )

    @cached_property
    def ends(self) -> IntArray:
        """The last poses of all blocks, as indices of poses, by robot and then by step."""
        count = max(1, round((self.steps - 1) / _BLOCK))
        own = np.rint(np.linspace(0, self.steps - 1, count + 1)[1:]).astype(int)
        return np.concatenate([robot * self.steps + own for robot in range(self.robots)])

    @cached_property
    def kept(self) -> IntArray:
        """The columns that are eliminated last, in this order: last poses of blocks, calibrations
        and lines.
        """
        poses = self.nodes.columns("poses")
        return np.append(poses[self.ends].ravel(), np.arange(poses.size, self.nodes.size))

    @property
    def order(self) -> IntArray:
        """The columns of all unknowns in the order of their elimination. The known first poses are
        not among them.
        """
        inner = np.ones((self.robots, self.steps), dtype=bool)
        inner[:, 0] = False
        inner.ravel()[self.ends] = False
        return np.append(self.nodes.columns("poses")[inner.ravel()].ravel(), self.kept)


@dataclass(frozen=True, eq=False)
class Solution:
    """An optimum of the least-squares problem.

    Attributes
    ----------
    state
        Poses, lines and calibration at the optimum.
    weights
        Weights (k,) of the readings: their inverse variances, 1/m^2; 0 for readings without a line
        and grazing ones.
    unknowns, graph, factors
        The graph, linearised at the state before the last step, and the factors of its matrix.
    """

    state: State
    weights: FloatArray
    unknowns: Unknowns
    graph: Graph
    factors: SuperLU

    @cached_property
    def covariance(self) -> FloatArray:
        """Joint covariance of the unknowns that are eliminated last."""
        return self.graph.covariance_of_last(self.factors, len(self.unknowns.kept))

    @property
    def of_calibration(self) -> FloatArray:
        """Joint covariance of the calibrations of all robots."""
        first = 3 * len(self.unknowns.ends)
        own = slice(first, first + self.unknowns.calibrated * self.unknowns.robots)
        return self.covariance[own, own]

    @property
    def of_lines(self) -> FloatArray:
        """Joint covariance (2 m, 2 m) of all lines."""
        first = len(self.covariance) - 2 * self.unknowns.lines
        return self.covariance[first:, first:]

    @property
    def of_poses(self) -> FloatArray:
        """Covariances (n, t, 3, 3) of all poses; those of the known starts are zero."""
        return self.graph.marginals("poses").reshape(*self.state.poses.shape, 3)


def solve(problem: Problem, state: State, labels: IntArray) -> Solution:
    """The optimum near a state by the Gauss-Newton method, for readings with known lines.

    ``labels`` (k,) is the line of each reading, or -1 for readings that are not used.

    Raises
    ------
    DegenerateError
        If there is no line, or the equations cannot be solved.
    """
    if not len(state.lines):
        raise DegenerateError("no line has enough readings")
    calibrated = 0 if problem.prior is None else state.calibration.shape[1]
    unknowns = Unknowns(len(problem.starts), problem.steps, calibrated, len(state.lines))
    sharing = np.bincount(labels + 1)[labels + 1]
    linearisation = _Linearisation(problem, labels, unknowns)
    weights = np.zeros(len(labels))
    for iteration in range(_MOST_ITERATIONS):
        readings = expected(problem, state, labels)
        if iteration < _CHOOSING:
            curved = problem.sensor.bend * 0.5 * readings.by_line[:, 1] ** 2
            curved /= readings.by_line[:, 0]
            variances = problem.variances(state, readings) + sharing * curved**2
            weights = not_grazing(readings, labels) / variances
        graph = linearisation.graph(state, readings, weights)
        factors = graph.factorise()
        step = -graph.solved(factors, graph.gradient)
        if not np.isfinite(step).all():
            raise DegenerateError("the readings do not determine the poses")
        state, change = linearisation.descend(state, step, readings, weights)
        if change < _CONVERGED:
            break
    return Solution(state, weights, unknowns, graph, factors)


def chi_square(problem: Problem, state: State, readings: Expected, weights: FloatArray) -> float:
    """Sum of the squared residuals of wheels, readings and calibration, each divided by its
    variance.
    """
    driven = problem.whitened(motion_errors(problem, state))
    read = range_residuals(problem, readings)
    total = float(np.sum(driven**2) + np.sum(weights * read**2))
    if problem.prior is None:
        return total
    off = state.calibration - problem.prior_calibration
    return total + float(np.einsum("ni,ij,nj->", off, problem.information, off))


def motion_errors(problem: Problem, state: State) -> FloatArray:
    """Errors of the motions (n, t - 1, 3), m, as they were reported: the noise is that of the
    reports. If it grew with the wheels, it would be least in the smallest map.
    """
    sizes = problem.sizes(state.calibration)
    return np.asarray((state.motions - problem.motions(state.calibration)) / sizes)


def range_residuals(problem: Problem, readings: Expected) -> FloatArray:
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
    np.add.at(score, places, (weighted * range_residuals(problem, readings)[:, None])[..., None])
    moved_by = np.linalg.solve(np.eye(3) + jitters @ information, jitters @ score)
    return replace(state, poses=state.poses + moved_by.reshape(state.poses.shape))


class _Linearisation:
    """The factors of a problem, which are linearised about one state after the other."""

    def __init__(self, problem: Problem, labels: IntArray, unknowns: Unknowns) -> None:
        self._problem = problem
        self._labels = labels
        self._unknowns = unknowns

    def graph(self, state: State, readings: Expected, weights: FloatArray) -> Graph:
        """The factors, linearised about a state."""
        unknowns = self._unknowns
        graph = Graph(unknowns.nodes, unknowns.order)
        if self._problem.prior is not None:
            off = state.calibration - self._problem.prior_calibration
            graph.add(prior("calibrations", off, self._problem.information))
        graph.add(self._wheels(state))
        graph.add(self._ranges(state, readings, weights))
        # Each line has a wide prior, which keeps its equations regular if it was read only once.
        graph.add(prior("lines", np.zeros_like(state.lines), np.diag(1.0 / np.array(LINE_PRIOR))))
        # The unknowns that are eliminated last get an entry for each pair, since their joint
        # covariance is asked for.
        count = len(unknowns.kept)
        graph.add_sums(unknowns.kept[None], np.zeros((1, count, count)), np.zeros((1, count)))
        return graph

    def descend(
        self, state: State, step: FloatArray, readings: Expected, weights: FloatArray
    ) -> tuple[State, float]:
        """The state after a step, which is halved until the residuals do not grow, and the largest
        change of a pose.

        The motions are changed, and the poses follow from them: so the wheels still drive arcs
        after a large step.
        """
        problem = self._problem
        unknowns = self._unknowns
        moves = step[unknowns.nodes.columns("poses")].reshape(state.poses.shape)
        lines = step[unknowns.nodes.columns("lines")]
        calibration = np.zeros_like(state.calibration)
        pairs = np.concatenate((moves[:, :-1], moves[:, 1:]), axis=-1)
        motions = np.einsum("ntij,ntj->nti", self._by_poses(state), pairs)
        if unknowns.calibrated:
            calibration = step[unknowns.nodes.columns("calibrations")]
            motions += self._by_axle(state) * calibration[:, 2, None, None]
        largest = float(np.abs(moves).max())
        before = chi_square(problem, state, readings, weights)
        share = 1.0
        for _ in range(_MOST_HALVINGS):
            new = moved(
                problem,
                state.motions + share * motions,
                state.lines + share * lines,
                state.anchors,
                state.calibration + share * calibration,
            )
            after = chi_square(problem, new, expected(problem, new, self._labels), weights)
            if share * largest < _CONVERGED or after <= before * (1.0 + 1e-6) + 1e-3:
                break
            share *= 0.5
        return new, share * largest

    def _wheels(self, state: State) -> Factors:
        """The motions by the wheels."""
        problem = self._problem
        unknowns = self._unknowns
        errors = motion_errors(problem, state)
        jacobian = self._by_poses(state)
        poses = np.arange(unknowns.robots * unknowns.steps).reshape(unknowns.robots, -1)
        keys: Keys = (("poses", poses[:, :-1].ravel()), ("poses", poses[:, 1:].ravel()))
        if unknowns.calibrated:
            by_calibration = np.zeros((*problem.wheels.shape, unknowns.calibrated))
            by_calibration[..., :3] = -problem.by_sizes
            by_calibration[..., 2] += self._by_axle(state)
            if problem.turns is None:
                by_calibration[..., [0, 1], [0, 1]] -= errors[..., :2]
            jacobian = np.concatenate((jacobian, by_calibration), axis=-1)
            robots = np.repeat(np.arange(unknowns.robots), problem.steps - 1)
            keys = (*keys, ("calibrations", robots))
        white = problem.whitened(jacobian / problem.sizes(state.calibration)[..., None])
        return Factors(
            keys,
            problem.whitened(errors).reshape(-1, 3),
            white.reshape(-1, 3, white.shape[-1]),
        )

    def _ranges(self, state: State, readings: Expected, weights: FloatArray) -> Factors:
        """The readings of lines."""
        problem = self._problem
        used = np.flatnonzero(self._labels >= 0)
        places = problem.readings.places[used]
        roots = np.sqrt(weights[used])
        keys: Keys = (("poses", places), ("lines", self._labels[used]))
        jacobian = [readings.by_pose[used], readings.by_line[used]]
        if self._unknowns.calibrated:
            keys = (*keys, ("calibrations", places // problem.steps))
            by_calibration = np.zeros((len(used), self._unknowns.calibrated))
            by_calibration[:, 3] = 1.0
            by_calibration[:, 4] = problem.true(readings.ranges[used], places, state.calibration)
            jacobian.append(by_calibration)
        errors = -range_residuals(problem, readings)[used] * roots
        return Factors(keys, errors[:, None], (np.hstack(jacobian) * roots[:, None])[:, None])

    def _by_poses(self, state: State) -> FloatArray:
        """Derivatives (n, t - 1, 3, 6) of the motions by the pose before and the pose after
        each.
        """
        pairs = zip(state.poses, state.calibration, strict=True)
        return np.array(
            [motion_jacobians(poses, self._problem.axle(sizes)) for poses, sizes in pairs]
        )

    def _by_axle(self, state: State) -> FloatArray:
        """Derivatives (n, t - 1, 3) of the motions by the relative excess of the axle."""
        turned = 0.5 * np.diff(state.poses[..., 2], axis=1) * self._problem.robot.axle
        if self._problem.turns is not None:  # the axle is as specified
            turned = np.zeros_like(turned)
        return np.stack((-turned, turned, np.zeros_like(turned)), axis=-1)
