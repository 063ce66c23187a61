"""Readings of clones with the numbers that tests know them by, and the filter's operations on
them.
"""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.beams import line_table, predict_readings
from limslam_agent.kernels.tables import Readings as FilterReadings
from limslam_agent.kernels.tables import clones_from
from limslam_agent.kernels.updates import compare_readings
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

    @property
    def rows(self) -> FloatArray:
        """The readings (n, 6) as the filter takes them."""
        cones = np.full(len(self.ranges), self.cone)
        return np.column_stack(
            (self.origins, self.angles, self.ranges, cones, self.sources[:, 1])
        ).astype(float)

    def variances(self, std: float) -> FloatArray:
        return np.asarray(std**2 + (self.growth * self.ranges**2) ** 2)


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
    first = clones_from(ekf.arrays.counts)
    return np.asarray(first + 3 * places_of(ekf.arrays, clones)[:, None] + np.arange(3))


def clone_poses(ekf: CloneEKF, clones: IntArray) -> FloatArray:
    return np.asarray(ekf.x[columns_of(ekf, clones)])


def keep_clones(ekf: CloneEKF, wanted: set[int]) -> None:
    clone_filter.keep_clones(ekf.arrays, np.array(sorted(wanted), dtype=float))


def of_filter(ekf: CloneEKF, readings: Readings, std: float = 0.0) -> FilterReadings:
    """The readings as the filter takes them."""
    return FilterReadings(
        places_of(ekf.arrays, readings.clones), readings.rows, readings.variances(std)
    )


def points_of(ekf: CloneEKF, readings: Readings, theta: float = math.nan) -> FloatArray:
    return clone_filter.end_points(ekf.arrays, of_filter(ekf, readings), theta)


def observe(
    ekf: CloneEKF, readings: Readings, index: int, std: float, iterations: int, huber: float
) -> None:
    own = of_filter(ekf, readings, std)
    clone_filter.observe(ekf.arrays, own, index, ekf, iterations, huber)


def compared(ekf: CloneEKF, readings: Readings, index: int, std: float) -> float:
    return compare_readings(ekf.arrays, of_filter(ekf, readings, std), index)
