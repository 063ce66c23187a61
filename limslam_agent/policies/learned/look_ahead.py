"""What the beams would newly see if the robot turned to a direction and drove straight ahead, by
the believed grid.

The beams at the sides see most of what is new, and they look at right angles to the way. A network
that saw only the polar cells near a direction would therefore not know what driving there shows.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.cells import GridArray, StampArray
from limslam_agent.kernels.tables import FROM_X, FROM_Y, TOO_FAR, TOWARDS_X, TOWARDS_Y
from limslam_env.compilation import compiled, entry_of
from limslam_env.geometry import FloatArray, IntArray

SPACING = 0.15
"""Distance between two places on the way from which the beams look, m."""

PLACES = (2, 4, 10)
"""Numbers of places after which the cells are counted: after 0.3, 0.6 and 1.5 m."""

FULL = (50.0, 100.0, 200.0)
"""Numbers of cells that are called 1."""

# Each unknown cell that a beam crosses makes it less likely that the beam goes on.
_FADE = 0.95
# The way is free if the body's middle and its shoulders, at this share of the radius, meet no
# occupied cell.
_SHOULDER = 0.7


class Ground(NamedTuple):
    """Cells (rows, columns): positive is free, negative is occupied, 0 is unknown. All cells beyond
    are unknown.

    ``corner`` has column and row of the lower left cell, counted from the world's origin, and
    ``cell`` is the side of a cell, m.
    """

    values: GridArray
    corner: IntArray
    cell: float


class Seen(NamedTuple):
    """The number of the direction in which each cell (rows, columns) was counted last, and row and
    column of the first one.
    """

    stamps: StampArray
    corner: tuple[int, int]


@compiled
def value_at(ground: Ground, row: int, column: int) -> int:
    """The value of a cell by its row and column from the world's origin."""
    rows, columns = ground.values.shape
    r = row - ground.corner[1]
    c = column - ground.corner[0]
    return ground.values[r, c] if 0 <= r < rows and 0 <= c < columns else 0


@compiled
def has_room(ground: Ground, x: float, y: float, cos: float, sin: float, radius: float) -> bool:
    """Whether no cell under the middle and the shoulders of a body at a place (m) with this heading
    is occupied.
    """
    for side in range(-1, 2):
        row = math.floor((y + side * _SHOULDER * radius * cos) / ground.cell)
        column = math.floor((x - side * _SHOULDER * radius * sin) / ground.cell)
        if value_at(ground, row, column) < 0:
            return False
    return True


@compiled
def count_on_beam(
    ground: Ground,
    place: tuple[float, float],
    step: tuple[float, float],
    steps: int,
    seen: Seen,
    stamp: int,
) -> float:
    """The unknown cells that a beam from a place (m) crosses up to an occupied one and that have
    not this stamp yet. The beam takes ``steps`` steps (m) of the length of a cell.
    """
    total = 0.0
    weight = 1.0
    for i in range(steps):
        row = math.floor((place[1] + i * step[1]) / ground.cell)
        column = math.floor((place[0] + i * step[0]) / ground.cell)
        value = value_at(ground, row, column)
        if value < 0:
            break
        if value == 0:
            at = (row - seen.corner[0], column - seen.corner[1])
            if seen.stamps[at] != stamp:
                seen.stamps[at] = stamp
                total += weight
            weight *= _FADE
    return total


@entry_of("limslam_agent.policies.learned", "limslam_agent.kernels")
def look_ahead(
    ground: Ground,
    pose: FloatArray,
    beams: FloatArray,
    radius: float,
    directions: int,
    ahead: NDArray[np.float32],
) -> None:
    """Fill ``ahead`` (AHEAD * directions,) with the unknown cells that straight drives would show.

    Parameters
    ----------
    ground
        What is believed.
    pose, beams, radius
        Pose (3,), m and rad, rows of ``RobotSpec.beam_table``, and radius of the body, m.
    directions
        Number of directions, counter-clockwise from straight ahead.
    """
    cell = ground.cell
    reach = 2 + math.ceil((PLACES[-1] * SPACING + beams[:, TOO_FAR].max() + radius) / cell)
    stamps = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.int32)
    corner = math.floor(pose[1] / cell) - reach, math.floor(pose[0] / cell) - reach
    seen = Seen(stamps, corner)
    for direction in range(directions):
        heading = pose[2] + 2.0 * math.pi * direction / directions
        cos = math.cos(heading)
        sin = math.sin(heading)
        total = 0.0
        is_open = True
        mark = 0
        for place in range(1, PLACES[-1] + 1):
            x = pose[0] + place * SPACING * cos
            y = pose[1] + place * SPACING * sin
            is_open = is_open and has_room(ground, x, y, cos, sin, radius)
            for beam in beams if is_open else beams[:0]:
                from_x = x + cos * beam[FROM_X] - sin * beam[FROM_Y]
                from_y = y + sin * beam[FROM_X] + cos * beam[FROM_Y]
                to_x = cell * (cos * beam[TOWARDS_X] - sin * beam[TOWARDS_Y])
                to_y = cell * (sin * beam[TOWARDS_X] + cos * beam[TOWARDS_Y])
                steps = math.floor(beam[TOO_FAR] / cell)
                total += count_on_beam(
                    ground, (from_x, from_y), (to_x, to_y), steps, seen, direction + 1
                )
            if place == PLACES[mark]:
                ahead[mark * directions + direction] = total / FULL[mark]
                mark += 1
