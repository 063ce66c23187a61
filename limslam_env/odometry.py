"""Wheel encoders: from what the wheels did to what they report."""

import numpy as np

from limslam_env.config import DrawnNoise
from limslam_env.geometry import FloatArray


def reported_travel(
    travel: FloatArray, remainder: FloatArray, noise: DrawnNoise, limit: float, generator: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """What the encoders of one robot say.

    Parameters
    ----------
    travel
        True left and right wheel travel since the last observation (2,), m.
    remainder
        Travel (2,) that was too small for the encoders to report so far, m.
    noise
        Of this episode.
    limit
        Largest travel that can be reported, m.
    generator
        Draws two normal numbers at every call, whatever the noise.

    Returns
    -------
    reported, remainder
        Both (2,), m.
    """
    std = np.sqrt(noise.wheel_variance * np.abs(travel))
    factors = np.array([1.0 + noise.wheel_mismatch, 1.0 - noise.wheel_mismatch])
    measured = travel * factors + std * generator.standard_normal(2) + remainder
    resolution = noise.encoder_resolution
    reported = np.trunc(measured / resolution) * resolution if resolution else measured
    return np.clip(reported, -limit, limit), measured - reported
