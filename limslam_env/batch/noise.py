"""Noise settings of many environments, drawn for each of them."""

from dataclasses import fields

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


def noise_settings(noise: NoiseConfig, robot: RobotSpec) -> Settings:
    """The noise of a configuration as kernels draw it."""
    bounds = np.array([bounds_of(getattr(noise, name)) for name in _NAMES], dtype=float)
    lowest, highest = (_table(values, robot) for values in bounds.T)
    return Settings(lowest, highest - lowest, np.array([_NAMES.index(name) for name in _SETTINGS]))


def _table(values: FloatArray, robot: RobotSpec) -> FloatArray:
    """A table of noise (14,) of the values of settings (k,)."""
    # The same functions that make one environment's table.
    noise = DrawnNoise(**dict(zip(_NAMES, values.tolist(), strict=True)))
    axle = robot.axle * (1.0 + noise.axle_mismatch)
    columns = (
        *range_noise(noise),
        *wheel_noise(noise, robot.max_wheel_travel),
        noise.slip_rate,
        noise.slip_share,
        axle,
    )
    return np.array(columns)
