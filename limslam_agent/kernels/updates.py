"""Updates of the filter of poses, lines and clones by readings of one line, and how badly readings
fit a line.

The filter is that of :mod:`~limslam_agent.kernels.covariance`. Rows of H are stored without zeros,
as ``predict_ranges`` fills them.
"""

import math

import numpy as np

from limslam_agent.kernels import tables
from limslam_agent.kernels.algebra import dot, factorise, solve_factored, whiten
from limslam_agent.kernels.beams import line_about, predict_ranges
from limslam_agent.kernels.compilation import compiled, entry
from limslam_agent.kernels.covariance import (
    clones_from,
    dense_block,
    dense_rows,
    error_transport,
    line_at,
    moved_since,
    size_of,
    transport_rows,
)
from limslam_agent.kernels.tables import (
    CLONES,
    FEWEST_TO_COMPARE,
    GRAZING,
    LEAST_DIVISOR,
    POSE,
    Filter,
    Readings,
    Update,
)
from limslam_env.geometry import FloatArray, IntArray

select = compiled(tables.select)


@compiled
def expected_of(ekf: Filter, readings: Readings, index: int) -> FloatArray:
    """What ``predict_ranges`` fills (n, 7) for readings of a line of the filter."""
    at = line_at(ekf.counts, index)
    out = np.empty((len(readings.places), 7))
    predict_ranges(
        ekf.x,
        clones_from(ekf.counts),
        readings.places,
        readings.rows,
        np.arange(len(readings.places)),
        line_about(ekf.x[at], ekf.x[at + 1], (ekf.anchors[index, 0], ekf.anchors[index, 1])),
        out,
    )
    return out


@compiled
def clear_readings(ekf: Filter, readings: Readings, index: int) -> Readings:
    """The readings that meet a line ahead of the beam and do not graze it."""
    out = expected_of(ekf, readings, index)
    clear = np.empty(len(out), dtype=np.int64)
    count = 0
    for i in range(len(out)):
        if abs(out[i, 6]) > GRAZING and out[i, 0] > 0.0:
            clear[count] = i
            count += 1
    return select(readings, clear[:count])


@compiled
def involved(ekf: Filter, places: IntArray, line: int) -> tuple[IntArray, IntArray]:
    """Indices in the state of all that readings depend on, and where each reading's clone begins
    among them (n,).

    The clones come first, then the line that begins at the index ``line``; no line if that is
    negative.
    """
    start = clones_from(ekf.counts)
    columns = np.empty(POSE * len(places) + 2, dtype=np.int64)
    size = 0
    begins = np.empty(len(places), dtype=np.int64)
    column_of = np.full(ekf.counts[CLONES], -1)
    for i in range(len(places)):
        place = places[i]
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
def compare_readings(ekf: Filter, readings: Readings, index: int) -> float:
    """How badly readings fit a line, as a chi-square.

    This is the generalised likelihood ratio of the hypotheses "the readings show this line" and
    "they show another line", both with the joint uncertainty of poses and line (two degrees of
    freedom). It is infinite if too few readings meet the line.
    """
    clear = clear_readings(ekf, readings, index)
    count = len(clear.places)
    if count < FEWEST_TO_COMPARE:
        return math.inf
    columns, begins = involved(ekf, clear.places, line_at(ekf.counts, index))
    H = expected_of(ekf, clear, index)
    values = np.empty((count, 3))
    S = covariance_of(dense_block(ekf.P, columns), begins, H, clear.variances)
    for i in range(count):
        values[i, 0] = clear.rows[i, 3] - H[i, 0]
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
def gained(
    rows: FloatArray, columns: IntArray, begins: IntArray, H: FloatArray, bend: float
) -> tuple[FloatArray, FloatArray]:
    """H P (m, s), from those rows of P for which H is not zero, and the lower triangle of H P H^T.

    What all readings share by a curvature of their wall is added to the latter.
    """
    count = len(begins)
    HP = np.empty((count, rows.shape[1]))
    S = np.empty((count, count))
    line = len(rows) - 2
    bent = np.empty(count)
    for i in range(count):
        bent[i] = 0.5 * bend * H[i, 5] ** 2 / H[i, 4]
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
    return HP, S


@entry
def update_by_readings(
    ekf: Filter, readings: Readings, index: int, iterations: int, huber: float
) -> tuple[Update, Readings, FloatArray]:
    """Iterate an update by readings of one line, with Huber weights, linearised anew at each
    iteration.

    The filter's state is moved to where the last iteration linearises, for ``correct_state`` to
    finish the update. ``huber`` limits the weights.

    Returns
    -------
    update, used, expected
        The update, the m readings that meet the line, and what ``predict_ranges`` has filled (m, 7)
        for them at last. If m is 0, there is nothing to update.
    """
    x = ekf.x
    size = size_of(ekf.counts)
    used = clear_readings(ekf, readings, index)
    count = len(used.places)
    columns, begins = involved(ekf, used.places, line_at(ekf.counts, index))
    before = np.empty(size)
    for j in range(size):
        before[j] = x[j]
    at_first = error_transport(ekf)
    moved = np.zeros((size, POSE))
    rows = dense_rows(ekf, columns)
    shifted = rows
    H = np.empty((count, 7))
    HP = np.empty((count, size))
    S = np.empty((count, count))
    change = np.zeros(size)
    scaled = used.variances.copy()
    off = np.empty(count)
    for iteration in range(iterations if count else 0):
        if iteration:
            shifted = np.empty(rows.shape)
            for j in range(size):
                x[j] += change[j]
            moved = moved_since(ekf, at_first)
            transport_rows(ekf.P, rows, columns, moved, shifted)
        H = expected_of(ekf, used, index)
        HP, S = gained(shifted, columns, begins, H, ekf.bend)
        for i in range(count):
            S[i, i] += scaled[i]
            residual = used.rows[i, 3] - H[i, 0]
            off[i] = residual + since(x, before, columns, begins[i], H[i])
            scaled[i] = used.variances[i] / huber_weight(residual, used.variances[i], huber)
        factorise(S, count)
        solution = off.copy()
        solve_factored(S, solution, count)
        for j in range(size):
            change[j] = before[j] - x[j]
        for i in range(count):
            for j in range(size):
                change[j] += solution[i] * HP[i, j]
    whiten(S, HP, count, size)
    dense = with_zeros(H, begins, len(columns))
    return Update(columns, dense, off, S, HP, moved, change), used, H


@entry
def linear_update(
    ekf: Filter,
    columns: IntArray,
    H: FloatArray,
    innovation: FloatArray,
    noise: FloatArray,
    moved: FloatArray,
) -> Update:
    """An update by m measurements with the derivative H (m, k) by some states (k,), an innovation
    (m,) and the covariance ``noise`` (m, m), for ``correct_state`` to finish.

    ``moved`` is that of the update.
    """
    count = len(innovation)
    rows = dense_rows(ekf, columns)
    shifted = np.empty(rows.shape)
    transport_rows(ekf.P, rows, columns, moved, shifted)
    W = H @ shifted
    factor = W[:, columns] @ H.T + noise
    factorise(factor, count)
    whiten(factor, W, count, W.shape[1])
    whitened = innovation.copy().reshape(count, 1)
    whiten(factor, whitened, count, 1)
    return Update(columns, H, innovation, factor, W, moved, whitened[:, 0].copy() @ W)
