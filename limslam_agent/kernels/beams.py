"""The model of a range beam: what it reads of a line, how that moves with pose and line, and
whether it passes through a line.

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

Readings come as ``places`` (n,), the numbers of the poses from which they were taken, and
``readings`` (n, 6): the beam's origin x, y in the robot's frame (m), its direction (rad), its range
(m), half its opening angle (rad), and the number of the beam. The poses of a filter begin in its
state ``x`` at the index ``start``. What is predicted for a reading is a row (7,): range (m),
derivatives by pose (3) and by line (2), and the cosine between the ray that measures and the
normal. The derivative by theta, over that by d, is how far from the anchor's foot the ray meets the
line, m against the line's direction.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.compilation import compiled, entry, lean_entry
from limslam_agent.kernels.tables import GRAZING, LEAST_DIVISOR, POSE
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import normal


class Line(NamedTuple):
    """A line: its distance from its anchor, m, its normal, and the anchor, m."""

    d: float
    normal_x: float
    normal_y: float
    anchor_x: float
    anchor_y: float


class Ray(NamedTuple):
    """A ray: its origin, m, and its direction."""

    x: float
    y: float
    to_x: float
    to_y: float


def line_table(lines: FloatArray, anchors: FloatArray) -> FloatArray:
    """Rows (m, 5) with the fields of :class:`Line`, for lines (m, 2) as (d, theta) about anchors
    (m, 2).
    """
    return np.column_stack((lines[:, 0], normal(lines), anchors))


@compiled
def line_about(d: float, theta: float, anchor: tuple[float, float]) -> Line:
    """The line (d, theta), m and rad, about an anchor, m."""
    return Line(d, math.cos(theta), math.sin(theta), anchor[0], anchor[1])


@compiled
def line_in(lines: FloatArray, number: int) -> Line:
    """A row of a table (m, 5) of lines."""
    return Line(
        lines[number, 0], lines[number, 1], lines[number, 2], lines[number, 3], lines[number, 4]
    )


@compiled
def ray_of(pose: tuple[float, float, float], reading: FloatArray) -> Ray:
    """The middle of a reading's beam from a pose, m, m, rad."""
    x, y, heading = pose
    cos = math.cos(heading)
    sin = math.sin(heading)
    angle = heading + reading[2]
    return Ray(
        x + (cos * reading[0] - sin * reading[1]),
        y + (sin * reading[0] + cos * reading[1]),
        math.cos(angle),
        math.sin(angle),
    )


@compiled
def measuring_ray(middle: Ray, normal: tuple[float, float], cone: float) -> Ray:
    """The ray that measures a line with this normal as a beam with half an opening angle does."""
    if cone == 0.0:
        return middle
    ux = middle.to_x
    uy = middle.to_y
    nx, ny = normal
    side = math.copysign(1.0, nx * ux + ny * uy)
    sine = side * (ux * ny - uy * nx)
    if abs(sine) <= math.sin(cone):
        return Ray(middle.x, middle.y, side * nx, side * ny)
    cos = math.cos(cone)
    sin = math.copysign(math.sin(cone), sine)
    return Ray(middle.x, middle.y, cos * ux - sin * uy, cos * uy + sin * ux)


@compiled
def wall_ray(middle: Ray, normal: tuple[float, float], cone: float) -> Ray:
    """:func:`measuring_ray` of readings that are compared with lines. A beam that grazes the line
    is a ray.
    """
    cosine = normal[0] * middle.to_x + normal[1] * middle.to_y
    return measuring_ray(middle, normal, cone) if abs(cosine) > GRAZING else middle


@compiled
def read_share(cosine: float, cone: float) -> float:
    """The share of its distance that a wall reads, given the cosine between the middle of the beam
    and the wall's normal.
    """
    sine = math.sqrt(max(1.0 - cosine * cosine, 0.0))
    measured = measuring_ray(Ray(0.0, 0.0, cosine, sine), (1.0, 0.0), cone)
    return cosine / measured.to_x


