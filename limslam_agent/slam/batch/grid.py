"""Occupancy grids of robots: counterpart of ``limslam_agent.grid.occupancy`` for a batch.

The batch keeps each robot's grid in a window that moves along: the cell (row, column) of the world,
counted from its origin, is stored at these numbers modulo the side of the window. When something is
seen outside of the window, the window is moved, and the cells that leave it are forgotten.
"""

import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.cells import SKIPPED, GridArray, StampArray, change_cells, touched_cells
from limslam_agent.kernels.tables import POSE
from limslam_agent.slam.batch.state import States
from limslam_agent.slam.consistent.pending_readings import Scan, Setup
from limslam_env.compilation import compiled
from limslam_env.geometry import FloatArray, IntArray

CropArray: TypeAlias = NDArray[np.uint8]

FREE = 127
OCCUPIED = 255


@compiled
def shift(grid: GridArray, window: IntArray, axis: int, low: int, high: int) -> None:
    """Move the window along an axis, no farther than necessary, to hold the cells from ``low`` to
    ``high``.

    If not all of them fit, the lower ones do.
    """
    side = grid.shape[0]
    first = window[axis]
    new = low if low < first else high - side + 1
    for entering in (
        range(max(new, first + side), new + side)
        if new > first
        else range(new, min(first, new + side))
    ):
        if axis == 0:
            grid[entering % side, :] = 0
        else:
            grid[:, entering % side] = 0
    window[axis] = new


@compiled
def update(state: States, scan: Scan, setup: Setup, stamps: StampArray, stamp: int) -> None:
    """Update a robot's grid by the new readings of a step.

    ``stamps`` (cells, cells) is scratch, and ``stamp`` a number that it does not contain yet.
    """
    settings: Any = setup.settings
    grid = state.grid
    window = state.window
    pose = state.belief.ekf.x[:POSE]
    cells = touched_cells(
        pose, scan.ranges, scan.measured, setup.table, settings.radius, settings.cell
    )
    side = grid.shape[0]
    for axis in range(2):
        low = cells[:, axis].min()
        high = cells[:, axis].max()
        if low < window[axis] or high >= window[axis] + side:
            shift(grid, window, axis, low, high)
    low = window[0]
    left_most = window[1]
    low_at = window[0] % side
    left_at = window[1] % side
    for i in range(len(cells)):
        row = cells[i, 0] - low
        column = cells[i, 1] - left_most
        # A cell that does not fit into the window, even after it has been moved, is skipped.
        if not (0 <= row < side and 0 <= column < side):
            cells[i, 2] = SKIPPED
        row = row + low_at
        column = column + left_at
        cells[i, 0] = row - side if row >= side else row
        cells[i, 1] = column - side if column >= side else column
    change_cells(grid, cells, stamps, stamp, settings.seen_through, settings.hit, settings.limit)


@compiled
def crop(pose: FloatArray, grid: GridArray, window: IntArray, cell: float, out: CropArray) -> None:
    """Fill ``out`` (size, size) with the grid around the robot, which is in the middle and looks
    up.

    Cells are 0 where unknown, ``FREE``, or ``OCCUPIED``.
    """
    size = out.shape[0]
    side = grid.shape[0]
    x = pose[0]
    y = pose[1]
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    low = float(window[0])
    left_most = float(window[1])
    # Where the window's first row and column are stored.
    low_at = float(window[0] % side)
    left_at = float(window[1] % side)
    places = np.empty(size, dtype=np.int32)
    values = np.empty(size, dtype=grid.dtype)
    cells = grid.reshape(-1)
    # Three loops without branches, so that the compiler takes several cells at once.
    for i in range(size):
        ahead = (0.5 * (size - 1) - i) * cell
        for j in range(size):
            left = (0.5 * (size - 1) - j) * cell
            row = np.floor((ahead * sin + left * cos + y) / cell) - low
            column = np.floor((ahead * cos - left * sin + x) / cell) - left_most
            is_inside = (row >= 0.0) & (row < side) & (column >= 0.0) & (column < side)
            row = row + low_at
            column = column + left_at
            row = row - side if row >= side else row
            column = column - side if column >= side else column
            places[j] = np.int32(row * side + column) if is_inside else -1
        for j in range(size):
            values[j] = cells[places[j]] if places[j] >= 0 else 0
        for j in range(size):
            out[i, j] = FREE if values[j] > 0 else OCCUPIED if values[j] < 0 else 0
