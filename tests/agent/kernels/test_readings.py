"""The front end's readings and masks, compiled, are those of plain numpy."""

import numpy as np
import pytest

from limslam_agent.kernels.readings import sort_readings
from limslam_agent.readings import as_readings
from limslam_env.interface import RobotSpec

ROBOT = RobotSpec()


@pytest.mark.parametrize("seed", range(20))
def test_readings(seed: int) -> None:
    generator, count = np.random.default_rng(seed), len(ROBOT.beams)
    special = np.array([np.nan, np.inf, -np.inf, -0.3, 0.0, ROBOT.max_ranges[0], ROBOT.min_ranges[0], 0.01, 9.0])
    values = generator.uniform(0.0, 2.0, count)
    values = np.where(generator.random(count) < 0.5, generator.choice(special, count), values)
    is_new = generator.random(count) < 0.7
    readings, measured, hits = np.empty(count), is_new.copy(), np.zeros(count, dtype=bool)
    limits = ROBOT.min_ranges, ROBOT.max_ranges, ROBOT.too_near, ROBOT.too_far
    refused = sort_readings(values, *limits, readings, measured, hits)
    expected = as_readings(values, ROBOT.min_ranges, ROBOT.max_ranges)
    np.testing.assert_array_equal(readings, expected)
    assert refused == np.count_nonzero(np.isnan(expected))
    np.testing.assert_array_equal(measured, is_new & ~np.isnan(expected))
    np.testing.assert_array_equal(hits, measured & (expected > ROBOT.too_near) & (expected < ROBOT.too_far))
