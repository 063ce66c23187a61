"""The occupancy grid of one robot, in a window that goes along: `occupancy` and the wrapper's crop, for kernels.

The cell (row, column) of the world, counted from its origin, is kept at those numbers modulo the side of the window.
When something is seen outside of the window, it is moved there, and the cells that it leaves are forgotten.
"""

import math

import numpy as np

from limslam_agent.batch_compile import compiled
from limslam_agent.batch_state import Minds, Settings
from limslam_env.geometry import BoolArray, FloatArray, IntArray

FREE, OCCUPIED = 127, 255
_CROSSED, _ENDED = 1, 2
_AROUND = 8
_BODY = 0.7  # share of the robot's radius


@compiled
def note(x: float, y: float, cell: float, kind: int, cells: IntArray, size: int) -> int:
    """Add the cell of a point (m) to a list of rows, columns and kinds; the size that the list has then."""
    cells[size, 0], cells[size, 1], cells[size, 2] = math.floor(y / cell), math.floor(x / cell), kind
    return size + 1


@compiled
def touched(mind: Minds, ranges: FloatArray, measured: BoolArray, settings: Settings) -> IntArray:
    """The cells (n, 3) that beams and body touch: row, column, and whether a beam crossed or ended."""
    x, y, cos, sin = mind.x[0], mind.x[1], math.cos(mind.x[2]), math.sin(mind.x[2])
    spacing, most = 0.5 * settings.cell, _AROUND + 1
    for beam in range(len(ranges)):
        if measured[beam] and ranges[beam] > settings.too_near[beam]:
            most += int(math.floor(ranges[beam] / spacing)) + 1
    cells, size = np.empty((most, 3), dtype=np.int64), 0
    for beam in range(len(ranges)):
        length = ranges[beam]
        if not (measured[beam] and length > settings.too_near[beam]):
            continue
        from_x, from_y = settings.origins[beam, 0], settings.origins[beam, 1]
        ux, uy = settings.directions[beam, 0], settings.directions[beam, 1]
        for i in range(int(math.floor(length / spacing))):
            px, py = from_x + i * spacing * ux, from_y + i * spacing * uy
            size = note(px * cos - py * sin + x, px * sin + py * cos + y, settings.cell, _CROSSED, cells, size)
        if length < settings.too_far[beam]:
            px, py = from_x + length * ux, from_y + length * uy
            size = note(px * cos - py * sin + x, px * sin + py * cos + y, settings.cell, _ENDED, cells, size)
    size = note(x, y, settings.cell, _CROSSED, cells, size)
    for k in range(_AROUND):
        dx, dy = _BODY * math.cos(k * (np.pi / 4)), _BODY * math.sin(k * (np.pi / 4))
        size = note(x + settings.radius * dx, y + settings.radius * dy, settings.cell, _CROSSED, cells, size)
    return cells[:size]


@compiled
def shift(mind: Minds, axis: int, low: int, high: int) -> None:
    """Move the window along an axis until it holds the cells from ``low`` to ``high``, as far as they fit."""
    side, first = mind.grid.shape[0], mind.window[axis]
    new = max(low, high - side + 1) if high >= first + side else first
    new = low if low < first else new
    for entering in range(max(new, first + side), new + side) if new > first else range(new, min(first, new + side)):
        if axis == 0:
            mind.grid[entering % side, :] = 0
        else:
            mind.grid[:, entering % side] = 0
    mind.window[axis] = new


@compiled
def see(
    mind: Minds, ranges: FloatArray, measured: BoolArray, settings: Settings, marks: np.ndarray  # type: ignore[type-arg]
) -> None:  # fmt: skip
    """Take in one step's readings (b,), m, of which some are new. ``marks`` (cells, cells) are zero, and stay so."""
    cells, side = touched(mind, ranges, measured, settings), mind.grid.shape[0]
    for axis in range(2):
        low, high = cells[:, axis].min(), cells[:, axis].max()
        if low < mind.window[axis] or high >= mind.window[axis] + side:
            shift(mind, axis, low, high)
    for i in range(len(cells)):
        if is_inside(mind, cells[i, 0], cells[i, 1]):
            row, column = cells[i, 0] % side, cells[i, 1] % side
            marks[row, column] = max(marks[row, column], cells[i, 2])
    for i in range(len(cells)):
        row, column = cells[i, 0] % side, cells[i, 1] % side
        if not (is_inside(mind, cells[i, 0], cells[i, 1]) and marks[row, column]):
            continue
        # Each cell counts once a step, however many beams touch it; where one ended, it is a wall.
        amount = -settings.hit if marks[row, column] == _ENDED else settings.seen_through
        marks[row, column] = 0
        value = min(max(mind.grid[row, column] + amount, -settings.limit), settings.limit)
        # 0 is kept for cells about which nothing is known.
        mind.grid[row, column] = value if value else (1 if amount > 0 else -1)


@compiled
def is_inside(mind: Minds, row: int, column: int) -> bool:
    """Whether the window holds a cell."""
    side = mind.grid.shape[0]
    return 0 <= row - mind.window[0] < side and 0 <= column - mind.window[1] < side


@compiled
def crop(mind: Minds, cell: float, out: np.ndarray) -> None:  # type: ignore[type-arg]
    """The grid around the robot (size, size), which is in the middle and looks up: unknown, free or occupied."""
    size, side = out.shape[0], mind.grid.shape[0]
    x, y, cos, sin = mind.x[0], mind.x[1], math.cos(mind.x[2]), math.sin(mind.x[2])
    for i in range(size):
        ahead = (0.5 * (size - 1) - i) * cell
        for j in range(size):
            left = (0.5 * (size - 1) - j) * cell
            row = math.floor((ahead * sin + left * cos + y) / cell)
            column = math.floor((ahead * cos - left * sin + x) / cell)
            value = mind.grid[row % side, column % side] if is_inside(mind, row, column) else 0
            out[i, j] = FREE if value > 0 else OCCUPIED if value < 0 else 0
