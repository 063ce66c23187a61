"""Tests that the readings of each line are of one straight wall.

Where two walls meet, readings of one wall can be assigned to the line of the other, as long as they lie within the gate
of association. There is nothing wrong with a single one of them, but the residuals of one wall are independent, and
these are not: they are systematic along the line.
"""

import numpy as np

from limslam_agent.kernels.tables import FEWEST
from limslam_agent.slam.line_graph.line_smoother import not_grazing, range_residuals
from limslam_agent.slam.line_graph.problem import Problem, State, expected
from limslam_env.geometry import FloatArray, IntArray

_FEWEST_APART = 3  # readings; two of them fit any line
# Chi-square by which two lines fit the readings of one line better where it is divided. Felt by the rows "noise told as
# half" and "bumping" of the scoreboard.
_BEND_GATE = 16.0


def straight_labels(problem: Problem, state: State, labels: IntArray, along: FloatArray) -> IntArray:
    """Labels (k,) in which bent lines are divided. Parts with too few readings for a line have no line.

    Parameters
    ----------
    state, labels
        Poses and lines, and the line (k,) of each reading, or -1.
    along
        Where each reading's beam meets its line (k,), m.
    """
    readings = expected(problem, state, labels)
    cosines = readings.cosines
    # The distance of a reading from its line is the residual along the beam times the cosine.
    variances = np.maximum(problem.variances(state, readings) * cosines**2, 1e-18)
    points = np.stack((along, range_residuals(problem, state, readings) * cosines, 1.0 / variances))
    order = np.lexsort((along, labels))
    order = order[not_grazing(readings, labels)[order]]
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
