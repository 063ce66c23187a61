"""Exploration as a task: what a step is worth, and when the goal is reached. Pure functions."""

from limslam_env.config import RewardConfig, TaskConfig


def reward(config: RewardConfig, new_area: float, contact: bool) -> float:
    """What one step is worth: ``new_area`` (m^2) seen for the first time, time, and ``contact``."""
    return config.new_area * new_area + config.step + config.collision * contact


def is_done(config: TaskConfig, coverage: float) -> bool:
    """Whether a covered share (0 to 1) reaches the goal."""
    return config.coverage_goal is not None and coverage >= config.coverage_goal
