"""The occupancy grid of one robot, in a window that goes along: `occupancy` and the wrapper's crop, for kernels.

The cell (row, column) of the world, counted from its origin, is kept at those numbers modulo the side of the window.
When something is seen outside of the window, it is moved there, and the cells that it leaves are forgotten.
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.batch.state import FROM_X, FROM_Y, TOO_FAR, TOO_NEAR, TOWARDS_X, TOWARDS_Y, Settings
from limslam_env.geometry import BoolArray, FloatArray, IntArray

GridArray: TypeAlias = NDArray[np.int16]
MarkArray: TypeAlias = NDArray[np.uint8]

FREE, OCCUPIED = 127, 255
_CROSSED, _ENDED = 1, 2
_AROUND = 8
_BODY = 0.7  # share of the robot's radius


@compiled
def touched(
    pose: FloatArray, ranges: FloatArray, measured: BoolArray, settings: Settings, beams: FloatArray
) -> IntArray:
    """The cells (n, 3) that beams and body touch: row, column, and whether a beam crossed or ended."""
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    spacing, most = 0.5 * settings.cell, _AROUND + 1
    for beam in range(len(ranges)):
        if measured[beam] and ranges[beam] > beams[beam, TOO_NEAR]:
            most += math.floor(ranges[beam] / spacing) + 1
    places, kinds, size = np.empty((most, 2)), np.full(most, _CROSSED), 0
    for beam in range(len(ranges)):
        length = ranges[beam]
        if not (measured[beam] and length > beams[beam, TOO_NEAR]):
            continue
        count = math.floor(length / spacing)
        ended = length < beams[beam, TOO_FAR]
        for i in range(count + ended):
            along = i * spacing if i < count else length
            px = beams[beam, FROM_X] + along * beams[beam, TOWARDS_X]
            py = beams[beam, FROM_Y] + along * beams[beam, TOWARDS_Y]
            places[size, 0], places[size, 1] = px * cos - py * sin + x, px * sin + py * cos + y
            size += 1
        if ended:
            kinds[size - 1] = _ENDED
    places[size, 0], places[size, 1] = x, y
    for k in range(_AROUND):
        size += 1
        places[size, 0] = x + settings.radius * (_BODY * math.cos(k * (np.pi / 4)))
        places[size, 1] = y + settings.radius * (_BODY * math.sin(k * (np.pi / 4)))
    cells = np.empty((size + 1, 3), dtype=np.int64)
    for i in range(size + 1):
        cells[i, 0] = math.floor(places[i, 1] / settings.cell)
        cells[i, 1] = math.floor(places[i, 0] / settings.cell)
        cells[i, 2] = kinds[i]
    return cells


@compiled
def shift(grid: GridArray, window: IntArray, axis: int, low: int, high: int) -> None:
    """Move the window along an axis, no farther than it must, to hold the cells from ``low`` to ``high``.

    If both do not fit, the lower ones do.
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
def see(
    pose: FloatArray, grid: GridArray, window: IntArray, ranges: FloatArray, measured: BoolArray, settings: Settings,
    beams: FloatArray, marks: MarkArray,
) -> None:  # fmt: skip
    """Take in one step's readings (b,), m, of which some are new. ``marks`` (cells, cells) are zero, and stay so."""
    cells, side = touched(pose, ranges, measured, settings, beams), grid.shape[0]
    for axis in range(2):
        low, high = cells[:, axis].min(), cells[:, axis].max()
        if low < window[axis] or high >= window[axis] + side:
            shift(grid, window, axis, low, high)
    top, right = window[0] + side, window[1] + side
    for i in range(len(cells)):
        # What does not even fit into a window that has been moved is left out.
        if not (window[0] <= cells[i, 0] < top and window[1] <= cells[i, 1] < right):
            cells[i, 2] = 0
        row, column = cells[i, 0] % side, cells[i, 1] % side
        marks[row, column] = max(marks[row, column], cells[i, 2])
    for i in range(len(cells)):
        row, column = cells[i, 0] % side, cells[i, 1] % side
        if not (cells[i, 2] and marks[row, column]):
            continue
        # Each cell counts once a step, however many beams touch it; where one ended, it is a wall.
        amount = -settings.hit if marks[row, column] == _ENDED else settings.seen_through
        marks[row, column] = 0
        value = min(max(grid[row, column] + amount, -settings.limit), settings.limit)
        # 0 is kept for cells about which nothing is known.
        grid[row, column] = value or (1 if amount > 0 else -1)


@compiled
def crop(pose: FloatArray, grid: GridArray, window: IntArray, cell: float, out: MarkArray) -> None:
    """The grid around the robot (size, size), which is in the middle and looks up: unknown, free or occupied."""
    size, side, low, left_most = out.shape[0], grid.shape[0], window[0], window[1]
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    # Rows and columns of the window, and where they are kept.
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
