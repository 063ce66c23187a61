"""What a beam should measure when it meets a line, and how that changes with the pose and the line.

A line is kept as (d, theta) about an anchor a, a fixed point of the world near it: n . (p - a) = d with
n = (cos theta, sin theta). Unlike (r, theta) about the world's origin, d and theta hardly interact there, d may change
its sign without harm, and nothing is special about lines through the origin.
"""

from typing import NamedTuple

import numpy as np

from limslam_env.geometry import FloatArray, IntArray

GRAZING = 0.2
"""Cosine between a beam and a line's normal below which a reading says next to nothing."""

_ALONG = 1e-9


class Readings(NamedTuple):
    """Readings of beams, each taken from a pose that the filter has kept.

    Attributes
    ----------
    clones
        Which kept pose (n,) each was taken from.
    origins, angles
        Where the beams begin (n, 2), m, and point (n,), rad, on the body.
    ranges
        What they measured (n,), m.
    sources
        (n, 2): step and beam.
    """

    clones: IntArray
    origins: FloatArray
    angles: FloatArray
    ranges: FloatArray
    sources: IntArray

    def select(self, chosen: IntArray) -> "Readings":
        """Some of them, by index."""
        return Readings(
            self.clones[chosen], self.origins[chosen], self.angles[chosen], self.ranges[chosen], self.sources[chosen]
        )


class Expected(NamedTuple):
    """What beams should measure: ranges (n,), m, their derivatives by pose (n, 3) and line (n, 2), and cosines (n,).

    The cosine is that between a beam and the line's normal: near zero the beam grazes the line.
    """

    ranges: FloatArray
    by_pose: FloatArray
    by_line: FloatArray
    cosines: FloatArray


def expected_ranges(poses: FloatArray, readings: Readings, line: FloatArray, anchor: FloatArray) -> Expected:
    """How far beams should see to a line.

    With p the beam's origin and u its direction in the world, r = (d - n . (p - a)) / (n . u).

    Parameters
    ----------
    poses
        Where each reading was taken (n, 3), m and rad.
    readings
        Of which beams.
    line, anchor
        (d, theta) and the point (2,) that d counts from, m and rad.
    """
    (offset_x, offset_y), origin, direction = _offsets(poses, readings)
    nx, ny = np.cos(line[1]), np.sin(line[1])
    ux, uy = direction.T
    cosines = nx * ux + ny * uy
    # A beam exactly along the line would meet it nowhere; very far away will do, and stays a number.
    divisors = np.copysign(np.maximum(np.abs(cosines), _ALONG), cosines)
    ranges = (line[0] - nx * (origin[:, 0] - anchor[0]) - ny * (origin[:, 1] - anchor[1])) / divisors
    hit_x, hit_y = origin[:, 0] + ranges * ux - anchor[0], origin[:, 1] + ranges * uy - anchor[1]
    turning = (-offset_y * nx + offset_x * ny) + ranges * (-uy * nx + ux * ny)
    by_pose = np.stack((np.full_like(cosines, -nx), np.full_like(cosines, -ny), -turning), axis=1)
    by_line = np.stack((np.ones_like(cosines), hit_x * ny - hit_y * nx), axis=1)
    return Expected(ranges, by_pose / divisors[:, None], by_line / divisors[:, None], cosines)


def hit_points(poses: FloatArray, readings: Readings) -> FloatArray:
    """Where readings end in the world (n, 2), m, taken from poses (n, 3)."""
    _, origin, direction = _offsets(poses, readings)
    return np.asarray(origin + readings.ranges[:, None] * direction)


def _offsets(poses: FloatArray, readings: Readings) -> tuple[tuple[FloatArray, FloatArray], FloatArray, FloatArray]:
    """From body to beam in the world's axes, the beams' origins (n, 2), and their directions (n, 2)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    offset_x = cos * readings.origins[:, 0] - sin * readings.origins[:, 1]
    offset_y = sin * readings.origins[:, 0] + cos * readings.origins[:, 1]
    heading = poses[:, 2] + readings.angles
    origin = poses[:, :2] + np.column_stack((offset_x, offset_y))
    return (offset_x, offset_y), origin, np.column_stack((np.cos(heading), np.sin(heading)))
