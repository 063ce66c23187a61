"""The line smoother: least squares over all poses of a run and all lines.

Every step has its own pose, the wheels drive exact arcs, and every reading that is associated with a line is one factor
(F. Dellaert and M. Kaess, "Factor Graphs for Robot Perception", 2017). The poses of a robot form a chain, and there are
few lines. Nearly all poses are therefore eliminated one after another (:mod:`.elimination`). A dense system of the
lines, a few poses and the calibration remains. Several robots are several chains that share the lines.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from limslam_agent.config.smoother import CalibrationPrior
from limslam_agent.slam.core.contact import Slip, slips_of
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.line_graph import chain_kernels as kernels
from limslam_agent.slam.line_graph.beam_width import widen
from limslam_agent.slam.line_graph.chain_kernels import CALIBRATED, COLUMNS, COSINE, RANGE
from limslam_agent.slam.line_graph.elimination import Chain, Couplings, Factored, eliminated
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import NominalNoise, RobotSpec

LEAST_RANGE_STD = 0.005  # m
GRAZING = 0.2  # cosine between beam and normal; below this value a reading depends mostly on the beam's angle error

_ASIDE_STD = 1e-5  # m: keeps the equations regular, and adds up to less than a millimetre in a run
_LEAST_VARIANCE = 1e-12  # m^2
_LINE_STD = np.array([100.0, 10.0])  # m and rad: keeps the equations of a line regular if it was read only once
_MOST_HALVINGS, _CHOOSING = 6, 2  # of a step; iterations after which the set of grazing readings is fixed


@dataclass(frozen=True, eq=False)
class Readings:
    """Readings of k beams, sorted by ``places``.

    Attributes
    ----------
    places
        Index (k,) of the pose of each reading. The pose of robot i at step s of t has the index i t + s.
    beams
        Index (k,) of the beam of each reading.
    distances
        Measured distances (k,), m.
    """

    places: IntArray
    beams: IntArray
    distances: FloatArray

    def __len__(self) -> int:
        return len(self.places)


@dataclass(frozen=True, eq=False)
class Problem:
    """The measurements of n robots in t steps, and their standard deviations.

    Attributes
    ----------
    robot
        Body and beams of each robot.
    starts
        Known poses (n, 3) of the first step, m and rad.
    wheels, stds
        Reported motions (n, t - 1, 3), m, whose last column is zero, and their standard deviations.
    readings, range_std, growth
        The readings of walls, and the standard deviation of one of usual length, m. It grows with the range: the part
        that is proportional to the squared range is ``growth``, 1/m^2, times that of short ranges.
    looks
        The readings of walls, and the beams that met no wall, each with the length of its free path.
    prior, beam_width
        Inverse covariance (4, 4) of a robot's calibration, or None; and half the opening angle of all beams, rad.
    kinds
        Lengths of the boards and of the walls with two faces that are known, m.
    bias
        By what all ranges are too long as far as that is known, m. A calibration estimates it from there on.
    slips
        The motions in which the robots may have touched something.
    """

    robot: RobotSpec
    starts: FloatArray
    wheels: FloatArray
    stds: FloatArray
    readings: Readings
    looks: Readings
    range_std: float
    prior: FloatArray | None = None
    beam_width: float = 0.0
    kinds: tuple[float, float] = (0.0, 0.0)
    growth: float = 0.0
    bias: float = 0.0
    slips: tuple[Slip, ...] = ()

    @property
    def steps(self) -> int:
        """Number of steps t."""
        return int(self.wheels.shape[1]) + 1

    @cached_property
    def beams(self) -> FloatArray:
        """Origin and direction (k, 3) of the beam of each reading, m, m, rad, in the robot's frame."""
        return self._beams_of(self.readings)

    @cached_property
    def look_beams(self) -> FloatArray:
        """Origin and direction (k, 3) of the beam of each look, m, m, rad, in the robot's frame."""
        return self._beams_of(self.looks)

    @cached_property
    def is_hit(self) -> BoolArray:
        """Which of the looks (k,) met a wall."""
        return np.asarray(self.looks.distances < self.robot.too_far[self.looks.beams])

    @cached_property
    def noise(self) -> FloatArray:
        """Standard deviation of each reading (k,), as a share of ``range_std``."""
        return self._noise_of(self.readings)

    @cached_property
    def look_noise(self) -> FloatArray:
        """Standard deviation of each look (k,), as a share of ``range_std``."""
        return self._noise_of(self.looks)

    @cached_property
    def assumed_calibration(self) -> FloatArray:
        """The calibration (n, 4) of robots that are as specified, but for the known bias."""
        return np.tile((0.0, 0.0, 0.0, self.bias), (len(self.starts), 1))

    def whitened(self, errors: FloatArray) -> FloatArray:
        """Errors of the motions (n, t - 1, 3), m, or derivatives of them (n, t - 1, 3, k), in standard deviations."""
        result = errors / self.stds.reshape(self.stds.shape + (1,) * (errors.ndim - 3))
        for number, motion, root in self.slips:
            result[number, motion] = root @ errors[number, motion]
        return np.asarray(result)

    def _noise_of(self, readings: Readings) -> FloatArray:
        sensor = RangeSensor(1.0, self.growth)
        return sensor.stds(readings.distances) / sensor.usual_std(float(self.robot.max_ranges.max()))

    def _beams_of(self, readings: Readings) -> FloatArray:
        table = np.column_stack((self.robot.beam_origins, self.robot.beam_angles))
        return np.asarray(table[readings.beams])


