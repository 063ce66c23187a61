"""Readings beside the ranges that walls predict: compiled as in plain numpy."""

from typing import NamedTuple

import numpy as np
import pytest

from limslam_agent.kernels.crossings import (
    LEAST_COSINE,
    WALL_COLUMNS,
    compare_readings,
    predict_ranges,
)
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.geometry.segment import distances
from limslam_env.interface import RobotSpec

ROBOT, STD, SEEDS = RobotSpec(), 0.02, range(5)
SENSOR = RangeSensor(STD).numbers
BEAMS = len(ROBOT.beams)
INSET, LEAST = 0.1, 0.35


class Crossed(NamedTuple):
    """Where beams at poses meet the lines of walls (m, b, k)."""

    distances: FloatArray
    ahead: BoolArray
    beyond: FloatArray
    cosines: FloatArray


def crossed(poses: FloatArray, segments: FloatArray) -> Crossed:
    origins = np.array([transform_points(pose, ROBOT.beam_origins) for pose in poses])
    headings = poses[:, 2, None] + ROBOT.beam_angles
    towards = np.stack((np.cos(headings), np.sin(headings)), axis=-1)
    spans = segments[:, 2:] - segments[:, :2]
    sizes = np.hypot(spans[:, 0], spans[:, 1])
    tangents = spans / sizes[:, None]
    normals = np.column_stack((-tangents[:, 1], tangents[:, 0]))
    cosines = towards @ normals.T
    is_crossing = np.abs(cosines) > LEAST_COSINE
    to_wall = np.sum(segments[:, :2] * normals, axis=1) - origins @ normals.T
    away = np.where(is_crossing, to_wall / np.where(is_crossing, cosines, 1.0), -1.0)
    along = origins @ tangents.T - np.sum(segments[:, :2] * tangents, axis=1) + away * (towards @ tangents.T)
    return Crossed(away, away > 0.0, np.maximum(-along, along - sizes), np.abs(cosines))


def first_walls(met: Crossed) -> tuple[FloatArray, FloatArray, IntArray]:
    """Distance to the first wall, the cosine there, and its number (m, b); infinite, 1 and 0 without a wall."""
    reached = np.where(met.ahead & (met.beyond < -INSET), met.distances, np.inf)
    nearest = reached.min(axis=2)
    cosines = np.take_along_axis(met.cosines, reached.argmin(axis=2)[..., None], axis=2)[..., 0]
    return nearest, np.where(np.isfinite(nearest), cosines, 1.0), reached.argmin(axis=2)


@pytest.mark.parametrize("seed", SEEDS)
def test_predicted_ranges(seed: int) -> None:
    generator = np.random.default_rng(seed)
    poses = np.cumsum(generator.normal(0.0, [0.02, 0.02, 0.03], (90, 3)), axis=0)
    segments, covariance = generator.normal(0.0, 1.5, (12, 4)), np.diag([1e-4, 2e-4, 3e-4])
    ranges, stds = np.empty((len(poses), BEAMS)), np.empty((len(poses), BEAMS))
    walls, first = np.empty((len(segments), WALL_COLUMNS)), np.empty(ranges.shape, dtype=np.int64)
    predict_ranges(poses, covariance, segments, ROBOT.beam_table, SENSOR, INSET, LEAST, walls, ranges, stds, first)
    nearest, cosines, numbers = first_walls(crossed(poses, segments))
    expected = np.where((cosines > LEAST) & (nearest < ROBOT.max_ranges), nearest, np.inf)
    np.testing.assert_allclose(ranges, expected)
    np.testing.assert_array_equal(first, numbers)
    lever = np.where(np.isfinite(expected), expected, 0.0)
    variances = STD**2 + 3e-4 + 3e-4 * lever**2
    np.testing.assert_allclose(stds, np.sqrt(variances) / np.maximum(cosines, LEAST_COSINE))
    assert np.isfinite(ranges).any()


@pytest.mark.parametrize("seed", SEEDS)
def test_readings_beside_a_map(seed: int) -> None:
    generator, sensor = np.random.default_rng(seed), RangeSensor(STD, 0.02, 0.1, 0.01)
    counts, (reach, least, cell), low = 0, (2, 4, 0.1), np.array([-3.0, -3.0])
    values = np.where(generator.random((60, 60)) < 0.02, -5, 9).astype(np.int16)
    for _ in range(40):
        pose = np.array([*generator.uniform(-2.0, 2.0, 2), generator.uniform(-3.0, 3.0)])
        segments, usable = generator.uniform(-3.0, 3.0, (3, 4)), generator.random(BEAMS) < 0.9
        ranges = generator.choice([0.05, 0.4, 0.8, 1.2, 5.0], BEAMS) + generator.normal(0.0, 0.03, BEAMS)
        predicted = np.where(generator.random(BEAMS) < 0.5, ranges + generator.normal(0.0, 0.15, BEAMS), np.inf)
        stds, found = generator.uniform(0.01, 0.05, BEAMS), np.empty((5, BEAMS), dtype=bool)
        compare_readings(
            pose, ranges, usable, predicted, stds, ROBOT.beam_table, sensor.numbers, 3.0, 0.05, segments, values, low,
            cell, reach, least, found,
        )  # fmt: skip
        counts_here = usable & (ranges > ROBOT.too_near)
        expected, ended = counts_here & np.isfinite(predicted), counts_here & (ranges < ROBOT.too_far)
        excess = np.where(expected, np.minimum(ranges, ROBOT.max_ranges) - np.where(expected, predicted, 0.0), 0.0)
        limit, reached = 3.0 * stds + 0.05, ranges - sensor.bias
        ends = transform_points(pose, ROBOT.beam_origins + reached[:, None] * ROBOT.beam_directions)
        near = 3.0 * sensor.stds(reached) + 0.05 + sensor.cone * reached
        in_free = ended & (distances(ends, segments).min(axis=1) > near)
        for beam, (x, y) in enumerate(ends):
            column, row = int(np.floor((x - low[0]) / cell)), int(np.floor((y - low[1]) / cell))
            is_inside = reach <= row < 60 - reach and reach <= column < 60 - reach
            around = values[row - reach : row + reach + 1, column - reach : column + reach + 1]
            in_free[beam] &= is_inside and bool(around.min() >= least)
        through, fits = expected & (excess > limit), expected & (np.abs(excess) <= limit)
        np.testing.assert_array_equal(found, [expected, fits, through, ended, in_free])
        counts = counts + found.sum(axis=1)
    assert np.min(counts) > 5
