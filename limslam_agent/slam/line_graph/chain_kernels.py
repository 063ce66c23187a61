"""Compiled parts of the line smoother: wheel motions, expected readings, and the elimination of chains of poses.

A **motion** is (left, right, aside): the travel of both wheels and a shift to the left, m. The wheels drive an exact
arc, as in :func:`limslam_env.geometry.se2.arc`; the shift is perpendicular to the chord of that arc. With the shift, a
pair of poses and a motion determine each other. A **calibration** is (left, right, axle, bias): the relative excess of
the wheels and of the axle over their specified sizes, and the bias of all ranges, m. A **line** is (d, alpha) about an
anchor a: the points x with (cos alpha, sin alpha) . (x - a) = d.
"""

import math

import numpy as np

from limslam_agent.slam.line_graph.compilation import compiled, entry
from limslam_env.geometry import FloatArray, IntArray

CALIBRATED = 4
"""Number of parameters in the calibration of a robot, without the directions of its beams."""

RANGE, BY_POSE, BY_LINE, COSINE, COLUMNS = 0, 1, 4, 6, 7
"""Columns of a row about a reading: its expected range, derivatives by pose (3) and line (2), and the cosine."""

_SMALL_TURN = 1e-4
_PARALLEL = 1e-9


@entry
def drive(start: FloatArray, motions: FloatArray, axle: float, poses: FloatArray) -> None:
    """Poses (t, 3) from a start (3,) by motions (t - 1, 3); headings are not wrapped."""
    poses[0] = start
    for step in range(len(motions)):
        half = 0.5 * (motions[step, 1] - motions[step, 0]) / axle
        chord = 0.5 * (motions[step, 0] + motions[step, 1]) / _arc_over_chord(half)
        middle = poses[step, 2] + half
        cos, sin = math.cos(middle), math.sin(middle)
        poses[step + 1, 0] = poses[step, 0] + chord * cos - motions[step, 2] * sin
        poses[step + 1, 1] = poses[step, 1] + chord * sin + motions[step, 2] * cos
        poses[step + 1, 2] = middle + half


@entry
def motions_between(poses: FloatArray, axle: float, motions: FloatArray) -> None:
    """Motions (t - 1, 3) from each pose of (t, 3) to the next; headings must not jump."""
    for step in range(len(motions)):
        half = 0.5 * (poses[step + 1, 2] - poses[step, 2])
        ahead, aside = _chord(poses[step], poses[step + 1])
        distance = ahead * _arc_over_chord(half)
        motions[step, 0], motions[step, 1] = distance - half * axle, distance + half * axle
        motions[step, 2] = aside


@entry
def motion_jacobians(poses: FloatArray, axle: float, by_before: FloatArray, by_after: FloatArray) -> None:
    """Derivatives (t - 1, 3, 3) of :func:`motions_between` by the pose before a motion and by the pose after it."""
    for step in range(len(by_before)):
        half = 0.5 * (poses[step + 1, 2] - poses[step, 2])
        middle = poses[step, 2] + half
        cos, sin = math.cos(middle), math.sin(middle)
        ahead, aside = _chord(poses[step], poses[step + 1])
        longer = _arc_over_chord(half)
        turned, stretched = 0.5 * longer * aside, 0.5 * ahead * _arc_over_chord_derivative(half)
        for row in range(2):
            lever = (row - 0.5) * axle
            by_after[step, row, 0], by_after[step, row, 1] = longer * cos, longer * sin
            by_after[step, row, 2] = turned + stretched + lever
            by_before[step, row, 2] = turned - stretched - lever
        by_after[step, 2, 0], by_after[step, 2, 1] = -sin, cos
        by_after[step, 2, 2] = by_before[step, 2, 2] = -0.5 * ahead
        for row in range(3):
            by_before[step, row, 0], by_before[step, row, 1] = -by_after[step, row, 0], -by_after[step, row, 1]


@compiled
def _chord(before: FloatArray, after: FloatArray) -> tuple[float, float]:
    """Displacement between two poses, ahead and to the left in the direction of their mean heading, m."""
    middle = 0.5 * (before[2] + after[2])
    cos, sin = math.cos(middle), math.sin(middle)
    x, y = after[0] - before[0], after[1] - before[1]
    return cos * x + sin * y, cos * y - sin * x


@compiled
def _arc_over_chord(half: float) -> float:
    """Ratio of the length of an arc to that of its chord; ``half`` is half the turn, rad."""
    return 1.0 + half * half / 6.0 if abs(half) < _SMALL_TURN else half / math.sin(half)


@compiled
def _arc_over_chord_derivative(half: float) -> float:
    if abs(half) < _SMALL_TURN:
        return half / 3.0
    sin = math.sin(half)
    return (sin - half * math.cos(half)) / (sin * sin)


