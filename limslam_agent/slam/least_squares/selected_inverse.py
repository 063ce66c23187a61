"""The entries of the inverse of a sparse matrix where its factors have entries: compiled."""

import numpy as np

from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)


@kernel
def selected_inverse(
    firsts: IntArray, rows: IntArray, lower: FloatArray, pivots: FloatArray, inverse: FloatArray
) -> None:
    """Entries of (L D L^T)^-1 where L has entries, from the last column to the first.

    K. Takahashi, J. Fagan and M. Chin, "Formation of a sparse bus impedance matrix and its application to short circuit
    study", 1973: z_ij = -sum over k of z_ik l_kj for i > j, and z_jj = 1 / d_j - sum over k of z_kj l_kj.

    Parameters
    ----------
    firsts, rows, lower
        The columns of L by their first entries (n + 1,), and the row and value of each entry (e,). The diagonal, which
        is 1, is the first entry of each column.
    pivots
        The diagonal (n,) of D.
    inverse
        Output array (e,).
    """
    own, total = np.zeros(len(pivots)), np.zeros(len(pivots))
    for column in range(len(pivots) - 1, -1, -1):
        begin, end = firsts[column] + 1, firsts[column + 1]
        for entry in range(begin, end):
            own[rows[entry]], total[rows[entry]] = lower[entry], 0.0
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
