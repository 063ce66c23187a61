"""Occupancy grids: the cells that a step's beams touch, and how their values change."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.compilation import compiled, entry
from limslam_agent.kernels.tables import (
    FROM_X,
    FROM_Y,
    TOO_FAR,
    TOO_NEAR,
    TOWARDS_X,
    TOWARDS_Y,
    Cells,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray

GridArray: TypeAlias = NDArray[np.int8] | NDArray[np.int16]
StampArray: TypeAlias = NDArray[np.int32]

SKIPPED = 0
CROSSED = 1
ENDED = 2
"""What happened in a touched cell: nothing that counts, a beam or the body crossed it, or a beam
ended in it.
"""

_ANGLES = np.arange(8) * (np.pi / 4)

BODY = np.vstack((np.zeros((1, 2)), 0.7 * np.column_stack((np.cos(_ANGLES), np.sin(_ANGLES)))))
"""Points (9, 2) of the robot's body that are certainly free, in shares of its radius."""


@compiled
def touched_cells(
    pose: FloatArray,
    ranges: FloatArray | ReadingArray,
    measured: BoolArray,
    beams: FloatArray,
    radius: float,
    cell: float,
) -> IntArray:
    """The cells of the world that the beams and the body of a robot touch.

    The robot is at a pose (3,), and those of its readings (b,), m, count that were ``measured``.
    ``beams`` is ``RobotSpec.beam_table``. Cells (n, 3) are row and column, counted from the world's
    origin, and ``CROSSED``, ``ENDED``, or ``SKIPPED`` where a beam that saw nothing ended. They may
    repeat, and those in which a beam ended come first.
    """
    x = pose[0]
    y = pose[1]
    cos = math.cos(pose[2])
    sin = math.sin(pose[2])
    spacing = 0.5 * cell
    most = len(BODY)
    # A reading at the minimum says that something is near, or that the sensor is dirty, but not
    # where.
    used = np.empty(len(ranges), dtype=np.int64)
    count = 0
    for i in range(len(ranges)):
        if measured[i] and ranges[i] > beams[i, TOO_NEAR]:
            used[count] = i
            count += 1
            most += math.floor(float(ranges[i]) / spacing) + 1
    used = used[:count]
    cells = np.empty((most, 3), dtype=np.int64)
    size = 0
    samples = np.empty((2, most))
    for beam in used:
        length = float(ranges[beam])
        px = beams[beam, FROM_X] + length * beams[beam, TOWARDS_X]
        py = beams[beam, FROM_Y] + length * beams[beam, TOWARDS_Y]
        cells[size, 0] = math.floor((px * sin + py * cos + y) / cell)
        cells[size, 1] = math.floor((px * cos - py * sin + x) / cell)
        cells[size, 2] = ENDED if length < beams[beam, TOO_FAR] else SKIPPED
        size += 1
    for beam in used:
        number = math.floor(float(ranges[beam]) / spacing)
        from_x = beams[beam, FROM_X]
        from_y = beams[beam, FROM_Y]
        towards_x = beams[beam, TOWARDS_X]
        towards_y = beams[beam, TOWARDS_Y]
        # A loop without branches, so that the compiler takes several samples at once.
        for i in range(number):
            px = from_x + i * spacing * towards_x
            py = from_y + i * spacing * towards_y
            samples[0, i] = np.floor((px * sin + py * cos + y) / cell)
            samples[1, i] = np.floor((px * cos - py * sin + x) / cell)
        for i in range(number):
            # Samples are half a cell apart, so that many lie in the same cell as the one before.
            if i and samples[0, i] == samples[0, i - 1] and samples[1, i] == samples[1, i - 1]:
                continue
            cells[size, 0] = int(samples[0, i])
            cells[size, 1] = int(samples[1, i])
            cells[size, 2] = CROSSED
            size += 1
    for k in range(len(BODY)):
        cells[size, 0] = math.floor((y + radius * BODY[k, 1]) / cell)
        cells[size, 1] = math.floor((x + radius * BODY[k, 0]) / cell)
        cells[size, 2] = CROSSED
        size += 1
    return cells[:size]


@compiled
def change_cells(
    values: GridArray,
    cells: IntArray,
    stamps: StampArray,
    stamp: int,
    seen_through: int,
    hit: int,
    limit: int,
) -> None:
    """Change the values of touched cells, each of them once, however many beams touch it.

    ``seen_through`` is added to the values (rows, columns) where a beam crossed, ``hit`` is
    subtracted where one ended, and ``limit`` is the largest absolute value. Of a cell that repeats,
    the first row counts. ``stamps`` (rows, columns) is scratch, and ``stamp`` a number that it does
    not contain yet.
    """
    for i in range(len(cells)):
        row = cells[i, 0]
        column = cells[i, 1]
        if cells[i, 2] == SKIPPED or stamps[row, column] == stamp:
            continue
        stamps[row, column] = stamp
        amount = -hit if cells[i, 2] == ENDED else seen_through
        value = min(max(values[row, column] + amount, -limit), limit)
        # The value 0 is reserved for unknown cells.
        values[row, column] = value or (1 if amount > 0 else -1)


@entry
def update_grid(
    pose: FloatArray,
    ranges: FloatArray,
    measured: BoolArray,
    body: tuple[FloatArray, float],
    grid: Cells,
    stamp: int,
    touched: IntArray,
) -> bool:
    """Update a grid by one step's readings, if it holds all cells that they touch; whether it does.

    The first arguments are those of :func:`touched_cells`, with the beams and the radius as the
    ``body``. ``stamp`` is the number of the update. ``touched`` (2, 2) is set to the first column
    and row that are touched, and to those after the last ones.
    """
    beams, radius = body
    cells = touched_cells(pose, ranges, measured, beams, radius, grid.size)
    for axis in range(2):
        touched[0, axis] = touched[1, axis] = cells[0, 1 - axis]
        for i in range(len(cells)):
            touched[0, axis] = min(touched[0, axis], cells[i, 1 - axis])
            touched[1, axis] = max(touched[1, axis], cells[i, 1 - axis])
        touched[1, axis] += 1
    for axis in range(2):
        end = grid.corner[axis] + grid.values.shape[1 - axis]
        if touched[0, axis] < grid.corner[axis] or touched[1, axis] > end:
            return False
    for i in range(len(cells)):
        cells[i, 0] -= grid.corner[1]
        cells[i, 1] -= grid.corner[0]
    seen_through, hit, limit = grid.rules
    change_cells(grid.values, cells, grid.stamps, stamp, seen_through, hit, limit)
    return True
