"""Measurement model of a range beam that meets a line, with its derivatives.

A line is stored as (d, theta) relative to an anchor a, a fixed point of the world near the line:
n . (p - a) = d with n = (cos theta, sin theta). This form has three advantages over (r, theta) relative to the world's
origin: d and theta are nearly uncorrelated, d may change its sign, and lines through the origin are not singular.
"""

from typing import NamedTuple

import numpy as np

from limslam_env.geometry import FloatArray, IntArray

GRAZING = 0.2
"""Least cosine between a beam and a line's normal. A reading at a flatter angle says too little about the line."""

LEAST_COSINE = 1e-9
"""Least cosine that a range is divided by. A beam parallel to a line meets it very far away, at a finite range."""


class Readings(NamedTuple):
    """Readings of beams, each taken from a pose that the filter has cloned.

    Attributes
    ----------
    clones
        Number of the clone (n,) that each reading was taken from.
    origins, angles
        Where the beams begin (n, 2), m, and their directions (n,), rad, in the robot's frame.
    ranges
        Measured ranges (n,), m.
    sources
        Step and beam of each reading (n, 2).
    """

    clones: IntArray
    origins: FloatArray
    angles: FloatArray
    ranges: FloatArray
    sources: IntArray

    def select(self, chosen: IntArray) -> "Readings":
        """The readings with the given indices."""
        return Readings(
            self.clones[chosen], self.origins[chosen], self.angles[chosen], self.ranges[chosen], self.sources[chosen]
        )


class Expected(NamedTuple):
    """Predicted measurements.

    Attributes
    ----------
    ranges
        Predicted ranges (n,), m.
    by_pose, by_line
        Derivatives of the ranges by the pose (n, 3) and by the line (n, 2).
    cosines
        Cosine between each beam and the line's normal (n,). It is near zero where the beam grazes the line.
    """

    ranges: FloatArray
    by_pose: FloatArray
    by_line: FloatArray
    cosines: FloatArray


def expected_ranges(poses: FloatArray, readings: Readings, line: FloatArray, anchor: FloatArray) -> Expected:
    """Predict the ranges of beams that meet a line.

    With p the beam's origin and u its direction in the world, r = (d - n . (p - a)) / (n . u).

    Parameters
    ----------
    poses
        Pose from which each reading was taken (n, 3), m and rad.
    readings
        The beams. Their measured ranges are not used.
    line, anchor
        (d, theta), m and rad, and the anchor (2,), m.
    """
    (offset_x, offset_y), origin, direction = _offsets(poses, readings)
    nx, ny = np.cos(line[1]), np.sin(line[1])
    ux, uy = direction.T
    cosines = nx * ux + ny * uy
    divisors = np.copysign(np.maximum(np.abs(cosines), LEAST_COSINE), cosines)
    ranges = (line[0] - nx * (origin[:, 0] - anchor[0]) - ny * (origin[:, 1] - anchor[1])) / divisors
    hit_x, hit_y = origin[:, 0] + ranges * ux - anchor[0], origin[:, 1] + ranges * uy - anchor[1]
    turning = (-offset_y * nx + offset_x * ny) + ranges * (-uy * nx + ux * ny)
    by_pose, by_line = np.empty((len(ranges), 3)), np.empty((len(ranges), 2))
    by_pose[:, 0], by_pose[:, 1], by_pose[:, 2] = -nx, -ny, -turning
    by_line[:, 0], by_line[:, 1] = 1.0, hit_x * ny - hit_y * nx
    return Expected(ranges, by_pose / divisors[:, None], by_line / divisors[:, None], cosines)


def hit_points(poses: FloatArray, readings: Readings) -> FloatArray:
    """End points of readings in the world (n, 2), m, for readings taken from poses (n, 3)."""
    _, origin, direction = _offsets(poses, readings)
    return np.asarray(origin + readings.ranges[:, None] * direction)


def _offsets(poses: FloatArray, readings: Readings) -> tuple[tuple[FloatArray, FloatArray], FloatArray, FloatArray]:
    """Vectors from body to beam in the world's axes, the beams' origins (n, 2), and their directions (n, 2)."""
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    offset_x = cos * readings.origins[:, 0] - sin * readings.origins[:, 1]
    offset_y = sin * readings.origins[:, 0] + cos * readings.origins[:, 1]
    heading = poses[:, 2] + readings.angles
    origin = poses[:, :2] + np.column_stack((offset_x, offset_y))
    return (offset_x, offset_y), origin, np.column_stack((np.cos(heading), np.sin(heading)))
