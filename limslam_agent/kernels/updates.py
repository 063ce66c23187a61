"""Motions of the filter of poses, lines and clones, and its updates by readings of one line.

``slam.consistent.clone_ekf`` explains the filter, whose letters x, P, H, S, W are those of the literature. Readings,
``places`` and the state are those of :mod:`~limslam_agent.kernels.measurement`. Rows of H are stored without zeros, as
``predict_ranges`` fills them. The functions take single rows and blocks of P, because the plain filter and the batch
store P in different ways.
"""

import math

import numpy as np

from limslam_agent.kernels.algebra import dot, factorise, solve_factored, whiten, wrapped
from limslam_agent.kernels.compilation import algebra, entry, lean_entry
from limslam_agent.kernels.measurement import fill_transport, predict_ranges
from limslam_agent.kernels.tables import FEWEST_TO_COMPARE, GRAZING, LEAST_RESIDUAL, POSE
from limslam_env.geometry import FloatArray, IntArray


@lean_entry
def move_pose(
    x: FloatArray, P: FloatArray, at: int, increment: FloatArray, covariance: FloatArray, by_pose: FloatArray,
    by_increment: FloatArray,
) -> None:  # fmt: skip
    """Move a pose, which begins in the state at the index ``at``, by an increment (3,) in its frame, m, m, rad.

    The increment's covariance (3, 3) is added. ``by_pose`` and ``by_increment`` (3, 3), which hold zeros, are set to
    the derivatives of the new pose.
    """
    cos, sin = math.cos(x[at + 2]), math.sin(x[at + 2])
    ahead, left = cos * increment[0] - sin * increment[1], sin * increment[0] + cos * increment[1]
    for k in range(POSE):
        by_pose[k, k] = 1.0
    by_pose[0, 2], by_pose[1, 2] = -left, ahead
    by_increment[0, 0], by_increment[0, 1], by_increment[1, 0], by_increment[1, 1] = cos, -sin, sin, cos
    by_increment[2, 2] = 1.0
    x[at], x[at + 1], x[at + 2] = x[at] + ahead, x[at + 1] + left, wrapped(x[at + 2] + increment[2])
    for j in range(len(x)):
        P[at, j] -= left * P[at + 2, j]
        P[at + 1, j] += ahead * P[at + 2, j]
    for i in range(POSE):
        P[at + i, at] -= left * P[at + i, at + 2]
        P[at + i, at + 1] += ahead * P[at + i, at + 2]
    for i in range(POSE):
        for j in range(POSE):
            for k in range(POSE):
                for m in range(POSE):
                    P[at + i, at + j] += by_increment[i, k] * covariance[k, m] * by_increment[j, m]
    for i in range(POSE):
        for j in range(len(x)):
            P[j, at + i] = P[at + i, j]


@algebra
def clear_readings(
    x: FloatArray, start: int, places: IntArray, readings: FloatArray, line: int, anchor: tuple[float, float]
) -> IntArray:
    """Indices of the readings that meet a line ahead of the beam and do not graze it.

    The line begins in the state at the index ``line``, and has an ``anchor``, m.
    """
    chosen, size, out = np.arange(len(places)), 0, np.empty((len(places), 7))
    predict_ranges(x, start, places, readings, chosen, (x[line], x[line + 1]), anchor, out)
    for i in range(len(places)):
        if abs(out[i, 6]) > GRAZING and out[i, 0] > 0.0:
            chosen[size] = i
            size += 1
    return chosen[:size]


@algebra
def gathered(values: np.ndarray, chosen: IntArray) -> np.ndarray:
    """Some of the values."""
    found = np.empty(len(chosen), dtype=values.dtype)
    for i in range(len(chosen)):
        found[i] = values[chosen[i]]
    return found


