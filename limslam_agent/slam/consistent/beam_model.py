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
    from limslam_agent.kernels.measurement import ranges_to_line

    return Expected(*ranges_to_line(poses, readings.origins, readings.angles, line, anchor, LEAST_COSINE))


def hit_points(poses: FloatArray, readings: Readings) -> FloatArray:
    """End points of readings in the world (n, 2), m, for readings taken from poses (n, 3)."""
    from limslam_agent.kernels.measurement import ends_of_beams

    return ends_of_beams(poses, readings.origins, readings.angles, np.ascontiguousarray(readings.ranges))
