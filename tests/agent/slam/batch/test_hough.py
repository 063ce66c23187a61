"""The batch finds the lines that the plain Hough transform and fit find."""

import numpy as np
import pytest
from support.batch_stages import NOISE, cached, estimator_after, estimator_config, waiting_readings
from support.readings import points_of

from limslam_agent.kernels import lines as line_kernels
from limslam_agent.slam.batch import hough
from limslam_agent.slam.core.hough import bin_size, extract_lines, max_distance
from limslam_agent.slam.core.line_fit import fit_line
from limslam_env.geometry import FloatArray

extract, fit = cached(hough.extract_lines), cached(line_kernels.fit_line)
CONFIG = estimator_config().hough


def clouds() -> list[FloatArray]:
    """Points of a corner with noise and outliers, as random as a seed makes them, and the points of a drive."""
    found = []
    for seed in range(6):
        generator = np.random.default_rng(seed)
        theta, along = generator.uniform(-np.pi, np.pi), generator.uniform(-1.0, 1.0, 30)
        walls = np.vstack((np.column_stack((along[:18], np.zeros(18))), np.column_stack((np.ones(12), along[18:]))))
        points = walls + NOISE * generator.standard_normal(walls.shape)
        rotation = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        found.append(
            np.vstack((points @ rotation, generator.uniform(-1.0, 1.0, (5, 2)))) + generator.normal(0.0, 2.0, 2)
        )
    estimator = estimator_after(100)
    return found + [points_of(estimator.belief, waiting_readings(estimator, side)) for side in range(3)]


@pytest.mark.parametrize("points", clouds())
def test_lines(points: FloatArray) -> None:
    bins = CONFIG.min_votes, bin_size(CONFIG, NOISE), CONFIG.theta_step, max_distance(CONFIG, NOISE)
    owner, lines, ends = extract(points, CONFIG.max_gap, *bins, CONFIG.min_length, CONFIG.only_best)
    expected = extract_lines(points, CONFIG, NOISE)
    assert len(lines) == len(expected)
    for index, line in enumerate(expected):
        np.testing.assert_array_equal(np.flatnonzero(owner == index), np.sort(line.members))
        np.testing.assert_allclose(lines[index], line.fit.line, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(ends[index], line.fit.ends, rtol=0.0, atol=1e-9)


def test_some_clouds_have_lines() -> None:
    assert sum(bool(extract_lines(points, CONFIG, NOISE)) for points in clouds()) > 5


def test_fits_of_random_points() -> None:
    generator = np.random.default_rng(3)
    for count in (2, 3, 10, 50):
        points, ends = generator.normal(1.0, 2.0, (count, 2)), np.empty((2, 2))
        members = np.sort(generator.choice(count, max(count - 2, 2), replace=False))
        expected = fit_line(points[members], NOISE)
        np.testing.assert_allclose(fit(points, members, ends), expected.line, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(ends, expected.ends, rtol=0.0, atol=1e-9)
