"""The filter of one robot in fixed arrays: compiled counterpart of ``consistent.clone_ekf``.

Letters x, P, F, Q, H, S, W are those of the literature. :class:`~limslam_agent.slam.batch.state.Filter` says how P is
stored. Functions that inner loops call take arrays instead of the filter, because each array of a tuple that is passed
on costs as much time as a beam.
"""

import math

import numpy as np

from limslam_agent.slam.batch.algebra import (
    add_products,
    block_of,
    dot,
    factorise,
    gather_rows,
    solve_factored,
    whiten,
    wrapped,
)
from limslam_agent.slam.batch.beam_model import expected_ranges
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.batch.state import CLONES, LINES, NEXT_CLONE, Filter
from limslam_agent.slam.consistent.beam_model import GRAZING
from limslam_agent.slam.consistent.clone_ekf import EQUALITY_NOISE, FEWEST_TO_COMPARE, LEAST_RESIDUAL, LINE_PRIOR
from limslam_agent.slam.core import carried_anchors
from limslam_agent.slam.core.carried_anchors import KNOWN_PLACE
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE
from limslam_env.geometry import FloatArray, IntArray

_by_carried_anchor = algebra(carried_anchors.by_carried_anchor)


@algebra
def clones_from(ekf: Filter) -> int:
    """Index in the state at which the clones begin."""
    return POSE + 2 * ekf.counts[LINES]


@algebra
def size_of(ekf: Filter) -> int:
    """Length of the state."""
    return POSE + 2 * ekf.counts[LINES] + POSE * ekf.counts[CLONES]


@algebra
def predict(ekf: Filter, increment: FloatArray, covariance: FloatArray) -> None:
    """Move the robot by an increment (3,) in its frame, m, m, rad, with its covariance (3, 3)."""
    x, top, size = ekf.x, ekf.top, size_of(ekf)
    cos, sin = math.cos(x[2]), math.sin(x[2])
    by_x, by_y = -sin * increment[0] - cos * increment[1], cos * increment[0] - sin * increment[1]
    x[0] += cos * increment[0] - sin * increment[1]
    x[1] += sin * increment[0] + cos * increment[1]
    x[2] = wrapped(x[2] + increment[2])
    for j in range(size):
        top[0, j] += by_x * top[2, j]
        top[1, j] += by_y * top[2, j]
    turned = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    for i in range(POSE):
        top[i, 0] += by_x * top[i, 2]
        top[i, 1] += by_y * top[i, 2]
    for i in range(POSE):
        for j in range(POSE):
            for k in range(POSE):
                for m in range(POSE):
                    top[i, j] += turned[i, k] * covariance[k, m] * turned[j, m]


@algebra
def clone(ekf: Filter) -> int:
    """Add a copy of the pose to the state, which must have room for it, and return the copy's number."""
    x, top, rest, old = ekf.x, ekf.top, ekf.rest, size_of(ekf)
    for k in range(POSE):
        base = (old + k) * (old + k + 1) // 2
        for j in range(old):
            rest[base + j] = top[k, j]
        for m in range(k + 1):
            rest[base + old + m] = top[k, m]
        x[old + k] = x[k]
    for k in range(POSE):
        for m in range(POSE):
            top[k, old + m] = top[k, m]
    number = ekf.counts[NEXT_CLONE]
    ekf.clones[ekf.counts[CLONES]] = number
    ekf.counts[CLONES] += 1
    ekf.counts[NEXT_CLONE] += 1
    return number


@algebra
def keep(ekf: Filter, kept: IntArray, size: int) -> None:
    """Marginalise all of the state but ``size`` places of it, in order. The caller updates the counts."""
    x, top, rest = ekf.x, ekf.top, ekf.rest
    for new in range(size):
        old = kept[new]
        if old == new:
            continue
        x[new] = x[old]
        for k in range(POSE):
            top[k, new] = top[k, old]
        base, before = new * (new + 1) // 2, old * (old + 1) // 2
        for j in range(POSE, new + 1):
            rest[base + j] = rest[before + kept[j]]


