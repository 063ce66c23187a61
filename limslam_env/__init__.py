"""LimSLAM's world: a robot with almost no sensing in an unknown building.

Importing this package registers the environments with Gymnasium, by name only: the physics
and the compiled kernels are loaded when the first environment is made.
"""

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import pettingzoo

from limslam_env.config import NOISE_PRESETS_M, NoiseConfig, RewardConfig
from limslam_env.interface import NominalNoise, Observation, RobotSpec, SensorSpec

if TYPE_CHECKING:
    from limslam_env.envs.parallel_env import LimSlamParallelEnv, aec_env, parallel_env
    from limslam_env.envs.vector_env import LimSlamVectorEnv
    from limslam_env.envs.vector_parallel_env import LimSlamParallelVectorEnv, parallel_vector_env

__version__ = "0.1.0"

__all__ = [
    "NOISE_PRESETS_M",
    "LimSlamParallelEnv",
    "LimSlamParallelVectorEnv",
    "LimSlamVectorEnv",
    "NoiseConfig",
    "NominalNoise",
    "Observation",
    "RewardConfig",
    "RobotSpec",
    "SensorSpec",
    "aec_env",
    "parallel_env",
    "parallel_vector_env",
]

MAX_EPISODE_STEPS = 18_000

# Where names are that are loaded when somebody asks for them.
_ROOMS = {
    "LimSlamParallelEnv": "envs.parallel_env",
    "LimSlamParallelVectorEnv": "envs.vector_parallel_env",
    "LimSlamVectorEnv": "envs.vector_env",
    "aec_env": "envs.parallel_env",
    "parallel_env": "envs.parallel_env",
    "parallel_vector_env": "envs.vector_parallel_env",
}

_PLACES = {
    "Env1": {"world": "env1"},
    "Env2": {"world": "env2"},
    "Env3": {"world": "env3"},
    "World": {},
    "Random": {"world": "random"},
}


def __getattr__(name: str) -> Any:
    # Physics and kernels are loaded when somebody asks for an environment.
    if name in _ROOMS:
        return getattr(importlib.import_module(f"limslam_env.{_ROOMS[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _register() -> None:
    for place, arguments in _PLACES.items():
        gym.register(
            f"LimSlam-{place}-v0",
            entry_point="limslam_env.envs.env:LimSlamEnv",
            vector_entry_point="limslam_env.envs.vector_env:LimSlamVectorEnv",
            max_episode_steps=MAX_EPISODE_STEPS,
            kwargs=arguments,
        )
        for kind in ("parallel", "aec"):
            pettingzoo.register(
                kind,
                f"limslam/{place}-v0",
                f"limslam_env.envs.parallel_env:{kind}_env",
                max_cycles=MAX_EPISODE_STEPS,
                kwargs=arguments,
            )


_register()
