"""The inner loops, compiled by numba: rays against walls and robots, and the cells that rays cross.

Plain functions on arrays. ``sensors`` and ``coverage`` give them names and shapes.
"""

import math

import numpy as np
from numba import njit

from limslam_env.geometry import BoolArray, FloatArray, IntArray

# Rays that pass exactly through the joint of two walls must hit one of them.
_END_SLACK = 1e-9


@njit(cache=True, nogil=True)
def cast_rays(
    origins: FloatArray,
    directions: FloatArray,
    lengths: FloatArray,
    owners: IntArray,
    edges: FloatArray,
    cell_starts: IntArray,
    cell_edges: IntArray,
    grid: FloatArray,
    columns: int,
    discs: FloatArray,
    disc_radius: float,
    distances: FloatArray,
    hits: IntArray,
) -> None:
    """Find the nearest hit of each ray among walls and discs.

    Parameters
    ----------
    origins, directions, lengths
        Rays (n, 2), unit vectors (n, 2) and reaches (n,), m.
    owners
        (n,) disc that each ray starts from and does not see.
    edges
        Walls (k, 4), m.
    cell_starts, cell_edges
        For cell c of a regular grid, ``cell_edges[cell_starts[c]:cell_starts[c + 1]]`` are the
        walls that a ray from inside the cell can reach.
    grid, columns
        ``(x, y, cell side, rows)`` of that grid, m, and its width in cells.
    discs, disc_radius
        Centres (m, 2) and radius of the robots' bodies, m.
    distances, hits
        Filled with the distance (n,), m, the reach where nothing is hit, and the index of the
        wall, -1 for nothing, -2 for a disc.
    """
    rows = int(grid[3])
    for ray in range(len(origins)):
        x, y = origins[ray, 0], origins[ray, 1]
        dx, dy = directions[ray, 0], directions[ray, 1]
        best, hit = lengths[ray], -1
        column = math.floor((x - grid[0]) / grid[2])
        row = math.floor((y - grid[1]) / grid[2])
        inside = 0 <= column < columns and 0 <= row < rows
        first = cell_starts[row * columns + column] if inside else 0
        last = cell_starts[row * columns + column + 1] if inside else len(edges)
        for item in range(first, last):
            edge = cell_edges[item] if inside else item
            ax, ay = edges[edge, 0] - x, edges[edge, 1] - y
            ex, ey = edges[edge, 2] - edges[edge, 0], edges[edge, 3] - edges[edge, 1]
            cross = dx * ey - dy * ex
            if cross == 0.0:
                continue
            distance = (ax * ey - ay * ex) / cross
            fraction = (ax * dy - ay * dx) / cross
            if 0.0 <= distance < best and -_END_SLACK <= fraction <= 1.0 + _END_SLACK:
                best, hit = distance, edge
        for disc in range(len(discs)):
            if disc == owners[ray]:
                continue
            ox, oy = discs[disc, 0] - x, discs[disc, 1] - y
            ahead = ox * dx + oy * dy
            aside = disc_radius * disc_radius - (ox * ox + oy * oy - ahead * ahead)
            if aside > 0.0 and ahead > 0.0:
                distance = max(ahead - math.sqrt(aside), 0.0)
                if distance < best:
                    best, hit = distance, -2
        distances[ray], hits[ray] = best, hit


@njit(cache=True, nogil=True)
def mark_rays(
    seen: BoolArray, origins: FloatArray, directions: FloatArray, lengths: FloatArray, low: FloatArray, cell: float
) -> None:
    """Set every cell that a ray crosses.

    ``seen`` (rows, columns) covers the plane from ``low`` (2,) on in cells of ``cell`` m. The
    walk from cell to cell is that of Amanatides and Woo, "A fast voxel traversal algorithm
    for ray tracing" (1987).
    """
    rows, columns = seen.shape
    for ray in range(len(origins)):
        x, y = (origins[ray, 0] - low[0]) / cell, (origins[ray, 1] - low[1]) / cell
        dx, dy = directions[ray, 0], directions[ray, 1]
        # A ray ends before the wall it hits, so that it never marks the cell behind.
        reach = lengths[ray] / cell - 1e-6
        column, row = math.floor(x), math.floor(y)
        column_step, row_step = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1)
        next_column = ((column + (dx > 0.0)) - x) / dx if dx != 0.0 else np.inf
        next_row = ((row + (dy > 0.0)) - y) / dy if dy != 0.0 else np.inf
        travelled = 0.0
        while travelled <= reach:
            if 0 <= row < rows and 0 <= column < columns:
                seen[row, column] = True
            if next_column < next_row:
                travelled = next_column
                next_column += abs(1.0 / dx)
                column += column_step
            else:
                travelled = next_row
                next_row += abs(1.0 / dy)
                row += row_step