@dataclass(frozen=True, eq=False)
class State:
    """The variables of the least-squares problem.

    Attributes
    ----------
    motions, poses
        Motions (n, t - 1, 3), m, and the poses (n, t, 3) that follow from them, m and rad; headings are not wrapped.
    lines, anchors
        Lines (m, 2) as (d, alpha) about one anchor point each, m and rad, and the anchors (m, 2), m.
    calibration
        Calibration (n, 4): relative excess of left wheel, right wheel and axle, and the bias of all ranges, m.
    """

    motions: FloatArray
    poses: FloatArray
    lines: FloatArray
    anchors: FloatArray
    calibration: FloatArray

    @property
    def flat_poses(self) -> FloatArray:
        """All poses (n t, 3), sorted by robot and then by step."""
        return self.poses.reshape(-1, 3)


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


def make_problem(
    robot: RobotSpec,
    noise: NominalNoise,
    starts: FloatArray,
    wheels: FloatArray,
    ranges: FloatArray,
    usable: BoolArray | None = None,
    prior: CalibrationPrior | None = None,
    first_step: int = 0,
    sensor: RangeSensor | None = None,
) -> Problem:
    """Collect the measurements of a run.

    Parameters
    ----------
    robot, noise
        Body and beams of each of the n robots, and the specified noise. The standard deviation of ranges is taken to be
        at least 5 mm.
    starts
        Known poses (n, 3), m and rad.
    wheels, ranges
        Observations (t, n, 2) and (t, n, n_beams), m; row 0 is the observation at the reset.
    usable
        Mask (t, n, n_beams) of the readings that may be used; None for all. Readings without a wall are always left
        out. So are old readings that a slow sensor repeats.
    prior
        Given if wheels, axle and bias are to be estimated.
    first_step
        Step of the drive that row 0 belongs to. It decides which readings a slow sensor repeats.
    sensor
        How the ranges are measured, if that is known to differ from ``robot`` and ``noise``.
    """
    reported = np.moveaxis(np.asarray(wheels, dtype=float), 0, 1)[:, 1:]
    stds = np.full((*reported.shape[:2], 3), _ASIDE_STD)
    stds[..., :2] = np.sqrt(noise.wheel_variance * np.abs(reported) + _LEAST_VARIANCE)
    motions = np.concatenate((reported, np.zeros_like(reported[..., :1])), axis=-1)
    ranges = np.asarray(ranges, dtype=float)
    fresh = np.array([robot.measures(first_step + row) for row in range(len(ranges))])[:, None]
    measured = fresh & np.isfinite(ranges) & (True if usable is None else usable)
    looked = measured & (ranges > robot.too_near)
    readings = _listed(looked & (ranges < robot.too_far), ranges)
    looks = _listed(looked, np.minimum(ranges, robot.max_ranges))
    sensor = sensor or RangeSensor(noise.range_std, cone=robot.cone)
    contact_std = max(noise.range_std, LEAST_RANGE_STD)
    return Problem(
        robot, np.asarray(starts, dtype=float), motions, stds, readings, looks,
        range_std=max(sensor.usual_std(float(robot.max_ranges.max())), LEAST_RANGE_STD),
        prior=None if prior is None else prior.information, beam_width=sensor.cone,
        growth=sensor.growth / sensor.std if sensor.growth else 0.0, bias=sensor.bias,
        slips=slips_of(robot, contact_std, reported, stds, ranges, measured),
    )  # fmt: skip


