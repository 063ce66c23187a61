"""Regions of a grid: groups of cells that touch, and frontiers."""

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.compilation import compiled, entry, lean_entry
from limslam_env.geometry import BoolArray, IntArray


@compiled
def has_group(cells: BoolArray, row: int, column: int, least: int, found: IntArray) -> bool:
    """Whether the cell at a row and a column is in a group, corners touching, of at least ``least`` of the cells.

    ``found`` (least, 2) is scratch.
    """
    rows, columns = cells.shape
    found[0, 0], found[0, 1] = row, column
    count, done = 1, 0
    while done < count < least:
        for down in range(max(found[done, 0] - 1, 0), min(found[done, 0] + 2, rows)):
            for right in range(max(found[done, 1] - 1, 0), min(found[done, 1] + 2, columns)):
                is_new = cells[down, right] and count < least
                # So few cells are searched that no mark of the cells found is needed.
                for k in range(count):
                    is_new = is_new and not (found[k, 0] == down and found[k, 1] == right)
                if is_new:
                    found[count, 0], found[count, 1] = down, right
                    count += 1
        done += 1
    return count >= least


@compiled
def is_between_walls(values: NDArray[np.int16], row: int, column: int) -> bool:
    """Whether a cell lies between two occupied ones, on opposite sides of it."""
    rows, columns = values.shape
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        if (
            row - down >= 0
            and row + down < rows
            and 0 <= column - right < columns
            and 0 <= column + right < columns
            and values[row - down, column - right] < 0
            and values[row + down, column + right] < 0
        ):
            return True
    return False


@lean_entry
def mark_frontier(
    values: NDArray[np.int16], ignored: BoolArray, least: int, pocket: int, close_gaps: bool,
    unknown: BoolArray, beside: BoolArray, chosen: BoolArray, found: IntArray,
) -> None:  # fmt: skip
    """Mark free cells (rows, columns) beside unknown ones, in groups.

    Parameters
    ----------
    values
        The grid (rows, columns): positive is free, negative is occupied, 0 is unknown. Cells beyond it are unknown.
    ignored
        Cells (rows, columns) that are no frontiers; an array without cells if there are none.
    least, pocket
        Least number of cells of a group, and of an unknown region that makes frontiers.
    close_gaps
        Whether an unknown cell between two occupied ones counts as wall.
    unknown, beside, found
        Scratch: (rows + 2, columns + 2), all of them set; (rows, columns); and (n, 2), where n is ``least`` and
        ``pocket`` at least.
    chosen
        Set to the frontier cells (rows, columns).
    """
    rows, columns = values.shape
    for row in range(rows):
        for column in range(columns):
            is_closed = close_gaps and values[row, column] == 0 and is_between_walls(values, row, column)
            unknown[row + 1, column + 1] = values[row, column] == 0 and not is_closed
    for row in range(rows):
        for column in range(columns):
            beside[row, column] = False
            if values[row, column] <= 0 or (ignored.size and ignored[row, column]):
                continue
            for down, right in ((0, 1), (1, 0), (2, 1), (1, 2)):
                if unknown[row + down, column + right] and has_group(
                    unknown, row + down, column + right, pocket, found
                ):
                    beside[row, column] = True
                    break
    for row in range(rows):
        for column in range(columns):
            chosen[row, column] = beside[row, column] and has_group(beside, row, column, least, found)


@entry
def group_around(cells: BoolArray, row: int, column: int, corners: bool) -> BoolArray:
    """The group of the cells (rows, columns) that one of them belongs to; ``corners`` says whether corners touch."""
    rows, columns = cells.shape
    group, stack = np.zeros((rows, columns), dtype=np.bool_), np.empty((rows * columns, 2), dtype=np.int64)
    group[row, column], stack[0, 0], stack[0, 1], size = True, row, column, 1
    while size:
        size -= 1
        at_row, at_column = stack[size, 0], stack[size, 1]
        for down in range(max(at_row - 1, 0), min(at_row + 2, rows)):
            for right in range(max(at_column - 1, 0), min(at_column + 2, columns)):
                touches = corners or down == at_row or right == at_column
                if touches and cells[down, right] and not group[down, right]:
                    group[down, right] = True
                    stack[size, 0], stack[size, 1] = down, right
                    size += 1
    return group
