"""A factor graph, linearised about one estimate: its nodes, factors, robust weights, the solution,
and covariances.

Both smoothers build such a graph at each iteration (F. Dellaert and M. Kaess, "Factor graphs for
robot perception", 2017).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

_AT_ONCE = 32
# Share of the product of two unknowns' scales, at random. splu drops exact zeros, and a number that
# is never zero keeps all places that the recursion of covariances visits. It is below the rounding
# errors of the matrix.
_NEVER_ZERO = 1e-16
_PANEL = 1  # columns that splu works on at once; more are slower for matrices with so few entries

Keys = tuple[tuple[str, IntArray], ...]
"""The nodes of f factors: the kind and the numbers (f,) of the first node of each, of the second
one, and so on.
"""

RobustKernel = Callable[[FloatArray], FloatArray]
"""The weights (f,) of factors by the chi-squares (f,) of their errors."""


class DegenerateError(ValueError):
    """The graph cannot be solved: the factors do not determine the nodes."""


class Nodes:
    """The unknowns of a graph, by the names of their kinds. Each kind has a number of nodes, and a
    number of unknowns for each node.

    Examples
    --------
    >>> nodes = Nodes(poses=(3, 3), lines=(2, 2))
    >>> nodes.columns("lines").tolist()
    [[9, 10], [11, 12]]
    """

    def __init__(self, **kinds: tuple[int, int]) -> None:
        self._columns = dict[str, IntArray]()
        self.size = 0
        for kind, (count, width) in kinds.items():
            end = self.size + count * width
            self._columns[kind] = np.arange(self.size, end).reshape(count, width)
            self.size = end

    def columns(self, kind: str) -> IntArray:
        """The columns (count, width) of the nodes of a kind."""
        return self._columns[kind]

    def columns_of(self, keys: Keys) -> IntArray:
        """The columns (f, q) of all nodes of f factors."""
        return np.hstack([self._columns[kind][numbers] for kind, numbers in keys])


@dataclass(frozen=True, eq=False)
class Factors:
    """A number f of factors of one kind, linearised.

    Attributes
    ----------
    keys
        The nodes of each factor.
    errors, jacobian
        Errors (f, d), and their derivatives (f, d, q) by all unknowns of the nodes.
    information
        Inverse covariances (f, d, d) of the errors. None if errors and derivatives are in standard
        deviations.
    """

    keys: Keys
    errors: FloatArray
    jacobian: FloatArray
    information: FloatArray | None = None

    @property
    def weighted_jacobian(self) -> FloatArray:
        """The derivatives (f, d, q), multiplied by the information."""
        return self.jacobian if self.information is None else self.information @ self.jacobian

    @property
    def chi2(self) -> FloatArray:
        """The chi-squares (f,) of the errors."""
        errors = self.errors[..., None]
        weighted = errors if self.information is None else self.information @ errors
        return np.asarray((errors * weighted).sum(axis=(1, 2)))


class Graph:
    """The sums of J^T W J and J^T W e over the factors of a graph.

    Parameters
    ----------
    nodes
        The nodes.
    order
        The columns that are solved for, in the order of their elimination. The others are fixed.
        None if only the first node is fixed, and the sparsity of the matrix gives the order.

    Attributes
    ----------
    gradient
        (size,) the sum of J^T W e.
    """

    def __init__(self, nodes: Nodes, order: IntArray | None = None) -> None:
        self.nodes = nodes
        self._column_order: Literal["NATURAL", "MMD_AT_PLUS_A"] = "NATURAL"
        if order is None:
            self._column_order = "MMD_AT_PLUS_A"
            order = np.arange(3, nodes.size)
        self._free = order
        is_fixed = np.ones(nodes.size, dtype=bool)
        is_fixed[order] = False
        # The place of each unknown in the matrix. Those that are fixed come last, and are left out.
        self._places = np.empty(nodes.size, dtype=np.int32)
        self._places[np.append(order, np.flatnonzero(is_fixed))] = np.arange(nodes.size)
        self._rows = list[IntArray]()
        self._columns = list[IntArray]()
        # Of each entry that was added, its place in the matrix; and the rows and columns of that
        self._sparsity: tuple[IntArray, IntArray, IntArray] | None = None
        self.clear()

    def clear(self) -> None:
        """Remove all factors. Factors of the same nodes have to be added again, in the same order:
        the sparsity of the matrix is found once for all of them.
        """
        self.gradient = np.zeros(self.nodes.size)
        self._values = list[FloatArray]()
        self._factors: SuperLU | None = None

    def add(self, factors: Factors) -> None:
        """Add factors without a robust kernel."""
        weighted = factors.weighted_jacobian
        self.add_sums(
            self.nodes.columns_of(factors.keys),
            factors.jacobian.transpose(0, 2, 1) @ weighted,
            np.einsum("fdq,fd->fq", weighted, factors.errors),
        )

    def add_robust(self, factors: Factors, robust: RobustKernel) -> FloatArray:
        """Add factors with a robust kernel. Returns their weights (f,).

        Many such factors have the same nodes. They are summed beforehand.
        """
        weights = robust(factors.chi2)
        if not len(weights):
            return weights
        order = np.lexsort([numbers for _, numbers in reversed(factors.keys)])
        numbers = np.column_stack([numbers for _, numbers in factors.keys])[order]
        firsts = np.flatnonzero((np.diff(numbers, axis=0, prepend=-1) != 0).any(axis=1))
        jacobian = factors.jacobian[order]
        weighted = weights[order, None, None] * factors.weighted_jacobian[order]
        self.add_sums(
            self.nodes.columns_of(factors.keys)[order[firsts]],
            np.add.reduceat(np.einsum("fdi,fdj->fij", weighted, jacobian), firsts),
            np.add.reduceat(np.einsum("fdq,fd->fq", weighted, factors.errors[order]), firsts),
        )
        return weights

    def add_sums(self, columns: IntArray, hessian: FloatArray, gradient: FloatArray) -> None:
        """Add sums over factors: columns (f, q), J^T W J (f, q, q) and J^T W e (f, q)."""
        self._factors = None
        self._values.append(hessian.ravel())
        if len(self._rows) < len(self._values):
            self._sparsity = None
            width = columns.shape[1]
            places = self._places[columns]
            self._rows.append(np.repeat(places, width, axis=1).ravel())
            self._columns.append(np.tile(places, (1, width)).ravel())
        np.add.at(self.gradient, columns.ravel(), gradient.ravel())

    def factorise(self) -> SuperLU:
        """Factorise the matrix of the unknowns that are not fixed, once for all factors.

        Raises
        ------
        DegenerateError
            If the matrix is singular.
        """
        if self._factors is None:
            self._factors = _factorised(self._matrix(), self._column_order)
        return self._factors

    def solve(self) -> FloatArray:
        """The Gauss-Newton step (size,)."""
        return -self.solved(self.factorise(), self.gradient)

    def solved(self, factors: SuperLU, right: FloatArray) -> FloatArray:
        """The inverse of the matrix times ``right`` (size, ...). The rows of fixed unknowns are
        zero.
        """
        solved = np.zeros_like(right)
        solved[self._free] = factors.solve(right[self._free])
        return solved

    def covariances(self, factors: Factors) -> FloatArray:
        """Covariances (f, d, d) of what factors measure, by their derivatives."""
        columns = self.nodes.columns_of(factors.keys)
        solver = self.factorise()
        count, height, _ = factors.jacobian.shape
        covariances = np.empty((count, height, height))
        # A few at a time, since each needs dense columns of all unknowns.
        for begin in range(0, count, _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            rows = columns[part, :, None]
            by = factors.jacobian[part]
            places = np.arange(len(by) * height).reshape(-1, 1, height)
            right = np.zeros((self.nodes.size, places.size))
            right[rows, places] = by.transpose(0, 2, 1)
            covariances[part] = by @ self.solved(solver, right)[rows, places]
        return covariances

    def covariance_of_last(self, factors: SuperLU, count: int) -> FloatArray:
        """Joint covariance (count, count) of the last unknowns of an order, all of which are
        coupled to each other.
        """
        lower, upper = (each[-count:, -count:].toarray() for each in (factors.L, factors.U))
        if not (upper.diagonal() > 0.0).all():
            raise DegenerateError("the factors do not determine the unknowns")
        inverse = np.linalg.inv(lower @ upper)
        return np.asarray(0.5 * (inverse + inverse.T))

    def marginals(self, kind: str) -> FloatArray:
        """Covariances (count, width, width) of all nodes of a kind, by an order; 0 where they are
        fixed.
        """
        matrix = self._matrix()
        scale = np.sqrt(matrix.diagonal())
        draws = np.random.default_rng(0).uniform(0.5, 1.0, matrix.nnz)
        column = np.repeat(np.arange(len(scale)), np.diff(matrix.indptr))
        matrix.data += _NEVER_ZERO * draws * scale[matrix.indices] * scale[column]
        factors = _factorised(matrix, "NATURAL")
        lower = csc_matrix(factors.L)
        pivots = factors.U.diagonal()
        lower.sort_indices()
        values = np.empty(lower.nnz)
        _selected_inverse(
            lower.indptr.astype(np.int64),
            lower.indices.astype(np.int64),
            lower.data,
            pivots,
            values,
        )
        inverse = csc_matrix((values, lower.indices, lower.indptr), shape=lower.shape)
        places = self._places[self.nodes.columns(kind)]
        is_free = (places < len(pivots)).all(axis=1)
        rows = places[is_free, :, None]
        columns = places[is_free, None, :]
        entries = inverse[np.maximum(rows, columns).ravel(), np.minimum(rows, columns).ravel()]
        covariances = np.zeros((*places.shape, places.shape[1]))
        covariances[is_free] = np.asarray(entries).reshape(-1, *covariances.shape[1:])
        return covariances

    def _matrix(self) -> csc_matrix:
        """The matrix of the unknowns that are not fixed."""
        count = len(self._free)
        if self._sparsity is None:
            places = (np.concatenate(self._rows), np.concatenate(self._columns))
            self._sparsity = _places_of_sums(*places, count)
        places, rows, firsts = self._sparsity
        sums = np.bincount(places, np.concatenate(self._values), len(rows) + 1)
        return csc_matrix((sums[1:], rows, firsts), shape=(count, count))


def _factorised(matrix: csc_matrix, order: Literal["NATURAL", "MMD_AT_PLUS_A"]) -> SuperLU:
    try:
        return splu(
            matrix,
            permc_spec=order,
            diag_pivot_thresh=0.0,
            panel_size=_PANEL,
            options={"SymmetricMode": True},
        )
    except RuntimeError as error:
        raise DegenerateError("the factors do not determine the unknowns") from error


@kernel
def _sorted(keys: IntArray, entries: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Those of the entries whose keys are below a number, sorted by their keys, equal ones in the
    same order; and where each key begins (count + 1,).
    """
    ends = np.zeros(count + 1, np.int64)
    for entry in entries:
        if keys[entry] < count:
            ends[keys[entry] + 1] += 1
    ends = np.cumsum(ends)
    firsts = ends.copy()
    found = np.empty(firsts[count], np.int64)
    for entry in entries:
        if keys[entry] < count:
            found[ends[keys[entry]]] = entry
            ends[keys[entry]] += 1
    return found, firsts