@algebra
def keep_clones(ekf: Filter, wanted: np.ndarray) -> None:
    """Marginalise the clones that are not ``wanted`` (n,). What they contributed to other states remains."""
    start, number, size = clones_from(ekf), ekf.counts[CLONES], 0
    kept = np.empty(size_of(ekf), dtype=np.int64)
    for place in range(start):
        kept[place] = place
    for place in range(number):
        if wanted[place]:
            ekf.clones[size] = ekf.clones[place]
            for k in range(POSE):
                kept[start + POSE * size + k] = start + POSE * place + k
            size += 1
    if size < number:
        keep(ekf, kept, start + POSE * size)
        ekf.counts[CLONES] = size


@algebra
def add_line(ekf: Filter, theta: float, anchor_x: float, anchor_y: float) -> int:
    """Add a line with an uninformative prior, for which there must be room, and return its index.

    It goes through its anchor, m, with its normal at ``theta``, rad.
    """
    x, top, rest, at, old = ekf.x, ekf.top, ekf.rest, clones_from(ekf), size_of(ekf)
    for i in range(old - 1, at - 1, -1):
        x[i + 2] = x[i]
        for k in range(POSE):
            top[k, i + 2] = top[k, i]
        base, before = (i + 2) * (i + 3) // 2, i * (i + 1) // 2
        for j in range(i, at - 1, -1):
            rest[base + j + 2] = rest[before + j]
        rest[base + at], rest[base + at + 1] = 0.0, 0.0
        for j in range(at - 1, POSE - 1, -1):
            rest[base + j] = rest[before + j]
    for i in range(2):
        base = (at + i) * (at + i + 1) // 2
        rest[base : base + at + i] = 0.0
        rest[base + at + i] = LINE_PRIOR[i]
        top[:, at + i] = 0.0
    x[at], x[at + 1] = 0.0, theta
    index = ekf.counts[LINES]
    ekf.anchors[index, 0], ekf.anchors[index, 1] = anchor_x, anchor_y
    ekf.counts[LINES] += 1
    return index


@algebra
def expected(
    ekf: Filter, places: IntArray, readings: FloatArray, chosen: IntArray, index: int, out: FloatArray
) -> None:
    """Predicted ranges of some beams that meet a line of the filter: the rows of ``expected_ranges``."""
    row, anchors = POSE + 2 * index, ekf.anchors
    expected_ranges(
        ekf.x, clones_from(ekf), places, readings, chosen, (ekf.x[row], ekf.x[row + 1]),
        (anchors[index, 0], anchors[index, 1]), out,
    )  # fmt: skip


@algebra
def clear_readings(ekf: Filter, places: IntArray, readings: FloatArray, index: int) -> IntArray:
    """Indices of the readings that meet a line ahead of the beam and do not graze it."""
    chosen, size, out = np.arange(len(places)), 0, np.empty((len(places), 7))
    expected(ekf, places, readings, chosen, index, out)
    for i in range(len(places)):
        if abs(out[i, 6]) > GRAZING and out[i, 0] > 0.0:
            chosen[size] = i
            size += 1
    return chosen[:size]


@algebra
def involved(ekf: Filter, places: IntArray, chosen: IntArray, index: int) -> tuple[IntArray, IntArray]:
    """Indices in the state of all that readings depend on, and where each reading's clone begins among them (n,).

    The clones come first, then the line ``index``; no line if that is negative.
    """
    start, size = clones_from(ekf), 0
    columns = np.empty(POSE * len(chosen) + 2, dtype=np.int64)
    begins, column_of = np.empty(len(chosen), dtype=np.int64), np.full(len(ekf.clones), -1, dtype=np.int64)
    for i in range(len(chosen)):
        place = places[chosen[i]]
        if column_of[place] < 0:
            column_of[place] = size
            for k in range(POSE):
                columns[size + k] = start + POSE * place + k
            size += POSE
        begins[i] = column_of[place]
    if index >= 0:
        columns[size], columns[size + 1] = POSE + 2 * index, POSE + 2 * index + 1
        size += 2
    return columns[:size], begins


