"""Measurement model of a range beam that meets a line, with its derivatives.

A line is stored as (d, theta) relative to an anchor a, a fixed point of the world near the line:
n . (p - a) = d with n = (cos theta, sin theta). This form has three advantages over (r, theta) relative to the world's
origin: d and theta are nearly uncorrelated, d may change its sign, and lines through the origin are not singular.

A beam may be a cone with half an opening angle c. It then reads the nearest point of the wall inside the cone. That is
the foot of the perpendicular if the cone contains it, and otherwise the end of the border ray that is nearer to the
perpendicular (J. Leonard and H. Durrant-Whyte, "Directed sonar sensing for mobile robot navigation", 1992). So a cone
measures what a ray measures that is turned towards the wall's normal, by c or until it is perpendicular to the wall.
The derivatives are those of this ray, too: where it follows the normal, its range does not depend on its direction.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import FLATTEST, LEAST_COSINE
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import angle_between


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
    growth, cone
        Those of the ``RangeSensor``.
    """

    clones: IntArray
    origins: FloatArray
    angles: FloatArray
    ranges: FloatArray
    sources: IntArray
    growth: float = 0.0
    cone: float = 0.0

    def select(self, chosen: IntArray) -> "Readings":
        """The readings with the given indices."""
        return Readings(
            self.clones[chosen], self.origins[chosen], self.angles[chosen], self.ranges[chosen], self.sources[chosen],
            self.growth, self.cone,
        )  # fmt: skip

    @property
    def rows(self) -> FloatArray:
        """Origins, angles, ranges and opening angle (n, 5), as compiled functions take them."""
        rows = np.empty((len(self.ranges), 5))
        rows[:, :2], rows[:, 2], rows[:, 3], rows[:, 4] = self.origins, self.angles, self.ranges, self.cone
        return rows

    def variances(self, std: float) -> FloatArray:
        """Variances of the ranges (n,), m^2, if short ranges have a standard deviation, m."""
        return RangeSensor(std, self.growth).variances(self.ranges)

    def towards(self, theta: float, headings: FloatArray) -> "Readings":
        """The rays that measure a line with its normal at ``theta``, rad, as the beams do.

        A beam whose middle grazes the line stays as it is, and is left out like a grazing ray: it is not clear which of
        its border rays is the nearer one.

        ``headings`` (n,), rad, are those of the poses that the readings were taken from.
        """
        if not self.cone:
            return self
        turn = angle_between(theta - headings - self.angles)
        turn = np.where(np.abs(turn) < FLATTEST, np.clip(turn, -self.cone, self.cone), 0.0)
        return self._replace(angles=self.angles + turn, cone=0.0)


class Expected(NamedTuple):
    """Predicted measurements.

    Attributes
    ----------
    ranges
        Predicted ranges (n,), m.
    by_pose, by_line
        Derivatives of the ranges by the pose (n, 3) and by the line (n, 2).
    cosines
        Cosine between each beam's ray and the line's normal (n,). It is near zero where the ray grazes the line.
    """

    ranges: FloatArray
    by_pose: FloatArray
    by_line: FloatArray
    cosines: FloatArray


class Disagreement(NamedTuple):
    """How badly readings fit a line, as chi-squares.

    Attributes
    ----------
    of_line
        Due to the line's position and direction (two degrees of freedom).
    left
        Not explained by any line.
    used
        Number of readings that were compared.
    offset, variance
        How far along its normal the readings put a parallel line, m, and the variance of that, m^2.
    """

    of_line: float
    left: float
    used: int
    offset: float
    variance: float


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

    return expected_of(ranges_to_line(poses.ravel(), np.arange(len(poses)), readings.rows, line, anchor))


def expected_of(rows: FloatArray) -> Expected:
    """Predicted measurements from the rows (n, 7) that compiled functions fill."""
    return Expected(rows[:, 0], rows[:, 1:4], rows[:, 4:6], rows[:, 6])


def by_range_errors(
    expected: Expected, readings: Readings, headings: FloatArray, theta: float, beams: int
) -> FloatArray:
    """Derivatives (n, 2 + beams) of predicted ranges by the errors of ``RangeErrors``.

    These are a bias of all ranges, half the opening angle of the beams, and the directions of the robot's beams. At the
    angle phi to the normal, a beam reads r tan(phi) more for each radian that it is turned away from the normal. A
    wider cone reads the wall under a ray that is nearer to the perpendicular, and so a shorter range.

    Parameters
    ----------
    expected, readings
        What is predicted, and the readings.
    headings
        Those of the poses that the readings were taken from (n,), rad.
    theta
        Direction of the line's normal, rad.
    beams
        Number of beams of the robot; 0 if their directions are not estimated.
    """
    cosines = np.maximum(np.abs(expected.cosines), LEAST_COSINE)
    sines = np.sqrt(np.maximum(1.0 - cosines**2, 0.0))
    by_width = -expected.ranges * sines / cosines
    by_errors = np.zeros((len(cosines), 2 + beams))
    by_errors[:, 0], by_errors[:, 1] = 1.0, by_width
    if beams:
        slants = angle_between(headings + readings.towards(theta, headings).angles - theta)
        by_errors[np.arange(len(slants)), 2 + readings.sources[:, 1]] = -np.sign(slants) * by_width
    return by_errors


def hit_points(poses: FloatArray, readings: Readings) -> FloatArray:
    """End points of readings in the world (n, 2), m, for readings taken from poses (n, 3)."""
    from limslam_agent.kernels.measurement import ends_of_beams

    return ends_of_beams(poses.ravel(), 0, np.arange(len(poses)), readings.rows, math.nan)
