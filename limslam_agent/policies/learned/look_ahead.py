"""What the beams would newly see if the robot turned to a direction and drove straight ahead, by
the believed grid.

The beams at the sides see most of what is new, and they look at right angles to the way. A network
that saw only the polar cells near a direction would therefore not know what driving there shows.
"""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.cells import GridArray
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


@compiled
def has_room(
    values: GridArray,
    corner: IntArray,
    x: float,
    y: float,
    cos: float,
    sin: float,
    radius: float,
    cell: float,
) -> bool:
    """Whether no cell under the middle and the shoulders of a body at a place (m) with this heading
    is occupied.
    """
    rows, columns = values.shape
    for side in range(-1, 2):
        row = math.floor((y + side * _SHOULDER * radius * cos) / cell) - corner[1]
        column = math.floor((x - side * _SHOULDER * radius * sin) / cell) - corner[0]
        if 0 <= row < rows and 0 <= column < columns and values[row, column] < 0:
            return False
    return True


@compiled
def count_on_beam(
    values: GridArray,
    corner: IntArray,
    x: float,
    y: float,
    to_x: float,
    to_y: float,
    steps: int,
    cell: float,
    counted: NDArray[np.int32],
    counted_corner: tuple[int, int],
    stamp: int,
) -> float:
    """The unknown cells that a beam from a place (m) crosses up to an occupied one and that are not
    ``counted`` yet.

    The beam takes ``steps`` steps (m) of the length of a cell. The first row and column of
    ``counted`` lie at ``counted_corner``. Its cells are set to ``stamp``.
    """
    rows, columns = values.shape
    total = 0.0
    weight = 1.0
    for i in range(steps):
        row = math.floor((y + i * to_y) / cell)
        column = math.floor((x + i * to_x) / cell)
        r = row - corner[1]
        c = column - corner[0]
        value = values[r, c] if 0 <= r < rows and 0 <= c < columns else 0
        if value < 0:
            break
        if value == 0:
            r = row - counted_corner[0]
            c = column - counted_corner[1]
            if counted[r, c] != stamp:
                counted[r, c] = stamp
                total += weight
            weight *= _FADE
    return total


@entry_of("limslam_agent.policies.learned", "limslam_agent.kernels")
def look_ahead(
    values: GridArray,
    corner: IntArray,
    pose: FloatArray,
    beams: FloatArray,
    radius: float,
    cell: float,
    directions: int,
    ahead: NDArray[np.float32],
) -> None:
    """Fill ``ahead`` (AHEAD * directions,) with the unknown cells that straight drives would show.

    Parameters
    ----------
    values, corner
        Cells (rows, columns): positive is free, negative is occupied, 0 is unknown. Column and row
        of the lower left cell, counted from the world's origin. All cells beyond are unknown.
    pose, beams, radius, cell
        Pose (3,), m and rad, rows of ``RobotSpec.beam_table``, radius of the body and side of a
        cell, m.
    directions
        Number of directions, counter-clockwise from straight ahead.
    """
    reach = 2 + math.ceil((PLACES[-1] * SPACING + beams[:, TOO_FAR].max() + radius) / cell)
    counted = np.zeros((2 * reach + 1, 2 * reach + 1), dtype=np.int32)
    counted_corner = math.floor(pose[1] / cell) - reach, math.floor(pose[0] / cell) - reach
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
            is_open = is_open and has_room(values, corner, x, y, cos, sin, radius, cell)
            for beam in range(len(beams) if is_open else 0):
                from_x = x + cos * beams[beam, FROM_X] - sin * beams[beam, FROM_Y]
                from_y = y + sin * beams[beam, FROM_X] + cos * beams[beam, FROM_Y]
                to_x = cell * (cos * beams[beam, TOWARDS_X] - sin * beams[beam, TOWARDS_Y])
                to_y = cell * (sin * beams[beam, TOWARDS_X] + cos * beams[beam, TOWARDS_Y])
                total += count_on_beam(
                    values,
                    corner,
                    from_x,
                    from_y,
                    to_x,
                    to_y,
                    math.floor(beams[beam, TOO_FAR] / cell),
                    cell,
                    counted,
                    counted_corner,
                    direction + 1,
                )
            if place == PLACES[mark]:
                ahead[mark * directions + direction] = total / FULL[mark]
                mark += 1
