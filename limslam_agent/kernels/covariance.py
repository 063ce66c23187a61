"""How the state and the covariance of the filter of poses, lines and clones change, in arrays that
have room.

``slam.consistent.clone_ekf`` explains the filter, whose letters x, P, H, S, W are those of the
literature. The state has the first ``size`` places of its arrays. ``begins`` says where its parts
begin: the end of the poses, the first line, and the first clone.

Of the symmetric P, the first ``whole`` rows, those of the poses, are kept whole. Of each other row,
only the part from the column ``whole`` to the diagonal is kept, so that an update and a
marginalisation touch half of the memory: P of many robots does not fit the processor's cache. What
lies elsewhere in P is not read until :func:`mirror` has set it.
"""

import math

import numpy as np

from limslam_agent.kernels.algebra import wrapped
from limslam_agent.kernels.compilation import compiled, entry, lean_entry
from limslam_agent.kernels.tables import POSE
from limslam_env.geometry import BoolArray, FloatArray, IntArray


@lean_entry
def mirror(P: FloatArray, size: int, whole: int) -> None:
    """Set all of P (size, size) that is not kept."""
    for i in range(whole, size):
        for j in range(whole):
            P[i, j] = P[j, i]
        for j in range(whole, i):
            P[j, i] = P[i, j]


@lean_entry
def move_pose(
    x: FloatArray,
    P: FloatArray,
    size: int,
    at: int,
    increment: FloatArray,
    covariance: FloatArray,
    by_pose: FloatArray,
    by_increment: FloatArray,
    whole: int,
) -> None:
    """Move a pose, which begins in the state at the index ``at``, by an increment (3,) in its
    frame, m, m, rad.

    The increment's covariance (3, 3) is added. ``by_pose`` and ``by_increment`` (3, 3), which hold
    zeros, are set to the derivatives of the new pose.
    """
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
    x[at], x[at + 1], x[at + 2] = x[at] + ahead, x[at + 1] + left, wrapped(x[at + 2] + increment[2])
    for j in range(size):
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
    for j in range(whole):
        for i in range(POSE):
            P[j, at + i] = P[at + i, j]


@lean_entry
def copy_pose(
    x: FloatArray, P: FloatArray, by_errors: FloatArray, size: int, whole: int, at: int
) -> None:
    """Append a copy of the pose that begins at the index ``at`` to a state of a size."""
    for k in range(POSE):
        x[size + k] = x[at + k]
        for j in range(by_errors.shape[1]):
            by_errors[size + k, j] = by_errors[at + k, j]
        for j in range(size):
            P[size + k, j] = P[at + k, j]
    for j in range(whole):
        for k in range(POSE):
            P[j, size + k] = P[size + k, j]
    for i in range(POSE):
        for k in range(POSE):
            P[size + i, size + k] = P[at + i, at + k]


@lean_entry
def keep_states(
    x: FloatArray,
    P: FloatArray,
    by_errors: FloatArray,
    whole: int,
    is_kept: BoolArray,
    kept: IntArray,
) -> None:
    """Marginalise all states (n,) but those to keep, in place. The derivatives by constant errors
    have n rows.

    ``kept`` (2, n) is scratch: where each state was, and where the stretch of states ends that move
    together.
    """
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
            x[new] = x[old]
            for j in range(by_errors.shape[1]):
                by_errors[new, j] = by_errors[old, j]
        begin = first if new < first else 0
        last = size if new < whole else new + 1
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
        for j in range(len(columns)):
            low = min(columns[i], columns[j])
            high = max(columns[i], columns[j])
            block[i, j] = P[low, high] if low < POSE else P[high, low]
    return block


@entry
def dense_rows(P: FloatArray, size: int, whole: int, columns: IntArray) -> FloatArray:
    """Rows (k, size) of a covariance."""
    rows = np.empty((len(columns), size))
    for i in range(len(columns)):
        column = columns[i]
        end = size if column < whole else column + 1
        for j in range(whole):
            rows[i, j] = P[j, column]
        for j in range(whole, end):
            rows[i, j] = P[column, j]
        for j in range(end, size):
            rows[i, j] = P[j, column]
    return rows


