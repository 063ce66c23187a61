"""Occupancy grids of robots: counterpart of ``limslam_agent.grid.occupancy`` for a batch.

The batch keeps each robot's grid in a window that moves along: the cell (row, column) of the world, counted from its
origin, is stored at these numbers modulo the side of the window. When something is seen outside of the window, the
window is moved, and the cells that leave it are forgotten.
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.cells import SKIPPED, GridArray, StampArray, change_cells, touched_cells
from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.batch.state import Settings
from limslam_env.geometry import BoolArray, FloatArray, IntArray

CropArray: TypeAlias = NDArray[np.uint8]

FREE, OCCUPIED = 127, 255


@compiled
def shift(grid: GridArray, window: IntArray, axis: int, low: int, high: int) -> None:
    """Move the window along an axis, no farther than necessary, to hold the cells from ``low`` to ``high``.

    If not all of them fit, the lower ones do.
    """
    side, first = grid.shape[0], window[axis]
    new = low if low < first else high - side + 1
    for entering in range(max(new, first + side), new + side) if new > first else range(new, min(first, new + side)):
        if axis == 0:
            grid[entering % side, :] = 0
        else:
            grid[:, entering % side] = 0
    window[axis] = new


@compiled
def update(
    pose: FloatArray, grid: GridArray, window: IntArray, ranges: FloatArray, measured: BoolArray, settings: Settings,
    beams: FloatArray, stamps: StampArray, stamp: int,
) -> None:  # fmt: skip
    """Update a grid by one step's readings (b,), m, of which those ``measured`` (b,) are new.

    ``stamps`` (cells, cells) is scratch, and ``stamp`` a number that it does not contain yet.
    """
    cells, side = touched_cells(pose, ranges, measured, beams, settings.radius, settings.cell), grid.shape[0]
    for axis in range(2):
        low, high = cells[:, axis].min(), cells[:, axis].max()
        if low < window[axis] or high >= window[axis] + side:
            shift(grid, window, axis, low, high)
    top, right = window[0] + side, window[1] + side
    for i in range(len(cells)):
        # A cell that does not fit into the window, even after it has been moved, is skipped.
        if not (window[0] <= cells[i, 0] < top and window[1] <= cells[i, 1] < right):
            cells[i, 2] = SKIPPED
        cells[i, 0] %= side
        cells[i, 1] %= side
    change_cells(grid, cells, stamps, stamp, settings.seen_through, settings.hit, settings.limit)


@compiled
def crop(pose: FloatArray, grid: GridArray, window: IntArray, cell: float, out: CropArray) -> None:
    """Fill ``out`` (size, size) with the grid around the robot, which is in the middle and looks up.

    Cells are 0 where unknown, ``FREE``, or ``OCCUPIED``.
    """
    size, side, low, left_most = out.shape[0], grid.shape[0], window[0], window[1]
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    # Where the window's first row and column are stored.
    low_at, left_at = low % side, left_most % side
    for i in range(size):
        ahead = (0.5 * (size - 1) - i) * cell
        for j in range(size):
            left = (0.5 * (size - 1) - j) * cell
            row = math.floor((ahead * sin + left * cos + y) / cell) - low
            column = math.floor((ahead * cos - left * sin + x) / cell) - left_most
            value = 0
            if 0 <= row < side and 0 <= column < side:
                row, column = row + low_at, column + left_at
                value = grid[row - side if row >= side else row, column - side if column >= side else column]
            out[i, j] = FREE if value > 0 else OCCUPIED if value < 0 else 0
