"""What readings say of a line: whether they fit it, and the update by them. `clone_ekf`'s other half for kernels.

Readings come as ``places`` (n,), the places of their clones among the mind's, and ``reads`` (n, 4): the beam's origin
on the body x, y (m), its angle (rad), and its range (m).
"""

import math

import numpy as np

from limslam_agent.slam.batch.algebra import dot, factorise, solve_factored, whiten
from limslam_agent.slam.batch.clone_ekf import carried, carry_top, clones_from, correct, cov, gather_rows, size_of
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.batch.state import POSE, Filter
from limslam_env.geometry import FloatArray, IntArray

GRAZING = 0.2
_ALONG = 1e-9
_FEWEST = 4


@algebra
def expect(
    x: FloatArray, start: int, places: IntArray, reads: FloatArray, chosen: IntArray, line: tuple[float, float],
    anchor: tuple[float, float], out: FloatArray,
) -> None:  # fmt: skip
    """What `beam_model.expected_ranges` says of some beams (n, 7): range, by pose (3), by line (2), cosine.

    Clones begin at ``start`` in the state ``x``. What is called in the inner loops takes arrays, not the filter:
    each array that is handed on costs as much as a beam.
    """
    nx, ny = math.cos(line[1]), math.sin(line[1])
    for i in range(len(chosen)):
        read = chosen[i]
        at = start + POSE * places[read]
        cos, sin = math.cos(x[at + 2]), math.sin(x[at + 2])
        offset_x, offset_y = cos * reads[read, 0] - sin * reads[read, 1], sin * reads[read, 0] + cos * reads[read, 1]
        ux, uy = math.cos(x[at + 2] + reads[read, 2]), math.sin(x[at + 2] + reads[read, 2])
        from_x, from_y = x[at] + offset_x - anchor[0], x[at + 1] + offset_y - anchor[1]
        cosine = nx * ux + ny * uy
        divisor = math.copysign(max(abs(cosine), _ALONG), cosine)
        reach = (line[0] - nx * from_x - ny * from_y) / divisor
        hit_x, hit_y = from_x + reach * ux, from_y + reach * uy
        turning = (-offset_y * nx + offset_x * ny) + reach * (-uy * nx + ux * ny)
        out[i, 0] = reach
        out[i, 1], out[i, 2], out[i, 3] = -nx / divisor, -ny / divisor, -turning / divisor
        out[i, 4], out[i, 5], out[i, 6] = 1.0 / divisor, (hit_x * ny - hit_y * nx) / divisor, cosine


@algebra
def end_points(x: FloatArray, start: int, places: IntArray, reads: FloatArray, ranges: FloatArray) -> FloatArray:
    """Where beams of those ranges (n,) end in the world (n, 2), m."""
    points = np.empty((len(places), 2))
    for i in range(len(places)):
        at = start + POSE * places[i]
        cos, sin = math.cos(x[at + 2]), math.sin(x[at + 2])
        ux, uy = math.cos(x[at + 2] + reads[i, 2]), math.sin(x[at + 2] + reads[i, 2])
        points[i, 0] = x[at] + (cos * reads[i, 0] - sin * reads[i, 1]) + ranges[i] * ux
        points[i, 1] = x[at + 1] + (sin * reads[i, 0] + cos * reads[i, 1]) + ranges[i] * uy
    return points


@algebra
def expect_line(
    mind: Filter, places: IntArray, reads: FloatArray, chosen: IntArray, index: int, out: FloatArray
) -> None:
    """What some beams should measure of a line of the filter, a row of ``expect`` each."""
    row, anchors = POSE + 2 * index, mind.anchors
    expect(
        mind.x, clones_from(mind), places, reads, chosen, (mind.x[row], mind.x[row + 1]),
        (anchors[index, 0], anchors[index, 1]), out,
    )  # fmt: skip


@algebra
def clear_of(mind: Filter, places: IntArray, reads: FloatArray, index: int) -> IntArray:
    """Which readings do not graze a line."""
    chosen, size, out = np.arange(len(places)), 0, np.empty((len(places), 7))
    expect_line(mind, places, reads, chosen, index, out)
    for i in range(len(places)):
        if abs(out[i, 6]) > GRAZING and out[i, 0] > 0.0:
            chosen[size] = i
            size += 1
    return chosen[:size]


