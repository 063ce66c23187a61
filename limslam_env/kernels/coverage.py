"""Coverage: the cells that rays cross and bodies touch.

A coverage grid is handed over as ``seen`` and ``coverable`` (rows, columns), row 0 at the bottom, and ``area``: the
grid's lower left corner x, y and its cell side, m.
"""

import math

from limslam_env.compilation import inlined, merged
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.kernels.rays import crossings

# A body may overlap a wall by this much, m, and must not count as seeing the cells behind the wall.
BODY_MARGIN = 1e-3

# A ray ends this much of a cell before the wall that it hits, so that it never marks the cell behind the wall.
RAY_MARGIN = 1e-6


@merged
def mark_ray(
    seen: BoolArray, coverable: BoolArray, area: FloatArray, x: float, y: float, dx: float, dy: float, reach: float
) -> int:
    """Set every cell that a ray crosses; the number of coverable cells that are new."""
    cell = area[2]
    x, y = (x - area[0]) / cell, (y - area[1]) / cell
    end = reach / cell - RAY_MARGIN
    rows, columns = seen.shape
    column, column_step, next_column, per_column = crossings(x, dx, 1.0)
    row, row_step, next_row, per_row = crossings(y, dy, 1.0)
    travelled, new = 0.0, 0
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
def mark_disc(seen: BoolArray, coverable: BoolArray, area: FloatArray, x: float, y: float, radius: float) -> int:
    """Set every cell that a body touches; the number of coverable cells that are new."""
    cell = area[2]
    x, y, radius = (x - area[0]) / cell, (y - area[1]) / cell, (radius - BODY_MARGIN) / cell
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