@algebra
def covariance_of(block: FloatArray, begins: IntArray, H: FloatArray, variance: float) -> FloatArray:
    """H P H^T + R of readings, the lower triangle; the rows of H are those of ``expected_ranges``.

    ``block`` is the part of P that ``involved`` names.
    """
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
        S[i, i] += variance
    return S


@algebra
def disagreement(
    ekf: Filter, places: IntArray, readings: FloatArray, index: int, std: float
) -> tuple[float, float, int, float, float]:
    """The fields of ``consistent.Disagreement``; no readings were used if too few of them can be compared."""
    chosen = clear_readings(ekf, places, readings, index)
    count = len(chosen)
    if count < FEWEST_TO_COMPARE:
        return 0.0, 0.0, 0, 0.0, 0.0
    columns, begins = involved(ekf, places, chosen, index)
    H, values = np.empty((count, 7)), np.empty((count, 3))
    expected(ekf, places, readings, chosen, index, H)
    S = covariance_of(block_of(ekf.top, ekf.rest, columns), begins, H, std**2)
    for i in range(count):
        values[i, 0] = readings[chosen[i], 3] - H[i, 0]
        values[i, 1], values[i, 2] = H[i, 4], H[i, 5]
    factorise(S, count)
    whiten(S, values, count, 3)
    a, b, c = dot(values, 1, 1, count), dot(values, 1, 2, count), dot(values, 2, 2, count)
    along, across = dot(values, 0, 1, count), dot(values, 0, 2, count)
    of_line = (c * along * along - 2.0 * b * along * across + a * across * across) / (a * c - b * b)
    return of_line, dot(values, 0, 0, count) - of_line, count, along / a, 1.0 / a


