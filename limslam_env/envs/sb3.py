"""Batches of environments for Stable-Baselines3, which has its own interface for them (extra
``rl``).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn


class Sb3VecEnv(VecEnv):
    """An adapter of a `gymnasium.vector.VectorEnv` to Stable-Baselines3's interface.

    ``Sb3VecEnv(gym.make_vec("LimSlam-Random-v0", 64, autoreset_mode="SameStep"))`` makes a batch
    whose steps are one call. The infos of an episode's last step hold ``terminal_observation``,
    ``TimeLimit.truncated`` and ``episode`` (return ``r``, steps ``l``), so that no `VecMonitor` is
    needed. The infos of each step hold its ``cost``, if the batch has one. Other infos stay behind,
    since turning arrays into a dict for each environment would cost more than the step.

    Parameters
    ----------
    env
        The batch. It begins an episode in the step in which another ends.

    Raises
    ------
    ValueError
        If it begins its episodes otherwise.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if env.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
            raise ValueError(
                "episodes must begin in the step in which others end: autoreset_mode='SameStep'"
            )
        self.env = env
        self._actions: NDArray[Any] | None = None
        self._returns = np.zeros(env.num_envs)
        self._lengths = np.zeros(env.num_envs, dtype=np.int64)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        if "render_fps" in env.metadata:
            self.metadata["render_fps"] = env.metadata["render_fps"]

    def reset(self) -> VecEnvObs:
        """Begin new episodes with the seed and the options that were set since the last reset."""
        options: dict[str, Any] = {}
        for given in self._options:
            options |= given
        observation, _ = self.env.reset(seed=self._seeds[0], options=options or None)
        self._reset_seeds()
        self._reset_options()
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return observation

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keep the actions (n, ...) for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Observations, rewards (n,), ends (n,) and a dict for each environment."""
        observation, rewards, terminated, truncated, found = self.env.step(self._actions)
        ends = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos = self._costs(found)
        for number in np.flatnonzero(ends):
            infos[number] |= {
                "terminal_observation": found["final_obs"][number],
                "TimeLimit.truncated": bool(truncated[number] and not terminated[number]),
                "episode": {"r": float(self._returns[number]), "l": int(self._lengths[number])},
            }
        self._returns[ends] = 0.0
        self._lengths[ends] = 0
        return observation, np.asarray(rewards, dtype=np.float32), ends, infos

    def close(self) -> None:
        """Close the batch."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The batch's attribute, once for each environment."""
        return [getattr(self.env, attr_name)] * len(self._numbers(indices))

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the batch. Single environments have no attributes of their own."""
        del indices
        setattr(self.env, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the batch once; returns its result for each environment."""
        return [getattr(self.env, method_name)(*args, **kwargs)] * len(self._numbers(indices))

    def env_is_wrapped(self, wrapper_class: type[Any], indices: VecEnvIndices = None) -> list[bool]:
        """Always false: single environments in a batch have no wrappers."""
        del wrapper_class
        return [False] * len(self._numbers(indices))

    def get_images(self) -> Sequence[NDArray[Any] | None]:
        """A picture (height, width, 3) of each environment; None where the batch has no
        ``render_mode``.
        """
        pictures: Sequence[Any] | None = self.env.render()
        return pictures or [None] * self.num_envs

    def _costs(self, found: dict[str, Any]) -> list[dict[str, Any]]:
        """An info for each environment with the cost of its step; without it if the batch has
        none.
        """
        if "cost" not in found:
            return [{} for _ in range(self.num_envs)]
        costs = found["cost"]
        if "final_info" in found:
            # The other cost is that of the first observation of the next episode.
            costs = np.where(found["_final_info"], found["final_info"]["cost"], costs)
        return [{"cost": cost} for cost in costs.tolist()]

    def _numbers(self, indices: VecEnvIndices) -> list[int]:
        return list(self._get_indices(indices))