@compiled
def expected_reading(pose: FloatArray, beam: FloatArray, line: FloatArray, anchor: FloatArray, row: FloatArray) -> None:
    """The expected range of a beam (x, y, angle) on the body; :data:`RANGE` etc. give the layout of ``row`` (7,)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    arm_x, arm_y = cos * beam[0] - sin * beam[1], sin * beam[0] + cos * beam[1]
    ux, uy = math.cos(pose[2] + beam[2]), math.sin(pose[2] + beam[2])
    nx, ny = math.cos(line[1]), math.sin(line[1])
    cosine = nx * ux + ny * uy
    # A beam exactly parallel to the line does not meet it. A very large finite distance is used instead.
    divisor = cosine if abs(cosine) > _PARALLEL else _PARALLEL
    x, y = pose[0] + arm_x - anchor[0], pose[1] + arm_y - anchor[1]
    distance = (line[0] - nx * x - ny * y) / divisor
    swept = arm_x * ny - arm_y * nx + distance * (ux * ny - uy * nx)
    row[RANGE], row[COSINE] = distance, cosine
    row[BY_POSE], row[BY_POSE + 1], row[BY_POSE + 2] = -nx / divisor, -ny / divisor, -swept / divisor
    row[BY_LINE] = 1.0 / divisor
    row[BY_LINE + 1] = ((x + distance * ux) * ny - (y + distance * uy) * nx) / divisor


@entry
def expected_readings(
    poses: FloatArray,
    places: IntArray,
    beam: FloatArray,
    label: IntArray,
    lines: FloatArray,
    anchors: FloatArray,
    rows: FloatArray,
) -> None:
    """Rows (k, 7) of readings that are associated with lines ``label`` (k,), by beams (k, 3) at pose indices (k,)."""
    for k in range(len(places)):
        if label[k] >= 0:
            expected_reading(poses[places[k]], beam[k], lines[label[k]], anchors[label[k]], rows[k])


@entry
def add_motions(
    by_before: FloatArray,
    by_after: FloatArray,
    by_calibration: FloatArray,
    residuals: FloatArray,
    diagonal: FloatArray,
    below: FloatArray,
    border: FloatArray,
    right: FloatArray,
    shared: FloatArray,
    shared_right: FloatArray,
) -> None:
    """Add the motions of one chain to its normal equations. All rows are divided by standard deviations.

    Parameters
    ----------
    by_before, by_after, by_calibration, residuals
        Derivatives (t - 1, 3, 3), (t - 1, 3, 3) and (t - 1, 3, c), and residuals (t - 1, 3).
    diagonal, below, border, right
        Parts of the equations of the poses: blocks (t, 3, 3), blocks (t, 3, 3) between each pose and the next pose,
        blocks (t, 3, c) with the calibration, and the right side (t, 3).
    shared, shared_right
        Parts of the equations of the calibration: (c, c) and (c,).
    """
    for step in range(len(by_before)):
        before, after, other = by_before[step], by_after[step], by_calibration[step]
        for row in range(3):
            for i in range(3):
                right[step, i] += before[row, i] * residuals[step, row]
                right[step + 1, i] += after[row, i] * residuals[step, row]
                for j in range(3):
                    diagonal[step, i, j] += before[row, i] * before[row, j]
                    diagonal[step + 1, i, j] += after[row, i] * after[row, j]
                    below[step, i, j] += after[row, i] * before[row, j]
                for j in range(other.shape[1]):
                    border[step, i, j] += before[row, i] * other[row, j]
                    border[step + 1, i, j] += after[row, i] * other[row, j]
            for i in range(other.shape[1]):
                shared_right[i] += other[row, i] * residuals[step, row]
                for j in range(other.shape[1]):
                    shared[i, j] += other[row, i] * other[row, j]


@entry
def add_readings(
    places: IntArray,
    label: IntArray,
    rows: FloatArray,
    residuals: FloatArray,
    weights: FloatArray,
    biases: IntArray,
    turns: IntArray,
    by_turns: FloatArray,
    first_line: int,
    diagonal: FloatArray,
    border: FloatArray,
    right: FloatArray,
    shared: FloatArray,
    shared_right: FloatArray,
) -> None:
    """Add readings to the normal equations of all poses (p, ...), of calibration and lines.

    ``biases`` (k,) are the columns of the range biases, or negative. ``turns`` (k,) are those of the beams' directions,
    or negative, with the derivatives ``by_turns`` (k,). ``first_line`` is the column of the first line.
    """
    for k in range(len(places)):
        weight = weights[k]
        if weight == 0.0:
            continue
        place, column, bias = places[k], first_line + 2 * label[k], biases[k]
        for i in range(3):
            scaled = weight * rows[k, BY_POSE + i]
            right[place, i] += scaled * residuals[k]
            for j in range(3):
                diagonal[place, i, j] += scaled * rows[k, BY_POSE + j]
            if bias >= 0:
                border[place, i, bias] += scaled
        for i in range(2):
            scaled = weight * rows[k, BY_LINE + i]
            shared_right[column + i] += scaled * residuals[k]
            for j in range(2):
                shared[column + i, column + j] += scaled * rows[k, BY_LINE + j]
            if bias >= 0:
                shared[column + i, bias] += scaled
                shared[bias, column + i] += scaled
        if bias >= 0:
            shared[bias, bias] += weight
            shared_right[bias] += weight * residuals[k]
        _add_turn(
            turns[k], by_turns[k], bias, column, rows[k], weight, residuals[k], border[place], shared, shared_right
        )


@compiled
def _add_turn(
    turn: int,
    by_turn: float,
    bias: int,
    column: int,
    row: FloatArray,
    weight: float,
    residual: float,
    border: FloatArray,
    shared: FloatArray,
    shared_right: FloatArray,
) -> None:
    """Add what a reading says of its beam's direction, the column ``turn``, if that is estimated."""
    if turn < 0:
        return
    scaled = weight * by_turn
    for i in range(3):
        border[i, turn] += scaled * row[BY_POSE + i]
    for i in range(2):
        shared[column + i, turn] += scaled * row[BY_LINE + i]
        shared[turn, column + i] += scaled * row[BY_LINE + i]
    shared[bias, turn] += scaled
    shared[turn, bias] += scaled
    shared[turn, turn] += scaled * by_turn
    shared_right[turn] += scaled * residual


