"""Coverage: the cells that rays cross and bodies touch.

The grid of one environment is handed over as ``seen`` and ``coverable`` (rows, columns), row 0 at
the bottom, and ``area``: the grid's lower left corner x, y and its cell side, m.

The unseen cells of many environments have one bit each. A *tile*, a word of 64 bits, stands for 8 x
8 cells, row by row from the lower left; the tiles of a grid follow each other in the same order. A
set bit is a coverable cell that has not been seen. Most rays cross no such cell, which a test of a
few words shows.
"""

import math

import numpy as np

from limslam_env.compilation import compiled, floored, inlined, merged
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.kernels.random_numbers import Words
from limslam_env.kernels.rays import crossings

# A body may overlap a wall by this much, m, and must not count as seeing the cells behind the wall.
BODY_MARGIN = 1e-3

# A ray ends this much of a cell before the wall that it hits, so that it never marks the cell
# behind the wall.
RAY_MARGIN = 1e-6

TILE = 8
"""Cells of a tile's side."""

LONGEST_LOOK = 16.0
"""Longest side of a rectangle, in cells, that three by three tiles hold wherever it lies."""

_NONE = np.uint64(0)
_ONE = np.uint64(1)
_TWO = np.uint64(2)
_EIGHT = np.uint64(8)
_SIXTEEN = np.uint64(16)
_FULL = np.uint64(0xFFFFFF)
_BYTE = np.uint64(0xFF)
_EACH_ROW = np.uint64(0x0101010101010101)

# Whole rows of a tile, for each set of rows as bits.
_ROW_MASKS = np.array(
    [sum(0xFF << 8 * row for row in range(8) if rows >> row & 1) for rows in range(256)], np.uint64
)


@merged
def mark_ray(
    seen: BoolArray,
    coverable: BoolArray,
    area: FloatArray,
    x: float,
    y: float,
    dx: float,
    dy: float,
    reach: float,
) -> int:
    """Set every cell that a ray crosses; the number of coverable cells that are new."""
    cell = area[2]
    x = (x - area[0]) / cell
    y = (y - area[1]) / cell
    end = reach / cell - RAY_MARGIN
    rows, columns = seen.shape
    column, column_step, next_column, per_column = crossings(x, dx, 1.0)
    row, row_step, next_row, per_row = crossings(y, dy, 1.0)
    travelled = 0.0
    new = 0
    while travelled <= end:
        if 0 <= row < rows and 0 <= column < columns and not seen[row, column]:
            seen[row, column] = True
            new += coverable[row, column]
        if next_column < next_row:
            travelled = next_column
            next_column += per_column
            column += column_step
        else:
            travelled = next_row
            next_row += per_row
            row += row_step
    return new


@inlined
def is_touched(column: int, row: int, x: float, y: float, radius: float) -> bool:
    """Whether a disc touches a cell; all in cells."""
    aside = x - min(max(x, column), column + 1.0)
    above = y - min(max(y, row), row + 1.0)
    return aside * aside + above * above < radius * radius


@merged
def mark_disc(
    seen: BoolArray, coverable: BoolArray, area: FloatArray, x: float, y: float, radius: float
) -> int:
    """Set every cell that a body touches; the number of coverable cells that are new."""
    cell = area[2]
    x = (x - area[0]) / cell
    y = (y - area[1]) / cell
    radius = (radius - BODY_MARGIN) / cell
    rows, columns = seen.shape
    new = 0
    for row in range(math.floor(y - radius), math.floor(y + radius) + 1):
        for column in range(math.floor(x - radius), math.floor(x + radius) + 1):
            if (
                is_touched(column, row, x, y, radius)
                and 0 <= row < rows
                and 0 <= column < columns
                and not seen[row, column]
            ):
                seen[row, column] = True
                new += coverable[row, column]
    return new