@algebra
def side_of(ekf: Filter, places: IntArray, readings: FloatArray, index: int) -> int:
    """From which side readings hit a line: ``POSITIVE`` or ``NEGATIVE``."""
    total, start, theta = 0.0, clones_from(ekf), ekf.x[POSE + 2 * index + 1]
    for i in range(len(places)):
        total += math.cos(ekf.x[start + POSE * places[i] + 2] + readings[i, 2] - theta)
    return POSITIVE if total < 0.0 else NEGATIVE


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
def off_from(
    x: FloatArray, start: FloatArray, columns: IntArray, begins: IntArray, H: FloatArray, measured: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """Residuals relative to the state ``start`` at which the update began."""
    line = columns[-2]
    for i in range(len(begins)):
        at = columns[begins[i]]
        out[i] = measured[i] - H[i, 0]
        for k in range(POSE):
            out[i] += H[i, 1 + k] * (x[at + k] - start[at + k])
        for k in range(2):
            out[i] += H[i, 4 + k] * (x[line + k] - start[line + k])


@algebra
def observe(
    ekf: Filter, places: IntArray, readings: FloatArray, index: int, std: float, iterations: int, huber: float
) -> None:
    """Update by readings of one line: the iterated EKF with Huber weights, linearised anew at each iteration."""
    chosen, size = clear_readings(ekf, places, readings, index), size_of(ekf)
    count = len(chosen)
    if not count:
        return
    columns, begins = involved(ekf, places, chosen, index)
    rows, measured = gather_rows(ekf.top, ekf.rest, columns, size), readings[chosen, 3]
    start, moved, at_first = ekf.x[:size].copy(), np.zeros((size, POSE)), np.empty((size, POSE))
    error_transport(ekf, size, at_first)
    H, HP, shifted = np.empty((count, 7)), np.empty((count, size)), rows.copy()
    change, weights, S, top = np.zeros(size), np.ones(count), np.empty((count, count)), np.empty((POSE, size))
    solution = np.empty(count)
    for iteration in range(iterations):
        if iteration:
            ekf.x[:size] += change
            error_transport(ekf, size, moved)
            moved -= at_first
            transported_top(ekf, moved, size, top)
            transported_rows(ekf.top, rows, columns, moved, top, shifted)
        expected(ekf, places, readings, chosen, index, H)
        gained(shifted, begins, H, HP)
        innovation(HP, columns, begins, H, std**2 / weights, S)
        off_from(ekf.x, start, columns, begins, H, measured, solution)
        for i in range(count):
            if huber > 0.0:
                weights[i] = min(1.0, huber * std / max(abs(measured[i] - H[i, 0]), LEAST_RESIDUAL))
        factorise(S, count)
        solve_factored(S, solution, count)
        change[:] = start - ekf.x[:size]
        for i in range(count):
            for j in range(size):
                change[j] += solution[i] * HP[i, j]
    whiten(S, HP, count, size)
    correct(ekf, moved, HP, count, change)


@algebra
def difference(ekf: Filter, older: int, younger: int) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Difference (2,) of two lines about the younger's anchor, m and rad, with H (2, n), its columns, and H P H^T."""
    a, b = POSE + 2 * older, POSE + 2 * younger
    between_x = ekf.anchors[younger, 0] - ekf.anchors[older, 0]
    between_y = ekf.anchors[younger, 1] - ekf.anchors[older, 1]
    cos, sin = math.cos(ekf.x[a + 1]), math.sin(ekf.x[a + 1])
    turned = math.cos(ekf.x[a + 1] - ekf.x[b + 1]) < 0.0
    sign = -1.0 if turned else 1.0
    off = np.array([
        sign * (ekf.x[a] - between_x * cos - between_y * sin) - ekf.x[b],
        wrapped(ekf.x[a + 1] - ekf.x[b + 1] + (math.pi if turned else 0.0)),
    ])  # fmt: skip
    H = np.array([[sign, sign * (between_x * sin - between_y * cos), -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    columns = np.array([a, a + 1, b, b + 1])
    x, y = ekf.anchors[younger, 0] - ekf.x[0], ekf.anchors[younger, 1] - ekf.x[1]
    by_pose = np.array(_by_carried_anchor(x, y, ekf.x[a + 1], ekf.x[b + 1], sign))
    if by_pose @ np.ascontiguousarray(ekf.top[:POSE, :POSE]) @ by_pose >= KNOWN_PLACE:
        H = np.concatenate((np.stack((by_pose, np.zeros(POSE))), H), axis=1)
        columns = np.concatenate((np.arange(POSE), columns))
    S = H @ block_of(ekf.top, ekf.rest, columns) @ H.T
    return off, H, columns, S


@algebra
def merge(ekf: Filter, younger: int, H: FloatArray, columns: IntArray, S: FloatArray, off: FloatArray) -> None:
    """Merge two lines: update by the constraint that they are equal, and marginalise the younger one.

    The other arguments are those that :func:`difference` returns.
    """
    size = size_of(ekf)
    first_line = len(columns) - 4
    HP = np.ascontiguousarray(H[:, first_line:]) @ gather_rows(ekf.top, ekf.rest, columns[first_line:], size)
    if first_line:
        HP += np.ascontiguousarray(H[:, :POSE]) @ np.ascontiguousarray(ekf.top[:, :size])
    change = np.empty(size)
    # With S = L L^T and W = L^-1 H P, the gain's correction is W^T L^-1 y.
    first = math.sqrt(S[0, 0] + EQUALITY_NOISE[0])
    beside = S[1, 0] / first
    second = math.sqrt(S[1, 1] + EQUALITY_NOISE[1] - beside * beside)
    y = -off[0] / first
    z = (-off[1] - beside * y) / second
    for j in range(size):
        HP[0, j] /= first
        HP[1, j] = (HP[1, j] - beside * HP[0, j]) / second
        change[j] = y * HP[0, j] + z * HP[1, j]
    correct(ekf, np.zeros((size, POSE)), HP, 2, change)
    remove_line(ekf, younger)


@algebra
def remove_line(ekf: Filter, index: int) -> None:
    """Marginalise a line."""
    size, row = size_of(ekf), POSE + 2 * index
    kept = np.empty(size - 2, dtype=np.int64)
    for new in range(size - 2):
        kept[new] = new if new < row else new + 2
    keep(ekf, kept, size - 2)
    for place in range(index, ekf.counts[LINES] - 1):
        ekf.anchors[place] = ekf.anchors[place + 1]
    ekf.counts[LINES] -= 1


@algebra
def error_transport(ekf: Filter, size: int, out: FloatArray) -> None:
    """Derivative (size, 3) of the state by the robot's pose when robot and world move together rigidly."""
    x, start = ekf.x, clones_from(ekf)
    out[:size] = 0.0
    for k in range(POSE):
        out[k, k] = 1.0
    for index in range(ekf.counts[LINES]):
        row = POSE + 2 * index
        cos, sin = math.cos(x[row + 1]), math.sin(x[row + 1])
        out[row, 0], out[row, 1] = cos, sin
        out[row, 2] = cos * (x[1] - ekf.anchors[index, 1]) - sin * (x[0] - ekf.anchors[index, 0])
        out[row + 1, 2] = 1.0
    for row in range(start, size, POSE):
        for k in range(POSE):
            out[row + k, k] = 1.0
        out[row, 2], out[row + 1, 2] = x[1] - x[row + 1], x[row] - x[0]


@algebra
def transported_top(ekf: Filter, moved: FloatArray, size: int, out: FloatArray) -> None:
    """The pose's rows of P (3, size) after its error is transported by ``moved`` (size, 3)."""
    top = ekf.top
    for k in range(POSE):
        for j in range(size):
            out[k, j] = top[k, j] + top[k, 0] * moved[j, 0] + top[k, 1] * moved[j, 1] + top[k, 2] * moved[j, 2]


@algebra
def transported_rows(
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
def correct(ekf: Filter, moved: FloatArray, W: FloatArray, rank: int, change: FloatArray) -> None:
    """Finish an update: transport the error of P to where W was found, subtract W^T W, and change the state.

    Then the error is transported to the changed state. With ``moved`` M (n, 3), the pose's rows A of P, and their
    first three columns B, a transport replaces P by P + M (A + B M^T) + A^T M^T. All is done in one pass over P.
    """
    size = size_of(ekf)
    height = (rank + 4 * POSE + 3) // 4 * 4
    left, right = np.zeros((height, size)), np.zeros((height, size))
    stack_transport(ekf, moved, size, left, right, rank)
    for k in range(POSE):
        for j in range(size):
            total = right[rank + k, j]
            for r in range(rank):
                total -= W[r, k] * W[r, j]
            ekf.top[k, j] = total
    left[:rank], right[:rank] = -W[:rank, :size], W[:rank, :size]
    before, after = np.empty((size, POSE)), np.empty((size, POSE))
    error_transport(ekf, size, before)
    for j in range(size):
        ekf.x[j] += change[j]
    error_transport(ekf, size, after)
    stack_transport(ekf, after - before, size, left, right, rank + 2 * POSE)
    for k in range(POSE):
        ekf.top[k, :size] = right[rank + 2 * POSE + k]
    add_products(ekf.rest, left, right, height, POSE, size)
    ekf.x[2] = wrapped(ekf.x[2])


@algebra
def stack_transport(ekf: Filter, moved: FloatArray, size: int, left: FloatArray, right: FloatArray, row: int) -> None:
    """Factors of a transport for ``add_products``; the first three rows of ``right`` are the pose's new rows of P."""
    transported_top(ekf, moved, size, right[row : row + POSE])
    for k in range(POSE):
        for j in range(size):
            left[row + k, j] = moved[j, k]
            left[row + POSE + k, j] = ekf.top[k, j]
            right[row + POSE + k, j] = moved[j, k]
