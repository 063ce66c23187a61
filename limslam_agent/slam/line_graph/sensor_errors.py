"""Errors of the range sensors that were not specified: the size of the noise, the width and directions of the beams.

They are estimated from the residuals of readings with known lines, and used only where the residuals require it. A run
with sensors as specified is solved as if nothing could be estimated.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtr, ndtri

from limslam_agent.config.consistent import MOST_TURNED
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.line_graph.chain_kernels import CALIBRATED
from limslam_agent.slam.line_graph.elimination import DegenerateError
from limslam_agent.slam.line_graph.line_smoother import range_residuals, solve
from limslam_agent.slam.line_graph.problem import CALIBRATION_PRIOR, LEAST_RANGE_STD, Problem, rows_of
from limslam_agent.slam.line_graph.reassociation import GATE, Association
from limslam_env.geometry import FloatArray

TURN_STD = 0.05
"""Prior standard deviation of the direction of a beam, rad."""

_FIXED_POINT = 20
# The noise is as assumed if the standard deviation of the residuals differs from it by at most this factor: from the
# specified noise, and from noise that was estimated.
_NOISE_RATIO, _SETTLED = 1.25, 1.05
_TURN_GATE = 40.0  # beams are turned if twice the logarithm of the Bayes factor for turned beams exceeds this
_WIDTH_GATE = 40.0  # the beams have an opening angle if chi-square falls by more than this
_MAX_WIDTH = math.radians(10.0)  # half of the largest opening angle
_TRIED_WIDTHS, _NEAR_WIDTHS = (0.02, 0.04), (-0.01, 0.01)  # rad: beyond a stated angle, and about one that was found
_SETTLED_GATE, _LEAST_STEP = 4.0, 5e-4  # chi-square, and rad
_LEAST_TURN = math.radians(0.1)


def fitted_sensor(problem: Problem, found: Association, stated: float) -> Problem:
    """The problem with the directions and width of the beams and the noise that the residuals of a solution require.

    It is the same object if they require no change. ``stated`` is the specified standard deviation of a range, m: a
    departure from it needs more evidence than a further change. Turned beams look like noise, and like wide beams: what
    explains the residuals better is corrected first.
    """
    ratio = max(residual_std(problem, found, GATE), LEAST_RANGE_STD) / problem.range_std
    most = _NOISE_RATIO if problem.range_std == stated else _SETTLED
    (turned, evidence), (changed, gain) = _with_turns(problem, found), _with_width(problem, found)
    if turned is not problem and evidence > gain:
        return turned
    if 1.0 / most <= ratio <= most:
        return changed
    return replace(changed, range_std=ratio * problem.range_std)


def residual_std(problem: Problem, found: Association, gate: float) -> float:
    """Standard deviation of ranges of usual length, m, by the median size of the residuals of the used readings.

    Readings beyond the gate of association, in standard deviations, were not used. The median is that of a normal
    distribution without its tails.
    """
    used = found.solution.weights > 0.0
    if not used.any():
        return problem.range_std
    residuals = range_residuals(problem, found.state, rows_of(problem, found.state, found.labels)) / problem.noise
    median, std = float(np.median(np.abs(residuals[used]))), problem.range_std
    for _ in range(_FIXED_POINT):
        inside = 2.0 * float(ndtr(gate * problem.range_std / std)) - 1.0
        std = max(median / float(ndtri(0.5 + 0.25 * inside)), 1e-6)
    return std


def beam_turns(problem: Problem, found: Association) -> tuple[FloatArray, FloatArray]:
    """By what the beams of one robot are turned against the specified ones (b,), rad, and the covariance (b, b).

    They are estimated with all other variables, wheels and ranges with constant errors included.

    Raises
    ------
    DegenerateError
        If the equations cannot be solved.
    """
    count = len(problem.robot.beams)
    prior = block_diag(CALIBRATION_PRIOR, np.eye(count) / TURN_STD**2)
    sized = replace(problem, prior=prior)
    calibration = np.hstack((found.state.calibration, np.zeros((1, count))))
    solution = solve(sized, replace(found.state, calibration=calibration), found.labels)
    first = solution.factored.first_shared + CALIBRATED
    turns = solution.state.calibration[0, CALIBRATED:] + (0.0 if problem.turns is None else problem.turns)
    return turns, solution.factored.covariance[first : first + count, first : first + count]


def _with_turns(problem: Problem, found: Association) -> tuple[Problem, float]:
    """The problem with the directions of the beams, and twice the logarithm of the Bayes factor for turned beams.

    It is the same problem if the readings do not require other directions than those that are assumed. The Bayes factor
    is the ratio of the prior and the posterior density of beams that are not turned (Savage-Dickey). For beams that are
    known to be turned, it is by how much chi-square falls.
    """
    count, known = len(problem.robot.beams), problem.turns
    if len(problem.starts) > 1 or count > MOST_TURNED:
        return problem, 0.0
    try:
        turns, covariance = beam_turns(problem, found)
    except DegenerateError:
        return problem, 0.0
    change = turns if known is None else turns - known
    evidence = float(change @ np.linalg.solve(covariance, change))
    if known is None:
        evidence += float(np.linalg.slogdet(covariance)[1]) - 2.0 * count * math.log(TURN_STD)
    if (known is None and evidence < _TURN_GATE) or np.abs(change).max() < _LEAST_TURN:
        return problem, evidence
    turned = RangeSensor(0.0, turns=tuple(change.tolist())).mounted(problem.robot)
    return replace(problem, robot=turned, turns=turns), evidence


def _with_width(problem: Problem, found: Association) -> tuple[Problem, float]:
    """The problem with the width that minimises chi-square, and by how much chi-square then falls.

    It is the same problem if chi-square does not fall by more than the gate.

    Chi-square at the optimum of all other variables is nearly quadratic in the width, since the width is small. Where
    the noise is small, what is missing to a quadratic function can exceed the gate. So the minimum is solved for, too.
    The constant errors of wheels and ranges are among the variables, so that they are not taken for a width. An angle
    that is known not to be as stated is corrected on less evidence: what remains would be taken for such errors.
    """
    sized, width = replace(problem, prior=CALIBRATION_PRIOR), problem.beam_width
    is_stated = width == problem.robot.cone
    tried, gate = (_TRIED_WIDTHS, _WIDTH_GATE) if is_stated else (_NEAR_WIDTHS, _SETTLED_GATE)
    widths = np.maximum(width + np.array(tried), 0.0)

    def gain_of(other: float) -> float:
        return before - solve(replace(sized, beam_width=other), found.state, found.labels).chi_square

    try:
        before = solve(replace(sized, beam_width=width), found.state, found.labels).chi_square
        bend, slope = np.linalg.lstsq(
            np.column_stack(((widths - width) ** 2, widths - width)), [-gain_of(each) for each in widths], rcond=None
        )[0]
        step = -0.5 * slope / bend if bend > 0.0 else 0.0
        best = float(np.clip(width + step, 0.0, max(_MAX_WIDTH, width)))
        gain = slope * (width - best) - bend * (width - best) ** 2
        is_better = abs(best - width) > _LEAST_STEP and gain > gate and gain_of(best) > gate
    except DegenerateError:
        return problem, 0.0
    return (replace(problem, beam_width=best), float(gain)) if is_better else (problem, 0.0)