@compiled
def fill_transport(
    x: FloatArray,
    size: int,
    begins: tuple[int, int, int],
    anchors: FloatArray,
    num_lines: int,
    out: FloatArray,
) -> None:
    """Derivative (size, 3) of the state by the first robot's pose when robot and world move
    together rigidly.

    ``begins`` says where the poses end in the state, and where lines and clones begin. ``out`` is
    filled.
    """
    poses_end, first, clones_from = begins
    out[:size] = 0.0
    for place in range((poses_end + size - clones_from) // POSE):
        # The clones do not begin at a multiple of three.
        at = POSE * place
        row = at if at < poses_end else at - poses_end + clones_from
        for k in range(POSE):
            out[row + k, k] = 1.0
        out[row, 2] = x[1] - x[row + 1]
        out[row + 1, 2] = x[row] - x[0]
    for number in range(num_lines):
        row = first + 2 * number
        cos = math.cos(x[row + 1])
        sin = math.sin(x[row + 1])
        out[row, 0] = cos
        out[row, 1] = sin
        out[row, 2] = cos * (x[1] - anchors[number, 1]) - sin * (x[0] - anchors[number, 0])
        out[row + 1, 2] = 1.0


@entry
def error_transport(
    x: FloatArray, size: int, begins: tuple[int, int, int], anchors: FloatArray, num_lines: int
) -> FloatArray:
    """What :func:`fill_transport` fills (size, 3), as Python calls it."""
    moved = np.empty((size, POSE))
    fill_transport(x, size, begins, anchors, num_lines, moved)
    return moved


@compiled
def change_of_transport(
    x: FloatArray,
    size: int,
    begins: tuple[int, int, int],
    anchors: FloatArray,
    num_lines: int,
    before: FloatArray,
    out: FloatArray,
) -> None:
    """Set ``out`` (size, 3) to what ``fill_transport`` finds, less what it found ``before``."""
    fill_transport(x, size, begins, anchors, num_lines, out)
    for j in range(size):
        for k in range(POSE):
            out[j, k] -= before[j, k]


@compiled
def transport_pose(P: FloatArray, moved: FloatArray, out: FloatArray) -> None:
    """The first pose's rows of P (3, size) after its error is transported by ``moved`` (size,
    3).
    """
    for k in range(POSE):
        for j in range(len(moved)):
            out[k, j] = (
                P[k, j] + P[k, 0] * moved[j, 0] + P[k, 1] * moved[j, 1] + P[k, 2] * moved[j, 2]
            )


@compiled
def transport_rows(
    P: FloatArray,
    rows: FloatArray,
    columns: IntArray,
    moved: FloatArray,
    pose: FloatArray,
    out: FloatArray,
) -> None:
    """Some rows of P after its error is transported by ``moved``; ``pose`` has those of the first
    pose after it.
    """
    size = len(moved)
    across = np.empty((POSE, size))
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
def correct_state(
    x: FloatArray,
    P: FloatArray,
    size: int,
    begins: tuple[int, int, int],
    anchors: FloatArray,
    num_lines: int,
    moved: FloatArray,
    W: FloatArray,
    change: FloatArray,
) -> FloatArray:
    """Finish an update: transport the error of P to where W was found, subtract W^T W, and change
    the state.

    Then the error is transported to the changed state. With ``moved`` M (size, 3), the first pose's
    rows A of P, and their first three columns B, a transport replaces P by P + M (A + B M^T) + A^T
    M^T. The two transports are one by the sum of both M, if W (m, size) is transported by the
    second M. So all is one product of two matrices.

    Returns
    -------
    moved
        The last transport (size, 3).
    """
    rank = len(W)
    height = (rank + 2 * POSE + 3) // 4 * 4
    left = np.zeros((height, size))
    right = np.zeros((height, size))
    after = np.empty((size, POSE))
    both = np.empty((size, POSE))
    fill_transport(x, size, begins, anchors, num_lines, both)
    for j in range(size):
        x[j] += change[j]
    change_of_transport(x, size, begins, anchors, num_lines, both, after)
    for j in range(size):
        for k in range(POSE):
            both[j, k] = moved[j, k] + after[j, k]
    for r in range(rank):
        for j in range(size):
            right[r, j] = (
                W[r, j] + W[r, 0] * after[j, 0] + W[r, 1] * after[j, 1] + W[r, 2] * after[j, 2]
            )
            left[r, j] = -right[r, j]
    transport_pose(P, both, right[rank : rank + POSE])
    for k in range(POSE):
        for j in range(size):
            left[rank + k, j] = right[rank + POSE + k, j] = both[j, k]
            left[rank + POSE + k, j] = P[k, j]
    add_products(P, begins[0], left, right)
    for heading in range(2, begins[0], POSE):
        x[heading] = wrapped(x[heading])
    return after
