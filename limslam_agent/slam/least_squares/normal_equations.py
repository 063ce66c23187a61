"""The sparse normal equations to which the factors of a graph are added, their solution, and
covariances.
"""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

_FIXED = 3
_AT_ONCE = 32
# Share of the product of two unknowns' scales, at random. splu drops exact zeros, and a number that
# is never zero keeps all places that the recursion of covariances visits. It is below the rounding
# errors of the matrix.
_NEVER_ZERO = 1e-16


def pose_columns(poses: IntArray) -> IntArray:
    """Columns (k, 3) of poses (k,), which are the first unknowns."""
    return np.asarray(3 * poses[:, None] + np.arange(3))


class DegenerateError(ValueError):
    """The normal equations cannot be solved: the factors do not determine the unknowns."""


@dataclass(eq=False)
class NormalEquations:
    """Sums of J^T W J and J^T W e over factors.

    Attributes
    ----------
    size
        Number of unknowns.
    order
        The unknowns that are solved for, in the order of their elimination. The others are fixed.
        None if only the first pose is fixed, and the sparsity of the matrix gives the order.
    gradient
        (size,) the sum of J^T W e.
    """

    size: int
    order: IntArray | None = None
    gradient: FloatArray = field(init=False)
    _free: IntArray = field(init=False)
    _places: IntArray = field(init=False)
    _rows: list[IntArray] = field(init=False, default_factory=list)
    _columns: list[IntArray] = field(init=False, default_factory=list)
    _values: list[FloatArray] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        self.gradient = np.zeros(self.size)
        self._free = np.arange(_FIXED, self.size) if self.order is None else self.order
        is_fixed = np.ones(self.size, dtype=bool)
        is_fixed[self._free] = False
        # The place of each unknown in the matrix. Those that are fixed come last, and are left out.
        self._places = np.empty(self.size, dtype=np.int32)
        self._places[np.append(self._free, np.flatnonzero(is_fixed))] = np.arange(self.size)

    def add(
        self,
        columns: IntArray,
        jacobian: FloatArray,
        error: FloatArray,
        information: FloatArray | None = None,
    ) -> None:
        """Add factors with columns (f, q), Jacobians (f, d, q), errors (f, d) and information
        matrices (f, d, d).

        Jacobians and errors are divided by standard deviations if there is no information matrix.
        """
        weighted = jacobian if information is None else information @ jacobian
        self.add_blocks(
            columns,
            jacobian.transpose(0, 2, 1) @ weighted,
            np.einsum("fdq,fd->fq", weighted, error),
        )

    def add_blocks(self, columns: IntArray, hessian: FloatArray, gradient: FloatArray) -> None:
        """Add given sums: columns (f, q), J^T W J (f, q, q) and J^T W e (f, q)."""
        width = columns.shape[1]
        places = self._places[columns]
        self._values.append(hessian.ravel())
        self._rows.append(np.repeat(places, width, axis=1).ravel())
        self._columns.append(np.tile(places, (1, width)).ravel())
        np.add.at(self.gradient, columns.ravel(), gradient.ravel())

    def factorise(self) -> SuperLU:
        """Factorise the matrix of the unknowns that are not fixed.

        Raises
        ------
        DegenerateError
            If the matrix is singular.
        """
        return _factors(self._matrix(), "MMD_AT_PLUS_A" if self.order is None else "NATURAL")

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

    def covariances(self, columns: IntArray, jacobian: FloatArray) -> FloatArray:
        """Covariances (f, d, d) of quantities whose Jacobians (f, d, q) refer to the unknowns
        ``columns`` (f, q).
        """
        factors, (count, height, _) = self.factorise(), jacobian.shape
        found = np.empty((count, height, height))
        # A few at a time, since each needs dense columns of all unknowns.
        for begin in range(0, count, _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            above = columns[part, :, None]
            by = jacobian[part]
            places = np.arange(len(by) * height).reshape(-1, 1, height)
            right = np.zeros((self.size, places.size))
            right[above, places] = by.transpose(0, 2, 1)
            found[part] = by @ self.solved(factors, right)[above, places]
        return found

    def covariance_of_last(self, factors: SuperLU, count: int) -> FloatArray:
        """Joint covariance (count, count) of the last unknowns of an order, all of which are
        coupled to each other.
        """
        lower, upper = (each[-count:, -count:].toarray() for each in (factors.L, factors.U))
        if not (upper.diagonal() > 0.0).all():
            raise DegenerateError("the factors do not determine the unknowns")
        inverse = np.linalg.inv(lower @ upper)
        return np.asarray(0.5 * (inverse + inverse.T))

    def marginals(self, columns: IntArray) -> FloatArray:
        """Covariances (f, q, q) of unknowns (f, q) with a factor in common, by an order; 0 where
        they are fixed.
        """
        matrix = self._matrix()
        scale = np.sqrt(matrix.diagonal())
        draws = np.random.default_rng(0).uniform(0.5, 1.0, matrix.nnz)
        column = np.repeat(np.arange(len(scale)), np.diff(matrix.indptr))
        matrix.data += _NEVER_ZERO * draws * scale[matrix.indices] * scale[column]
        factors = _factors(matrix, "NATURAL")
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
        places = self._places[columns]
        is_free = (places < len(pivots)).all(axis=1)
        above = places[is_free, :, None]
        below = places[is_free, None, :]
        found = np.zeros((*places.shape, places.shape[1]))
        entries = inverse[np.maximum(above, below).ravel(), np.minimum(above, below).ravel()]
        found[is_free] = np.asarray(entries).reshape(above.shape[0], *found.shape[1:])
        return found

    def _matrix(self) -> csc_matrix:
        """The matrix of the unknowns that are not fixed."""
        places = (np.concatenate(self._rows), np.concatenate(self._columns))
        count = len(self._free)
        whole = coo_matrix((np.concatenate(self._values), places), shape=(self.size, self.size))
        # Sorting by rows and then by columns is faster than the sum of scipy, which sorts each
        # column by comparisons.
        whole.has_canonical_format = True
        matrix = whole.tocsr().tocsc()
        matrix.has_sorted_indices = True
        matrix.has_canonical_format = False
        matrix.sum_duplicates()
        return matrix[:count, :count]


def _factors(matrix: csc_matrix, order: Literal["NATURAL", "MMD_AT_PLUS_A"]) -> SuperLU:
    try:
        return splu(
            matrix, permc_spec=order, diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
    except RuntimeError as error:
        raise DegenerateError("the factors do not determine the unknowns") from error


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