@entry
def eliminate(
    diagonal: FloatArray,
    below: FloatArray,
    border: FloatArray,
    right: FloatArray,
    steps: IntArray,
    label: IntArray,
    rows: FloatArray,
    weights: FloatArray,
    lower: FloatArray,
    gains: FloatArray,
    coupled: FloatArray,
    solved: FloatArray,
) -> None:
    """Eliminate the poses 1 to t - 2 of a chain. The first pose is known, and the last pose remains.

    This is a block Cholesky factorisation of an arrow matrix. The readings of the chain, sorted by ``steps`` (k,),
    couple the poses to the lines. ``border`` (t, 3, c) couples the poses to the calibration.

    Parameters
    ----------
    lower, gains
        Output arrays (t, 3, 3): the Cholesky factor of each pose's block, and the coupling of each pose to the previous
        pose.
    coupled, solved
        Output arrays (t, 3, m) and (t, 3): the coupling of each pose to calibration and lines, and its right side, both
        multiplied by the inverse of the factor. The entries of the last pose are not changed.
    """
    last, first_line = len(diagonal) - 1, border.shape[2]
    # Lines are numbered in the order of their first readings: the columns of later lines are still zero.
    active, k = first_line, 0
    while k < len(steps) and steps[k] < 1:
        k += 1
    for step in range(1, last + 1):
        coupled[step, :, :first_line] = border[step]
        while k < len(steps) and steps[k] == step:
            if weights[k] != 0.0:
                column = first_line + 2 * label[k]
                active = max(active, int(column) + 2)
                _couple(coupled[step], column, rows[k], weights[k])
            k += 1
        lower[step] = diagonal[step]
        solved[step] = right[step]
        if step > 1:
            _subtract_previous(below[step - 1], lower, gains, coupled, solved, step, active)
        if step < last:
            _factor(lower[step])
            _take_off(lower[step], coupled[step], solved[step], active)


@compiled
def _couple(block: FloatArray, column: int, row: FloatArray, weight: float) -> None:
    for i in range(3):
        scaled = weight * row[BY_POSE + i]
        block[i, column] += scaled * row[BY_LINE]
        block[i, column + 1] += scaled * row[BY_LINE + 1]


@compiled
def _subtract_previous(
    below: FloatArray,
    lower: FloatArray,
    gains: FloatArray,
    coupled: FloatArray,
    solved: FloatArray,
    step: int,
    active: int,
) -> None:
    """Subtract the effect of eliminating the previous pose from a pose's block, coupling and right side."""
    factor, gain = lower[step - 1], gains[step]
    for i in range(3):
        gain[i, 0] = below[i, 0] / factor[0, 0]
        gain[i, 1] = (below[i, 1] - gain[i, 0] * factor[1, 0]) / factor[1, 1]
        gain[i, 2] = (below[i, 2] - gain[i, 0] * factor[2, 0] - gain[i, 1] * factor[2, 1]) / factor[2, 2]
    before = coupled[step - 1]
    for i in range(3):
        a, b, c = gain[i, 0], gain[i, 1], gain[i, 2]
        solved[step, i] -= a * solved[step - 1, 0] + b * solved[step - 1, 1] + c * solved[step - 1, 2]
        for j in range(3):
            lower[step, i, j] -= a * gain[j, 0] + b * gain[j, 1] + c * gain[j, 2]
        for j in range(active):
            coupled[step, i, j] -= a * before[0, j] + b * before[1, j] + c * before[2, j]


