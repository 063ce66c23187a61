"""Errors of the range sensors that were not specified: the size of the noise, and the width of the beams.

Both are estimated from the residuals of readings with known lines, and used only where the residuals require it. A run
with sensors as specified is solved as if nothing could be estimated.
"""

from dataclasses import replace

import numpy as np
from scipy.special import ndtr, ndtri

from limslam_agent.config.smoother import SmootherConfig
from limslam_agent.slam.line_graph.elimination import DegenerateError
from limslam_agent.slam.line_graph.line_smoother import range_residuals, solve
from limslam_agent.slam.line_graph.problem import LEAST_RANGE_STD, Problem, rows_of
from limslam_agent.slam.line_graph.reassociation import GATE, Association

_FIXED_POINT = 20
_SETTLED = 1.05
_TRIED_WIDTHS, _NEAR_WIDTHS = (0.02, 0.04), (-0.01, 0.01)  # rad: beyond a stated angle, and about one that was found
_SETTLED_GATE, _LEAST_STEP = 4.0, 5e-4  # chi-square, and rad


def fitted_sensor(problem: Problem, found: Association, config: SmootherConfig, stated: float) -> Problem:
    """The problem with the beam width and the noise that the residuals of a solution require.

    It is the same object if they require no change. ``stated`` is the specified standard deviation of a range, m: a
    departure from it needs more evidence than a further change.
    """
    ratio = max(residual_std(problem, found, GATE), LEAST_RANGE_STD) / problem.range_std
    most = config.sensor.noise_ratio if problem.range_std == stated else _SETTLED
    changed = _with_width(problem, found, config)
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


def _with_width(problem: Problem, found: Association, config: SmootherConfig) -> Problem:
    """The problem with the width that minimises chi-square, if chi-square then falls by more than the gate.

    Chi-square at the optimum of all other variables is nearly quadratic in the width, since the width is small. Where
    the noise is small, what is missing to a quadratic function can exceed the gate. So the minimum is solved for, too.
    The constant errors of wheels and ranges are among the variables, so that they are not taken for a width. An angle
    that is known not to be as stated is corrected on less evidence: what remains would be taken for such errors.
    """
    sized, width = replace(problem, prior=config.calibration.information), problem.beam_width
    is_stated = width == problem.robot.cone
    tried, gate = (_TRIED_WIDTHS, config.sensor.width_gate) if is_stated else (_NEAR_WIDTHS, _SETTLED_GATE)
    widths = np.maximum(width + np.array(tried), 0.0)

    def gain_of(other: float) -> float:
        return before - solve(replace(sized, beam_width=other), found.state, found.labels).chi_square

    try:
        before = solve(replace(sized, beam_width=width), found.state, found.labels).chi_square
        bend, slope = np.linalg.lstsq(
            np.column_stack(((widths - width) ** 2, widths - width)), [-gain_of(each) for each in widths], rcond=None
        )[0]
        step = -0.5 * slope / bend if bend > 0.0 else 0.0
        best = float(np.clip(width + step, 0.0, max(config.sensor.max_width, width)))
        gain = slope * (width - best) - bend * (width - best) ** 2
        is_better = abs(best - width) > _LEAST_STEP and gain > gate and gain_of(best) > gate
    except DegenerateError:
        return problem
    return replace(problem, beam_width=best) if is_better else problem
