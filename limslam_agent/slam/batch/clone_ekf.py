"""The filter with clones of one robot, in fixed arrays: `clone_ekf` once more, for kernels.

Letters x, P, F, Q, H, S, W are the literature's. What P is kept as says ``Filter``.
"""

import math

import numpy as np

from limslam_agent.slam.batch.algebra import add_products, wrapped
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.batch.state import CLONES, LINES, NEXT_CLONE, POSE, Filter
from limslam_env.geometry import FloatArray, IntArray

_PRIOR = (10.0**2, 3.0**2)


@algebra
def clones_from(mind: Filter) -> int:
    """The first number of the state that belongs to a clone."""
    return POSE + 2 * mind.counts[LINES]


@algebra
def size_of(mind: Filter) -> int:
    """How many numbers the state has."""
    return POSE + 2 * mind.counts[LINES] + POSE * mind.counts[CLONES]


@algebra
def cov(top: FloatArray, rest: FloatArray, i: int, j: int) -> float:
    """One number of P."""
    if i < j:
        i, j = j, i
    return top[j, i] if j < POSE else rest[i * (i + 1) // 2 + j]


@algebra
def gather_rows(top: FloatArray, rest: FloatArray, columns: IntArray, size: int) -> FloatArray:
    """Some rows of P, none of them the pose's, in full."""
    rows = np.empty((len(columns), size))
    for i in range(len(columns)):
        column = columns[i]
        base = column * (column + 1) // 2
        for j in range(POSE):
            rows[i, j] = top[j, column]
        for j in range(POSE, column + 1):
            rows[i, j] = rest[base + j]
        base += column
        for j in range(column + 1, size):
            base += j
            rows[i, j] = rest[base]
    return rows


@algebra
def predict(mind: Filter, increment: FloatArray, covariance: FloatArray) -> None:
    """Move the robot by an increment (3,) in its frame, with its covariance (3, 3)."""
    x, top, size = mind.x, mind.top, size_of(mind)
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
def clone(mind: Filter) -> int:
    """Keep a copy of the pose, for which there is room, and give back the copy's number."""
    x, top, rest, old = mind.x, mind.top, mind.rest, size_of(mind)
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
    number = mind.counts[NEXT_CLONE]
    mind.clones[mind.counts[CLONES]] = number
    mind.counts[CLONES] += 1
    mind.counts[NEXT_CLONE] += 1
    return number


@algebra
def keep(mind: Filter, kept: IntArray, size: int) -> None:
    """Let go of all numbers of the state but ``size`` of them, in order; the caller counts lines and clones."""
    x, top, rest = mind.x, mind.top, mind.rest
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
def keep_clones(mind: Filter, wanted: np.ndarray) -> None:
    """Let go of the clones that are not wanted, by their places: what they told stays in what correlates with them."""
    start, number, size = clones_from(mind), mind.counts[CLONES], 0
    kept = np.empty(size_of(mind), dtype=np.int64)
    for place in range(start):
        kept[place] = place
    for place in range(number):
        if wanted[place]:
            mind.clones[size] = mind.clones[place]
            for k in range(POSE):
                kept[start + POSE * size + k] = start + POSE * place + k
            size += 1
    if size < number:
        keep(mind, kept, start + POSE * size)
        mind.counts[CLONES] = size


@algebra
def add_line(mind: Filter, theta: float, anchor_x: float, anchor_y: float) -> int:
    """A new line, for which there is room, through a point (m) with the normal at ``theta``; nothing else is known."""
    x, top, rest, at, old = mind.x, mind.top, mind.rest, clones_from(mind), size_of(mind)
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
        rest[base + at + i] = _PRIOR[i]
        top[:, at + i] = 0.0
    x[at], x[at + 1] = 0.0, theta
    index = mind.counts[LINES]
    mind.anchors[index, 0], mind.anchors[index, 1] = anchor_x, anchor_y
    mind.counts[LINES] += 1
    return index


@algebra
def carried(mind: Filter, size: int, out: FloatArray) -> None:
    """How all of the state (size, 3) moves with the robot when the whole world does."""
    x, start = mind.x, clones_from(mind)
    out[:size] = 0.0
    for k in range(POSE):
        out[k, k] = 1.0
    for index in range(mind.counts[LINES]):
        row = POSE + 2 * index
        cos, sin = math.cos(x[row + 1]), math.sin(x[row + 1])
        out[row, 0], out[row, 1] = cos, sin
        out[row, 2] = cos * (x[1] - mind.anchors[index, 1]) - sin * (x[0] - mind.anchors[index, 0])
        out[row + 1, 2] = 1.0
    for row in range(start, size, POSE):
        for k in range(POSE):
            out[row + k, k] = 1.0
        out[row, 2], out[row + 1, 2] = x[1] - x[row + 1], x[row] - x[0]


@algebra
def carry_top(mind: Filter, moved: FloatArray, size: int, out: FloatArray) -> None:
    """The pose's rows of P (3, size) when all else (size, 3) has moved with the robot's error."""
    top = mind.top
    for k in range(POSE):
        for j in range(size):
            out[k, j] = top[k, j] + top[k, 0] * moved[j, 0] + top[k, 1] * moved[j, 1] + top[k, 2] * moved[j, 2]


@algebra
def correct(mind: Filter, moved: FloatArray, W: FloatArray, rank: int, change: FloatArray) -> None:
    """Let P follow to where W was found, subtract W^T W, change the state, and let P follow it there.

    With M the move (n, 3), A the pose's rows of P, and B their first three columns, P becomes
    P + M (A + B M^T) + A^T M^T: all of it is done in one pass.
    """
    size = size_of(mind)
    height = (rank + 4 * POSE + 3) // 4 * 4
    left, right = np.zeros((height, size)), np.zeros((height, size))
    stack_carry(mind, moved, size, left, right, rank)
    for k in range(POSE):
        for j in range(size):
            total = right[rank + k, j]
            for r in range(rank):
                total -= W[r, k] * W[r, j]
            mind.top[k, j] = total
    left[:rank], right[:rank] = -W[:rank, :size], W[:rank, :size]
    before, after = np.empty((size, POSE)), np.empty((size, POSE))
    carried(mind, size, before)
    for j in range(size):
        mind.x[j] += change[j]
    carried(mind, size, after)
    stack_carry(mind, after - before, size, left, right, rank + 2 * POSE)
    for k in range(POSE):
        mind.top[k, :size] = right[rank + 2 * POSE + k]
    add_products(mind.rest, left, right, height, POSE, size)
    mind.x[2] = wrapped(mind.x[2])


@algebra
def stack_carry(mind: Filter, moved: FloatArray, size: int, left: FloatArray, right: FloatArray, row: int) -> None:
    """The six products of a carry, for ``add_products``; right's first three rows are the pose's rows of P after it."""
    carry_top(mind, moved, size, right[row : row + POSE])
    for k in range(POSE):
        for j in range(size):
            left[row + k, j] = moved[j, k]
            left[row + POSE + k, j] = mind.top[k, j]
            right[row + POSE + k, j] = moved[j, k]
