"""Checks of the types of arguments that all environments share. They name what is wrong and what to write instead."""

from typing import Any

import numpy as np

from limslam_env.config import NoiseConfig, RewardConfig, bounds_of
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.messages import described, one_line
from limslam_env.robots import ROBOTS


def robot_of(value: Any) -> RobotSpec:
    """The robot that an argument names; the paper's robot for None.

    Raises
    ------
    ValueError
        If the argument is no ``RobotSpec``.
    """
    if value is None:
        return RobotSpec()
    if isinstance(value, RobotSpec):
        return value
    shipped = ROBOTS.get(value.replace("_", "-")) if isinstance(value, str) else None
    example = "" if shipped is None else f" (did you mean robot=limslam_env.robots.{shipped.__name__}()?)"
    raise _refusal("robot", "a RobotSpec", value, example)


def rewards_of(value: Any) -> RewardConfig:
    """The rewards that an argument gives; the default rewards for None.

    Raises
    ------
    ValueError
        If the argument is no ``RewardConfig``.
    """
    if value is None:
        return RewardConfig()
    if isinstance(value, RewardConfig):
        return value
    raise _refusal("rewards", "a RewardConfig", value, _with_keywords("rewards=RewardConfig", value))


def check_noise(value: Any, several: str = "") -> None:
    """Refuse what is no noise. ``several`` names further kinds of arguments that the environment takes.

    Raises
    ------
    ValueError
        If the argument is no ``NoiseConfig``.
    """
    if isinstance(value, NoiseConfig):
        return
    example = _with_keywords("noise=NoiseConfig", value)
    if is_number(value) or (isinstance(value, tuple) and len(value) == 2 and all(map(is_number, value))):
        example = f" (did you mean sensor_noise={value}?)"
    raise _refusal("noise", f"a NoiseConfig{several}", value, example)


def nominal_noise(noise: NoiseConfig) -> NominalNoise:
    """The noise that the robot's data sheets give, and that an agent may therefore know.

    Of a range of values it is the upper end. The variance of the wheels is never below that of ``NominalNoise()``,
    because no data sheet promises ideal wheels. Noise that a standard deviation cannot describe (dropouts, slip,
    unequal wheels and so on) is not part of it.
    """
    wheel_variance = max(bounds_of(noise.wheel_variance)[1], NominalNoise().wheel_variance)
    return NominalNoise(bounds_of(noise.sensor_noise)[1], wheel_variance)


def is_number(value: Any) -> bool:
    """Whether a value is one number, and not a truth value."""
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def _with_keywords(call: str, value: Any) -> str:
    """For a dictionary: the same settings as a call."""
    if not (isinstance(value, dict) and value and all(isinstance(key, str) for key in value)):
        return ""
    return f" (did you mean {call}({', '.join(f'{key}={setting!r}' for key, setting in value.items())})?)"


def _refusal(name: str, wanted: str, value: Any, example: str) -> ValueError:
    return ValueError(one_line(f"{name} must be {wanted}, not {described(value)}{example}"))