@algebra
def involved(
    places: IntArray, chosen: IntArray, num_clones: int, start: int, line: int
) -> tuple[IntArray, IntArray]:  # fmt: skip
    """Indices in the state of all that readings depend on, and where each reading's clone begins among them (n,).

    The clones come first, then the line that begins at the index ``line``; no line if that is negative.
    """
    columns, size = np.empty(POSE * len(chosen) + 2, dtype=np.int64), 0
    begins, column_of = np.empty(len(chosen), dtype=np.int64), np.full(num_clones, -1, dtype=np.int64)
    for i in range(len(chosen)):
        place = places[chosen[i]]
        if column_of[place] < 0:
            column_of[place] = size
            for k in range(POSE):
                columns[size + k] = start + POSE * place + k
            size += POSE
        begins[i] = column_of[place]
    if line >= 0:
        columns[size], columns[size + 1] = line, line + 1
        size += 2
    return columns[:size], begins


@algebra
def dense_block(P: FloatArray, columns: IntArray) -> FloatArray:
    """Block (k, k) of a covariance: its rows and columns ``columns`` (k,)."""
    block = np.empty((len(columns), len(columns)))
    for i in range(len(columns)):
        for j in range(len(columns)):
            block[i, j] = P[columns[i], columns[j]]
    return block


@algebra
def dense_rows(P: FloatArray, columns: IntArray) -> FloatArray:
    """Rows (k, n) of a covariance."""
    rows = np.empty((len(columns), P.shape[1]))
    for i in range(len(columns)):
        for j in range(P.shape[1]):
            rows[i, j] = P[columns[i], j]
    return rows


@algebra
def covariance_of(block: FloatArray, begins: IntArray, H: FloatArray, variances: FloatArray) -> FloatArray:
    """H P H^T + R of readings with variances (n,), the lower triangle; ``block`` is the part of P of ``involved``."""
    count, size = len(begins), len(block)
    S, row = np.empty((count, count)), np.empty(size)
    # The block holds three rows for each clone, and two for the line if there is one.
    line, with_line = size - 2, size % POSE > 0
    for i in range(count):
        at = begins[i]
        for j in range(size):
            row[j] = H[i, 1] * block[at, j] + H[i, 2] * block[at + 1, j] + H[i, 3] * block[at + 2, j]
        if with_line:
            for j in range(size):
                row[j] += H[i, 4] * block[line, j] + H[i, 5] * block[line + 1, j]
        for m in range(i + 1):
            to = begins[m]
            S[i, m] = row[to] * H[m, 1] + row[to + 1] * H[m, 2] + row[to + 2] * H[m, 3]
            if with_line:
                S[i, m] += row[line] * H[m, 4] + row[line + 1] * H[m, 5]
        S[i, i] += variances[i]
    return S


@algebra
def compare(
    x: FloatArray, start: int, block: FloatArray, begins: IntArray, places: IntArray, readings: FloatArray,
    chosen: IntArray, line: int, anchor: tuple[float, float], variances: FloatArray,
) -> tuple[float, float, int, float, float]:  # fmt: skip
    """How badly some readings fit a line, as chi-squares, with the part of P of ``involved``.

    This is the generalised likelihood ratio of the hypotheses "the readings show this line" and "they show another
    line", both with the joint uncertainty of poses and line (two degrees of freedom); then the chi-square that "another
    line" leaves, how many readings were compared, and how far along its normal the readings put a parallel line, m,
    with the variance of that, m^2.
    """
    count = len(chosen)
    H, values = np.empty((count, 7)), np.empty((count, 3))
    predict_ranges(x, start, places, readings, chosen, (x[line], x[line + 1]), anchor, H)
    S = covariance_of(block, begins, H, gathered(variances, chosen))
    for i in range(count):
        values[i, 0] = readings[chosen[i], 3] - H[i, 0]
        values[i, 1], values[i, 2] = H[i, 4], H[i, 5]
    factorise(S, count)
    whiten(S, values, count, 3)
    a, b, c = dot(values, 1, 1, count), dot(values, 1, 2, count), dot(values, 2, 2, count)
    along, across = dot(values, 0, 1, count), dot(values, 0, 2, count)
    of_line = (c * along * along - 2.0 * b * along * across + a * across * across) / (a * c - b * b)
    return of_line, dot(values, 0, 0, count) - of_line, count, along / a, 1.0 / a


