"""Updates of the filter of poses, lines and clones by readings of one line, and how badly readings
fit a line.

The state and its covariance are those of :mod:`~limslam_agent.kernels.covariance`. Readings and
``places`` are those of
:mod:`~limslam_agent.kernels.beams`. Rows of H are stored without zeros, as ``predict_ranges``
fills them.
"""

import math

import numpy as np

from limslam_agent.kernels.algebra import dot, factorise, solve_factored, whiten
from limslam_agent.kernels.beams import line_about, predict_ranges
from limslam_agent.kernels.compilation import compiled, entry
from limslam_agent.kernels.covariance import (
    change_of_transport,
    dense_block,
    dense_rows,
    fill_transport,
    transport_pose,
    transport_rows,
)
from limslam_agent.kernels.tables import FEWEST_TO_COMPARE, GRAZING, LEAST_DIVISOR, POSE
from limslam_env.geometry import FloatArray, IntArray


@compiled
def clear_readings(
    x: FloatArray,
    start: int,
    places: IntArray,
    readings: FloatArray,
    line: int,
    anchor: tuple[float, float],
) -> IntArray:
    """Indices of the readings that meet a line ahead of the beam and do not graze it.

    The line begins in the state at the index ``line``, and has an ``anchor``, m.
    """
    chosen = np.arange(len(places))
    size = 0
    out = np.empty((len(places), 7))
    predict_ranges(
        x, start, places, readings, chosen, line_about(x[line], x[line + 1], anchor), out
    )
    for i in range(len(places)):
        if abs(out[i, 6]) > GRAZING and out[i, 0] > 0.0:
            chosen[size] = i
            size += 1
    return chosen[:size]


@compiled
def gathered(values: np.ndarray, chosen: IntArray) -> np.ndarray:
    """Some of the values."""
    found = np.empty(len(chosen), dtype=values.dtype)
    for i in range(len(chosen)):
        found[i] = values[chosen[i]]
    return found


@compiled
def involved(
    places: IntArray, chosen: IntArray, num_clones: int, start: int, line: int
) -> tuple[IntArray, IntArray]:
    """Indices in the state of all that readings depend on, and where each reading's clone begins
    among them (n,).

    The clones come first, then the line that begins at the index ``line``; no line if that is
    negative.
    """
    columns = np.empty(POSE * len(chosen) + 2, dtype=np.int64)
    size = 0
    begins = np.empty(len(chosen), dtype=np.int64)
    column_of = np.full(num_clones, -1, dtype=np.int64)
    for i in range(len(chosen)):
        place = places[chosen[i]]
        if column_of[place] < 0:
            column_of[place] = size
            for k in range(POSE):
                columns[size + k] = start + POSE * place + k
            size += POSE
        begins[i] = column_of[place]
    if line >= 0:
        columns[size] = line
        columns[size + 1] = line + 1
        size += 2
    return columns[:size], begins


@compiled
def covariance_of(
    block: FloatArray, begins: IntArray, H: FloatArray, variances: FloatArray
) -> FloatArray:
    """H P H^T + R of readings with variances (n,), the lower triangle; ``block`` is the part of P
    of ``involved``.
    """
    count = len(begins)
    size = len(block)
    S = np.empty((count, count))
    row = np.empty(size)
    # The block holds three rows for each clone, and two for the line if there is one.
    line = size - 2
    with_line = size % POSE > 0
    for i in range(count):
        at = begins[i]
        for j in range(size):
            row[j] = (
                H[i, 1] * block[at, j] + H[i, 2] * block[at + 1, j] + H[i, 3] * block[at + 2, j]
            )
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


@compiled
def since(x: FloatArray, before: FloatArray, columns: IntArray, begin: int, H: FloatArray) -> float:
    """What the change of the state since ``before`` makes of a range, by its row of H."""
    at = columns[begin]
    line = columns[-2]
    total = 0.0
    for k in range(POSE):
        total += H[1 + k] * (x[at + k] - before[at + k])
    for k in range(2):
        total += H[4 + k] * (x[line + k] - before[line + k])
    return total