@kernel
def _places_of_sums(
    rows: IntArray, columns: IntArray, count: int
) -> tuple[IntArray, IntArray, IntArray]:
    """A square matrix with so many columns, as the sum of entries (e,) at rows and columns.

    Sorting by counting is faster than by comparisons.

    Returns
    -------
    places, rows, firsts
        For each entry (e,), its sum, from 1 on, or 0 if it lies outside of the matrix; the row of
        each sum (s,); and where each column begins (count + 1,).
    """
    by_row, _ = _sorted(rows, np.arange(len(rows)), count)
    order, begins = _sorted(columns, by_row, count)
    places = np.zeros(len(rows), np.int64)
    rows_of = np.empty(len(order), np.int32)
    firsts = np.zeros(count + 1, np.int32)
    sums = 0
    for column in range(count):
        before = -1
        for entry in order[begins[column] : begins[column + 1]]:
            if rows[entry] != before:
                before = rows[entry]
                rows_of[sums] = before
                sums += 1
            places[entry] = sums
        firsts[column + 1] = sums
    return places, rows_of[:sums].copy(), firsts


@kernel
def _selected_inverse(
    firsts: IntArray, rows: IntArray, lower: FloatArray, pivots: FloatArray, inverse: FloatArray
) -> None:
    """Entries of (L D L^T)^-1 where L has entries, from the last column to the first.

    K. Takahashi, J. Fagan and M. Chin, "Formation of a sparse bus impedance matrix and its
    application to short circuit study", 1973: z_ij = -sum over k of z_ik l_kj for i > j, and z_jj =
    1 / d_j - sum over k of z_kj l_kj.

    Parameters
    ----------
    firsts, rows, lower
        The columns of L by their first entries (n + 1,), and the row and value of each entry (e,).
        The diagonal, which is 1, is the first entry of each column.
    pivots
        The diagonal (n,) of D.
    inverse
        Output array (e,).
    """
    own = np.zeros(len(pivots))
    total = np.zeros(len(pivots))
    for column in range(len(pivots) - 1, -1, -1):
        begin = firsts[column] + 1
        end = firsts[column + 1]
        for entry in range(begin, end):
            own[rows[entry]] = lower[entry]
            total[rows[entry]] = 0.0
        for entry in range(begin, end):
            other = rows[entry]
            total[other] += inverse[firsts[other]] * own[other]
            for place in range(firsts[other] + 1, firsts[other + 1]):
                total[rows[place]] += inverse[place] * own[other]
                total[other] += inverse[place] * own[rows[place]]
        inverse[firsts[column]] = 1.0 / pivots[column]
        for entry in range(begin, end):
            inverse[entry] = -total[rows[entry]]
            inverse[firsts[column]] += total[rows[entry]] * lower[entry]
            own[rows[entry]] = 0.0