@entry
def compare_readings(
    x: FloatArray, P: FloatArray, start: int, places: IntArray, readings: FloatArray, line: int,
    anchor: tuple[float, float], variances: FloatArray,
) -> tuple[float, float, int, float, float]:  # fmt: skip
    """:func:`compare` with a whole covariance P, as Python calls it; no reading is used if there are too few."""
    chosen = clear_readings(x, start, places, readings, line, anchor)
    if len(chosen) < FEWEST_TO_COMPARE:
        return 0.0, 0.0, 0, 0.0, 0.0
    columns, begins = involved(places, chosen, (len(x) - start) // POSE, start, line)
    return compare(x, start, dense_block(P, columns), begins, places, readings, chosen, line, anchor, variances)


@algebra
def gained(rows: FloatArray, begins: IntArray, H: FloatArray, HP: FloatArray) -> None:
    """H P (m, size) from those rows of P for which H is not zero."""
    line = len(rows) - 2
    for i in range(len(begins)):
        at = begins[i]
        a, b, c, d, e = H[i, 1], H[i, 2], H[i, 3], H[i, 4], H[i, 5]
        for j in range(rows.shape[1]):
            HP[i, j] = (
                a * rows[at, j] + b * rows[at + 1, j] + c * rows[at + 2, j] + d * rows[line, j] + e * rows[line + 1, j]
            )


@algebra
def innovation(
    HP: FloatArray, columns: IntArray, begins: IntArray, H: FloatArray, variances: FloatArray, S: FloatArray
) -> None:
    """H P H^T + R of readings (m, m), the lower triangle."""
    line = columns[-2]
    for i in range(len(begins)):
        for m in range(i + 1):
            at = columns[begins[m]]
            S[i, m] = (
                HP[i, at] * H[m, 1] + HP[i, at + 1] * H[m, 2] + HP[i, at + 2] * H[m, 3]
                + HP[i, line] * H[m, 4] + HP[i, line + 1] * H[m, 5]
            )  # fmt: skip
        S[i, i] += variances[i]


@algebra
def since(x: FloatArray, before: FloatArray, columns: IntArray, begin: int, H: FloatArray) -> float:
    """What the change of the state since ``before`` makes of a range, by its row of H."""
    at, line, total = columns[begin], columns[-2], 0.0
    for k in range(POSE):
        total += H[1 + k] * (x[at + k] - before[at + k])
    for k in range(2):
        total += H[4 + k] * (x[line + k] - before[line + k])
    return total


@algebra
def iterate(
    x: FloatArray, size: int, begins_of: tuple[int, int, int], anchors: FloatArray, num_lines: int, top: FloatArray,
    rows: FloatArray, columns: IntArray, begins: IntArray, places: IntArray, readings: FloatArray, chosen: IntArray,
    index: int, variances: FloatArray, iterations: int, huber: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Iterate an update by readings of one line, with Huber weights, linearised anew at each iteration.

    Parameters
    ----------
    x, size, begins_of, anchors, num_lines
        The state and its parts, as of ``fill_transport``. It is moved to where the last iteration linearises.
    top, rows
        The first three rows of P, and those for which H is not zero.
    columns, begins
        As of :func:`involved`.
    places, readings, chosen, index
        Readings, the indices (m,) of those that are used, and the index of their line.
    variances, iterations, huber
        Variances of the used ranges (m,), m^2, the number of iterations, and the limit of the Huber weights.

    Returns
    -------
    moved
        The change of the error transport (size, 3) until the last iteration. P is transported by it.
    H, factor, W, innovation
        H (m, 7) of the last iteration, the Cholesky factor L of S, L^-1 H P (m, size), and the innovation (m,).
    change
        What is still to be added to the state (size,).
    """
    count, first, start = len(chosen), begins_of[1] + 2 * index, begins_of[2]
    anchor, before = (anchors[index, 0], anchors[index, 1]), np.empty(size)
    moved, at_first = np.zeros((size, POSE)), np.empty((size, POSE))
    fill_transport(x, size, begins_of, anchors, num_lines, at_first)
    H, HP, shifted = np.empty((count, 7)), np.empty((count, size)), rows
    change, scaled, S = np.zeros(size), np.empty(count), np.empty((count, count))
    off, solution, now, further = np.empty(count), np.empty(count), np.empty((POSE, size)), np.empty(rows.shape)
    for j in range(size):
        before[j] = x[j]
    for i in range(count):
        scaled[i] = variances[i]
    for iteration in range(iterations):
        if iteration:
            shifted = further
            for j in range(size):
                x[j] += change[j]
            fill_transport(x, size, begins_of, anchors, num_lines, moved)
            subtract(moved, at_first)
            transport_top(top, moved, size, now)
            transport_rows(top, rows, columns, moved, now, shifted)
        predict_ranges(x, start, places, readings, chosen, (x[first], x[first + 1]), anchor, H)
        gained(shifted, begins, H, HP)
        innovation(HP, columns, begins, H, scaled, S)
        for i in range(count):
            residual = readings[chosen[i], 3] - H[i, 0]
            off[i] = solution[i] = residual + since(x, before, columns, begins[i], H[i])
            scaled[i] = variances[i] / huber_weight(residual, variances[i], huber)
        factorise(S, count)
        solve_factored(S, solution, count)
        set_change(before, x, solution, HP, change)
    whiten(S, HP, count, size)
    return moved, H, S, HP, off, change


@algebra
def huber_weight(residual: float, variance: float, huber: float) -> float:
    """Weight of a range: less than 1 beyond ``huber`` standard deviations, unless that is 0."""
    if huber <= 0.0:
        return 1.0
    return min(1.0, huber * math.sqrt(variance) / max(abs(residual), LEAST_RESIDUAL))


@algebra
def set_change(before: FloatArray, x: FloatArray, solution: FloatArray, HP: FloatArray, change: FloatArray) -> None:
    """Set what has to be added to the state x, which was ``before`` when the update began."""
    for j in range(len(change)):
        change[j] = before[j] - x[j]
    for i in range(len(solution)):
        for j in range(len(change)):
            change[j] += solution[i] * HP[i, j]


@algebra
def subtract(values: FloatArray, others: FloatArray) -> None:
    """Subtract one matrix from another, in place."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            values[i, j] -= others[i, j]


@algebra
def transport_top(top: FloatArray, moved: FloatArray, size: int, out: FloatArray) -> None:
    """The pose's rows of P (3, size) after its error is transported by ``moved`` (size, 3)."""
    for k in range(POSE):
        for j in range(size):
            out[k, j] = top[k, j] + top[k, 0] * moved[j, 0] + top[k, 1] * moved[j, 1] + top[k, 2] * moved[j, 2]


@algebra
def transport_rows(
    before: FloatArray, rows: FloatArray, columns: IntArray, moved: FloatArray, top: FloatArray, out: FloatArray
) -> None:
    """Some rows of P after its error is transported; ``before`` and ``top`` are the pose's rows before and after."""
    size = len(moved)
    across = np.empty((POSE, size))
    for k in range(POSE):
        for j in range(size):
            across[k, j] = moved[j, k]
    for i in range(len(columns)):
        column = columns[i]
        a, b, c = moved[column, 0], moved[column, 1], moved[column, 2]
        d, e, f = before[0, column], before[1, column], before[2, column]
        for j in range(size):
            out[i, j] = rows[i, j] + (
                a * top[0, j] + b * top[1, j] + c * top[2, j] + d * across[0, j] + e * across[1, j] + f * across[2, j]
            )


@algebra
def stack_changes(
    x: FloatArray, size: int, begins_of: tuple[int, int, int], anchors: FloatArray, num_lines: int, top: FloatArray,
    moved: FloatArray, W: FloatArray, change: FloatArray, left: FloatArray, right: FloatArray,
) -> FloatArray:  # fmt: skip
    """Finish an update: transport the error of P to where W was found, subtract W^T W, and change the state.

    Then the error is transported to the changed state. With ``moved`` M (n, 3), the pose's rows A of P, and their
    first three columns B, a transport replaces P by P + M (A + B M^T) + A^T M^T. The two transports are one by the sum
    of both M, if W is transported by the second M. So all is one product of two matrices (at least the number of rows
    of W + 6, size), which are filled: P becomes P + ``left``^T ``right``. The pose's own rows, ``top``, become what
    they are after it.

    Returns
    -------
    moved
        The last transport (size, 3).
    """
    rank, after, both = len(W), np.empty((size, POSE)), np.empty((size, POSE))
    fill_transport(x, size, begins_of, anchors, num_lines, both)
    for j in range(size):
        x[j] += change[j]
    fill_transport(x, size, begins_of, anchors, num_lines, after)
    subtract(after, both)
    for j in range(size):
        for k in range(POSE):
            both[j, k] = moved[j, k] + after[j, k]
    stack_transport(top, both, size, left, right, rank)
    for k in range(POSE):
        for j in range(size):
            top[k, j] = right[rank + k, j]
    stack_square(top, after, W, left, right)
    for r in range(rank + 2 * POSE, len(left)):
        for j in range(size):
            left[r, j] = right[r, j] = 0.0
    return after


@algebra
def stack_square(top: FloatArray, moved: FloatArray, W: FloatArray, left: FloatArray, right: FloatArray) -> None:
    """Add -W^T W, where W (m, size) is transported, to two stacks and to the pose's rows of P."""
    for r in range(len(W)):
        a, b, c = W[r, 0], W[r, 1], W[r, 2]
        for j in range(len(moved)):
            right[r, j] = W[r, j] + a * moved[j, 0] + b * moved[j, 1] + c * moved[j, 2]
            left[r, j] = -right[r, j]
        for k in range(POSE):
            for j in range(len(moved)):
                top[k, j] += left[r, k] * right[r, j]


@algebra
def stack_transport(
    top: FloatArray, moved: FloatArray, size: int, left: FloatArray, right: FloatArray, row: int
) -> None:
    """Add a transport to two stacks; the first three rows of ``right`` are the pose's new rows of P."""
    transport_top(top, moved, size, right[row : row + POSE])
    for k in range(POSE):
        for j in range(size):
            left[row + k, j] = moved[j, k]
            left[row + POSE + k, j] = top[k, j]
            right[row + POSE + k, j] = moved[j, k]


@algebra
def with_zeros(H: FloatArray, begins: IntArray, width: int) -> FloatArray:
    """H (m, width) with its zeros."""
    dense = np.zeros((len(begins), width))
    for i in range(len(begins)):
        for k in range(POSE):
            dense[i, begins[i] + k] = H[i, 1 + k]
        dense[i, width - 2], dense[i, width - 1] = H[i, 4], H[i, 5]
    return dense


@entry
def update_by_readings(
    x: FloatArray, P: FloatArray, begins_of: tuple[int, int, int], anchors: FloatArray, index: int, places: IntArray,
    readings: FloatArray, variances: FloatArray, iterations: int, huber: float,
) -> tuple[
    FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, IntArray, FloatArray, FloatArray,
    FloatArray, IntArray,
]:  # fmt: skip
    """Update a state with its whole covariance P by readings of one line, as Python calls it; x changes in place.

    Returns
    -------
    left, right
        P becomes P + ``left``^T ``right``. They are empty if no reading meets the line; then nothing has changed.
    moved, moved_again
        Transports of the error before and after ``W`` is subtracted.
    expected, jacobian, columns
        What ``predict_ranges`` fills (m, 7), and H (m, k) for these states (k,).
    factor, W, innovation
        As of :func:`iterate`.
    chosen
        Indices (m,) of the readings that are used.
    """
    first, start, size = begins_of[1] + 2 * index, begins_of[2], len(x)
    anchor = (anchors[index, 0], anchors[index, 1])
    chosen = clear_readings(x, start, places, readings, first, anchor)
    columns, begins = involved(places, chosen, (size - start) // POSE, start, first)
    moved, H, factor, W, off, change = iterate(
        x, size, begins_of, anchors, len(anchors), P[:POSE], dense_rows(P, columns), columns, begins, places, readings,
        chosen, index, gathered(variances, chosen), iterations if len(chosen) else 0, huber,
    )  # fmt: skip
    height = len(chosen) + 2 * POSE if len(chosen) else 0
    left, right = np.empty((height, size)), np.empty((height, size))
    again = moved
    if height:
        top = dense_rows(P, np.arange(POSE))
        again = stack_changes(x, size, begins_of, anchors, len(anchors), top, moved, W, change, left, right)
    return left, right, moved, again, H, with_zeros(H, begins, len(columns)), columns, factor, W, off, chosen