@compiled
def huber_weight(residual: float, variance: float, huber: float) -> float:
    """Weight of a range: less than 1 beyond ``huber`` standard deviations, unless that is 0."""
    if huber <= 0.0:
        return 1.0
    return min(1.0, huber * math.sqrt(variance) / max(abs(residual), LEAST_DIVISOR))


@compiled
def with_zeros(H: FloatArray, begins: IntArray, width: int) -> FloatArray:
    """H (m, width) with its zeros."""
    dense = np.zeros((len(begins), width))
    for i in range(len(begins)):
        for k in range(POSE):
            dense[i, begins[i] + k] = H[i, 1 + k]
        dense[i, width - 2] = H[i, 4]
        dense[i, width - 1] = H[i, 5]
    return dense


@entry
def compare_readings(
    x: FloatArray,
    P: FloatArray,
    start: int,
    places: IntArray,
    readings: FloatArray,
    line: int,
    anchor: tuple[float, float],
    variances: FloatArray,
) -> float:
    """How badly readings fit the line that begins in the state at the index ``line``, as a
    chi-square.

    This is the generalised likelihood ratio of the hypotheses "the readings show this line" and
    "they show another line", both with the joint uncertainty of poses and line (two degrees of
    freedom). It is infinite if too few readings meet the line.
    """
    chosen = clear_readings(x, start, places, readings, line, anchor)
    count = len(chosen)
    if count < FEWEST_TO_COMPARE:
        return math.inf
    columns, begins = involved(places, chosen, (len(x) - start) // POSE, start, line)
    H = np.empty((count, 7))
    values = np.empty((count, 3))
    predict_ranges(x, start, places, readings, chosen, line_about(x[line], x[line + 1], anchor), H)
    S = covariance_of(dense_block(P, columns), begins, H, gathered(variances, chosen))
    for i in range(count):
        values[i, 0] = readings[chosen[i], 3] - H[i, 0]
        values[i, 1] = H[i, 4]
        values[i, 2] = H[i, 5]
    factorise(S, count)
    whiten(S, values, count, 3)
    a = dot(values, 1, 1, count)
    b = dot(values, 1, 2, count)
    c = dot(values, 2, 2, count)
    along = dot(values, 0, 1, count)
    across = dot(values, 0, 2, count)
    return (c * along * along - 2.0 * b * along * across + a * across * across) / (a * c - b * b)


@compiled
def set_gained(
    rows: FloatArray,
    columns: IntArray,
    begins: IntArray,
    H: FloatArray,
    variances: FloatArray,
    bend: float,
    HP: FloatArray,
    S: FloatArray,
) -> None:
    """Set H P (m, size) from those rows of P for which H is not zero, and the lower triangle of S =
    H P H^T + R. What all readings share by a curvature of their wall is a part of R.
    """
    line = len(rows) - 2
    bent = 0.5 * bend * H[:, 5] ** 2 / H[:, 4]
    for i in range(len(begins)):
        at = begins[i]
        a = H[i, 1]
        b = H[i, 2]
        c = H[i, 3]
        d = H[i, 4]
        e = H[i, 5]
        for j in range(rows.shape[1]):
            HP[i, j] = (
                a * rows[at, j]
                + b * rows[at + 1, j]
                + c * rows[at + 2, j]
                + d * rows[line, j]
                + e * rows[line + 1, j]
            )
        for m in range(i + 1):
            to = columns[line]
            place = columns[begins[m]]
            S[i, m] = (
                HP[i, place] * H[m, 1]
                + HP[i, place + 1] * H[m, 2]
                + HP[i, place + 2] * H[m, 3]
                + HP[i, to] * H[m, 4]
                + HP[i, to + 1] * H[m, 5]
                + bent[i] * bent[m]
            )
        S[i, i] += variances[i]


@compiled
def iterate(
    x: FloatArray,
    P: FloatArray,
    size: int,
    begins_of: tuple[int, int, int],
    anchors: FloatArray,
    num_lines: int,
    columns: IntArray,
    begins: IntArray,
    places: IntArray,
    readings: FloatArray,
    chosen: IntArray,
    index: int,
    variances: FloatArray,
    iterations: int,
    huber: float,
    bend: float,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Iterate an update by readings of one line, with Huber weights, linearised anew at each
    iteration.

    ``columns`` and ``begins`` are those of :func:`involved`, ``chosen`` (m,) are the readings that
    are used, with ``variances`` (m,), m^2, and ``huber`` limits the weights. The curvature of the
    wall has the standard deviation ``bend``, 1/m. x is moved to where the last iteration
    linearises.

    Returns
    -------
    moved
        The change of the error transport (size, 3) until the last iteration. P is transported by
        it.
    H, factor, W, innovation
        H (m, 7) of the last iteration, the Cholesky factor L of S, L^-1 H P (m, size), and the
        innovation (m,).
    change
        What is still to be added to the state (size,).
    """
    count = len(chosen)
    first = begins_of[1] + 2 * index
    start = begins_of[2]
    anchor = (anchors[index, 0], anchors[index, 1])
    before = x[:size].copy()
    moved = np.zeros((size, POSE))
    at_first = np.empty((size, POSE))
    pose = np.empty((POSE, size))
    fill_transport(x, size, begins_of, anchors, num_lines, at_first)
    rows = dense_rows(P, size, begins_of[0], columns)
    H = np.empty((count, 7))
    HP = np.empty((count, size))
    shifted = rows
    further = np.empty(rows.shape)
    change = np.zeros(size)
    scaled = variances.copy()
    S = np.empty((count, count))
    off = np.empty(count)
    solution = np.empty(count)
    for iteration in range(iterations):
        if iteration:
            shifted = further
            for j in range(size):
                x[j] += change[j]
            change_of_transport(x, size, begins_of, anchors, num_lines, at_first, moved)
            transport_pose(P, moved, pose)
            transport_rows(P, rows, columns, moved, pose, shifted)
        predict_ranges(
            x, start, places, readings, chosen, line_about(x[first], x[first + 1], anchor), H
        )
        set_gained(shifted, columns, begins, H, scaled, bend, HP, S)
        for i in range(count):
            residual = readings[chosen[i], 3] - H[i, 0]
            off[i] = solution[i] = residual + since(x, before, columns, begins[i], H[i])
            scaled[i] = variances[i] / huber_weight(residual, variances[i], huber)
        factorise(S, count)
        solve_factored(S, solution, count)
        for j in range(size):
            change[j] = before[j] - x[j]
        for i in range(count):
            for j in range(size):
                change[j] += solution[i] * HP[i, j]
    whiten(S, HP, count, size)
    return moved, H, S, HP, off, change


@entry
def update_by_readings(
    x: FloatArray,
    P: FloatArray,
    size: int,
    begins_of: tuple[int, int, int],
    anchors: FloatArray,
    num_lines: int,
    index: int,
    places: IntArray,
    readings: FloatArray,
    variances: FloatArray,
    iterations: int,
    huber: float,
    bend: float,
) -> tuple[
    FloatArray,
    FloatArray,
    FloatArray,
    FloatArray,
    IntArray,
    FloatArray,
    FloatArray,
    FloatArray,
    IntArray,
]:
    """Find an update by readings of one line, for ``correct_state`` to finish; there is none if
    none meets the line.

    Returned are ``moved`` and ``change`` of :func:`iterate`, what ``predict_ranges`` fills (m, 7),
    H (m, k) for states (k,) and these states, factor, W and innovation of :func:`iterate`, and the
    indices (m,) of the readings that are used.
    """
    line = begins_of[1] + 2 * index
    start = begins_of[2]
    chosen = clear_readings(
        x, start, places, readings, line, (anchors[index, 0], anchors[index, 1])
    )
    columns, begins = involved(places, chosen, (len(x) - start) // POSE, start, line)
    moved, H, factor, W, off, change = iterate(
        x,
        P,
        size,
        begins_of,
        anchors,
        num_lines,
        columns,
        begins,
        places,
        readings,
        chosen,
        index,
        gathered(variances, chosen),
        iterations if len(chosen) else 0,
        huber,
        bend,
    )
    return moved, change, H, with_zeros(H, begins, len(columns)), columns, factor, W, off, chosen
