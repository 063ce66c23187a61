"""Walls sorted into the cells of a grid, so that a ray or a body looks only at the walls near it.

Python hands walls to kernels as a *scene* of four arrays: ``edges`` (k, 4) in metres and a cell list, in which
``cell_edges[cell_starts[c]:cell_starts[c + 1]]`` are the walls that cross cell ``c``; ``grid`` holds the grid's
lower left corner x, y and cell side in metres, its number of columns and its number of rows.
"""

import math
from typing import NamedTuple

from limslam_env.compilation import inlined, lean_entry
from limslam_env.geometry import FloatArray, IntArray

# Of a cell, in its sides; a little more, for rounding.
_HALF_DIAGONAL = 0.70711


class Walls(NamedTuple):
    """The walls of one world as the kernels hand them on: a cell list that may lie among those of other worlds.

    Attributes
    ----------
    edges
        (k, 4): x1, y1, x2, y2 of each wall, m.
    cell_starts, cell_edges
        ``cell_edges[cell_starts[c]:cell_starts[c + 1]]`` are the walls that cross cell ``first_cell + c``.
    low_x, low_y, side
        Lower left corner of the grid and side of a cell, m.
    columns, rows
        Size of the grid in cells.
    first_cell
        Number of the world's first cell in ``cell_starts``.
    """

    edges: FloatArray
    cell_starts: IntArray
    cell_edges: IntArray
    low_x: float
    low_y: float
    side: float
    columns: int
    rows: int
    first_cell: int


@inlined
def scene_walls(edges: FloatArray, cell_starts: IntArray, cell_edges: IntArray, grid: FloatArray) -> Walls:
    """The walls of a scene."""
    return Walls(edges, cell_starts, cell_edges, grid[0], grid[1], grid[2], int(grid[3]), int(grid[4]), 0)


@lean_entry
def list_walls(
    edges: FloatArray, grid: FloatArray, border: float, taken: IntArray, cell_starts: IntArray, cell_edges: IntArray
) -> None:
    """Sort walls into the cells that they cross, or come as near to as ``border``, m.

    Called twice: with an empty ``cell_edges`` it fills ``cell_starts`` (cells + 1,), all 0 before; with one of
    ``cell_starts[-1]`` places it fills that. ``taken`` (cells,) is scratch memory, all 0 before.
    """
    columns, rows, side = int(grid[3]), int(grid[4]), grid[2]
    is_filling = len(cell_edges) > 0
    for edge in range(len(edges)):
        x1, y1, x2, y2 = edges[edge, 0], edges[edge, 1], edges[edge, 2], edges[edge, 3]
        normal_x, normal_y = y1 - y2, x2 - x1
        # Half a cell's width across the wall. Walls that run along the border of a cell are in both.
        half = 0.5 * side * (abs(normal_x) + abs(normal_y)) + border * math.hypot(normal_x, normal_y)
        squared, farthest = normal_x * normal_x + normal_y * normal_y, border + _HALF_DIAGONAL * side
        for row in range(
            max(math.floor((min(y1, y2) - border - grid[1]) / side), 0),
            min(math.floor((max(y1, y2) + border - grid[1]) / side), rows - 1) + 1,
        ):
            for column in range(
                max(math.floor((min(x1, x2) - border - grid[0]) / side), 0),
                min(math.floor((max(x1, x2) + border - grid[0]) / side), columns - 1) + 1,
            ):
                x, y = grid[0] + (column + 0.5) * side, grid[1] + (row + 0.5) * side
                if abs((x - x1) * normal_x + (y - y1) * normal_y) > half:
                    continue
                # The ends of the wall, too, must come that near.
                share = min(max(((x - x1) * normal_y - (y - y1) * normal_x) / squared, 0.0), 1.0)
                if math.hypot(x - x1 - share * normal_y, y - y1 + share * normal_x) > farthest:
                    continue
                cell = row * columns + column
                if is_filling:
                    cell_edges[cell_starts[cell] + taken[cell]] = edge
                taken[cell] += 1
    if not is_filling:
        for cell in range(columns * rows):
            cell_starts[cell + 1] = cell_starts[cell] + taken[cell]
