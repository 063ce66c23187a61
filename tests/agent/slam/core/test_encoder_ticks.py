"""Ticks of encoders: how they are found, and how far a pose may be off by them."""

import numpy as np
import pytest

from limslam_agent.slam.core.encoder_ticks import first_jitter, jitter_of, tick_by, ticks_of
from limslam_env.geometry import se2


@pytest.mark.parametrize("tick", [0.0003, 0.0023, 0.0102])
def test_a_tick_is_found_in_what_is_reported(tick: float) -> None:
    totals = np.cumsum(np.random.default_rng(0).normal(0.02, 0.01, (300, 1, 2)), axis=0)
    wheels = np.diff(np.floor(totals / tick) * tick, axis=0).astype(np.float32)
    np.testing.assert_allclose(ticks_of(wheels.astype(float)), tick, rtol=1e-3)


def test_exact_travels_have_no_tick_that_counts() -> None:
    assert ticks_of(np.random.default_rng(0).normal(0.02, 1e-4, (300, 1, 2))).max() < 1e-4


def test_travels_that_are_all_the_same_say_nothing_of_a_tick() -> None:
    tick = 0.0
    for _ in range(5):
        tick = tick_by(tick, 0.03)
    assert tick < 0.0
    assert not jitter_of(np.array([tick, tick]), 0.16).any()
    assert tick_by(tick, 0.02) == pytest.approx(0.01)


def test_the_jitter_is_the_covariance_of_parts_of_ticks() -> None:
    ticks, axle = np.array([0.01, 0.004]), 0.2
    parts = np.random.default_rng(0).uniform(-0.5, 0.5, (20000, 2)) * ticks
    poses = np.array([se2.arc(*se2.wheels_to_arc(each, axle)) for each in parts])
    np.testing.assert_allclose(jitter_of(ticks, axle), np.cov(poses.T), rtol=0.03, atol=2e-7)


def test_the_first_jitter_is_that_of_the_wheels_whose_ticks_were_not_known() -> None:
    ticks = np.array([0.01, 0.004])
    added = first_jitter(np.array([0.0, 0.004]), ticks, 0.2)
    np.testing.assert_array_equal(added, jitter_of(np.array([0.01, 0.0]), 0.2))
    assert not first_jitter(ticks, ticks, 0.2).any()