@compiled
def _factor(block: FloatArray) -> None:
    """Replace a block (3, 3) by its lower Cholesky factor."""
    a = math.sqrt(block[0, 0])
    b, c = block[1, 0] / a, block[2, 0] / a
    d = math.sqrt(block[1, 1] - b * b)
    e = (block[2, 1] - c * b) / d
    f = math.sqrt(block[2, 2] - c * c - e * e)
    block[0, 0], block[1, 0], block[2, 0], block[1, 1], block[2, 1], block[2, 2] = a, b, c, d, e, f
    block[0, 1] = block[0, 2] = block[1, 2] = 0.0


@compiled
def _take_off(factor: FloatArray, coupled: FloatArray, solved: FloatArray, active: int) -> None:
    """Solve with the factor (3, 3) for the columns (3, m) and the right side (3,), in place."""
    for j in range(active):
        coupled[0, j] /= factor[0, 0]
        coupled[1, j] = (coupled[1, j] - factor[1, 0] * coupled[0, j]) / factor[1, 1]
        coupled[2, j] = (coupled[2, j] - factor[2, 0] * coupled[0, j] - factor[2, 1] * coupled[1, j]) / factor[2, 2]
    solved[0] /= factor[0, 0]
    solved[1] = (solved[1] - factor[1, 0] * solved[0]) / factor[1, 1]
    solved[2] = (solved[2] - factor[2, 0] * solved[0] - factor[2, 1] * solved[1]) / factor[2, 2]


@entry
def substitute(
    lower: FloatArray, gains: FloatArray, coupled: FloatArray, solved: FloatArray, shared: FloatArray, moves: FloatArray
) -> None:
    """Compute the steps of poses ``moves`` (t, 3) from its last row and the steps of calibration and lines (m,)."""
    for step in range(len(moves) - 2, 0, -1):
        factor, gain, move = lower[step], gains[step + 1], moves[step]
        for i in range(3):
            total = solved[step, i]
            for j in range(len(shared)):
                total -= coupled[step, i, j] * shared[j]
            for j in range(3):
                total -= gain[j, i] * moves[step + 1, j]
            move[i] = total
        move[2] /= factor[2, 2]
        move[1] = (move[1] - factor[2, 1] * move[2]) / factor[1, 1]
        move[0] = (move[0] - factor[1, 0] * move[1] - factor[2, 0] * move[2]) / factor[0, 0]


@entry
def pose_marginals(
    lower: FloatArray,
    gains: FloatArray,
    coupled: FloatArray,
    shared: FloatArray,
    with_shared: FloatArray,
    covariances: FloatArray,
) -> None:
    """Fill in the covariances (t, 3, 3) of all poses of a chain; that of the last pose is given.

    An eliminated pose is L^-T (z - W y - G^T x). Here y are the shared variables, x is the next pose, and z has unit
    covariance and is independent of both.

    Parameters
    ----------
    shared, with_shared
        Covariance (m, m) of calibration and lines, and the cross-covariance (3, m) of the last pose with them.
    """
    cross = with_shared.copy()
    for step in range(len(covariances) - 2, 0, -1):
        back = _inverse_transposed(lower[step])
        gain, window = gains[step + 1].T.copy(), coupled[step]
        by_next = -(gain @ covariances[step + 1]) - window @ cross.T.copy()
        by_shared = -(gain @ cross) - window @ shared
        inner = np.eye(3) - by_next @ gain.T.copy() - by_shared @ window.T.copy()
        cross = back @ by_shared
        whole = back @ inner @ back.T.copy()
        covariances[step] = 0.5 * (whole + whole.T)


@compiled
def _inverse_transposed(factor: FloatArray) -> FloatArray:
    """The inverse of the transpose of a lower triangular matrix (3, 3)."""
    back = np.zeros((3, 3))
    for i in range(3):
        back[i, i] = 1.0 / factor[i, i]
    back[0, 1] = -factor[1, 0] * back[0, 0] * back[1, 1]
    back[1, 2] = -factor[2, 1] * back[1, 1] * back[2, 2]
    back[0, 2] = (factor[1, 0] * factor[2, 1] - factor[2, 0] * factor[1, 1]) * back[0, 0] * back[1, 1] * back[2, 2]
    return back
