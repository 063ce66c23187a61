"""Settings: what is refused, and how ranges are drawn from."""

import dataclasses
import math

import numpy as np
import pytest

from limslam_env import LimSlamEnv, NoiseConfig

HIGHEST = {
    "sensor_noise": 1e3,
    "range_noise_growth": 1e3,
    "range_resolution": 1e3,
    "dropout": 1.0,
    "fold_back": 1e3,
    "cone": 0.5 * math.pi,
    "wheel_variance": 1e3,
    "encoder_resolution": 1e3,
    "wheel_mismatch": 0.5,
    "axle_mismatch": 0.5,
    "slip_rate": 1e6,
    "slip_share": 1.0,
}
MISMATCHES = {"wheel_mismatch", "axle_mismatch"}


def lowest(name: str) -> float:
    return -HIGHEST[name] if name in MISMATCHES else 0.0


def test_every_setting_has_its_bounds_here():
    assert [part.name for part in dataclasses.fields(NoiseConfig)] == list(HIGHEST)


@pytest.mark.parametrize("name", HIGHEST)
def test_a_setting_out_of_bounds_is_refused_in_one_clear_line(name):
    low, high = lowest(name), HIGHEST[name]
    above, below = high * 1.001, low - 1e-9
    nan, inf = math.nan, math.inf
    for value in (
        *(above, below, nan, inf, -inf),
        *((low, above), (below, high), (high, low), (nan, high), (low, nan), (low, inf), [below, high]),
    ):
        with pytest.raises(ValueError, match=rf"^{name} must be a number from \S+ to \S+, or a range") as refusal:
            NoiseConfig(**{name: value})
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", HIGHEST)
def test_the_bounds_themselves_are_allowed(name):
    low, high = lowest(name), HIGHEST[name]
    for value in (low, high, (low, high), (high, high)):
        assert getattr(NoiseConfig(**{name: value}), name) == value


def test_what_is_drawn_lies_in_its_range_and_fills_it():
    ranges = {name: (lowest(name), high) for name, high in HIGHEST.items()}
    generator = np.random.default_rng(0)
    draws = [NoiseConfig(**ranges).drawn(generator) for _ in range(400)]
    for name, (low, high) in ranges.items():
        values = np.array([getattr(drawn, name) for drawn in draws])
        assert all(type(getattr(drawn, name)) is float for drawn in draws)
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
        assert values.mean() == pytest.approx(0.5 * (low + high), abs=5.0 * (high - low) / math.sqrt(12.0 * 400))


def test_settings_are_drawn_independently_of_each_other():
    ranges = {name: (lowest(name), high) for name, high in HIGHEST.items()}
    generator = np.random.default_rng(1)
    values = np.array([list(vars(NoiseConfig(**ranges).drawn(generator)).values()) for _ in range(2000)])
    correlations = np.corrcoef(values.T) - np.eye(len(HIGHEST))
    assert np.abs(correlations).max() < 5.0 / math.sqrt(2000)


@pytest.mark.parametrize("name", HIGHEST)
def test_one_range_more_shifts_no_other_draw(name):
    some = {"sensor_noise": (0.01, 0.04), "axle_mismatch": (-0.1, 0.1), "slip_share": (0.2, 0.9)}
    with_it = {**some, name: (lowest(name), HIGHEST[name])}
    one, other = (NoiseConfig(**settings).drawn(np.random.default_rng(5)) for settings in (some, with_it))
    for part in dataclasses.fields(NoiseConfig):
        if part.name != name:
            assert getattr(one, part.name) == getattr(other, part.name)


def test_sharp_sensors_can_be_changed():
    sharp = NoiseConfig.sharp(dropout=(0.0, 0.1), wheel_variance=1e-4)
    assert sharp == dataclasses.replace(NoiseConfig.sharp(), dropout=(0.0, 0.1), wheel_variance=1e-4)
    with pytest.raises(ValueError, match=r"^cone must be"):
        NoiseConfig.sharp(cone=-0.1)
    with pytest.raises(TypeError, match="colour"):
        NoiseConfig.sharp(colour=1.0)


@pytest.mark.parametrize("goal", [0.0, -0.5, 1.0001, math.nan, math.inf])
def test_a_coverage_goal_that_cannot_be_reached_or_is_no_goal_is_refused(goal):
    with pytest.raises(ValueError, match="coverage_goal must lie in"):
        LimSlamEnv("env1", coverage_goal=goal)
