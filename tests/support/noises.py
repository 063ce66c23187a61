"""Noise that the tests of several environments share."""

from limslam_env.config import NoiseConfig

EVERYTHING = NoiseConfig.sharp(
    encoder_resolution=0.001,
    wheel_mismatch=0.01,
    axle_mismatch=(-0.05, 0.05),
    slip_rate=2.0,
    slip_share=(0.1, 0.9),
)
"""Every kind of noise at once, some of it drawn anew at each reset."""
