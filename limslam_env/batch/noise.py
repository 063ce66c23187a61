"""Noise settings of many environments, drawn for each of them."""

from collections.abc import Sequence
from dataclasses import fields
from types import SimpleNamespace
from typing import cast

import numpy as np

from limslam_env.config import DrawnNoise, NoiseConfig, bounds_of
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.random_numbers import Words, fill_units
from limslam_env.simulation.odometry import wheel_noise
from limslam_env.simulation.sensors import range_noise

_NAMES = [part.name for part in fields(NoiseConfig)]


class BatchNoise:
    """The noise settings of environments, and the tables of drawn values for the kernels.

    Parameters
    ----------
    settings
        One for all environments, or one for each.
    robot
        The specification of the robots.
    """

    def __init__(self, settings: Sequence[NoiseConfig], robot: RobotSpec) -> None:
        bounds = np.array([[bounds_of(getattr(noise, name)) for name in _NAMES] for noise in settings], dtype=float)
        self._low, self._span = bounds[..., 0], bounds[..., 1] - bounds[..., 0]
        self._robot = robot

    def drawn(self, envs: IntArray, keys: Words) -> FloatArray:
        """The noise (k, 14) of environments (k,), as :func:`limslam_env.kernels.batch_step.advance` takes it."""
        shares = np.zeros((len(envs), len(_NAMES)))
        if self._span.any():
            fill_units(keys, shares)
        rows = envs if len(self._low) > 1 else np.zeros(len(envs), dtype=np.int64)
        values = self._low[rows] + self._span[rows] * shares
        # The same functions that make one environment's table make columns of these.
        noise = cast(DrawnNoise, SimpleNamespace(**dict(zip(_NAMES, values.T, strict=True))))
        robot = self._robot
        limit = cast(float, np.full(len(envs), robot.max_wheel_travel))
        axle = robot.axle * (1.0 + np.asarray(noise.axle_mismatch))
        columns = (*range_noise(noise), *wheel_noise(noise, limit), noise.slip_rate, noise.slip_share, axle)
        return np.ascontiguousarray(np.column_stack(columns))
