"""A batch of environments on the processors or on a GPU, as ``gym.make_vec`` asks for it."""

from typing import Any

import gymnasium as gym

from limslam_env.envs.vector_env import LimSlamVectorEnv
from limslam_env.messages import described


def vector_env(*, device: str = "cpu", **arguments: Any) -> gym.vector.VectorEnv[Any, Any, Any]:
    """A batch of environments on processors, ``"cpu"``, or on a GPU, ``"cuda"``; ``gym.make_vec``
    calls this.
    """
    if device == "cpu":
        return LimSlamVectorEnv(**arguments)
    if device != "cuda":
        raise ValueError(f"device must be 'cpu' or 'cuda', not {described(device)}")
    # numba's part for GPUs takes long to load.
    from limslam_env.envs.device_env import LimSlamDeviceEnv

    return LimSlamDeviceEnv(**arguments)
