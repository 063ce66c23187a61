"""The line smoother: least squares over all poses of a run and all lines.

Every step has its own pose, and every reading that is associated with a line is one factor (F. Dellaert and M. Kaess,
"Factor Graphs for Robot Perception", 2017). The poses of a robot form a chain, and there are few lines. Nearly all
poses are therefore eliminated one after another (:mod:`.elimination`). A dense system of the lines, a few poses and the
calibration remains. Several robots are several chains that share the lines.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from limslam_agent.slam.line_graph import chain_kernels as kernels
from limslam_agent.slam.line_graph.chain_kernels import CALIBRATED, COSINE, RANGE
from limslam_agent.slam.line_graph.elimination import Chain, Couplings, Factored, eliminated
from limslam_agent.slam.line_graph.problem import Problem, State, by_turns, moved, rows_of
from limslam_env.geometry import FloatArray, IntArray

GRAZING = 0.2  # cosine between beam and normal; below this value a reading depends mostly on the beam's angle error

_LINE_STD = np.array([100.0, 10.0])  # m and rad: keeps the equations of a line regular if it was read only once
_MOST_HALVINGS, _CHOOSING = 6, 2  # of a step; iterations after which the set of grazing readings is fixed


@dataclass(frozen=True, eq=False)
class Solution:
    """An optimum of the least-squares problem.

    Attributes
    ----------
    state
        Poses, lines and calibration at the optimum.
    weights
        Weights (k,): 0 for readings without a line and for grazing readings, otherwise 1, or more or less than that if
        the noise grows with the range.
    chi_square
        Sum of the squared residuals of wheels, readings and calibration, each divided by its variance.
    factored
        The factored equations, from which covariances are computed.
    """

    state: State
    weights: FloatArray
    chi_square: float
    factored: Factored


def solve(
    problem: Problem,
    state: State,
    labels: IntArray,
    *,
    iterations: int = 8,
    tolerance: float = 1e-4,
    shares: FloatArray | None = None,
) -> Solution:
    """The optimum near a state, for readings with known lines.

    Parameters
    ----------
    labels
        Line (k,) of each reading, or -1 for readings that are not used.
    iterations, tolerance, shares
        Largest number of Gauss-Newton steps, which end with a step that moves no pose farther than ``tolerance``, m or
        rad; and the weights (k,) of the readings, 0 to 1, or None for 1.

    Raises
    ------
    DegenerateError
        If the equations cannot be solved.
    """
    weights = np.zeros(len(labels))
    for iteration in range(iterations):
        rows = rows_of(problem, state, labels)
        if iteration < _CHOOSING:
            weights = _not_grazing(rows, labels) / problem.noise**2 * (1.0 if shares is None else shares)
        equations = _Equations(problem, state, labels, rows, weights)
        step = equations.step()
        state, change = _descend(problem, state, step, labels, weights, equations.chi_square)
        if change < tolerance and iteration >= _CHOOSING - 1:
            # The equations of this step are as accurate as those of the next step would be.
            break
    else:
        equations = _Equations(problem, state, labels, rows_of(problem, state, labels), weights)
    return Solution(state, weights, equations.chi_square, equations.factored)


def pose_covariances(solution: Solution) -> FloatArray:
    """Marginal covariances (n, t, 3, 3) of all poses; the covariances of the known starts are zero."""
    covariances = np.zeros((*solution.state.poses.shape, 3))
    for block in solution.factored.blocks:
        block.marginals(solution.factored.covariance, covariances[block.robot])
    return covariances


def chi_square(problem: Problem, state: State, labels: IntArray, weights: FloatArray) -> float:
    """Sum of the squared residuals of wheels, readings and calibration, each divided by its variance."""
    rows = rows_of(problem, state, labels)
    driven = _motion_residuals(problem, state)
    read = range_residuals(problem, state, rows)
    total = float(np.sum(driven**2) + np.sum(weights * read**2) / problem.range_std**2)
    return total + calibration_chi_square(problem, state)


def wheel_chi_square(problem: Problem, state: State) -> float:
    """Sum of the squared residuals of the wheels alone, each divided by its variance."""
    return float(np.sum(_motion_residuals(problem, state) ** 2))


def calibration_chi_square(problem: Problem, state: State) -> float:
    """Squared Mahalanobis distance of the calibration from its prior mean; 0 where none is estimated."""
    if problem.prior is None:
        return 0.0
    off = state.calibration - problem.assumed_calibration
    return float(np.einsum("ni,ij,nj->", off, problem.prior, off))


def _motion_residuals(problem: Problem, state: State) -> FloatArray:
    """Reported wheel travel, corrected by the calibration, minus true travel (n, t - 1, 3), in standard deviations."""
    return problem.whitened(problem.motions(state.calibration) - state.motions)


def range_residuals(problem: Problem, state: State, rows: FloatArray) -> FloatArray:
    """Measured minus expected ranges (k,), m."""
    biases = state.calibration[problem.readings.places // problem.steps, 3]
    return np.asarray(problem.readings.distances - rows[:, RANGE] - biases)


def _not_grazing(rows: FloatArray, labels: IntArray) -> FloatArray:
    """Weights (k,): 1 for readings of a line in front of the beam that the beam does not graze, otherwise 0."""
    return ((labels >= 0) & (np.abs(rows[:, COSINE]) >= GRAZING) & (rows[:, RANGE] > 0.0)).astype(float)


@dataclass(frozen=True, eq=False)
class _Step:
    """A Gauss-Newton step: changes of motions, lines and calibration, and the largest change of a pose."""

    motions: FloatArray
    lines: FloatArray
    calibration: FloatArray
    largest: float


def _descend(
    problem: Problem, state: State, step: _Step, labels: IntArray, weights: FloatArray, before: float
) -> tuple[State, float]:
    """The state after a step, which is halved until the residuals do not grow, and the largest pose change."""
    share = 1.0
    for _ in range(_MOST_HALVINGS):
        new = moved(
            problem,
            state.motions + share * step.motions,
            state.lines + share * step.lines,
            state.anchors,
            state.calibration + share * step.calibration,
        )
        if share * step.largest < 1e-3 or chi_square(problem, new, labels, weights) <= before * (1.0 + 1e-6) + 1e-3:
            break
        share *= 0.5
    return new, share * step.largest


class _Equations:
    """The normal equations, linearised about a state. The constructor eliminates the chains of poses."""

    def __init__(self, problem: Problem, state: State, labels: IntArray, rows: FloatArray, weights: FloatArray) -> None:
        self._problem, self._state = problem, state
        count, steps = state.poses.shape[:2]
        self._width = 0 if problem.prior is None else len(problem.prior)
        self._first_line = self._width * count
        size = self._first_line + 2 * len(state.lines)
        self._shared, self._shared_right = np.zeros((size, size)), np.zeros(size)
        self._diagonal, self._right = np.zeros((count, steps, 3, 3)), np.zeros((count, steps, 3))
        self._below = np.zeros((count, steps - 1, 3, 3))
        self._border = np.zeros((count, steps, 3, self._first_line))
        self.chi_square = chi_square(problem, state, labels, weights)
        self._add_motions()
        self._add_readings(labels, rows, weights)
        self._add_priors()
        parts = self._diagonal, self._below, self._border, self._right, self._couplings(labels, rows, weights)
        chains = [Chain(*each) for each in zip(*parts, strict=True)]
        self.factored, self._dense_right = eliminated(chains, self._shared, self._shared_right)

    def step(self) -> _Step:
        """The solution of the equations."""
        factored, moves = self.factored, np.zeros(self._state.poses.shape)
        solved = factored.solve(self._dense_right)
        for block in factored.blocks:
            block.substitute(solved, moves[block.robot])
        motions = np.einsum("nsij,nsj->nsi", self._by_before, moves[:, :-1])
        motions += np.einsum("nsij,nsj->nsi", self._by_after, moves[:, 1:])
        calibration = np.zeros_like(self._state.calibration)
        if self._first_line:
            calibration = solved[factored.first_shared : factored.first_line].reshape(-1, self._width)
            motions += self._by_axle * calibration[:, 2, None, None]
        lines = solved[factored.first_line :].reshape(-1, 2)
        return _Step(motions, lines, calibration, float(np.abs(moves).max()))

    def _add_motions(self) -> None:
        problem, state = self._problem, self._state
        shape = (*problem.wheels.shape, 3)
        self._by_before, self._by_after = np.empty(shape), np.empty(shape)
        residuals = _motion_residuals(problem, state)
        self._by_axle = np.zeros_like(problem.wheels)
        turned = 0.5 * np.diff(state.poses[..., 2], axis=1) * problem.robot.axle
        self._by_axle[..., 0], self._by_axle[..., 1] = -turned, turned
        for number, poses in enumerate(state.poses):
            axle = problem.axle(state.calibration[number])
            kernels.motion_jacobians(poses, axle, self._by_before[number], self._by_after[number])
        by_calibration = np.array([self._by_calibration(number) for number in range(len(state.poses))])
        before, after, by_sizes = (problem.whitened(each) for each in (self._by_before, self._by_after, by_calibration))
        for number in range(len(state.poses)):
            kernels.add_motions(
                before[number], after[number], by_sizes[number], residuals[number],
                self._diagonal[number], self._below[number], self._border[number], self._right[number],
                self._shared[: self._first_line, : self._first_line], self._shared_right[: self._first_line],
            )  # fmt: skip

    def _by_calibration(self, number: int) -> FloatArray:
        """Derivatives (t - 1, 3, c) of a robot's motions minus its reported wheel travel, by all calibrations."""
        by_all = np.zeros((self._problem.steps - 1, 3, self._first_line))
        if self._first_line:
            first = self._width * number
            by_all[:, 0, first] = -self._problem.wheels[number, :, 0]
            by_all[:, 1, first + 1] = -self._problem.wheels[number, :, 1]
            by_all[:, :, first + 2] = self._by_axle[number]
        return by_all

    def _add_readings(self, labels: IntArray, rows: FloatArray, weights: FloatArray) -> None:
        problem, readings = self._problem, self._problem.readings
        biases, border = np.full(len(readings), -1), (problem.steps * len(problem.starts), 3, self._first_line)
        turns, by_turn = biases, np.zeros(len(readings))
        if self._first_line:
            biases = self._width * (readings.places // problem.steps) + CALIBRATED - 1
        if self._width > CALIBRATED:
            turns, by_turn = biases + 1 + readings.beams, by_turns(problem, self._state, rows)
        kernels.add_readings(
            readings.places, labels, rows, range_residuals(problem, self._state, rows),
            weights / problem.range_std**2, biases, turns, by_turn, self._first_line,
            self._diagonal.reshape(-1, 3, 3), self._border.reshape(border),
            self._right.reshape(-1, 3), self._shared, self._shared_right,
        )  # fmt: skip

    def _add_priors(self) -> None:
        np.einsum("ii->i", self._shared)[self._first_line :] += np.tile(_LINE_STD**-2.0, len(self._state.lines))
        if self._problem.prior is None:
            return
        for number, off in enumerate(self._state.calibration - self._problem.assumed_calibration):
            own = slice(self._width * number, self._width * (number + 1))
            self._shared[own, own] += self._problem.prior
            self._shared_right[own] -= self._problem.prior @ off

    def _couplings(self, labels: IntArray, rows: FloatArray, weights: FloatArray) -> list[Couplings]:
        """The couplings of each chain's poses to lines."""
        problem, places = self._problem, self._problem.readings.places
        bounds = np.searchsorted(places, problem.steps * np.arange(len(problem.starts) + 1))
        parts = [slice(low, high) for low, high in pairwise(bounds.tolist())]
        return [
            Couplings(places[own] - number * problem.steps, labels[own], rows[own], weights[own] / problem.range_std**2)
            for number, own in enumerate(parts)
        ]
