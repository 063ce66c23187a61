"""Cholesky factors of sparse symmetric matrices, in panels.

A panel has the columns of successive nodes that are coupled with the same later nodes, and the rows
of all of these. The panels are found from the first to the last, each from those before it.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from limslam_env.compilation import compiled, entry_of
from limslam_env.geometry import FloatArray, IntArray

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)


class Panels(NamedTuple):
    """Where the entries of a factor are. Its n nodes are numbered in the order of elimination."""

    starts: IntArray  # the first unknown (n + 1,) of each node
    # owners, nodes: the panel (n,) of each node, and the first node (p + 1,) of each panel
    owners: IntArray
    nodes: IntArray
    # firsts, rows: where each panel begins (p + 1,) among the nodes (r,) of all rows, which ascend
    # from its own ones
    firsts: IntArray
    rows: IntArray
    places: IntArray  # the first row (r,) of each of these nodes in its panel
    # tops, unknowns: the same for the unknowns (u,) of all rows
    tops: IntArray
    unknowns: IntArray
    begins: IntArray  # where the entries of each panel begin (p + 1,), column after column


def panels(coupled: csc_matrix, widths: IntArray) -> Panels:
    """The panels for nodes with so many unknowns (n,), with the lower half of a matrix (n, n) of
    those that are coupled.
    """
    count = len(widths)
    firsts, found = _filled(coupled.indptr, coupled.indices)
    starts = np.append(0, np.cumsum(widths))
    sizes = np.diff(firsts)
    found = found[: firsts[-1]]
    found = found[np.lexsort((found, np.repeat(np.arange(count), sizes)))]
    is_first = np.ones(count, dtype=np.bool_)
    following = found[firsts[:-2] + 1] == np.arange(1, count)
    is_first[1:] = (sizes[1:] != sizes[:-1] - 1) | ~following
    nodes = np.append(np.flatnonzero(is_first), count)
    found = found[np.repeat(is_first, sizes)]
    sizes = sizes[is_first]
    wide = widths[found]
    before = np.append(0, np.cumsum(wide))
    firsts = np.append(0, np.cumsum(sizes))
    tops = before[firsts]
    places = before[:-1] - np.repeat(tops[:-1], sizes)
    unknowns = np.arange(before[-1]) + np.repeat(starts[found] - before[:-1], wide)
    begins = np.append(0, np.cumsum(np.diff(tops) * np.diff(starts[nodes])))
    owners = np.cumsum(is_first) - 1
    return Panels(starts, owners, nodes, firsts, found, places, tops, unknowns, begins)


def sparse_order(coupled: csc_matrix) -> IntArray:
    """The nodes (n,) in an order of elimination that leaves few couplings, by minimum degree.

    scipy gives the order with the factors of a matrix. Half of the couplings are enough for it.
    """
    order: Literal["MMD_AT_PLUS_A"] = "MMD_AT_PLUS_A"
    found = splu(coupled, order, diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.argsort(found.perm_c)


@kernel
def _filled(firsts: IntArray, rows: IntArray) -> tuple[IntArray, IntArray]:
    """Where the columns of a factor begin (n + 1,), and their rows, of which the diagonal is the
    first. An elimination couples all nodes that its node was coupled with.
    """
    count = len(firsts) - 1
    found = np.empty(2 * len(rows) + count, np.int64)
    ends = np.zeros(count + 1, np.int64)
    child = np.full(count, -1)
    sibling = np.full(count, -1)
    seen = np.full(count, -1)
    for node in range(count):
        end = ends[node]
        if end + count > len(found):
            wider = np.empty(2 * len(found) + count, np.int64)
            for place in range(end):
                wider[place] = found[place]
            found = wider
        after = count
        for place in range(firsts[node], firsts[node + 1]):
            row = rows[place]
            seen[row] = node
            found[end] = row
            end += 1
            if row > node:
                after = min(after, row)
        each = child[node]
        while each >= 0:
            for place in range(ends[each] + 1, ends[each + 1]):
                row = found[place]
                if seen[row] < node:
                    seen[row] = node
                    found[end] = row
                    end += 1
                    after = min(after, row)
            each = sibling[each]
        ends[node + 1] = end
        if after < count:
            sibling[node] = child[after]
            child[after] = node
    return ends, found


@kernel
def add_blocks(
    at: Panels, nodes: IntArray, widths: IntArray, hessians: FloatArray, values: FloatArray
) -> None:
    """Add the matrices (f, q, q) of factors of nodes (f, m) with so many unknowns (m,) to the
    entries of a matrix. Nodes that are not below n are fixed.
    """
    count = len(at.owners)
    for number in range(len(nodes)):
        right = 0
        for j in range(len(widths)):
            column = nodes[number, j]
            low = 0
            for i in range(len(widths)):
                row = nodes[number, i]
                if column <= row < count:
                    owner = at.owners[column]
                    entry = at.firsts[owner]
                    end = at.firsts[owner + 1]
                    while entry < end:
                        middle = (entry + end) // 2
                        if at.rows[middle] < row:
                            entry = middle + 1
                        else:
                            end = middle
                    height = at.tops[owner + 1] - at.tops[owner]
                    begin = at.starts[column] - at.starts[at.nodes[owner]]
                    begin = at.begins[owner] + begin * height + at.places[entry]
                    for b in range(widths[j]):
                        for a in range(widths[i]):
                            values[begin + a] += hessians[number, low + a, right + b]
                        begin += height
                low += widths[i]
            right += widths[j]


@compiled
def _panel(tops: IntArray, begins: IntArray, number: int) -> tuple[int, int, int, int]:
    """Of a panel: the first of its rows and how many, the first of its entries, and how many
    columns.
    """
    height = tops[number + 1] - tops[number]
    begin = begins[number]
    return tops[number], height, begin, (begins[number + 1] - begin) // height


@kernel
def factorise(at: Panels, values: FloatArray) -> bool:
    """Replace the entries of a matrix by those of its factor. Returns whether it is positive
    definite.
    """
    count = len(at.begins) - 1
    # Of each panel: the entry of the next node that it changes, and the next panel that changes the
    # same one
    by = np.empty(count, np.int64)
    first = np.full(count, -1)
    following = np.full(count, -1)
    place_of = np.empty(at.starts[-1], np.int64)
    sums = np.empty(at.starts[-1])
    for number in range(count):
        top, height, begin, width = _panel(at.tops, at.begins, number)
        for i in range(height):
            place_of[at.unknowns[top + i]] = i
        other = first[number]
        while other >= 0:
            after = following[other]
            earlier = _panel(at.tops, at.begins, other)
            low = at.places[by[other]]
            end = at.starts[at.nodes[number + 1]]
            _subtract(values, at.unknowns, earlier, low, end, place_of, sums, (begin, height))
            _wait(at, other, number + 1, by, first, following)
            other = after
        for column in range(width):
            own = begin + column * height
            if not values[own + column] > 0.0:
                return False
            root = np.sqrt(values[own + column])
            for i in range(column, height):
                values[own + i] /= root
            for k in range(column + 1, width):
                share = values[own + k]
                later = begin + k * height
                for i in range(k, height):
                    values[later + i] -= share * values[own + i]
        by[number] = at.firsts[number]
        _wait(at, number, number + 1, by, first, following)
    return True


@compiled
def _subtract(
    values: FloatArray,
    unknowns: IntArray,
    earlier: tuple[int, int, int, int],
    low: int,
    end: int,
    place_of: IntArray,
    sums: FloatArray,
    panel: tuple[int, int],
) -> None:
    """Subtract what the rows of an earlier panel, from the one at ``low``, add to those of a panel,
    whose unknowns are below ``end``.
    """
    top, height, begin, width = earlier
    for column in range(low, height):
        unknown = unknowns[top + column]
        if unknown >= end:
            break
        for i in range(column, height):
            sums[i] = 0.0
        for k in range(width):
            part = begin + k * height
            share = values[part + column]
            for i in range(column, height):
                sums[i] += share * values[part + i]
        own = panel[0] + place_of[unknown] * panel[1]
        for i in range(column, height):
            values[own + place_of[unknowns[top + i]]] -= sums[i]


@compiled
def _wait(
    at: Panels, number: int, before: int, by: IntArray, first: IntArray, following: IntArray
) -> None:
    """Let a panel wait for the next one that it changes, which is not ``before`` a panel."""
    while by[number] < at.firsts[number + 1] and at.rows[by[number]] < at.nodes[before]:
        by[number] += 1
    if by[number] < at.firsts[number + 1]:
        owner = at.owners[at.rows[by[number]]]
        following[number] = first[owner]
        first[owner] = number


@kernel
def forward(at: Panels, values: FloatArray, right: FloatArray) -> FloatArray:
    """Divide right sides (q, k) by a factor from the left, in place."""
    for number in range(len(at.begins) - 1):
        top, height, begin, width = _panel(at.tops, at.begins, number)
        is_used = False
        for column in range(width):
            for k in range(right.shape[1]):
                is_used |= right[at.unknowns[top + column], k] != 0.0
        for column in range(width if is_used else 0):
            own = at.unknowns[top + column]
            for k in range(right.shape[1]):
                right[own, k] /= values[begin + column]
            for i in range(column + 1, height):
                share = values[begin + i]
                other = at.unknowns[top + i]
                for k in range(right.shape[1]):
                    right[other, k] -= share * right[own, k]
            begin += height
    return right


@kernel
def backward(at: Panels, values: FloatArray, right: FloatArray) -> FloatArray:
    """Divide a right side (q,) by the transpose of a factor from the left, in place."""
    for number in range(len(at.begins) - 2, -1, -1):
        top, height, begin, width = _panel(at.tops, at.begins, number)
        for column in range(width - 1, -1, -1):
            part = begin + column * height
            total = right[at.unknowns[top + column]]
            for i in range(column + 1, height):
                total -= values[part + i] * right[at.unknowns[top + i]]
            right[at.unknowns[top + column]] = total / values[part + column]
    return right


@kernel
def selected_inverse(at: Panels, values: FloatArray) -> FloatArray:
    """Entries of (L D L^T)^-1 where L has entries, from the last column to the first.

    K. Takahashi, J. Fagan and M. Chin, "Formation of a sparse bus impedance matrix and its
    application to short circuit study", 1973: z_ij = -sum over k of z_ik l_kj for i > j, and z_jj =
    1 / d_j - sum over k of z_kj l_kj.
    """
    inverse = np.zeros(len(values))
    own = np.zeros(at.starts[-1])
    total = np.zeros(at.starts[-1])
    for number in range(len(at.begins) - 2, -1, -1):
        top, height, begin, width = _panel(at.tops, at.begins, number)
        for column in range(width - 1, -1, -1):
            out = begin + column * height
            pivot = values[out + column]
            for i in range(column + 1, height):
                own[at.unknowns[top + i]] = values[out + i] / pivot
                total[at.unknowns[top + i]] = 0.0
            for entry in range(at.firsts[number], at.firsts[number + 1]):
                node = at.rows[entry]
                first, size, known, _ = _panel(at.tops, at.begins, at.owners[node])
                least = max(at.starts[node], at.unknowns[top + column] + 1)
                for unknown in range(least, at.starts[node + 1]):
                    j = unknown - at.unknowns[first]
                    part = known + j * size
                    total[unknown] += inverse[part + j] * own[unknown]
                    for i in range(j + 1, size):
                        coupled = at.unknowns[first + i]
                        total[coupled] += inverse[part + i] * own[unknown]
                        total[unknown] += inverse[part + i] * own[coupled]
            inverse[out + column] = 1.0 / pivot**2
            for i in range(column + 1, height):
                row = at.unknowns[top + i]
                inverse[out + i] = -total[row]
                inverse[out + column] += total[row] * own[row]
                own[row] = 0.0
    return inverse