@compiled
def meeting(ray: Ray, line: Line) -> tuple[float, float, float]:
    """Where a ray meets a line: how far along the ray, m, negative behind it; how far along the
    line from the foot of its anchor, m; and the cosine between the ray and the line's normal.
    """
    nx = line.normal_x
    ny = line.normal_y
    cosine = nx * ray.to_x + ny * ray.to_y
    cosine = math.copysign(max(abs(cosine), LEAST_DIVISOR), cosine)
    away_x = ray.x - line.anchor_x
    away_y = ray.y - line.anchor_y
    distance = (line.d - nx * away_x - ny * away_y) / cosine
    along = (away_y + distance * ray.to_y) * nx - (away_x + distance * ray.to_x) * ny
    return distance, along, cosine


@compiled
def passes(distance: float, cosine: float, length: float, margin: float) -> bool:
    """Whether a beam that is free for a length, m, passes through a line that it meets at a
    distance, m, by more than a margin, m along the line's normal. It does not if it grazes the
    line.
    """
    return abs(cosine) > GRAZING and distance > 0.0 and distance + margin / abs(cosine) < length


@compiled
def predict_range(
    pose: tuple[float, float, float], reading: FloatArray, line: Line, out: FloatArray
) -> None:
    """Set a row (7,) to what is predicted for a reading of a line from a pose, m, m, rad."""
    nx = line.normal_x
    ny = line.normal_y
    ray = wall_ray(ray_of(pose, reading), (nx, ny), reading[4])
    distance, along, cosine = meeting(ray, line)
    turning = (
        (pose[1] - ray.y) * nx
        + (ray.x - pose[0]) * ny
        + distance * (-ray.to_y * nx + ray.to_x * ny)
    )
    out[0] = distance
    out[1] = -nx / cosine
    out[2] = -ny / cosine
    out[3] = -turning / cosine
    out[4] = 1.0 / cosine
    out[5] = -along / cosine
    out[6] = cosine


@compiled
def predict_ranges(
    x: FloatArray,
    start: int,
    places: IntArray,
    readings: FloatArray,
    chosen: IntArray,
    line: Line,
    out: FloatArray,
) -> None:
    """Fill rows (k, 7) with what is predicted for those readings that are ``chosen`` (k,), whose
    beams meet a line.
    """
    for i in range(len(chosen)):
        at = start + POSE * places[chosen[i]]
        predict_range((x[at], x[at + 1], x[at + 2]), readings[chosen[i]], line, out[i])


@lean_entry
def predict_readings(
    poses: FloatArray,
    places: IntArray,
    readings: FloatArray,
    lines: FloatArray,
    labels: IntArray,
    out: FloatArray,
) -> None:
    """Fill rows (n, 7) with what is predicted for readings from poses (p, 3), each of the line that
    its label (n,) says. A line is a row (m, 5) with the fields of :class:`Line`.
    """
    for i in range(len(places)):
        pose = poses[places[i]]
        line = line_in(lines, labels[i])
        predict_range((pose[0], pose[1], pose[2]), readings[i], line, out[i])


@compiled
def end_of_ray(ray: Ray, length: float) -> tuple[float, float]:
    """End point of a ray with a length, m."""
    return ray.x + length * ray.to_x, ray.y + length * ray.to_y


@compiled
def end_on_wall(
    pose: tuple[float, float, float], reading: FloatArray, normal: tuple[float, float], reach: float
) -> tuple[float, float]:
    """Where a reading from a pose, m, m, rad, ends on a wall with this normal at a range, m."""
    return end_of_ray(wall_ray(ray_of(pose, reading), normal, reading[4]), reach)


@entry
def ends_of_beams(
    x: FloatArray, start: int, places: IntArray, readings: FloatArray, theta: float
) -> FloatArray:
    """End points (n, 2), m, of readings on a wall with its normal at ``theta``, rad; of the middle
    of beams if NaN.
    """
    points = np.empty((len(places), 2))
    # No beam is turned towards a normal that is no number.
    normal = (math.cos(theta), math.sin(theta))
    for i in range(len(places)):
        at = start + POSE * places[i]
        points[i] = end_on_wall((x[at], x[at + 1], x[at + 2]), readings[i], normal, readings[i, 3])
    return points
