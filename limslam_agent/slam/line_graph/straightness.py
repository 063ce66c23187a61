"""Tests that the readings of each line are of one straight wall.

Where two walls meet, readings of one wall can be assigned to the line of the other, as long as they lie within the gate
of association. There is nothing wrong with a single one of them, but the residuals of one wall are independent, and
these are not: they are systematic along the line, or all on one side of it.
"""

import numpy as np

from limslam_agent.kernels.tables import FEWEST
from limslam_agent.slam.line_graph import line_kernels as kernels
from limslam_agent.slam.line_graph.line_smoother import not_grazing, range_residuals
from limslam_agent.slam.line_graph.problem import Problem, State, expected
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_FEWEST_APART = 3  # readings; two of them fit any line
_RUN_GAP = 10  # steps without a reading that end a run
_LONGEST_RUN = 40  # readings that are tested together
_BEND_GATE = 16.0  # chi-square: a line is divided where two lines fit its readings better by this much
# Standard deviations of a sum of residuals: successive readings of one beam with a larger sum lie on one side of their
# line.
_RUN_GATE = 4.0


def straight_labels(problem: Problem, state: State, labels: IntArray, along: FloatArray) -> IntArray:
    """Labels (k,) in which bent lines are divided, and runs of readings on one side of their line have no line.

    Parameters
    ----------
    state, labels
        Poses and lines, and the line (k,) of each reading, or -1.
    along
        Where each reading's beam meets its line (k,), m.
    """
    readings = expected(problem, state, labels)
    residuals = range_residuals(problem, state, readings)
    result = _divided(along, residuals, readings.cosines, problem.stds, labels, not_grazing(readings, labels))
    return np.where(_is_one_sided(problem, residuals, labels), -1, result)


def _divided(
    along: FloatArray,
    residuals: FloatArray,
    cosines: FloatArray,
    stds: FloatArray,
    labels: IntArray,
    is_used: BoolArray,
) -> IntArray:
    """The labels (k,) with bent lines divided. Parts with too few readings for a line have no line."""
    # The distance of a reading from its line is the residual along the beam times the cosine.
    points = np.stack((along, residuals * cosines, np.maximum(stds * np.abs(cosines), 1e-9) ** -2.0))
    order = np.lexsort((along, labels))
    order = order[(labels[order] >= 0) & is_used[order]]
    result, count = labels.copy(), int(labels.max(initial=-1)) + 1
    for line in np.split(order, np.flatnonzero(np.diff(labels[order])) + 1):
        for part in _straight_parts(points, line)[1:]:
            result[part] = count
            count += 1
    few = np.bincount(result[result >= 0], minlength=count) < FEWEST
    return np.where(few[result], -1, result)


def _straight_parts(points: FloatArray, line: IntArray) -> list[IntArray]:
    """The readings of a line, sorted along the line, in the parts into which the line is divided."""
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
    """Chi-square (k,) of the best line through points, from the sums (6, k) of w, w s, w s s, w y, w s y, w y y."""
    w, ws, wss, wy, wsy, wyy = sums
    spread = np.maximum(wss - ws * ws / w, 1e-9 * w)
    return np.asarray(wyy - wy * wy / w - (wsy - ws * wy / w) ** 2 / spread)


def _is_one_sided(problem: Problem, residuals: FloatArray, labels: IntArray) -> BoolArray:
    """Mask (k,) of successive readings of a beam that lie on one side of their line, as those beside a corner do."""
    readings = problem.readings
    order = np.lexsort((readings.places, labels, readings.beams, readings.places // problem.steps))
    order = order[labels[order] >= 0]
    is_new = np.diff(labels[order], prepend=-1) != 0
    is_new |= np.diff(readings.beams[order], prepend=-1) != 0
    is_new |= np.abs(np.diff(readings.places[order], prepend=0)) > _RUN_GAP
    firsts = np.append(np.flatnonzero(is_new), len(order))
    found, result = np.zeros(len(order), dtype=bool), np.zeros(len(labels), dtype=bool)
    kernels.one_sided_runs((residuals / problem.stds)[order], firsts, _RUN_GATE, _LONGEST_RUN, found)
    result[order[found]] = True
    return result