@merged
def unseen_nearby(
    left: Words,
    env: int,
    tile_columns: int,
    tile_rows: int,
    low_x: float,
    low_y: float,
    high_x: float,
    high_y: float,
) -> np.uint64:
    """Which unseen cells touch a rectangle of at most ``LONGEST_LOOK`` cells a side: 0 if there is
    none.

    The rectangle lies in the grid, and is given in cells. The words of its three by three tiles are
    joined, so that other numbers than 0 mean nothing more. No branches, no loops, no signed places
    in arrays: this is done for each ray and each body in each step, several at once.
    """
    column0 = max(int(low_x), 0)
    column1 = min(int(high_x), tile_columns * TILE - 1)
    row0 = max(int(low_y), 0)
    row1 = min(int(high_y), tile_rows * TILE - 1)
    tile_column = column0 >> 3
    tile_row = row0 >> 3
    columns = _between(column0 - TILE * tile_column, column1 - TILE * tile_column)
    rows = _between(row0 - TILE * tile_row, row1 - TILE * tile_row)
    left_columns = (columns & _BYTE) * _EACH_ROW
    middle_columns = ((columns >> _EIGHT) & _BYTE) * _EACH_ROW
    right_columns = ((columns >> _SIXTEEN) & _BYTE) * _EACH_ROW
    line = np.uint64(env)
    low = np.uint64(tile_row * tile_columns + tile_column)
    middle = low + np.uint64(tile_columns)
    high = middle + np.uint64(tile_columns)
    low_words = (left[line, low] & left_columns) | (left[line, low + _ONE] & middle_columns)
    low_words |= left[line, low + _TWO] & right_columns
    middle_words = (left[line, middle] & left_columns) | (
        left[line, middle + _ONE] & middle_columns
    )
    middle_words |= left[line, middle + _TWO] & right_columns
    high_words = (left[line, high] & left_columns) | (left[line, high + _ONE] & middle_columns)
    high_words |= left[line, high + _TWO] & right_columns
    found: np.uint64 = (
        (low_words & _ROW_MASKS[rows & _BYTE])
        | (middle_words & _ROW_MASKS[(rows >> _EIGHT) & _BYTE])
        | (high_words & _ROW_MASKS[(rows >> _SIXTEEN) & _BYTE])
    )
    return found


@inlined
def _between(low: int, high: int) -> np.uint64:
    """Bits ``low`` to ``high`` of the first 24."""
    return (_FULL >> np.uint64(23 - high)) & (_FULL << np.uint64(low))


@inlined
def take(left: Words, env: int, tile_columns: int, column: int, row: int) -> int:
    """Take a cell out of the unseen cells; 1 if it was one of them, else 0."""
    tile = (row >> 3) * tile_columns + (column >> 3)
    bit = _ONE << np.uint64((row & 7) * 8 + (column & 7))
    word = left[env, tile]
    new = 1 if word & bit else 0
    left[env, tile] = word & ~bit
    return new


@compiled
def walk_ray(
    left: Words,
    env: int,
    tile_columns: int,
    tile_rows: int,
    x: float,
    y: float,
    dx: float,
    dy: float,
    end: float,
) -> int:
    """Take every cell that a ray crosses out of the unseen cells; returns how many there were.

    The counterpart of :func:`mark_ray`. Lengths are in cells; the ray lies in the grid.
    """
    columns = tile_columns * TILE
    rows = tile_rows * TILE
    column, column_step, next_column, per_column = crossings(x, dx, 1.0)
    row, row_step, next_row, per_row = crossings(y, dy, 1.0)
    travelled = 0.0
    new = 0
    while travelled <= end:
        if 0 <= row < rows and 0 <= column < columns:
            new += take(left, env, tile_columns, column, row)
        # The axis is unpredictable: values are selected, because a branch would often be
        # mispredicted.
        is_column = next_column < next_row
        travelled = next_column if is_column else next_row
        column += column_step if is_column else 0
        row += 0 if is_column else row_step
        next_column = next_column + per_column if is_column else next_column
        next_row = next_row if is_column else next_row + per_row
    return new


@compiled
def walk_disc(
    left: Words, env: int, tile_columns: int, tile_rows: int, x: float, y: float, radius: float
) -> int:
    """Take every cell that a body touches out of the unseen cells; returns how many there were.

    The counterpart of :func:`mark_disc`. Lengths are in cells.
    """
    columns = tile_columns * TILE
    rows = tile_rows * TILE
    new = 0
    for row in range(max(floored(y - radius), 0), min(floored(y + radius), rows - 1) + 1):
        for column in range(max(floored(x - radius), 0), min(floored(x + radius), columns - 1) + 1):
            if is_touched(column, row, x, y, radius):
                new += take(left, env, tile_columns, column, row)
    return new
