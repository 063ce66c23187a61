"""Triangular systems, solved without the threads of the linear algebra library.

``scipy.linalg.solve_triangular`` starts threads for matrices of any size when the library has more than one, and these
threads wait for each other longer than they compute. OpenBLAS solves for fewer than eight columns in one thread.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dtrsm, dtrsv

from limslam_env.geometry import FloatArray

Matrix = NDArray[np.floating[Any]]

_COLUMNS = 6


def solve_lower(factor: Matrix, values: Matrix) -> FloatArray:
    """Solve L x = b for a lower triangular matrix L, by the operations of ``solve_triangular`` in the same order.

    Parameters
    ----------
    factor
        L (n, n). What is above its diagonal is not read.
    values
        b (n,) or (n, k).

    Returns
    -------
    solution
        x, of the same shape as b.
    """
    # Rows in order are the columns of the transpose, which is how the library stores matrices.
    upper = factor.T
    if values.ndim == 1:
        return np.asarray(dtrsv(upper, values, lower=0, trans=1))
    if values.shape[1] == 1:
        return np.asarray(dtrsv(upper, values[:, 0], lower=0, trans=1)[:, None])
    solution = np.empty(values.shape, order="F")
    for begin in range(0, values.shape[1], _COLUMNS):
        part = slice(begin, begin + _COLUMNS)
        solution[:, part] = dtrsm(1.0, upper, values[:, part], lower=0, trans_a=1)
    return solution
