"""The exploration task: the reward of a step and the goal. Pure functions."""

from typing import Any, cast, overload

from limslam_env.config import RewardConfig, TaskConfig
from limslam_env.geometry import BoolArray, FloatArray


@overload
def reward(config: RewardConfig, new_area: float, contact: bool) -> float: ...
@overload
def reward(config: RewardConfig, new_area: FloatArray, contact: BoolArray) -> FloatArray: ...
def reward(config: RewardConfig, new_area: float | FloatArray, contact: bool | BoolArray) -> float | FloatArray:
    """The reward of a step with ``new_area`` (m^2) seen for the first time and with ``contact``; or arrays of each."""
    worth: Any = config.new_area * new_area + config.step + config.collision * contact
    return cast("float | FloatArray", worth)


@overload
def is_done(config: TaskConfig, coverage: float) -> bool: ...
@overload
def is_done(config: TaskConfig, coverage: FloatArray) -> bool | BoolArray: ...
def is_done(config: TaskConfig, coverage: float | FloatArray) -> bool | BoolArray:
    """Whether a coverage (0 to 1) reaches the goal; for an array, elementwise."""
    return config.coverage_goal is not None and coverage >= config.coverage_goal
