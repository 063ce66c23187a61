"""Readings of clones with the numbers that tests know them by, and the filter's operations on
them.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.beams import line_table, predict_readings
from limslam_agent.slam.consistent import clone_filter
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.pending_readings import places_of
from limslam_env.geometry import FloatArray, IntArray


class Readings(NamedTuple):
    """Clones (n,), where beams begin (n, 2), their directions and ranges (n,), and step and beam of
    each (n, 2).
    """

    clones: IntArray
    origins: FloatArray
    angles: FloatArray
    ranges: FloatArray
    sources: IntArray
    growth: float = 0.0
    cone: float = 0.0

    def select(self, chosen: IntArray) -> "Readings":
        return Readings(
            self.clones[chosen],
            self.origins[chosen],
            self.angles[chosen],
            self.ranges[chosen],
            self.sources[chosen],
            self.growth,
            self.cone,
        )

    @property
    def rows(self) -> FloatArray:
        """The readings (n, 6) as the filter takes them."""
        cones = np.full(len(self.ranges), self.cone)
        return np.column_stack(
            (self.origins, self.angles, self.ranges, cones, self.sources[:, 1])
        ).astype(float)

    def variances(self, std: float) -> FloatArray:
        return np.asarray(std**2 + (self.growth * self.ranges**2) ** 2)


class Expected(NamedTuple):
    """Ranges (n,), their derivatives by pose (n, 3) and line (n, 2), and cosines between beam and
    normal (n,).
    """

    ranges: FloatArray
    by_pose: FloatArray
    by_line: FloatArray
    cosines: FloatArray


def expected_rows(
    poses: FloatArray, readings: Readings, line: FloatArray, anchor: FloatArray
) -> FloatArray:
    """What the kernel says of ranges from a pose each (n, 7)."""
    found = np.empty((len(poses), 7))
    places = np.arange(len(poses))
    poses = np.ascontiguousarray(poses, dtype=float)
    lines = line_table(line[None], anchor[None])
    predict_readings(poses, places, readings.rows, lines, np.zeros_like(places), found)
    return found


def expected_ranges(
    poses: FloatArray, readings: Readings, line: FloatArray, anchor: FloatArray
) -> Expected:
    rows = expected_rows(poses, readings, line, anchor)
    return Expected(rows[:, 0], rows[:, 1:4], rows[:, 4:6], rows[:, 6])


def hit_points(poses: FloatArray, readings: Readings) -> FloatArray:
    """End points (n, 2) on the middle of the beams."""
    headings = poses[:, 2] + readings.angles
    cos = np.cos(poses[:, 2])
    sin = np.sin(poses[:, 2])
    x, y = readings.origins.T
    return np.column_stack(
        (
            poses[:, 0] + cos * x - sin * y + readings.ranges * np.cos(headings),
            poses[:, 1] + sin * x + cos * y + readings.ranges * np.sin(headings),
        )
    )


def columns_of(ekf: CloneEKF, clones: IntArray) -> IntArray:
    """Indices (n, 3) of clones in the state."""
    first = clone_filter.clones_from(ekf.arrays.counts)
    return np.asarray(first + 3 * places_of(ekf.arrays, clones)[:, None] + np.arange(3))


def clone_poses(ekf: CloneEKF, clones: IntArray) -> FloatArray:
    return np.asarray(ekf.x[columns_of(ekf, clones)])


def clone_covariance(ekf: CloneEKF, clones: IntArray) -> FloatArray:
    columns = columns_of(ekf, clones).ravel()
    return np.asarray(ekf.P[np.ix_(columns, columns)])


def keep_clones(ekf: CloneEKF, wanted: set[int]) -> None:
    clone_filter.keep_clones(ekf.arrays, np.array(sorted(wanted), dtype=float))


def points_of(ekf: CloneEKF, readings: Readings, theta: float = math.nan) -> FloatArray:
    return clone_filter.end_points(
        ekf.arrays, places_of(ekf.arrays, readings.clones), readings.rows, theta
    )


def observe(
    ekf: CloneEKF, readings: Readings, index: int, std: float, iterations: int, huber: float
) -> None:
    places = places_of(ekf.arrays, readings.clones)
    variances = readings.variances(std)
    clone_filter.observe(ekf.arrays, places, readings.rows, index, variances, iterations, huber)


def compared(ekf: CloneEKF, readings: Readings, index: int, std: float) -> float:
    places = places_of(ekf.arrays, readings.clones)
    variances = readings.variances(std)
    return clone_filter.compare(ekf.arrays, places, readings.rows, index, variances)
