"""What the tests of several environments share: noise, actions, and the comparison of steps."""

import numpy as np

from limslam_env import NoiseConfig

EVERYTHING = NoiseConfig.sharp(
    encoder_resolution=0.001,
    wheel_mismatch=0.01,
    axle_mismatch=(-0.05, 0.05),
    slip_rate=2.0,
    slip_share=(0.1, 0.9),
)
"""Every kind of noise at once, some of it drawn anew at each reset."""


def held_actions(steps: int, *robots: int, seed: int = 0) -> np.ndarray:
    """Actions (steps, *robots, 2) that are held for a while, so that robots meet walls and each
    other.
    """
    held = (
        np.random.default_rng(seed)
        .uniform(-0.4, 1.0, (steps // 25 + 1, *robots, 2))
        .astype(np.float32)
    )
    return np.repeat(held, 25, axis=0)[:steps]


def bits(result: tuple) -> bytes:
    """All that a reset or a step gives, to the last bit."""

    def leaves(value):
        if isinstance(value, dict):
            for key, part in value.items():
                yield key.encode()
                yield from leaves(part)
        else:
            yield np.asarray(value).tobytes()

    return b"|".join(leaf for part in result for leaf in leaves(part))