def _listed(kept: BoolArray, ranges: FloatArray) -> Readings:
    """The ranges (t, n, n_beams) that are kept, in the order of poses."""
    number, step, beam = np.nonzero(np.moveaxis(kept, 0, 1))
    return Readings(number * len(ranges) + step, beam, ranges[step, number, beam])


def state_from_poses(problem: Problem, poses: FloatArray) -> State:
    """A state without lines at poses (t, n, 3). The first pose is the known start; headings may be wrapped."""
    chains = np.moveaxis(np.asarray(poses, dtype=float), 0, 1).copy()
    chains[..., 2] = np.unwrap(chains[..., 2], axis=1)
    motions = np.empty_like(problem.wheels)
    for chain, motion in zip(chains, motions, strict=True):
        kernels.motions_between(chain, problem.robot.axle, motion)
    return moved(problem, motions, np.zeros((0, 2)), np.zeros((0, 2)), problem.assumed_calibration)


def state_from_motions(problem: Problem) -> State:
    """The state without lines that follows from the reported wheel travel."""
    nothing = np.zeros((0, 2))
    return moved(problem, problem.wheels, nothing, nothing, problem.assumed_calibration)


def moved(
    problem: Problem, motions: FloatArray, lines: FloatArray, anchors: FloatArray, calibration: FloatArray
) -> State:
    """The state with motions (n, t - 1, 3), and with the poses that follow from these motions."""
    poses = np.empty((len(motions), problem.steps, 3))
    for number, chain in enumerate(poses):
        kernels.drive(problem.starts[number], motions[number], _axle(problem, calibration[number]), chain)
    return State(motions, poses, lines, anchors, calibration)


def rows_of(problem: Problem, state: State, labels: IntArray) -> FloatArray:
    """One row (k, 7) for each reading, given its line (k,) or -1, laid out as in :mod:`.chain_kernels`."""
    rows = np.zeros((len(problem.readings), COLUMNS))
    kernels.expected_readings(
        state.flat_poses, problem.readings.places, problem.beams, labels, state.lines, state.anchors, rows
    )
    if problem.beam_width:
        headings = state.flat_poses[problem.readings.places, 2] + problem.beams[:, 2]
        widen(rows, state.lines[labels, 1] - headings, problem.beam_width)
    return rows


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


def _axle(problem: Problem, calibration: FloatArray) -> float:
    return problem.robot.axle * (1.0 + float(calibration[2]))


def _motion_residuals(problem: Problem, state: State) -> FloatArray:
    """Reported wheel travel, corrected by the calibration, minus true travel (n, t - 1, 3), in standard deviations."""
    sizes = np.ones((len(state.motions), 1, 3))
    sizes[:, 0, :2] += state.calibration[:, :2]
    return problem.whitened(problem.wheels * sizes - state.motions)


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
        self._first_line = 0 if problem.prior is None else CALIBRATED * count
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
            calibration = solved[factored.first_shared : factored.first_line].reshape(-1, CALIBRATED)
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
            axle = _axle(problem, state.calibration[number])
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
            first = CALIBRATED * number
            by_all[:, 0, first] = -self._problem.wheels[number, :, 0]
            by_all[:, 1, first + 1] = -self._problem.wheels[number, :, 1]
            by_all[:, :, first + 2] = self._by_axle[number]
        return by_all

    def _add_readings(self, labels: IntArray, rows: FloatArray, weights: FloatArray) -> None:
        problem, readings = self._problem, self._problem.readings
        biases, border = np.full(len(readings), -1), (problem.steps * len(problem.starts), 3, self._first_line)
        if self._first_line:
            biases = CALIBRATED * (readings.places // problem.steps) + 3
        kernels.add_readings(
            readings.places, labels, rows, range_residuals(problem, self._state, rows),
            weights / problem.range_std**2, biases, self._first_line,
            self._diagonal.reshape(-1, 3, 3), self._border.reshape(border),
            self._right.reshape(-1, 3), self._shared, self._shared_right,
        )  # fmt: skip

    def _add_priors(self) -> None:
        np.einsum("ii->i", self._shared)[self._first_line :] += np.tile(_LINE_STD**-2.0, len(self._state.lines))
        if self._problem.prior is None:
            return
        for number, off in enumerate(self._state.calibration - self._problem.assumed_calibration):
            own = slice(CALIBRATED * number, CALIBRATED * (number + 1))
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
