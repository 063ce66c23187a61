"""Cholesky factors of sparse symmetric matrices, in panels.

A panel has the columns of successive nodes that are coupled with the same later nodes, and the rows
of all of these. The panels are found from the first to the last, each from those before it.
"""

from typing import Literal, NamedTuple

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from limslam_env.compilation import entry_of
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
        for row in rows[firsts[node] : firsts[node + 1]]:
            seen[row] = node
            found[end] = row
            end += 1
            if row > node:
                after = min(after, row)
        each = child[node]
        while each >= 0:
            for row in found[ends[each] + 1 : ends[each + 1]]:
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
def _panel(at: Panels, number: int, values: FloatArray) -> tuple[FloatArray, IntArray]:
    """The entries (columns, rows) of a panel, and the unknowns of its rows."""
    rows = at.unknowns[at.tops[number] : at.tops[number + 1]]
    return values[at.begins[number] : at.begins[number + 1]].reshape(-1, len(rows)), rows


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
                    first = at.firsts[owner]
                    coupled = at.rows[first : at.firsts[owner + 1]]
                    place = at.places[first + np.searchsorted(coupled, row)]
                    height = at.tops[owner + 1] - at.tops[owner]
                    begin = at.starts[column] - at.starts[at.nodes[owner]]
                    begin = at.begins[owner] + begin * height + place
                    for b in range(widths[j]):
                        for a in range(widths[i]):
                            values[begin + a] += hessians[number, low + a, right + b]
                        begin += height
                low += widths[i]
            right += widths[j]


@kernel
def factorise(at: Panels, values: FloatArray) -> bool:
    """Replace the entries of a matrix by those of its factor. Returns whether it is positive
    definite.
    """
    count = len(at.begins) - 1
    # Of each panel: the entry of the next node that it changes, and the next panel that changes the
    # same one
    by = at.firsts[:-1].copy()
    first = np.full(count, -1)
    following = np.full(count, -1)
    place_of = np.empty(at.starts[-1], np.int64)
    sums = np.empty(at.starts[-1])
    for number in range(count):
        panel, rows = _panel(at, number, values)
        for i in range(len(rows)):
            place_of[rows[i]] = i
        other = first[number]
        while other >= 0:
            after = following[other]
            earlier, rows = _panel(at, other, values)
            low = at.places[by[other]]
            end = at.starts[at.nodes[number + 1]]
            _subtract(earlier[:, low:], rows[low:], end, place_of, sums, panel)
            _wait(at, other, number + 1, by, first, following)
            other = after
        for column in range(len(panel)):
            own = panel[column]
            if not own[column] > 0.0:
                return False
            root = np.sqrt(own[column])
            for i in range(column, len(own)):
                own[i] /= root
            for k in range(column + 1, len(panel)):
                share = own[k]
                later = panel[k]
                for i in range(k, len(own)):
                    later[i] -= share * own[i]
        _wait(at, number, number + 1, by, first, following)
    return True


@kernel
def _subtract(
    earlier: FloatArray,
    rows: IntArray,
    end: int,
    place_of: IntArray,
    sums: FloatArray,
    panel: FloatArray,
) -> None:
    """Subtract what the rows (r,) of an earlier panel (k, r) add to those of a panel, whose
    unknowns are below ``end``.
    """
    for column in range(len(rows)):
        if rows[column] >= end:
            break
        total = sums[column : len(rows)]
        total[:] = 0.0
        for k in range(len(earlier)):
            share = earlier[k, column]
            part = earlier[k, column:]
            for i in range(len(total)):
                total[i] += share * part[i]
        own = panel[place_of[rows[column]]]
        for i in range(len(total)):
            own[place_of[rows[column + i]]] -= total[i]


@kernel
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
        panel, rows = _panel(at, number, values)
        if not right[rows[0] : rows[0] + len(panel)].any():
            continue
        for column in range(len(panel)):
            own = right[rows[column]]
            own /= panel[column, column]
            for i in range(column + 1, len(rows)):
                share = panel[column, i]
                other = right[rows[i]]
                for k in range(len(other)):
                    other[k] -= share * own[k]
    return right


@kernel
def backward(at: Panels, values: FloatArray, right: FloatArray) -> FloatArray:
    """Divide a right side (q,) by the transpose of a factor from the left, in place."""
    for number in range(len(at.begins) - 2, -1, -1):
        panel, rows = _panel(at, number, values)
        for column in range(len(panel) - 1, -1, -1):
            total = right[rows[column]]
            for i in range(column + 1, len(rows)):
                total -= panel[column, i] * right[rows[i]]
            right[rows[column]] = total / panel[column, column]
    return right


@kernel
def selected_inverse(at: Panels, values: FloatArray) -> FloatArray:
    """Entries of (L D L^T)^-1 where L has entries, from the last column to the first.

    K. Takahashi, J. Fagan and M. Chin, "Formation of a sparse bus impedance matrix and its
    application to short circuit study", 1973: z_ij = -sum over k of z_ik l_kj for i > j, and z_jj =
    1 / d_j - sum over k of z_kj l_kj.
    """
    inverse = np.zeros_like(values)
    own = np.zeros(at.starts[-1])
    total = np.zeros(at.starts[-1])
    for number in range(len(at.begins) - 2, -1, -1):
        panel, rows = _panel(at, number, values)
        out, _ = _panel(at, number, inverse)
        for column in range(len(panel) - 1, -1, -1):
            pivot = panel[column, column]
            for i in range(column + 1, len(rows)):
                own[rows[i]] = panel[column, i] / pivot
                total[rows[i]] = 0.0
            for entry in range(at.firsts[number], at.firsts[number + 1]):
                node = at.rows[entry]
                known, coupled = _panel(at, at.owners[node], inverse)
                for unknown in range(max(at.starts[node], rows[column] + 1), at.starts[node + 1]):
                    j = unknown - coupled[0]
                    total[unknown] += known[j, j] * own[unknown]
                    for i in range(j + 1, len(coupled)):
                        total[coupled[i]] += known[j, i] * own[unknown]
                        total[unknown] += known[j, i] * own[coupled[i]]
            out[column, column] = 1.0 / pivot**2
            for i in range(column + 1, len(rows)):
                out[column, i] = -total[rows[i]]
                out[column, column] += total[rows[i]] * own[rows[i]]
                own[rows[i]] = 0.0
    return inverse
