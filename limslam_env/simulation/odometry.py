"""Wheels and their encoders: their noise as the kernels read it, and slips."""

import numpy as np

from limslam_env.config import DrawnNoise
from limslam_env.geometry import FloatArray


def wheel_noise(noise: DrawnNoise, limit: float) -> FloatArray:
    """The noise of encoders as :func:`limslam_env.kernels.observation.observe` reads it, (5,).

    ``limit`` (m) is the largest travel that they report.
    """
    mismatch = noise.wheel_mismatch
    return np.array([1.0 + mismatch, 1.0 - mismatch, noise.wheel_variance, noise.encoder_resolution, limit])


def carried_travel(travel: FloatArray, noise: DrawnNoise, uniforms: FloatArray) -> FloatArray:
    """How far wheels that turn by ``travel`` (n, 2), m, get on the floor: less where they slip.

    Slips are a Poisson process along the way; ``uniforms`` (n, 2) from U(0, 1) decide.
    """
    slips = uniforms < -np.expm1(-noise.slip_rate * np.abs(travel))
    return np.where(slips, travel * (1.0 - noise.slip_share), travel)
