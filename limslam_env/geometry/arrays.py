"""Names for the array types that appear in signatures."""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.signedinteger[Any]]
ReadingArray: TypeAlias = NDArray[np.float32]


def no_rows(width: int) -> FloatArray:
    """An array of no rows (0, width)."""
    return np.zeros((0, width))
