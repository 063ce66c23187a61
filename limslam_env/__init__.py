"""LimSLAM's world: a robot with almost no sensing in an unknown building.

Importing this package registers the environments with Gymnasium, by name only: the physics
and the compiled kernels are loaded when the first environment is made.
"""

import gymnasium as gym

from limslam_env.config import NOISE_PRESETS_M, NoiseConfig, RewardConfig
from limslam_env.interface import NominalNoise, Observation, RobotSpec, SensorSpec

__version__ = "0.1.0"

__all__ = [
    "NOISE_PRESETS_M",
    "NoiseConfig",
    "NominalNoise",
    "Observation",
    "RewardConfig",
    "RobotSpec",
    "SensorSpec",
]

MAX_EPISODE_STEPS = 18_000


def _register() -> None:
    worlds = {"LimSlam-Env1-v0": {"world": "env1"}, "LimSlam-World-v0": {}}
    for name, arguments in worlds.items():
        gym.register(
            name, entry_point="limslam_env.env:LimSlamEnv", max_episode_steps=MAX_EPISODE_STEPS, kwargs=arguments
        )


_register()
