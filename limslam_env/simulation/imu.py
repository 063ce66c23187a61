"""The heading of each robot by an inertial measurement unit (IMU)."""

import math

import numpy as np

from limslam_env.config import NoiseConfig
from limslam_env.geometry import FloatArray, ReadingArray
from limslam_env.geometry.se2 import wrap_angle


class Imu:
    """The units of all robots. Each begins at a random heading of its own.

    Parameters
    ----------
    generator
        What the noise is drawn from.
    noise
        The noise; its numbers have been drawn.
    period
        Time between two readings, s.
    """

    def __init__(self, generator: np.random.Generator, noise: NoiseConfig, period: float) -> None:
        self._generator = generator
        self._noise = noise
        self._period = period
        self._total: FloatArray | None = None
        self._before = np.zeros(0)

    def read(self, headings: FloatArray) -> ReadingArray:
        """The next readings (n, 1), rad, from -pi to pi, of robots with true headings (n,), rad."""
        values = vars(self._noise)
        count = len(headings)
        period = self._period
        if self._total is None:
            self._total = self._generator.uniform(-math.pi, math.pi, count)
        else:
            walk = values["yaw_std"] * math.sqrt(period) * self._generator.standard_normal(count)
            turns = wrap_angle(headings - self._before)
            self._total = self._total + turns + walk + values["yaw_drift"] * period
        self._before = headings.copy()
        yaw = self._total
        resolution = values["yaw_resolution"]
        if resolution:
            yaw = resolution * np.round(yaw / resolution)
        return wrap_angle(yaw).astype(np.float32)[:, None]
