"""How the state and the covariance of the filter of poses, lines and clones change, in arrays that
have room.

``slam.consistent.clone_ekf`` explains the filter, whose letters x, P, H, S, W are those of the
literature.

Of the symmetric P, the rows of the poses are kept whole. Of each other row, only the part from the
end of the poses to the diagonal is kept, so that an update and a marginalisation touch half of the
memory: P of many robots does not fit the processor's cache. What lies elsewhere in P is not read
until :func:`mirror` has set it.
"""

import math

import numpy as np

from limslam_agent.kernels import tables
from limslam_agent.kernels.algebra import wrapped
from limslam_agent.kernels.compilation import compiled, entry, lean_entry
from limslam_agent.kernels.tables import LINES, POSE, POSES_END, Filter, Update
from limslam_env.geometry import BoolArray, FloatArray, IntArray

line_at = compiled(tables.line_at)
clones_from = compiled(tables.clones_from)
size_of = compiled(tables.size_of)


@lean_entry
def mirror(ekf: Filter) -> None:
    """Set all of P that is not kept."""
    P = ekf.P
    whole = ekf.counts[POSES_END]
    for i in range(whole, size_of(ekf.counts)):
        for j in range(whole):
            P[i, j] = P[j, i]
        for j in range(whole, i):
            P[j, i] = P[i, j]


@lean_entry
def move_pose(
    ekf: Filter,
    at: int,
    increment: FloatArray,
    covariance: FloatArray,
    by_pose: FloatArray,
    by_increment: FloatArray,
) -> None:
    """Move a pose, which begins in the state at the index ``at``, by an increment (3,) in its
    frame, m, m, rad, whose covariance (3, 3) is added.

    ``by_pose`` and ``by_increment`` (3, 3), which hold zeros, are set to the derivatives of the new
    pose.
    """
    x = ekf.x
    P = ekf.P
    cos = math.cos(x[at + 2])
    sin = math.sin(x[at + 2])
    ahead = cos * increment[0] - sin * increment[1]
    left = sin * increment[0] + cos * increment[1]
    for k in range(POSE):
        by_pose[k, k] = 1.0
    by_pose[0, 2] = -left
    by_pose[1, 2] = ahead
    by_increment[0, 0] = cos
    by_increment[0, 1] = -sin
    by_increment[1, 0] = sin
    by_increment[1, 1] = cos
    by_increment[2, 2] = 1.0
    x[at] += ahead
    x[at + 1] += left
    x[at + 2] = wrapped(x[at + 2] + increment[2])
    for j in range(size_of(ekf.counts)):
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
    for j in range(ekf.counts[POSES_END]):
        for i in range(POSE):
            P[j, at + i] = P[at + i, j]


@lean_entry
def copy_pose(ekf: Filter, at: int) -> None:
    """Append a copy of the pose that begins at the index ``at`` to the state. The caller counts
    it.
    """
    P = ekf.P
    size = size_of(ekf.counts)
    for k in range(POSE):
        ekf.x[size + k] = ekf.x[at + k]
        for j in range(ekf.by_errors.shape[1]):
            ekf.by_errors[size + k, j] = ekf.by_errors[at + k, j]
        for j in range(size):
            P[size + k, j] = P[at + k, j]
    for j in range(ekf.counts[POSES_END]):
        for k in range(POSE):
            P[j, size + k] = P[size + k, j]
    for i in range(POSE):
        for k in range(POSE):
            P[size + i, size + k] = P[at + i, at + k]


