"""Memory for the next covariance of a filter whose state often grows and shrinks."""

import numpy as np

from limslam_env.geometry import FloatArray


class SpareMemory:
    """Two blocks of memory that take turns: one holds a covariance, and the other one the next covariance.

    Copies of an estimate are made often and need no spare memory: a copy has none.
    """

    def __init__(self) -> None:
        self._blocks = [np.empty(0), np.empty(0)]

    def square(self, size: int) -> FloatArray:
        """An uninitialised matrix (size, size) outside of the last one. Allocating one takes longer than filling it."""
        self._blocks.reverse()
        if self._blocks[0].size < size**2:
            self._blocks[0] = np.empty(2 * size**2)
        return self._blocks[0][: size**2].reshape(size, size)

    def __reduce__(self) -> tuple[type["SpareMemory"], tuple[()]]:
        return type(self), ()
