"""Costs of the steps between the cells of a grid, for searches of paths."""

import math

from limslam_agent.kernels.compilation import lean_entry
from limslam_agent.kernels.tables import STEPS
from limslam_env.geometry import BoolArray, FloatArray


@lean_entry
def price_steps(open_cells: BoolArray, prices: FloatArray, weights: FloatArray) -> None:
    """Costs of the steps from each cell to its eight neighbours.

    Parameters
    ----------
    open_cells, prices
        Cells that can be entered (rows, columns), and the cost of a step of the length of a cell in each of them.
    weights
        Set to the costs (rows, columns, 8), in the order of ``STEPS`` and then the same steps backwards.
        Infinite for steps that are not possible.
    """
    rows, columns = open_cells.shape
    for row in range(rows):
        for column in range(columns):
            for slot in range(8):
                weights[row, column, slot] = math.inf
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
