"""Noise: the table that kernels read, random numbers for the steps of an episode, and slip."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.tables import SLIP_RATE, SLIP_SHARE

_BLOCK = 64
_NUM_WHEELS = 2


def noise_table(values: Mapping[str, Any], robot: RobotSpec) -> FloatArray:
    """The noise (14,) with the columns of :mod:`limslam_env.kernels.tables`, of the values of a ``NoiseConfig``."""
    names = "sensor_noise", "range_noise_growth", "dropout", "range_resolution", "fold_back", "cone"
    mismatch = values["wheel_mismatch"]
    encoders = (
        1.0 + mismatch, 1.0 - mismatch, values["wheel_variance"], values["encoder_resolution"], robot.max_wheel_travel,
    )  # fmt: skip
    axle = robot.axle * (1.0 + values["axle_mismatch"])
    return np.array([*(values[name] for name in names), *encoders, values["slip_rate"], values["slip_share"], axle])


def ground_travel(travel: FloatArray, noise: FloatArray, uniforms: FloatArray) -> FloatArray:
    """Distance (n, 2), m, that wheels move over the ground when they turn by ``travel`` (n, 2), m: less when they slip.

    Slips are a Poisson process along the path. ``noise`` is a table (14,), and ``uniforms`` (n, 2) are random numbers
    from U(0, 1).
    """
    slips = uniforms < -np.expm1(-noise[SLIP_RATE] * np.abs(travel))
    return np.where(slips, travel * (1.0 - noise[SLIP_SHARE]), travel)


class StepDraws:
    """Numbers from N(0, 1) and U(0, 1) for each beam and each wheel of all robots, generated for many steps at once.

    A step takes the same numbers whatever the noise is, so that runs with equal seeds can be compared in pairs.

    Parameters
    ----------
    ranges, wheels
        Separate generators for beams and wheels, so that the number of beams does not change the wheels' noise.
    num_robots, num_beams
        How many there are.
    """

    def __init__(
        self, ranges: np.random.Generator, wheels: np.random.Generator, num_robots: int, num_beams: int
    ) -> None:
        self._ranges, self._wheels, self._num_beams = ranges, wheels, num_beams
        self._shape = (_BLOCK, num_robots, num_beams + _NUM_WHEELS, 2)
        self._rows: list[FloatArray] = []

    def next(self) -> FloatArray:
        """The numbers of a step, (num_robots, num_beams + 2, 2)."""
        if not self._rows:
            block = np.empty(self._shape)
            beams, wheels = block[:, :, : self._num_beams], block[:, :, self._num_beams :]
            for generator, part in ((self._ranges, beams), (self._wheels, wheels)):
                part[..., 0] = generator.standard_normal(part.shape[:-1])
                part[..., 1] = generator.random(part.shape[:-1])
            self._rows = list(block)
        return self._rows.pop()