@lean_entry
def keep_states(ekf: Filter, is_kept: BoolArray, kept: IntArray) -> None:
    """Marginalise all states (n,) but those to keep, in place. The caller counts what is left.

    ``kept`` (2, n) is scratch: where each state was, and where the stretch of states ends that move
    together.
    """
    P = ekf.P
    size = 0
    first = len(is_kept)
    for place in range(len(is_kept)):
        if is_kept[place]:
            kept[0, size] = place
            size += 1
        else:
            first = min(first, place)
    for new in range(size - 1, -1, -1):
        is_last = new + 1 == size or kept[0, new + 1] > kept[0, new] + 1
        kept[1, new] = new + 1 if is_last else kept[1, new + 1]
    for new in range(size):
        old = kept[0, new]
        if old != new:
            ekf.x[new] = ekf.x[old]
            for j in range(ekf.by_errors.shape[1]):
                ekf.by_errors[new, j] = ekf.by_errors[old, j]
        begin = first if new < first else 0
        last = size if new < ekf.counts[POSES_END] else new + 1
        while begin < last:
            end = min(kept[1, begin], last)
            shift = kept[0, begin] - begin
            for j in range(begin, end):
                P[new, j] = P[old, j + shift]
            begin = end


@entry
def dense_block(P: FloatArray, columns: IntArray) -> FloatArray:
    """Block (k, k) of a covariance: its rows and columns ``columns`` (k,), which are of no pose but
    the first one.
    """
    block = np.empty((len(columns), len(columns)))
    for i in range(len(columns)):
        for j in range(i + 1):
            low = min(columns[i], columns[j])
            high = max(columns[i], columns[j])
            block[i, j] = block[j, i] = P[low, high] if low < POSE else P[high, low]
    return block


@compiled
def dense_rows(ekf: Filter, columns: IntArray) -> FloatArray:
    """Rows (k, s) of the covariance of s states."""
    size = size_of(ekf.counts)
    whole = ekf.counts[POSES_END]
    rows = np.empty((len(columns), size))
    for i in range(len(columns)):
        column = columns[i]
        end = size if column < whole else column + 1
        for j in range(whole):
            rows[i, j] = ekf.P[j, column]
        for j in range(whole, end):
            rows[i, j] = ekf.P[column, j]
        for j in range(end, size):
            rows[i, j] = ekf.P[j, column]
    return rows


