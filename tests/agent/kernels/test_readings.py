"""The front end's readings and masks, and the evidence of sudden changes: compiled, they are those of plain numpy."""

import math

import numpy as np
import pytest
from scipy.special import ndtr

from limslam_agent.dropouts import short_series
from limslam_agent.kernels.readings import sort_readings, weigh_changes
from limslam_agent.readings import as_readings
from limslam_env import RobotSpec
from limslam_env.geometry import BoolArray, FloatArray

ROBOT = RobotSpec()


@pytest.mark.parametrize("seed", range(5))
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


def density(off: FloatArray, std: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * (off / std) ** 2) / (std * math.sqrt(2.0 * math.pi)))


def plain_evidence(ranges: FloatArray, usable: BoolArray, motions: FloatArray, std: float, growth: float) -> FloatArray:
    limits, shares, slopes = ROBOT.max_ranges, (0.75, 0.25), ((1.0, 0.7), (2.0, 2.0))
    seen, nothing = np.minimum(ranges, limits), ranges >= ROBOT.too_far
    now, before, earlier = seen[2:], seen[1:-1], seen[:-2]
    travel, turn = motions[2:, :1], motions[2:, 1:]
    shorter = np.minimum(now, before)
    variances = std**2 + (growth * shorter**2) ** 2
    base = 2.0 * variances + 0.01**2
    stds = [np.sqrt(base + (drive * travel) ** 2 + (spin * turn * shorter) ** 2) for drive, spin in slopes]
    edges = 0.01 + 0.4 * np.minimum(turn, 0.2)
    goes_on = sum(share * density(now - before, each) for share, each in zip(shares, stds, strict=True))
    bend = np.sqrt(6.0 * variances + 0.03**2 + (0.2 * turn * shorter) ** 2)
    is_line = (np.minimum(turn, motions[1:-1, 1:]) > 0.05) & ~(nothing[2:] | nothing[1:-1] | nothing[:-2])
    is_line &= ~np.isnan(earlier)
    goes_on = np.where(is_line, np.maximum(goes_on, 0.6 * density(now - 2.0 * before + earlier, bend)), goes_on)
    changes = (1.0 - edges) * goes_on + edges / limits
    vanishes = sum(share * ndtr((before - limits) / each) for share, each in zip(shares, stds, strict=True))
    vanishes = (1.0 - edges) * vanishes + 0.45 * edges
    comes = sum(share * density(limits - now, each) for share, each in zip(shares, stds, strict=True))
    comes = 0.08 * (1.0 + 3.0 * (turn > 0.1)) * comes + edges / limits
    here = np.where(nothing[2:], vanishes, np.where(nothing[1:-1], comes, changes))
    evidence = np.log(np.where(nothing[2:], 0.45, 0.55 / limits) / here)
    evidence = np.where(nothing[2:] & nothing[1:-1], math.log(0.45), evidence)
    return np.where(usable[2:] & usable[1:-1], np.clip(evidence, -1.5, 4.5), 0.0)


@pytest.mark.parametrize("seed", range(3))
def test_evidence_of_changes(seed: int) -> None:
    generator, shape = np.random.default_rng(seed), (12, len(ROBOT.beams))
    ranges = np.cumsum(generator.normal(0.0, 0.03, shape), axis=0) + generator.uniform(0.3, 1.5, shape[1])
    ranges = np.where(generator.random(shape) < 0.15, ROBOT.max_ranges, np.clip(ranges, 0.1, ROBOT.max_ranges))
    ranges[generator.random(shape) < 0.05] = np.nan
    usable = ~np.isnan(ranges) & (generator.random(shape) < 0.95)
    motions = np.abs(generator.normal(0.0, (0.02, 0.1), (12, 2)))
    evidence = np.empty((10, shape[1]))
    weigh_changes(ranges, usable, motions, ROBOT.beam_table, 0.02, 0.05, evidence)
    np.testing.assert_allclose(evidence, plain_evidence(ranges, usable, motions, 0.02, 0.05), rtol=1e-9, atol=1e-9)
    assert np.std(evidence) > 0.1


@pytest.mark.parametrize("seed", range(3))
def test_dropouts(seed: int) -> None:
    nothing = np.random.default_rng(seed).random((15, 6)) < 0.7
    expected = nothing.copy()
    for first in range(15 - 4 + 1):
        expected[first : first + 4, nothing[first : first + 4].all(axis=0)] = False
    np.testing.assert_array_equal(short_series(nothing, 4), expected)
