"""The floor of a building: where a disc fits, and what can be seen from a region of it."""

import math
from typing import NamedTuple

import numpy as np

from limslam_env.compilation import inlined, lean_entry, merged
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.kernels.coverage import CellGrid, mark_ray
from limslam_env.kernels.rays import Ray, Walls, first_wall


@inlined
def clipped(low: float, high: float, origin: float, cell: float, count: int) -> tuple[int, int]:
    """First cell, and the one after the last, of a stretch of one axis (m) on a grid of ``count``
    cells.
    """
    first = min(max(math.floor((low - origin) / cell), 0), count)
    return first, min(max(math.ceil((high - origin) / cell), 0), count)


@lean_entry
def clear_near_walls(edges: FloatArray, space: FloatArray, radius: float, free: BoolArray) -> None:
    """Clear the cells whose centres lie less than ``radius`` (m) from an edge; ``space``: corner x,
    y and cell, m.
    """
    low_x = space[0]
    low_y = space[1]
    cell = space[2]
    rows, columns = free.shape
    reach = radius + cell
    for edge in range(len(edges)):
        x1 = edges[edge, 0]
        y1 = edges[edge, 1]
        x2 = edges[edge, 2]
        y2 = edges[edge, 3]
        ex = x2 - x1
        ey = y2 - y1
        squared = max(ex * ex + ey * ey, 1e-300)
        first_row, end_row = clipped(min(y1, y2) - reach, max(y1, y2) + reach, low_y, cell, rows)
        for row in range(first_row, end_row):
            above = low_y + (row + 0.5) * cell - y1
            start = 0.0
            end = 1.0
            if abs(ey) >= 1e-12:
                start = min(max((above - reach) / ey, 0.0), 1.0)
                end = min(max((above + reach) / ey, 0.0), 1.0)
            from_x = x1 + start * ex
            to_x = x1 + end * ex
            first, last = clipped(
                min(from_x, to_x) - reach, max(from_x, to_x) + reach, low_x, cell, columns
            )
            for column in range(first, last):
                if not free[row, column]:
                    continue
                aside = low_x + (column + 0.5) * cell - x1
                share = min(max((aside * ex + above * ey) / squared, 0.0), 1.0)
                dx = aside - share * ex
                dy = above - share * ey
                free[row, column] = math.sqrt(dx * dx + dy * dy) >= radius


@lean_entry
def clear_inside(
    corners: FloatArray, space: FloatArray, crossed: FloatArray, free: BoolArray
) -> None:
    """Clear the cells whose centres lie inside a polygon, by the crossing-number rule.

    ``corners`` (c, 2) are in m, ``space`` as for :func:`clear_near_walls`; ``crossed`` (c,) is
    scratch memory.
    """
    low_x = space[0]
    low_y = space[1]
    cell = space[2]
    rows, columns = free.shape
    left = np.inf
    right = -np.inf
    bottom = np.inf
    top = -np.inf
    for corner in range(len(corners)):
        left = min(left, corners[corner, 0])
        right = max(right, corners[corner, 0])
        bottom = min(bottom, corners[corner, 1])
        top = max(top, corners[corner, 1])
    first_row, end_row = clipped(bottom, top, low_y, cell, rows)
    first, last = clipped(left, right, low_x, cell, columns)
    for row in range(first_row, end_row):
        y = low_y + (row + 0.5) * cell
        count = 0
        for corner in range(len(corners)):
            beyond = corner + 1 if corner + 1 < len(corners) else 0
            x1 = corners[corner, 0]
            y1 = corners[corner, 1]
            x2 = corners[beyond, 0]
            y2 = corners[beyond, 1]
            if (y1 <= y) != (y2 <= y):
                crossed[count] = ((x2 - x1) * (y - y1)) / (y2 - y1) + x1
                count += 1
        for column in range(first, last):
            x = low_x + (column + 0.5) * cell
            is_inside = False
            for number in range(count):
                is_inside = is_inside != (x < crossed[number])
            if is_inside:
                free[row, column] = False


class Lookout(NamedTuple):
    """A region of free space, and what is seen from it.

    Attributes
    ----------
    walls
        The walls of the world.
    views, reach
        Unit vectors (v, 2) to look along, and how far robots see, m.
    space, region, inner
        The grid of free space: lower left corner x, y and cell side (3,), m; the cells of the
        region (rows, columns), and those with all of their neighbours in it.
    grid
        The coverage, whose coverable cells are changed.
    """

    walls: Walls
    views: FloatArray
    reach: float
    space: FloatArray
    region: BoolArray
    inner: BoolArray
    grid: CellGrid


@merged
def look_around(x: float, y: float, lookout: Lookout) -> None:
    """Mark the cells that can be seen from (x, y), m, along those of the views that leave the
    region at once.
    """
    region = lookout.region
    low_x = lookout.space[0]
    low_y = lookout.space[1]
    side = lookout.space[2]
    rows, columns = region.shape
    for view in range(len(lookout.views)):
        dx = lookout.views[view, 0]
        dy = lookout.views[view, 1]
        column = math.floor((x + 1.5 * side * dx - low_x) / side)
        row = math.floor((y + 1.5 * side * dy - low_y) / side)
        if not (0 <= row < rows and 0 <= column < columns and region[row, column]):
            distance, _ = first_wall(Ray(x, y, dx, dy, lookout.reach), lookout.walls)
            mark_ray(lookout.grid, Ray(x, y, dx, dy, distance))


@lean_entry
def look_out(lookout: Lookout, loose: FloatArray, is_seen_from: BoolArray) -> None:
    """Mark the cells that robots can cover from a region: those in it, and those that can be seen
    from it.

    Every view of what lies beyond the region crosses the region's border, which lies nearer to it.
    So it is enough to look from the border, from one place for each cell of the coverage.

    Parameters
    ----------
    loose
        Further places (n, 2), m, to look from.
    is_seen_from
        Scratch memory (rows, columns), all false, with a cell for each of the coverage around the
        region.
    """
    region = lookout.region
    coverable = lookout.grid.coverable
    area = lookout.grid.area
    low_x = lookout.space[0]
    low_y = lookout.space[1]
    side = lookout.space[2]
    cell = area[2]
    rows, columns = region.shape
    first_x = math.floor(low_x / cell)
    first_y = math.floor(low_y / cell)
    for row in range(rows):
        y = low_y + (row + 0.5) * side
        for column in range(columns):
            if not region[row, column]:
                continue
            x = low_x + (column + 0.5) * side
            coverable[math.floor((y - area[1]) / cell), math.floor((x - area[0]) / cell)] = True
            if lookout.inner[row, column]:
                continue
            place = math.floor(y / cell) - first_y, math.floor(x / cell) - first_x
            if not is_seen_from[place]:
                is_seen_from[place] = True
                look_around(x, y, lookout)
    for number in range(len(loose)):
        look_around(loose[number, 0], loose[number, 1], lookout)
