"""A factor graph, linearised about one estimate: its nodes, factors, robust weights, the solution,
and covariances.

Both smoothers build such a graph at each iteration (F. Dellaert and M. Kaess, "Factor graphs for
robot perception", 2017).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix

from limslam_agent.slam.graph import cholesky
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

_AT_ONCE = 32

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

    Attributes
    ----------
    size
        The number of all unknowns.
    widths, owners
        The number of unknowns of each node (m,), and the node of each column (size,).

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
        counts, widths = np.array(list(kinds.values())).T
        self.widths = np.repeat(widths, counts)
        self.owners = np.repeat(np.arange(len(self.widths)), self.widths)

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
        self._order = order
        if order is not None:
            order = nodes.owners[order]
            self._order = order[np.diff(order, prepend=-1) != 0]
        # The nodes of the factors that were added, and the panels of the matrix
        self._numbers = list[IntArray]()
        self._panels: cholesky.Panels | None = None
        self.clear()

    def clear(self) -> None:
        """Remove all factors. Factors of the same nodes have to be added again, in the same order:
        the sparsity of the matrix is found once for all of them. A graph that was solved takes no
        further factors until it is cleared.
        """
        self.gradient = np.zeros(self.nodes.size)
        self._hessians = list[FloatArray]()
        self._factor: FloatArray | None = None

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
        is_first = (np.diff(numbers, axis=0, prepend=-1) != 0).any(axis=1)
        columns = self.nodes.columns_of(factors.keys)[order[is_first]]
        gradient = np.zeros(columns.shape)
        hessian = np.zeros((*columns.shape, columns.shape[1]))
        _add_products(
            order,
            np.cumsum(is_first) - 1,
            weights[:, None, None] * factors.weighted_jacobian,
            factors.jacobian,
            factors.errors,
            hessian,
            gradient,
        )
        self.add_sums(columns, hessian, gradient)
        return weights

    def add_sums(self, columns: IntArray, hessian: FloatArray, gradient: FloatArray) -> None:
        """Add sums over factors: columns (f, q), J^T W J (f, q, q) and J^T W e (f, q)."""
        if not len(columns):
            return
        if self._factor is not None:
            raise ValueError("factors are added before a graph is solved, or after it is cleared")
        self._hessians.append(hessian)
        if len(self._numbers) < len(self._hessians):
            self._panels = None
            firsts = np.flatnonzero(np.diff(self.nodes.owners[columns[0]], prepend=-1))
            self._numbers.append(self.nodes.owners[columns.take(firsts, axis=1)])
        np.add.at(self.gradient, columns.ravel(), gradient.ravel())

    def factorise(self) -> tuple[cholesky.Panels, FloatArray]:
        """The factor of the matrix of the unknowns that are not fixed, once for all factors.

        Raises
        ------
        DegenerateError
            If the matrix is singular.
        """
        panels = self._panels or self._found_panels()
        if self._factor is None:
            factor = np.zeros(panels.begins[-1])
            for numbers, hessian in zip(self._numbers, self._hessians, strict=True):
                widths = self.nodes.widths[numbers[0]]
                cholesky.add_blocks(panels, self._ranks[numbers], widths, hessian, factor)
            if not cholesky.factorise(panels, factor):
                raise DegenerateError("the factors do not determine the unknowns")
            self._factor = factor
            self._hessians.clear()
        return panels, self._factor

    def solve(self) -> FloatArray:
        """The Gauss-Newton step (size,)."""
        factor = self.factorise()
        step = np.zeros(self.nodes.size)
        step[self._free] = cholesky.backward(*factor, -self.whitened(self.gradient[:, None])[:, 0])
        return step

    def whitened(self, right: FloatArray) -> FloatArray:
        """Right sides (size, k) divided by the factor L: with the inverse C of the matrix, the
        products of their columns are ``right.T @ C @ right``.
        """
        factor = self.factorise()
        return np.asarray(cholesky.forward(*factor, right[self._free]))

    def covariances(self, factors: Factors) -> FloatArray:
        """Covariances (f, d, d) of what factors measure, by their derivatives."""
        columns = self.nodes.columns_of(factors.keys)
        count, height, _ = factors.jacobian.shape
        covariances = np.empty((count, height, height))
        # A few at a time, since each needs dense columns of all unknowns.
        for begin in range(0, count, _AT_ONCE):
            part = slice(begin, begin + _AT_ONCE)
            by = factors.jacobian[part]
            places = np.arange(len(by) * height).reshape(-1, 1, height)
            right = np.zeros((self.nodes.size, places.size))
            right[columns[part, :, None], places] = by.transpose(0, 2, 1)
            white = self.whitened(right).reshape(-1, len(by), height)
            covariances[part] = np.einsum("nfd,nfe->fde", white, white)
        return covariances

    def covariance_of_last(self, count: int) -> FloatArray:
        """Joint covariance (count, count) of the last unknowns of an order, all of which are
        coupled to each other.
        """
        panels, factor = self.factorise()
        # What is coupled to each other and to nothing later is one panel.
        height = panels.tops[-1] - panels.tops[-2]
        last = factor[panels.begins[-2] :].reshape(-1, height)[-count:, -count:]
        inverse = np.linalg.inv(np.triu(last))
        return np.asarray(inverse @ inverse.T)

    def marginals(self, kind: str) -> FloatArray:
        """Covariances (count, width, width) of all nodes of a kind; 0 where they are fixed."""
        panels, factor = self.factorise()
        inverse = cholesky.selected_inverse(panels, factor)
        columns = self.nodes.columns(kind)
        ranks = self._ranks[self.nodes.owners[columns[:, 0]]]
        is_free = ranks < len(panels.owners)
        ranks = ranks[is_free, None, None]
        owners = panels.owners[ranks]
        low, high = np.sort(np.indices((columns.shape[1],) * 2), axis=0)
        begin = panels.starts[ranks] - panels.starts[panels.nodes[owners]]
        places = (begin + low) * np.diff(panels.tops)[owners] + begin + high
        covariances = np.zeros((*columns.shape, columns.shape[1]))
        covariances[is_free] = inverse[panels.begins[owners] + places]
        return covariances

    def _found_panels(self) -> cholesky.Panels:
        """The panels of the matrix, after the elimination has been ordered."""
        nodes = self.nodes
        count = len(nodes.widths)
        self._ranks = np.full(count, count)
        order = self._order
        if order is None:
            self._ranks[1:] = np.arange(count - 1)
            order = 1 + cholesky.sparse_order(self._coupled(count - 1))
        self._ranks[order] = np.arange(len(order))
        # The unknowns of nodes that are fixed come last.
        self._free = np.argsort(self._ranks[nodes.owners], kind="stable")
        self._panels = cholesky.panels(self._coupled(len(order)), nodes.widths[order])
        self._free = self._free[: self._panels.starts[-1]]
        return self._panels

    def _coupled(self, count: int) -> csc_matrix:
        """The lower half of a matrix (count, count) that has an entry for each node, and for each
        pair of nodes that share a factor.
        """
        pairs = [
            np.sort(self._ranks[numbers][:, np.tril_indices(numbers.shape[1])], axis=1)
            .transpose(1, 0, 2)
            .reshape(2, -1)
            for numbers in self._numbers
        ]
        columns, rows = np.hstack([*pairs, np.tile(np.arange(count), (2, 1))])
        free = rows < count
        entries = (np.ones(np.count_nonzero(free)), (rows[free], columns[free]))
        return csc_matrix(entries, shape=(count, count))


@kernel
def _add_products(
    order: IntArray,
    sums: IntArray,
    weighted: FloatArray,
    jacobian: FloatArray,
    errors: FloatArray,
    hessian: FloatArray,
    gradient: FloatArray,
) -> None:
    """Add J^T W J to sums (s, q, q), and J^T W e to sums (s, q), for factors (f,) in an order, each
    with its sum, with W J (f, d, q), J (f, d, q) and e (f, d).
    """
    for number in range(len(order)):
        factor = order[number]
        place = sums[number]
        for row in range(errors.shape[1]):
            for i in range(gradient.shape[1]):
                by = weighted[factor, row, i]
                gradient[place, i] += by * errors[factor, row]
                for j in range(gradient.shape[1]):
                    hessian[place, i, j] += by * jacobian[factor, row, j]
