"""Coverage: the cells that rays cross and bodies touch.

The grid of one environment is a :class:`CellGrid`.

The unseen cells of many environments have one bit each. A *tile*, a word of 64 bits, stands for 8 x
8 cells, row by row from the lower left; the tiles of a grid follow each other in the same order. A
set bit is a coverable cell that has not been seen. Most rays cross no such cell, which a test of a
few words shows.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_env.compilation import compiled, floored, inlined, merged
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.kernels.random_numbers import Words
from limslam_env.kernels.rays import Ray, crossings

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


class CellGrid(NamedTuple):
    """The coverage of one environment.

    Attributes
    ----------
    seen, coverable
        Cells (rows, columns) that have been seen, and those that count; row 0 is at the bottom.
    area
        Lower left corner x, y of the grid and side of a cell (3,), m.
    """

    seen: BoolArray
    coverable: BoolArray
    area: FloatArray


class TileGrid(NamedTuple):
    """The unseen cells of an environment: its row of ``unseen``, the tiles in a row and in a
    column, and lower left corner and side of a cell, m.
    """

    unseen: Words
    env: int
    columns: int
    rows: int
    low_x: float
    low_y: float
    cell: float


@merged
def mark_ray(grid: CellGrid, ray: Ray) -> int:
    """Set every cell that a ray crosses; the number of coverable cells that are new."""
    cell = grid.area[2]
    end = ray.reach / cell - RAY_MARGIN
    seen = grid.seen
    coverable = grid.coverable
    rows, columns = seen.shape
    x = (ray.x - grid.area[0]) / cell
    y = (ray.y - grid.area[1]) / cell
    column, column_step, next_column, per_column = crossings(x, ray.dx, 1.0)
    row, row_step, next_row, per_row = crossings(y, ray.dy, 1.0)
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
def mark_disc(grid: CellGrid, x: float, y: float, radius: float) -> int:
    """Set every cell that a body touches; the number of coverable cells that are new."""
    seen = grid.seen
    coverable = grid.coverable
    cell = grid.area[2]
    x = (x - grid.area[0]) / cell
    y = (y - grid.area[1]) / cell
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
    grid: TileGrid, low_x: float, low_y: float, high_x: float, high_y: float
) -> np.uint64:
    """Which unseen cells touch a rectangle of at most ``LONGEST_LOOK`` cells a side: 0 if there is
    none.

    The rectangle lies in the grid, and is given in cells. The words of its three by three tiles are
    joined, so that other numbers than 0 mean nothing more. No branches, no loops, no signed places
    in arrays: this is done for each ray and each body in each step, several at once.
    """
    left = grid.unseen
    column0 = max(int(low_x), 0)
    column1 = min(int(high_x), grid.columns * TILE - 1)
    row0 = max(int(low_y), 0)
    row1 = min(int(high_y), grid.rows * TILE - 1)
    tile_column = column0 >> 3
    tile_row = row0 >> 3
    columns = _between(column0 - TILE * tile_column, column1 - TILE * tile_column)
    rows = _between(row0 - TILE * tile_row, row1 - TILE * tile_row)
    left_columns = (columns & _BYTE) * _EACH_ROW
    middle_columns = ((columns >> _EIGHT) & _BYTE) * _EACH_ROW
    right_columns = ((columns >> _SIXTEEN) & _BYTE) * _EACH_ROW
    line = np.uint64(grid.env)
    low = np.uint64(tile_row * grid.columns + tile_column)
    middle = low + np.uint64(grid.columns)
    high = middle + np.uint64(grid.columns)
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
def take(grid: TileGrid, column: int, row: int) -> int:
    """Take a cell out of the unseen cells; 1 if it was one of them, else 0."""
    tile = (row >> 3) * grid.columns + (column >> 3)
    bit = _ONE << np.uint64((row & 7) * 8 + (column & 7))
    word = grid.unseen[grid.env, tile]
    new = 1 if word & bit else 0
    grid.unseen[grid.env, tile] = word & ~bit
    return new


@compiled
def walk_ray(grid: TileGrid, ray: Ray) -> int:
    """Take every cell that a ray crosses out of the unseen cells; returns how many there were.

    The counterpart of :func:`mark_ray`. The ray lies in the grid.
    """
    columns = grid.columns * TILE
    rows = grid.rows * TILE
    end = ray.reach / grid.cell - RAY_MARGIN
    column, column_step, next_column, per_column = crossings(
        (ray.x - grid.low_x) / grid.cell, ray.dx, 1.0
    )
    row, row_step, next_row, per_row = crossings((ray.y - grid.low_y) / grid.cell, ray.dy, 1.0)
    travelled = 0.0
    new = 0
    while travelled <= end:
        if 0 <= row < rows and 0 <= column < columns:
            new += take(grid, column, row)
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
def walk_disc(grid: TileGrid, x: float, y: float, radius: float) -> int:
    """Take every cell that a body touches out of the unseen cells; returns how many there were.

    The counterpart of :func:`mark_disc`.
    """
    columns = grid.columns * TILE
    rows = grid.rows * TILE
    x = (x - grid.low_x) / grid.cell
    y = (y - grid.low_y) / grid.cell
    radius = (radius - BODY_MARGIN) / grid.cell
    new = 0
    for row in range(max(floored(y - radius), 0), min(floored(y + radius), rows - 1) + 1):
        for column in range(max(floored(x - radius), 0), min(floored(x + radius), columns - 1) + 1):
            if is_touched(column, row, x, y, radius):
                new += take(grid, column, row)
    return new
