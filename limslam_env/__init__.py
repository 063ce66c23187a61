"""A simulator of small robots that explore unknown buildings with a few range sensors and wheel
encoders.

The environments implement the interfaces of Gymnasium (one robot, or a batch of them) and
PettingZoo (several robots). Importing this package registers them by name, for example
``LimSlam-Env1-v0``. The physics engine and the compiled kernels are loaded when the first
environment is made.

The public interface is the list ``__all__`` of this module. All other modules and names are
private: they can change in any release.
"""

import importlib
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import pettingzoo

from limslam_env.config import NOISE_PRESETS_M, NoiseConfig, RewardConfig
from limslam_env.interface import NominalNoise, Observation, RobotSpec, SensorSpec

if TYPE_CHECKING:
    from limslam_env.envs.env import LimSlamEnv
    from limslam_env.envs.parallel_env import LimSlamParallelEnv, aec_env, parallel_env
    from limslam_env.envs.vector_env import (
        LimSlamParallelVectorEnv,
        LimSlamVectorEnv,
        parallel_vector_env,
    )
    from limslam_env.overlay import Overlay
    from limslam_env.worlds.formats.loading import load_world
    from limslam_env.worlds.generation.floor_plans import FloorPlanConfig
    from limslam_env.worlds.world import World

__version__ = "0.1.0"

__all__ = [
    "NOISE_PRESETS_M",
    "FloorPlanConfig",
    "LimSlamEnv",
    "LimSlamParallelEnv",
    "LimSlamParallelVectorEnv",
    "LimSlamVectorEnv",
    "NoiseConfig",
    "NominalNoise",
    "Observation",
    "Overlay",
    "RewardConfig",
    "RobotSpec",
    "SensorSpec",
    "World",
    "aec_env",
    "load_world",
    "parallel_env",
    "parallel_vector_env",
]

MAX_EPISODE_STEPS = 18_000

# The modules of the names that are loaded at their first use.
_LAZY_MODULES = {
    "FloorPlanConfig": "worlds.generation.floor_plans",
    "LimSlamEnv": "envs.env",
    "LimSlamParallelEnv": "envs.parallel_env",
    "LimSlamParallelVectorEnv": "envs.vector_env",
    "LimSlamVectorEnv": "envs.vector_env",
    "Overlay": "overlay",
    "World": "worlds.world",
    "aec_env": "envs.parallel_env",
    "load_world": "worlds.formats.loading",
    "parallel_env": "envs.parallel_env",
    "parallel_vector_env": "envs.vector_env",
}

_WORLD_ARGUMENTS: dict[str, dict[str, str | None]] = {
    "Env1": {"world": "env1"},
    "Env2": {"world": "env2"},
    "Env3": {"world": "env3"},
    "World": {"world": None},
    "Random": {"world": "random"},
}


def __getattr__(name: str) -> Any:
    if name in _LAZY_MODULES:
        return getattr(importlib.import_module(f"limslam_env.{_LAZY_MODULES[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def _register() -> None:
    for name, arguments in _WORLD_ARGUMENTS.items():
        gym.register(
            f"LimSlam-{name}-v0",
            entry_point="limslam_env.envs.env:LimSlamEnv",
            vector_entry_point="limslam_env.envs.devices:vector_env",
            max_episode_steps=MAX_EPISODE_STEPS,
            kwargs=arguments,
        )
        for kind in ("parallel", "aec"):
            pettingzoo.register(
                kind,
                f"limslam/{name}-v0",
                f"limslam_env.envs.parallel_env:{kind}_env",
                max_cycles=MAX_EPISODE_STEPS,
                kwargs=arguments,
            )


_register()
