"""Frontiers of a grid, in groups of cells that touch, and stretches of faces where free ground ends."""

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_env.geometry import BoolArray, FloatArray, IntArray


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


_SLIGHTLY_MORE = 1.0 + 1e-9


@compiled
def are_near(middles: FloatArray, first: int, second: int, reach: float) -> bool:
    """Whether two of the points (n, 2) are at most so far apart."""
    x, y = middles[first, 0] - middles[second, 0], middles[first, 1] - middles[second, 1]
    return bool(x * x + y * y <= reach * reach)


@compiled
def cosine(normals: FloatArray, first: int, second: int) -> float:
    """Cosine of the angle between two of the unit vectors (n, 2)."""
    return float(normals[first, 0] * normals[second, 0] + normals[first, 1] * normals[second, 1])


@lean_entry
def sum_normals(middles: FloatArray, normals: FloatArray, order: IntArray, reach: float, total: FloatArray) -> None:
    """Add to the normal of each face (n, 2) those of the faces near it that do not look the opposite way.

    ``total`` (n, 2) holds the normals before, and ``reach`` is how far apart the middles (n, 2) may be. ``order`` (n,)
    sorts the middles by y.
    """
    for place in range(len(order)):
        i = order[place]
        for j in order[:place][::-1]:
            if middles[i, 1] - middles[j, 1] > _SLIGHTLY_MORE * reach:
                break
            if are_near(middles, i, j, reach) and cosine(normals, i, j) >= 0.0:
                for k in range(2):
                    total[i, k] += normals[j, k]
                    total[j, k] += normals[i, k]


@compiled
def stretch_of(stretches: IntArray, face: int) -> int:
    """The first face of the stretch of a face, as far as the stretch is known."""
    while stretches[face] != face:
        stretches[face] = stretches[stretches[face]]
        face = stretches[face]
    return face


@lean_entry
def join_faces(
    middles: FloatArray, normals: FloatArray, order: IntArray, reach: float, least: float, stretches: IntArray
) -> None:  # fmt: skip
    """Join faces to stretches: those at most ``reach`` apart between whose normals the cosine is at least ``least``.

    ``order`` (n,) sorts the middles by y. ``stretches`` (n,) is set to the index of one face of each face's stretch.
    """
    for place in range(len(order)):
        i = order[place]
        stretches[i] = i
        for j in order[:place][::-1]:
            if middles[i, 1] - middles[j, 1] > _SLIGHTLY_MORE * reach:
                break
            if are_near(middles, i, j, reach) and cosine(normals, i, j) >= least:
                first, second = stretch_of(stretches, i), stretch_of(stretches, j)
                stretches[max(first, second)] = min(first, second)
    for i in range(len(middles)):
        stretches[i] = stretch_of(stretches, i)


@lean_entry
def mark_drawn(
    middles: FloatArray, normals: FloatArray, walls: FloatArray, across: float, sideways: float, past: float,
    same_way: float, drawn: BoolArray,
) -> None:  # fmt: skip
    """Find the faces at which a wall is drawn.

    Parameters
    ----------
    middles, normals
        Middles (n, 2), m, and normals (n, 2) of the faces.
    walls
        Start, m, unit vector along the wall, and length, m, of each wall (m, 5).
    across, sideways, past
        Farthest distances, m, from the wall: of a face that looks along the wall's normal, of any other face, and past
        the wall's ends.
    same_way
        Least cosine between the normals of a face and of a wall that look along one line.
    drawn
        Set to whether each face (n,) has a wall.
    """
    for i in range(len(middles)):
        drawn[i] = False
        for wall in range(len(walls)):
            x, y = middles[i, 0] - walls[wall, 0], middles[i, 1] - walls[wall, 1]
            along_x, along_y, length = walls[wall, 2], walls[wall, 3], walls[wall, 4]
            looks = abs(normals[i, 0] * -along_y + normals[i, 1] * along_x)
            position = x * along_x + y * along_y
            is_beside = -past <= position <= length + past
            if is_beside and abs(x * along_y - y * along_x) <= (across if looks >= same_way else sideways):
                drawn[i] = True
                break
