"""The believed grid around a robot as a picture, compiled, since a learner gets a picture at every step."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from limslam_agent.grid.occupancy import GridView
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray

UNKNOWN, FREE, OCCUPIED = 0, 127, 255
"""Values of a picture's cells."""

_Picture: TypeAlias = NDArray[np.uint8]


def crop(grid: GridView, pose: FloatArray, size: int) -> _Picture:
    """The grid (size, size) around a robot at ``pose`` (3,), m and rad, which is in the middle and looks up."""
    picture: _Picture = np.empty((size, size), dtype=np.uint8)
    # One kind of array, or the kernel would be compiled for each kind: views are read-only and not contiguous.
    _fill(np.array(grid.values), np.asarray(grid.low, dtype=float), np.asarray(pose, dtype=float), grid.cell, picture)
    return picture


@entry_of("limslam_agent.wrappers.crop", allocates=False)
def _fill(values: NDArray[np.int16], low: FloatArray, pose: FloatArray, cell: float, picture: _Picture) -> None:
    (rows, columns), size = values.shape, picture.shape[0]
    x, y, cos, sin = pose[0] - low[0], pose[1] - low[1], math.cos(pose[2]), math.sin(pose[2])
    for i in range(size):
        ahead = (0.5 * (size - 1) - i) * cell
        for j in range(size):
            left = (0.5 * (size - 1) - j) * cell
            row = math.floor((ahead * sin + left * cos + y) / cell)
            column = math.floor((ahead * cos - left * sin + x) / cell)
            value = values[row, column] if 0 <= row < rows and 0 <= column < columns else 0
            picture[i, j] = FREE if value > 0 else OCCUPIED if value < 0 else UNKNOWN
