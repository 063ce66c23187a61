"""Costs of the steps between the cells of a grid, for searches of paths."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.compilation import lean_entry
from limslam_agent.kernels.tables import STEPS
from limslam_env.geometry import BoolArray, FloatArray

NeighbourArray: TypeAlias = NDArray[np.int32]


@lean_entry
def price_cells(
    distances: FloatArray, radius: float, comfort: float, coast: float, cell: float, tight: float, wide: float,
    prices: FloatArray,
) -> None:  # fmt: skip
    """Costs of a step of the length of a cell in each cell.

    Parameters
    ----------
    distances, prices
        Distance of each cell from the nearest wall (rows, columns), m; set to the costs (rows, columns), m.
    radius, comfort, coast
        Distances from walls within which a step costs ``tight`` times as much, within which it costs up to three times
        as much beyond the radius, and beyond which it costs ``wide`` times as much, m.
    cell
        Side of a cell, m.
    """
    for row in range(distances.shape[0]):
        for column in range(distances.shape[1]):
            distance = distances[row, column]
            factor = 1.0 + 2.0 * min(max((radius + comfort - distance) / comfort, 0.0), 1.0)
            if distance < radius:
                factor += tight
            if distance > coast:
                factor *= wide
            prices[row, column] = factor * cell


@lean_entry
def price_steps(open_cells: BoolArray, prices: FloatArray, weights: FloatArray, neighbours: NeighbourArray) -> None:
    """Costs of the steps from each cell to its eight neighbours.

    Parameters
    ----------
    open_cells, prices
        Cells that can be entered (rows, columns), and the cost of a step of the length of a cell in each of them.
    weights
        Set to the costs (rows, columns, 8), in the order of ``STEPS`` and then the same steps backwards.
        Infinite for steps that are not possible.
    neighbours
        Set to the flat indices of the cells to which the steps lead (rows, columns, 8). A step beyond the grid, which
        is not possible, leads to any cell.
    """
    rows, columns = open_cells.shape
    for row in range(rows):
        for column in range(columns):
            for slot in range(8):
                weights[row, column, slot] = math.inf
                step = STEPS[slot] if slot < len(STEPS) else STEPS[7 - slot]
                ahead = step[0] * columns + step[1]
                at = row * columns + column + (ahead if slot < len(STEPS) else -ahead)
                neighbours[row, column, slot] = min(max(at, 0), rows * columns - 1)
    for row in range(rows):
        for column in range(columns):
            if not open_cells[row, column]:
                continue
            for slot in range(len(STEPS)):
                down, right, length = STEPS[slot]
                to_row, to_column = row + down, column + right
                if to_row >= rows or not 0 <= to_column < columns or not open_cells[to_row, to_column]:
                    continue
                # A diagonal step must not pass between two occupied cells: they may be one wall.
                if down and right and not (open_cells[row, to_column] and open_cells[to_row, column]):
                    continue
                step = 0.5 * length * (prices[row, column] + prices[to_row, to_column])
                weights[row, column, slot] = weights[to_row, to_column, 7 - slot] = step