@entry
def error_transport(ekf: Filter) -> FloatArray:
    """Derivative (s, 3) of the state by the first robot's pose when robot and world move together
    rigidly.
    """
    x = ekf.x
    poses_end = ekf.counts[POSES_END]
    size = size_of(ekf.counts)
    first_clone = clones_from(ekf.counts)
    moved = np.zeros((size, POSE))
    for place in range((poses_end + size - first_clone) // POSE):
        # The clones do not begin at a multiple of three.
        at = POSE * place
        row = at if at < poses_end else at - poses_end + first_clone
        for k in range(POSE):
            moved[row + k, k] = 1.0
        moved[row, 2] = x[1] - x[row + 1]
        moved[row + 1, 2] = x[row] - x[0]
    for index in range(ekf.counts[LINES]):
        row = line_at(ekf.counts, index)
        cos = math.cos(x[row + 1])
        sin = math.sin(x[row + 1])
        moved[row, 0] = cos
        moved[row, 1] = sin
        moved[row, 2] = cos * (x[1] - ekf.anchors[index, 1]) - sin * (x[0] - ekf.anchors[index, 0])
        moved[row + 1, 2] = 1.0
    return moved


@compiled
def moved_since(ekf: Filter, before: FloatArray) -> FloatArray:
    """By what the transport of the error exceeds the one ``before`` (s, 3)."""
    moved = error_transport(ekf)
    for j in range(len(moved)):
        for k in range(POSE):
            moved[j, k] -= before[j, k]
    return moved


@compiled
def transport_pose(P: FloatArray, moved: FloatArray, out: FloatArray) -> None:
    """The first pose's rows of P (3, s) after its error is transported by ``moved`` (s, 3)."""
    for k in range(POSE):
        for j in range(len(moved)):
            out[k, j] = (
                P[k, j] + P[k, 0] * moved[j, 0] + P[k, 1] * moved[j, 1] + P[k, 2] * moved[j, 2]
            )


@compiled
def transport_rows(
    P: FloatArray, rows: FloatArray, columns: IntArray, moved: FloatArray, out: FloatArray
) -> None:
    """Some rows (k, s) of P after its error is transported by ``moved`` (s, 3)."""
    size = len(moved)
    across = np.empty((POSE, size))
    pose = np.empty((POSE, size))
    transport_pose(P, moved, pose)
    for k in range(POSE):
        for j in range(size):
            across[k, j] = moved[j, k]
    for i in range(len(columns)):
        column = columns[i]
        a = moved[column, 0]
        b = moved[column, 1]
        c = moved[column, 2]
        d = P[0, column]
        e = P[1, column]
        f = P[2, column]
        for j in range(size):
            out[i, j] = rows[i, j] + (
                a * pose[0, j]
                + b * pose[1, j]
                + c * pose[2, j]
                + d * across[0, j]
                + e * across[1, j]
                + f * across[2, j]
            )


@compiled
def add_products(P: FloatArray, whole: int, left: FloatArray, right: FloatArray) -> None:
    """P += left^T right, both (rank, size), which is symmetric; ``rank`` is a multiple of four."""
    rank, size = left.shape
    if size % 2:
        for k in range(rank):
            for j in range(size):
                P[0, j] += left[k, 0] * right[k, j]
    # Two rows at once, so that what is loaded of ``right`` is used twice. The first of them is
    # updated one place beyond the diagonal, which is not read.
    for i in range(size % 2, size, 2):
        row = P[i]
        other = P[i + 1]
        end = size if i < whole else i + 2
        for k in range(0, rank, 4):
            a = left[k, i]
            b = left[k + 1, i]
            c = left[k + 2, i]
            d = left[k + 3, i]
            e = left[k, i + 1]
            f = left[k + 1, i + 1]
            g = left[k + 2, i + 1]
            h = left[k + 3, i + 1]
            for j in range(end):
                one = right[k, j]
                two = right[k + 1, j]
                three = right[k + 2, j]
                four = right[k + 3, j]
                row[j] += a * one + b * two + c * three + d * four
                other[j] += e * one + f * two + g * three + h * four


@entry
def correct_state(ekf: Filter, update: Update) -> FloatArray:
    """Finish an update: transport the error of P to where W was found, subtract W^T W, and change
    the state.

    Then the error is transported to the changed state. With ``moved`` M (s, 3), the first pose's
    rows A of P, and their first three columns B, a transport replaces P by P + M (A + B M^T) + A^T
    M^T. The two transports are one by the sum of both M, if W (m, s) is transported by the second
    M. So all is one product of two matrices.

    Returns
    -------
    after
        The last transport (s, 3).
    """
    W = update.W
    rank, size = W.shape
    height = (rank + 2 * POSE + 3) // 4 * 4
    left = np.zeros((height, size))
    right = np.zeros((height, size))
    before = error_transport(ekf)
    for j in range(size):
        ekf.x[j] += update.change[j]
    after = moved_since(ekf, before)
    both = np.empty((size, POSE))
    for j in range(size):
        for k in range(POSE):
            both[j, k] = update.moved[j, k] + after[j, k]
    for r in range(rank):
        for j in range(size):
            right[r, j] = (
                W[r, j] + W[r, 0] * after[j, 0] + W[r, 1] * after[j, 1] + W[r, 2] * after[j, 2]
            )
            left[r, j] = -right[r, j]
    transport_pose(ekf.P, both, right[rank : rank + POSE])
    for k in range(POSE):
        for j in range(size):
            left[rank + k, j] = right[rank + POSE + k, j] = both[j, k]
            left[rank + POSE + k, j] = ekf.P[k, j]
    add_products(ekf.P, ekf.counts[POSES_END], left, right)
    for heading in range(2, ekf.counts[POSES_END], POSE):
        ekf.x[heading] = wrapped(ekf.x[heading])
    return after
