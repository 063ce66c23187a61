"""Settings of the simulated world: noise, task and reward, as frozen dataclasses with units."""

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

Setting: TypeAlias = float | tuple[float, float]
"""A number, or a range (low, high) that a new value is drawn from at each reset."""

NOISE_PRESETS_M = {"none": 0.0, "low": 0.02, "high": 0.04}
"""Standard deviations of the ranges in the paper's experiments, m."""


@dataclass(frozen=True)
class NoiseConfig:
    """The true noise of ranges and wheels. Every number may be a range that is drawn from at reset.

    Attributes
    ----------
    sensor_noise
        Standard deviation of a range, m.
    dropout
        Chance that a beam misses what it should have seen, per measurement.
    wheel_variance
        Variance of a wheel's reported travel, m^2 per metre of travel.
    encoder_resolution
        Smallest travel that an encoder tells apart, m; what is left over counts next time. 0 is exact.
    wheel_mismatch
        Share by which the left encoder reports too much and the right one too little (unequal wheels).
    """

    sensor_noise: Setting = 0.0
    dropout: Setting = 0.0
    wheel_variance: Setting = 2e-5
    encoder_resolution: Setting = 0.0
    wheel_mismatch: Setting = 0.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, list):
                object.__setattr__(self, name, tuple(value))
        for name in ("sensor_noise", "dropout", "wheel_variance", "encoder_resolution"):
            low, high = bounds_of(getattr(self, name))
            if not (math.isfinite(high) and 0.0 <= low <= high):
                raise ValueError(f"{name} must be 0 or more, or a range of such numbers, not {getattr(self, name)}")
        if bounds_of(self.dropout)[1] > 1.0:
            raise ValueError(f"dropout is a chance, at most 1, not {self.dropout}")
        low, high = bounds_of(self.wheel_mismatch)
        if not -0.5 <= low <= high <= 0.5:
            raise ValueError(f"wheel_mismatch must lie between -0.5 and 0.5, not {self.wheel_mismatch}")

    def drawn(self, generator: np.random.Generator) -> "DrawnNoise":
        """The same settings with a value drawn from each range.

        A number is drawn for every setting, so that making one of them a range shifts no other.
        """
        values = {}
        for (name, setting), share in zip(vars(self).items(), generator.random(len(vars(self))), strict=True):
            low, high = bounds_of(setting)
            values[name] = low + (high - low) * float(share)
        return DrawnNoise(**values)


@dataclass(frozen=True)
class DrawnNoise(NoiseConfig):
    """Noise of one episode: every number is one number."""

    sensor_noise: float = 0.0
    dropout: float = 0.0
    wheel_variance: float = 2e-5
    encoder_resolution: float = 0.0
    wheel_mismatch: float = 0.0


@dataclass(frozen=True)
class RewardConfig:
    """Pieces that a step's reward is the sum of.

    Attributes
    ----------
    new_area
        Reward per square metre that is newly covered, by the truth.
    step
        Reward of every step: a cost of time when negative.
    collision
        Reward of a step in contact: a cost when negative.
    """

    new_area: float = 1.0
    step: float = -0.001
    collision: float = -0.05


@dataclass(frozen=True)
class TaskConfig:
    """When an episode has reached its goal, and what a step is worth.

    Attributes
    ----------
    coverage_goal
        Share of the coverable cells at which the episode terminates; None never ends it.
    reward
        The pieces of the reward.
    """

    coverage_goal: float | None = 0.99
    reward: RewardConfig = field(default_factory=RewardConfig)

    def __post_init__(self) -> None:
        if self.coverage_goal is not None and not 0.0 < self.coverage_goal <= 1.0:
            raise ValueError(f"coverage_goal must lie in (0, 1] or be None, not {self.coverage_goal}")


def bounds_of(setting: Setting) -> tuple[float, float]:
    """Lowest and highest value that a setting can take."""
    low, high = setting if isinstance(setting, tuple) else (setting, setting)
    return low, high
