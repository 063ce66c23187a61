"""Least-cost paths over the cells of a grid."""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.tables import STEPS
from limslam_env.geometry import BoolArray, FloatArray

# Steps to the eight neighbours of a cell, in the order in which they are tried.
_NEIGHBOURS = (*STEPS, *((-down, -right, length) for down, right, length in reversed(STEPS)))

Cells = NDArray[np.int32]


@compiled
def comes_first(cost: FloatArray, cell: int, other: int) -> bool:
    """Whether a search visits a cell before another one: the cheaper one, or of equally cheap ones
    the later one.
    """
    return bool(cost[cell] < cost[other] or (cost[cell] == cost[other] and cell > other))


@compiled
def rise(queue: Cells, places: Cells, cost: FloatArray, cell: int, place: int) -> None:
    """Put a cell into a binary heap at a place, or above it if the cell comes first."""
    while place > 0:
        above = (place - 1) // 2
        other = queue[above]
        if not comes_first(cost, cell, other):
            break
        queue[place] = other
        places[other] = place
        place = above
    queue[place] = cell
    places[cell] = place


@compiled
def sink(queue: Cells, places: Cells, cost: FloatArray, size: int, cell: int) -> None:
    """Put a cell into a binary heap of a size at its first place, or below it if other cells come
    first.
    """
    place = 0
    while 2 * place + 1 < size:
        below = 2 * place + 1
        if below + 1 < size and comes_first(cost, queue[below + 1], queue[below]):
            below += 1
        other = queue[below]
        if not comes_first(cost, other, cell):
            break
        queue[place] = other
        places[other] = place
        place = below
    queue[place] = cell
    places[cell] = place


@lean_entry
def search_paths(
    open_cells: BoolArray,
    prices: FloatArray,
    wanted: BoolArray,
    extra: FloatArray,
    start: int,
    queue: Cells,
    places: Cells,
    cost: FloatArray,
    before: Cells,
) -> None:
    """Find the least-cost paths from a cell to those around it.

    Of equally cheap cells, the one with the largest index is visited first. So paths of equal cost
    are chosen by the grid alone. Arrays of cells are (rows, columns), or (n,) with flat indices.

    Parameters
    ----------
    open_cells, prices
        Cells that can be entered, and the cost of a step of the length of a cell in each of them.
    wanted, extra
        The search ends when the cheapest of the wanted cells is known, with what it costs besides
        its path, m, at least 0; arrays without cells for no end, and for nothing.
    start, queue, places
        Where paths begin, and scratch (n,): a binary heap, and where each cell is in it.
    cost, before
        Costs (n,), all infinite, and the cells (n,) before each cell on its path, all negative.
        They are set where a path has been found.
    """
    rows, columns = open_cells.shape
    cost[start] = 0.0
    nearest = math.inf
    size = 1
    queue[0] = start
    places[start] = 0
    while size and cost[queue[0]] <= nearest:
        cell = queue[0]
        size = size - 1
        if size:
            sink(queue, places, cost, size, queue[size])
        row = cell // columns
        column = cell % columns
        so_far = cost[cell]
        if wanted.size and wanted[row, column]:
            nearest = min(nearest, so_far + (extra[row, column] if extra.size else 0.0))
        price = prices[row, column]
        for down, right, length in _NEIGHBOURS:
            to_row = row + down
            to_column = column + right
            if (
                not (0 <= to_row < rows and 0 <= to_column < columns)
                or not open_cells[to_row, to_column]
            ):
                continue
            # A diagonal step must not pass between two occupied cells: they may be one wall.
            if down and right and not (open_cells[row, to_column] and open_cells[to_row, column]):
                continue
            to = to_row * columns + to_column
            reached = so_far + 0.5 * length * (price + prices[to_row, to_column])
            if reached >= cost[to]:
                continue
            size += cost[to] == math.inf
            place = size - 1 if cost[to] == math.inf else places[to]
            cost[to] = reached
            before[to] = cell
            rise(queue, places, cost, to, place)
    for place in range(size):
        # A path to a cell that was not visited may still become cheaper.
        cost[queue[place]] = math.inf
