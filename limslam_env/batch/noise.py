"""Noise settings of many environments, drawn for each of them."""

from collections.abc import Sequence
from dataclasses import fields
from types import SimpleNamespace
from typing import cast

import numpy as np

from limslam_env.config import DrawnNoise, NoiseConfig, bounds_of
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.batch_state import Settings
from limslam_env.simulation.odometry import wheel_noise
from limslam_env.simulation.sensors import range_noise

_NAMES = [part.name for part in fields(NoiseConfig)]

# The setting that each column of the table depends on. The limit of the encoders, column 10, depends on none.
_SETTINGS = (
    "sensor_noise", "range_noise_growth", "dropout", "range_resolution", "fold_back", "cone",
    "wheel_mismatch", "wheel_mismatch", "wheel_variance", "encoder_resolution", "encoder_resolution",
    "slip_rate", "slip_share", "axle_mismatch",
)  # fmt: skip


def noise_settings(settings: Sequence[NoiseConfig], robot: RobotSpec) -> Settings:
    """The noise of one configuration for all environments, or of one for each, as kernels draw it."""
    bounds = np.array([[bounds_of(getattr(noise, name)) for name in _NAMES] for noise in settings], dtype=float)
    lowest, highest = _table(bounds[..., 0], robot), _table(bounds[..., 1], robot)
    return Settings(lowest, highest - lowest, np.array([_NAMES.index(name) for name in _SETTINGS]))


def _table(values: FloatArray, robot: RobotSpec) -> FloatArray:
    """Tables of noise (k, 14) of values (k, settings)."""
    # The same functions that make one environment's table make columns of these.
    noise = cast(DrawnNoise, SimpleNamespace(**dict(zip(_NAMES, values.T, strict=True))))
    limit = cast(float, np.full(len(values), robot.max_wheel_travel))
    axle = robot.axle * (1.0 + np.asarray(noise.axle_mismatch))
    columns = (*range_noise(noise), *wheel_noise(noise, limit), noise.slip_rate, noise.slip_share, axle)
    return np.ascontiguousarray(np.column_stack(columns))