@algebra
def columns_of(mind: Filter, places: IntArray, chosen: IntArray, index: int) -> tuple[IntArray, IntArray]:
    """The numbers of the state that readings depend on: clones, then the line; and where each one's clone begins."""
    start, size = clones_from(mind), 0
    columns = np.empty(POSE * len(chosen) + 2, dtype=np.int64)
    begins, column_of = np.empty(len(chosen), dtype=np.int64), np.full(len(mind.clones), -1, dtype=np.int64)
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
def block_of(top: FloatArray, rest: FloatArray, columns: IntArray) -> FloatArray:
    """The part of P of some numbers of the state, in full."""
    size = len(columns)
    block = np.empty((size, size))
    for i in range(size):
        for j in range(i + 1):
            block[i, j] = block[j, i] = cov(top, rest, columns[i], columns[j])
    return block


@algebra
def covariance_of(block: FloatArray, begins: IntArray, H: FloatArray, variance: float) -> FloatArray:
    """H P H^T + R of readings, the lower triangle; rows of H are those of ``expect``."""
    count, size = len(begins), len(block)
    S, row = np.empty((count, count)), np.empty(size)
    # The numbers are those of clones, three each, and of a line, if there is one, two.
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
def disagreement(mind: Filter, places: IntArray, reads: FloatArray, index: int, std: float) -> tuple[float, float, int]:
    """How badly readings fit a line: by where it lies, beside that, and how many were used; 0 are too few to say."""
    chosen = clear_of(mind, places, reads, index)
    count = len(chosen)
    if count < _FEWEST:
        return 0.0, 0.0, 0
    columns, begins = columns_of(mind, places, chosen, index)
    H, values = np.empty((count, 7)), np.empty((count, 3))
    expect_line(mind, places, reads, chosen, index, H)
    S = covariance_of(block_of(mind.top, mind.rest, columns), begins, H, std**2)
    for i in range(count):
        values[i, 0] = reads[chosen[i], 3] - H[i, 0]
        values[i, 1], values[i, 2] = H[i, 4], H[i, 5]
    factorise(S, count)
    whiten(S, values, count, 3)
    a, b, c = dot(values, 1, 1, count), dot(values, 1, 2, count), dot(values, 2, 2, count)
    along, across = dot(values, 0, 1, count), dot(values, 0, 2, count)
    of_line = (c * along * along - 2.0 * b * along * across + a * across * across) / (a * c - b * b)
    return of_line, dot(values, 0, 0, count) - of_line, count


@algebra
def carry_rows(
    before: FloatArray, rows: FloatArray, columns: IntArray, moved: FloatArray, top: FloatArray, out: FloatArray
) -> None:
    """Some rows of P when all has moved (size, 3) with the robot's error; ``before`` and ``top`` are the pose's."""
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
def gained(rows: FloatArray, begins: IntArray, H: FloatArray, HP: FloatArray) -> None:
    """H P (m, size) from the rows of P that matter: those of the clones, and of the line."""
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
    """How far readings are off, as seen from where the update started."""
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
    mind: Filter, places: IntArray, reads: FloatArray, index: int, std: float, iterations: int, huber: float
) -> None:
    """Update by readings of one line, linearised anew at each iteration, as `clone_ekf.observe` does."""
    chosen, size = clear_of(mind, places, reads, index), size_of(mind)
    count = len(chosen)
    if not count:
        return
    columns, begins = columns_of(mind, places, chosen, index)
    rows, measured = gather_rows(mind.top, mind.rest, columns, size), reads[chosen, 3]
    start, moved, at_first = mind.x[:size].copy(), np.zeros((size, POSE)), np.empty((size, POSE))
    carried(mind, size, at_first)
    H, HP, shifted = np.empty((count, 7)), np.empty((count, size)), rows.copy()
    change, weights, S, top = np.zeros(size), np.ones(count), np.empty((count, count)), np.empty((POSE, size))
    solution = np.empty(count)
    for iteration in range(iterations):
        if iteration:
            mind.x[:size] += change
            carried(mind, size, moved)
            moved -= at_first
            carry_top(mind, moved, size, top)
            carry_rows(mind.top, rows, columns, moved, top, shifted)
        expect_line(mind, places, reads, chosen, index, H)
        gained(shifted, begins, H, HP)
        innovation(HP, columns, begins, H, std**2 / weights, S)
        off_from(mind.x, start, columns, begins, H, measured, solution)
        for i in range(count):
            if huber > 0.0:
                weights[i] = min(1.0, huber * std / max(abs(measured[i] - H[i, 0]), 1e-9))
        factorise(S, count)
        solve_factored(S, solution, count)
        change[:] = start - mind.x[:size]
        for i in range(count):
            for j in range(size):
                change[j] += solution[i] * HP[i, j]
    whiten(S, HP, count, size)
    correct(mind, moved, HP, count, change)
