"""Wheels and encoders: the table of their noise for the kernels, and slip."""

import numpy as np

from limslam_env.config import DrawnNoise
from limslam_env.geometry import FloatArray


def wheel_noise(noise: DrawnNoise, limit: float) -> FloatArray:
    """The noise of encoders (5,) with the columns of :mod:`limslam_env.kernels.tables`.

    ``limit`` (m) is the largest travel that they report.
    """
    mismatch = noise.wheel_mismatch
    return np.array([1.0 + mismatch, 1.0 - mismatch, noise.wheel_variance, noise.encoder_resolution, limit])


def ground_travel(travel: FloatArray, noise: DrawnNoise, uniforms: FloatArray) -> FloatArray:
    """Distance (n, 2), m, that wheels move over the ground when they turn by ``travel`` (n, 2), m: less when they slip.

    Slips are a Poisson process along the path. ``uniforms`` (n, 2) are random numbers from U(0, 1).
    """
    slips = uniforms < -np.expm1(-noise.slip_rate * np.abs(travel))
    return np.where(slips, travel * (1.0 - noise.slip_share), travel)
