"""The batch finds the lines that the plain Hough transform and fit find."""

from dataclasses import replace

import numpy as np
import pytest
from support.batch_stages import NOISE, cached, estimator_after, estimator_config, spec

from limslam_agent.kernels import lines as line_kernels
from limslam_agent.slam.batch import hough
from limslam_agent.slam.consistent.pending_readings import SIDES
from limslam_agent.slam.core.hough import extract_lines
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
    return found + [estimator._points(estimator._pending[0].readings(side)) for side in SIDES]


@pytest.mark.parametrize("points", clouds())
def test_lines(points: FloatArray) -> None:
    settings, count = spec().settings[0], len(points)
    most = count // CONFIG.min_votes + 1
    owner, lines, ends = np.empty(count, dtype=np.int64), np.empty((most, 2)), np.empty((most, 2, 2))
    number = extract(points, CONFIG.max_gap, settings, owner, lines, ends)
    expected = extract_lines(points, replace(CONFIG), NOISE)
    assert number == len(expected)
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
