"""What readings say of a line: whether they fit it, and the update by them. `clone_ekf`'s other half for kernels.

Readings come as ``places`` (n,), the places of their clones among the mind's, and ``reads`` (n, 4): the beam's origin
on the body x, y (m), its angle (rad), and its range (m).
"""

import math

import numpy as np

from limslam_agent.batch_algebra import dot, factorise, solve_factored, whiten
from limslam_agent.batch_compile import algebra
from limslam_agent.batch_filter import carried, carry_top, clones_from, correct, cov, gather_row, size_of
from limslam_agent.batch_state import POSE, Minds
from limslam_env.geometry import FloatArray, IntArray

GRAZING = 0.2
_ALONG = 1e-9
_FEWEST = 4


@algebra
def expect(pose: FloatArray, read: FloatArray, line: FloatArray, anchor: FloatArray, out: FloatArray) -> None:
    """What `beam_model.expected_ranges` says of one beam, (7,): range, by pose (3), by line (2), cosine."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    offset_x, offset_y = cos * read[0] - sin * read[1], sin * read[0] + cos * read[1]
    ux, uy = math.cos(pose[2] + read[2]), math.sin(pose[2] + read[2])
    from_x, from_y = pose[0] + offset_x - anchor[0], pose[1] + offset_y - anchor[1]
    nx, ny = math.cos(line[1]), math.sin(line[1])
    cosine = nx * ux + ny * uy
    divisor = math.copysign(max(abs(cosine), _ALONG), cosine)
    reach = (line[0] - nx * from_x - ny * from_y) / divisor
    hit_x, hit_y = from_x + reach * ux, from_y + reach * uy
    turning = (-offset_y * nx + offset_x * ny) + reach * (-uy * nx + ux * ny)
    out[0] = reach
    out[1], out[2], out[3] = -nx / divisor, -ny / divisor, -turning / divisor
    out[4], out[5], out[6] = 1.0 / divisor, (hit_x * ny - hit_y * nx) / divisor, cosine


@algebra
def ends_at(pose: FloatArray, read: FloatArray, reach: float) -> tuple[float, float]:
    """Where a beam of that length ends in the world, m."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x = pose[0] + (cos * read[0] - sin * read[1]) + reach * math.cos(pose[2] + read[2])
    y = pose[1] + (sin * read[0] + cos * read[1]) + reach * math.sin(pose[2] + read[2])
    return x, y


@algebra
def clear_of(mind: Minds, places: IntArray, reads: FloatArray, index: int) -> IntArray:
    """Which readings do not graze a line."""
    start, row, size = clones_from(mind), POSE + 2 * index, 0
    chosen, out = np.empty(len(places), dtype=np.int64), np.empty(7)
    for i in range(len(places)):
        at = start + POSE * places[i]
        expect(mind.x[at : at + POSE], reads[i], mind.x[row : row + 2], mind.anchors[index], out)
        if abs(out[6]) > GRAZING and out[0] > 0.0:
            chosen[size] = i
            size += 1
    return chosen[:size]


@algebra
def expect_all(
    mind: Minds, places: IntArray, reads: FloatArray, chosen: IntArray, index: int, out: FloatArray
) -> None:
    """What some beams should measure, a row of ``expect`` each."""
    start, row = clones_from(mind), POSE + 2 * index
    for i in range(len(chosen)):
        at = start + POSE * places[chosen[i]]
        expect(mind.x[at : at + POSE], reads[chosen[i]], mind.x[row : row + 2], mind.anchors[index], out[i])


@algebra
def columns_of(mind: Minds, places: IntArray, chosen: IntArray, index: int) -> tuple[IntArray, IntArray]:
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
def block_of(mind: Minds, columns: IntArray) -> FloatArray:
    """The part of P of some numbers of the state, in full."""
    size = len(columns)
    block = np.empty((size, size))
    for i in range(size):
        for j in range(i + 1):
            block[i, j] = block[j, i] = cov(mind, columns[i], columns[j])
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
def disagreement(
    mind: Minds, places: IntArray, reads: FloatArray, index: int, std: float
) -> tuple[float, float, int]:
    """How badly readings fit a line: by where it lies, beside that, and how many were used; 0 are too few to say."""
    chosen = clear_of(mind, places, reads, index)
    count = len(chosen)
    if count < _FEWEST:
        return 0.0, 0.0, 0
    columns, begins = columns_of(mind, places, chosen, index)
    H, values = np.empty((count, 7)), np.empty((count, 3))
    expect_all(mind, places, reads, chosen, index, H)
    S = covariance_of(block_of(mind, columns), begins, H, std**2)
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
    mind: Minds, rows: FloatArray, columns: IntArray, moved: FloatArray, top: FloatArray, out: FloatArray
) -> None:
    """Some rows of P when all has moved (size, 3) with the robot's error; ``top`` are the pose's rows then."""
    size = len(moved)
    across = np.empty((POSE, size))
    for k in range(POSE):
        for j in range(size):
            across[k, j] = moved[j, k]
    for i in range(len(columns)):
        column = columns[i]
        a, b, c = moved[column, 0], moved[column, 1], moved[column, 2]
        d, e, f = mind.top[0, column], mind.top[1, column], mind.top[2, column]
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
    mind: Minds, start: FloatArray, columns: IntArray, begins: IntArray, H: FloatArray, measured: FloatArray,
    out: FloatArray,
) -> None:  # fmt: skip
    """How far readings are off, as seen from where the update started."""
    line = columns[-2]
    for i in range(len(begins)):
        at = columns[begins[i]]
        out[i] = measured[i] - H[i, 0]
        for k in range(POSE):
            out[i] += H[i, 1 + k] * (mind.x[at + k] - start[at + k])
        for k in range(2):
            out[i] += H[i, 4 + k] * (mind.x[line + k] - start[line + k])


@algebra
def observe(
    mind: Minds, places: IntArray, reads: FloatArray, index: int, std: float, iterations: int, huber: float
) -> None:
    """Update by readings of one line, linearised anew at each iteration, as `clone_ekf.observe` does."""
    chosen, size = clear_of(mind, places, reads, index), size_of(mind)
    count = len(chosen)
    if not count:
        return
    columns, begins = columns_of(mind, places, chosen, index)
    rows, measured = np.empty((len(columns), size)), reads[chosen, 3]
    for i in range(len(columns)):
        gather_row(mind, columns[i], size, rows[i])
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
            carry_rows(mind, rows, columns, moved, top, shifted)
        expect_all(mind, places, reads, chosen, index, H)
        gained(shifted, begins, H, HP)
        innovation(HP, columns, begins, H, std**2 / weights, S)
        off_from(mind, start, columns, begins, H, measured, solution)
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
