"""Occupancy grids of robots: compiled counterpart of ``limslam_agent.grid.occupancy``.

:func:`touched_cells` and :func:`change_cells` are shared with the training of exploration policies. The batch keeps
each robot's grid in a window that moves along: the cell (row, column) of the world, counted from its origin, is stored
at these numbers modulo the side of the window. When something is seen outside of the window, the window is moved, and
the cells that leave it are forgotten.
"""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from limslam_agent.grid.occupancy import BODY
from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.batch.state import FROM_X, FROM_Y, TOO_FAR, TOO_NEAR, TOWARDS_X, TOWARDS_Y, Settings
from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray

GridArray: TypeAlias = NDArray[np.int8] | NDArray[np.int16]
CropArray: TypeAlias = NDArray[np.uint8]
StampArray: TypeAlias = NDArray[np.int32]

FREE, OCCUPIED = 127, 255
SKIPPED, CROSSED, ENDED = 0, 1, 2
"""What happened in a touched cell: nothing that counts, a beam or the body crossed it, or a beam ended in it."""


@compiled
def touched_cells(
    pose: FloatArray, ranges: FloatArray | ReadingArray, measured: BoolArray, beams: FloatArray, radius: float,
    cell: float,
) -> IntArray:  # fmt: skip
    """The cells of the world that the beams and the body of a robot touch.

    Parameters
    ----------
    pose
        (3,), m, m, rad.
    ranges, measured
        Readings (b,), m, and which of them are new.
    beams
        (b, 6 or more): origin x, y (m), direction x, y, and the ranges (m) up to and from which nothing is measured.
    radius, cell
        Of the body, and side of a cell, m.

    Returns
    -------
    cells
        (n, 3): row and column, counted from the world's origin, and ``CROSSED`` or ``ENDED``. Cells may repeat, and
        those in which a beam ended come first.
    """
    x, y, cos, sin = pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    spacing, most = 0.5 * cell, len(BODY)
    for beam in range(len(ranges)):
        if measured[beam] and ranges[beam] > beams[beam, TOO_NEAR]:
            most += math.floor(float(ranges[beam]) / spacing) + 1
    cells, size = np.empty((most, 3), dtype=np.int64), 0
    for beam in range(len(ranges)):
        length = float(ranges[beam])
        # A reading at the minimum says that something is near, or that the sensor is dirty, but not where.
        if measured[beam] and beams[beam, TOO_NEAR] < length < beams[beam, TOO_FAR]:
            px = beams[beam, FROM_X] + length * beams[beam, TOWARDS_X]
            py = beams[beam, FROM_Y] + length * beams[beam, TOWARDS_Y]
            cells[size, 0] = math.floor((px * sin + py * cos + y) / cell)
            cells[size, 1] = math.floor((px * cos - py * sin + x) / cell)
            cells[size, 2] = ENDED
            size += 1
    for beam in range(len(ranges)):
        length = float(ranges[beam])
        if not (measured[beam] and length > beams[beam, TOO_NEAR]):
            continue
        first = size
        for i in range(math.floor(length / spacing)):
            px = beams[beam, FROM_X] + i * spacing * beams[beam, TOWARDS_X]
            py = beams[beam, FROM_Y] + i * spacing * beams[beam, TOWARDS_Y]
            row = math.floor((px * sin + py * cos + y) / cell)
            column = math.floor((px * cos - py * sin + x) / cell)
            # Samples are half a cell apart, so that many lie in the same cell as the one before.
            if size > first and row == cells[size - 1, 0] and column == cells[size - 1, 1]:
                continue
            cells[size, 0], cells[size, 1], cells[size, 2] = row, column, CROSSED
            size += 1
    for k in range(len(BODY)):
        cells[size, 0] = math.floor((y + radius * BODY[k, 1]) / cell)
        cells[size, 1] = math.floor((x + radius * BODY[k, 0]) / cell)
        cells[size, 2] = CROSSED
        size += 1
    return cells[:size]


@compiled
def change_cells(
    values: GridArray, cells: IntArray, stamps: StampArray, stamp: int, seen_through: int, hit: int, limit: int
) -> None:
    """Change the values of touched cells, each of them once, however many beams touch it.

    Parameters
    ----------
    values
        (rows, columns), changed: positive is free, negative is occupied, 0 is unknown.
    cells
        (n, 3): row and column in ``values``, and what happened there. Of a cell that repeats, the first row counts.
    stamps, stamp
        Scratch (rows, columns), and a number that it does not contain yet.
    seen_through, hit, limit
        What is added where a beam crossed, what is subtracted where a beam ended, and the largest absolute value.
    """
    for i in range(len(cells)):
        row, column = cells[i, 0], cells[i, 1]
        if cells[i, 2] == SKIPPED or stamps[row, column] == stamp:
            continue
        stamps[row, column] = stamp
        amount = -hit if cells[i, 2] == ENDED else seen_through
        value = min(max(values[row, column] + amount, -limit), limit)
        # The value 0 is reserved for unknown cells.
        values[row, column] = value or (1 if amount > 0 else -1)


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
