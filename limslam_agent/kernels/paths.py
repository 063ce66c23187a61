"""Least-cost paths over the cells of a grid."""

import heapq
import math

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.compilation import entry
from limslam_agent.kernels.tables import STEPS
from limslam_env.geometry import FloatArray

# Steps to the eight neighbours of a cell, in the order in which they are tried.
_NEIGHBOURS = (*STEPS, *((-down, -right, length) for down, right, length in reversed(STEPS)))


@entry
def search_paths(
    prices: FloatArray, ends: FloatArray, start: int, cost: FloatArray, before: NDArray[np.int32]
) -> None:
    """Find the least-cost paths from a cell to those around it.

    Of equally cheap cells, the one with the largest index is visited first. So paths of equal cost
    are chosen by the grid alone.

    Parameters
    ----------
    prices
        Cost of a step of the length of a cell in each cell (rows, columns); infinite where no path
        leads.
    ends
        The search ends when the cheapest cell is known, with what it costs besides its path
        (rows, columns), m, at least 0. That is infinite for cells that are no ends.
    start
        Flat index of the cell where paths begin.
    cost, before
        Costs (n,), all infinite, and the cells (n,) before each cell on its path, all negative.
        They are set where a path has been found.
    """
    rows, columns = prices.shape
    cost[start] = 0.0
    nearest = math.inf
    queue = [(0.0, -start)]
    while queue and queue[0][0] <= nearest:
        so_far, minus = heapq.heappop(queue)
        cell = -minus
        if so_far > cost[cell]:
            continue  # a cheaper path was found later
        row = cell // columns
        column = cell % columns
        nearest = min(nearest, so_far + ends[row, column])
        price = prices[row, column]
        for down, right, length in _NEIGHBOURS:
            to_row = row + down
            to_column = column + right
            if not (0 <= to_row < rows and 0 <= to_column < columns):
                continue
            # A diagonal step must not pass between two occupied cells: they may be one wall.
            if down and right and math.isinf(prices[row, to_column] + prices[to_row, column]):
                continue
            to = to_row * columns + to_column
            reached = so_far + 0.5 * length * (price + prices[to_row, to_column])
            if reached < cost[to]:
                cost[to] = reached
                before[to] = cell
                heapq.heappush(queue, (reached, -to))
    for reached, minus in queue:
        # A path to a cell that was not visited may still become cheaper.
        if reached == cost[-minus]:
            cost[-minus] = math.inf
