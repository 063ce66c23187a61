"""Settings of the simulated world: noise, task and reward, as frozen dataclasses with units."""

import math
from dataclasses import dataclass, field
from typing import Any, Self, TypeAlias

import numpy as np

from limslam_env.geometry.numbers import check_number, is_number
from limslam_env.messages import described

Setting: TypeAlias = float | tuple[float, float]
"""A number, or a range (low, high) that a new value is drawn from at each reset."""

NOISE_PRESETS_M = {"none": 0.0, "low": 0.02, "high": 0.04}
"""Standard deviations of the ranges in the paper's experiments, m."""


_BOUNDS = {
    "sensor_noise": (0.0, 1e3),
    "range_noise_growth": (0.0, 1e3),
    "range_resolution": (0.0, 1e3),
    "dropout": (0.0, 1.0),
    "fold_back": (0.0, 1e3),
    "cone": (0.0, 0.5 * math.pi),
    "wheel_variance": (0.0, 1e3),
    "encoder_resolution": (0.0, 1e3),
    "wheel_mismatch": (-0.5, 0.5),
    "axle_mismatch": (-0.5, 0.5),
    "slip_rate": (0.0, 1e6),
    "slip_share": (0.0, 1.0),
    "yaw_std": (0.0, 1e3),
    "yaw_drift": (-10.0, 10.0),
    "yaw_resolution": (0.0, 1.0),
}

_LARGEST_REWARD = 1e6


@dataclass(frozen=True)
class NoiseConfig:
    """The true noise of ranges, wheels and the heading. Every number may be a range that is drawn
    from at reset.

    Attributes
    ----------
    sensor_noise
        Standard deviation of a range, m.
    range_noise_growth
        Further noise that grows with the square of the range, 1/m: a sensor that finds distance by
        triangulation has a standard deviation of this times the squared range.
    range_resolution
        Step in which ranges are given, m; 0 is exact.
    dropout
        Chance that a beam misses what it should have seen, per measurement.
    fold_back
        By how much a reading rises per metre that a wall is nearer than ``min_range``, as that of a
        triangulating sensor does; 0 reads ``min_range`` there.
    cone
        Half the opening of a beam, rad: it reads the nearest of what five rays across it meet. 0 is
        one ray.
    wheel_variance
        Variance of a wheel's reported travel, m^2 per metre of travel.
    encoder_resolution
        Smallest travel that an encoder tells apart, m; what is left over counts next time. 0 is
        exact.
    wheel_mismatch
        Share by which the left encoder reports too much and the right one too little (unequal
        wheels).
    axle_mismatch
        Share by which the wheels are farther apart than the data sheet says.
    slip_rate
        How often a wheel slips, times per metre of its travel.
    slip_share
        Part of a step's travel that is lost when it does; the encoder counts it none the less.
    yaw_std
        Of the heading by an inertial measurement unit, which only environments with one observe:
        standard deviation by which it goes off in a second, rad.
    yaw_drift
        How fast it turns while the robot does not, rad/s.
    yaw_resolution
        Step in which it is given, rad; 0 is exact.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_env import NoiseConfig
    >>> noise = NoiseConfig(sensor_noise=(0.01, 0.04), dropout=0.01, encoder_resolution=0.002)
    >>> env = gym.make("LimSlam-Env2-v0", noise=noise)
    >>> NoiseConfig.sharp().cone > 0.0
    True
    """

    sensor_noise: Setting = 0.0
    range_noise_growth: Setting = 0.0
    range_resolution: Setting = 0.0
    dropout: Setting = 0.0
    fold_back: Setting = 0.0
    cone: Setting = 0.0
    wheel_variance: Setting = 2e-5
    encoder_resolution: Setting = 0.0
    wheel_mismatch: Setting = 0.0
    axle_mismatch: Setting = 0.0
    slip_rate: Setting = 0.0
    slip_share: Setting = 0.5
    yaw_std: Setting = 5e-4
    yaw_drift: Setting = (-3e-3, 3e-3)
    yaw_resolution: Setting = 1e-3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, list):
                object.__setattr__(self, name, tuple(value))
        for name, value in vars(self).items():
            lowest, highest = _BOUNDS[name]
            if not lies_within(value, lowest, highest):
                raise ValueError(
                    f"{name} must be a number from {lowest:g} to {highest:g}, or a range of such "
                    f"numbers, not {described(value)}"
                )

    @classmethod
    def sharp(cls, **changes: Setting) -> Self:
        """Noise of triangulating infrared sensors such as Sharp's, with dropouts, steps, fold-back
        and a cone.

        ``changes`` add or replace settings. The values have the order of magnitude of a GP2Y0A02's
        data sheet.
        """
        typical: dict[str, Setting] = {
            "sensor_noise": 0.005,
            "range_noise_growth": 0.015,
            "range_resolution": 0.005,
            "dropout": 0.005,
            "fold_back": 3.0,
            "cone": math.radians(2.0),
        }
        return cls(**{**typical, **changes})

    def drawn(self, generator: np.random.Generator) -> "NoiseConfig":
        """The same settings with a value drawn from each range.

        A number is drawn for every setting, so that making one of them a range shifts no other.
        """
        values = {}
        for (name, setting), share in zip(
            vars(self).items(), generator.random(len(vars(self))), strict=True
        ):
            low, high = bounds_of(setting)
            values[name] = low + (high - low) * float(share)
        return NoiseConfig(**values)


@dataclass(frozen=True)
class RewardConfig:
    """The terms whose sum is the reward of a step.

    Attributes
    ----------
    new_area
        Reward per square metre that is newly covered, by the truth.
    step
        Reward of every step: a cost of time when negative.
    collision
        Reward of a step in contact: a cost when negative.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_env import RewardConfig
    >>> env = gym.make("LimSlam-Env1-v0", rewards=RewardConfig(collision=-1.0))
    """

    new_area: float = 1.0
    step: float = -0.001
    collision: float = -0.05

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check_number(f"the reward {name}", value, -_LARGEST_REWARD, _LARGEST_REWARD)
            object.__setattr__(self, name, float(value))

    def of_step(self, new_area: float, contact: bool) -> float:
        """The reward of a step in which ``new_area`` (m^2) was seen for the first time."""
        return self.new_area * new_area + self.step + self.collision * contact


@dataclass(frozen=True)
class TaskConfig:
    """The goal of an episode and the reward of a step.

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
        goal = self.coverage_goal
        if goal is not None and not (lies_within(goal, 0.0, 1.0) and goal > 0.0):
            raise ValueError(f"coverage_goal must lie in (0, 1] or be None, not {goal}")

    def is_over(self, coverage: float) -> bool:
        """Whether a coverage (0 to 1) reaches the goal."""
        return self.coverage_goal is not None and coverage >= self.coverage_goal


def lies_within(setting: Any, lowest: float, highest: float) -> bool:
    """Whether a setting is a number, or a range of numbers, within limits."""
    try:
        low, high = bounds_of(setting)
        return is_number(low) and is_number(high) and lowest <= low <= high <= highest
    except (TypeError, ValueError):
        return False


def bounds_of(setting: Setting) -> tuple[float, float]:
    """Lowest and highest value that a setting can take."""
    low, high = setting if isinstance(setting, tuple) else (setting, setting)
    return low, high
