"""Measurement model of a range beam that meets a line, and how errors move with the world.

A line is stored as (d, theta) relative to an anchor a, a fixed point of the world near the line:
n . (p - a) = d with n = (cos theta, sin theta). This form has three advantages over (r, theta)
relative to the world's origin: d and theta are nearly uncorrelated, d may change its sign, and
lines through the origin are not singular.

A beam may be a cone with half an opening angle c. It then reads the nearest point of the wall
inside the cone. That is the foot of the perpendicular if the cone contains it, and otherwise the
end of the border ray that is nearer to the perpendicular (J. Leonard and H. Durrant-Whyte,
"Directed sonar sensing for mobile robot navigation", 1992). So a cone measures what a ray measures
that is turned towards the wall's normal, by c or until it is perpendicular to the wall. The
derivatives are those of this ray, too: where it follows the normal, its range does not depend on
its direction.

Readings come as ``places`` (n,), the places of their clones in the state, and ``readings`` (n, 6):
the beam's origin x, y in the robot's frame (m), its direction (rad), its range (m), half its
opening angle (rad), and the number of the beam. The clones begin in the state ``x`` at the index
``start``.
"""

import math

import numpy as np

from limslam_agent.kernels.compilation import compiled, entry
from limslam_agent.kernels.tables import FLATTEST, LEAST_DIVISOR, POSE
from limslam_env.geometry import FloatArray, IntArray


@compiled
def read_share(cosine: float, width: float) -> float:
    """The share of its distance that a wall reads, given the cosine between the beam and the wall's
    normal.

    The beam has half an opening angle ``width``, rad. It reads the nearest point of the wall inside
    of it.
    """
    if width == 0.0:
        return 1.0
    steep = abs(cosine)
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    turned = steep * math.cos(width) + sine * math.sin(width)
    return steep if sine <= math.sin(width) else steep / turned


@compiled
def ray_angle(reading: FloatArray, heading: float, theta: float) -> float:
    """Direction in the robot's frame, rad, of the ray that measures a line with its normal at
    ``theta`` as a beam does.

    ``heading``, rad, is that of the pose that the reading was taken from.
    """
    angle = float(reading[2])
    cone = reading[4]
    if cone > 0.0:
        turn = (theta - heading - angle + 0.5 * math.pi) % math.pi - 0.5 * math.pi
        angle += min(max(turn, -cone), cone) if abs(turn) < FLATTEST else 0.0
    return angle


@compiled
def predict_ranges(
    x: FloatArray,
    start: int,
    places: IntArray,
    readings: FloatArray,
    chosen: IntArray,
    line: tuple[float, float],
    anchor: tuple[float, float],
    out: FloatArray,
) -> None:
    """Predict the ranges of those readings that are ``chosen`` (k,), whose beams meet a line.

    ``line`` is (d, theta), m and rad, about an ``anchor``, m. ``out`` (k, 7) is filled: range,
    derivatives by pose (3) and by line (2), and cosine between beam and normal.
    """
    nx = math.cos(line[1])
    ny = math.sin(line[1])
    for i in range(len(chosen)):
        read = chosen[i]
        at = start + POSE * places[read]
        cos = math.cos(x[at + 2])
        sin = math.sin(x[at + 2])
        offset_x = cos * readings[read, 0] - sin * readings[read, 1]
        offset_y = sin * readings[read, 0] + cos * readings[read, 1]
        heading = x[at + 2] + ray_angle(readings[read], x[at + 2], line[1])
        ux = math.cos(heading)
        uy = math.sin(heading)
        from_x = x[at] + offset_x - anchor[0]
        from_y = x[at + 1] + offset_y - anchor[1]
        cosine = nx * ux + ny * uy
        divisor = math.copysign(max(abs(cosine), LEAST_DIVISOR), cosine)
        reach = (line[0] - nx * from_x - ny * from_y) / divisor
        hit_x = from_x + reach * ux
        hit_y = from_y + reach * uy
        turning = (-offset_y * nx + offset_x * ny) + reach * (-uy * nx + ux * ny)
        out[i, 0] = reach
        out[i, 1] = -nx / divisor
        out[i, 2] = -ny / divisor
        out[i, 3] = -turning / divisor
        out[i, 4] = 1.0 / divisor
        out[i, 5] = (hit_x * ny - hit_y * nx) / divisor
        out[i, 6] = cosine


@compiled
def end_of_beam(
    x: FloatArray, at: int, reading: FloatArray, angle: float, reach: float
) -> tuple[float, float]:
    """End point, m, of a ray at ``angle``, rad, with a range, m, from the pose that begins in the
    state at ``at``.
    """
    cos = math.cos(x[at + 2])
    sin = math.sin(x[at + 2])
    heading = x[at + 2] + angle
    return (
        x[at] + (cos * reading[0] - sin * reading[1]) + reach * math.cos(heading),
        x[at + 1] + (sin * reading[0] + cos * reading[1]) + reach * math.sin(heading),
    )


@compiled
def fill_transport(
    x: FloatArray,
    size: int,
    begins: tuple[int, int, int],
    anchors: FloatArray,
    num_lines: int,
    out: FloatArray,
) -> None:
    """Derivative (size, 3) of the state by the first robot's pose when robot and world move
    together rigidly.

    ``begins`` says where the poses end in the state, and where lines and clones begin. ``out`` is
    filled.
    """
    poses_end, first, clones_from = begins
    out[:size] = 0.0
    for place in range((poses_end + size - clones_from) // POSE):
        # The clones do not begin at a multiple of three.
        at = POSE * place
        row = at if at < poses_end else at - poses_end + clones_from
        for k in range(POSE):
            out[row + k, k] = 1.0
        out[row, 2] = x[1] - x[row + 1]
        out[row + 1, 2] = x[row] - x[0]
    for number in range(num_lines):
        row = first + 2 * number
        cos = math.cos(x[row + 1])
        sin = math.sin(x[row + 1])
        out[row, 0] = cos
        out[row, 1] = sin
        out[row, 2] = cos * (x[1] - anchors[number, 1]) - sin * (x[0] - anchors[number, 0])
        out[row + 1, 2] = 1.0


@entry
def error_transport(
    x: FloatArray, size: int, begins: tuple[int, int, int], anchors: FloatArray, num_lines: int
) -> FloatArray:
    """What :func:`fill_transport` fills (size, 3), as Python calls it."""
    moved = np.empty((size, POSE))
    fill_transport(x, size, begins, anchors, num_lines, moved)
    return moved


@entry
def ends_of_beams(
    x: FloatArray, start: int, places: IntArray, readings: FloatArray, theta: float
) -> FloatArray:
    """End points (n, 2), m, of readings on a line with its normal at ``theta``, rad; of the middle
    of beams if NaN.
    """
    points = np.empty((len(places), 2))
    for i in range(len(places)):
        at = start + POSE * places[i]
        angle = readings[i, 2]
        if not math.isnan(theta):
            angle = ray_angle(readings[i], x[at + 2], theta)
        points[i] = end_of_beam(x, at, readings[i], angle, readings[i, 3])
    return points
