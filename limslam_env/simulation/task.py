"""Exploration as a task: what a step is worth, and when the goal is reached. Pure functions."""

from typing import Any, cast, overload

from limslam_env.config import RewardConfig, TaskConfig
from limslam_env.geometry import BoolArray, FloatArray


@overload
def reward(config: RewardConfig, new_area: float, contact: bool) -> float: ...
@overload
def reward(config: RewardConfig, new_area: FloatArray, contact: BoolArray) -> FloatArray: ...
def reward(config: RewardConfig, new_area: float | FloatArray, contact: bool | BoolArray) -> float | FloatArray:
    """What one step is worth: ``new_area`` (m^2) seen for the first time, time, and ``contact``; or arrays of each."""
    worth: Any = config.new_area * new_area + config.step + config.collision * contact
    return cast("float | FloatArray", worth)


@overload
def is_done(config: TaskConfig, coverage: float) -> bool: ...
@overload
def is_done(config: TaskConfig, coverage: FloatArray) -> bool | BoolArray: ...
def is_done(config: TaskConfig, coverage: float | FloatArray) -> bool | BoolArray:
    """Whether a covered share (0 to 1), or which of an array of them, reaches the goal."""
    return config.coverage_goal is not None and coverage >= config.coverage_goal
