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

    ``Sb3VecEnv(gym.make_vec("LimSlam-Random-v0", 64))`` makes a batch whose steps are one call. An
    episode begins in the step in which another ends, as Stable-Baselines3 wants it, whatever the
    ``autoreset_mode`` of the batch is.

    The infos of an episode's last step hold ``terminal_observation``, ``TimeLimit.truncated`` and
    ``episode`` (return ``r``, steps ``l``), so that no `VecMonitor` is needed, and all that the
    batch says of this step, ``coverage`` for example. The infos of other steps hold their ``cost``
    alone, if the batch has one, since turning arrays into a dict for each environment would cost
    more than the step.

    Parameters
    ----------
    env
        The batch.

    Raises
    ------
    ValueError
        If the batch is on a GPU.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any]) -> None:
        if hasattr(env.unwrapped, "to_device"):
            raise ValueError(
                "Stable-Baselines3 takes arrays of numpy: make the environments without "
                "device='cuda'"
            )
        self.env = env
        self._begins_itself = env.metadata.get("autoreset_mode") is AutoresetMode.SAME_STEP
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
        costs = found["cost"].tolist() if "cost" in found else ()
        infos = [{"cost": cost} for cost in costs] or [{} for _ in range(self.num_envs)]
        last = found
        final = observation
        if ends.any() and self._begins_itself:
            last = found["final_info"]
            final = found["final_obs"]
        elif ends.any():
            observation, _ = self.env.reset(options={"reset_mask": ends})
        for number in np.flatnonzero(ends):
            infos[number] = {
                **_row(last, number),
                "terminal_observation": _row(final, number),
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

    def _numbers(self, indices: VecEnvIndices) -> list[int]:
        return list(self._get_indices(indices))


def _row(rows: Any, number: Any) -> Any:
    """What an observation or an info of all environments has for one of them, without the masks of
    infos.
    """
    if isinstance(rows, dict):
        return {key: _row(each, number) for key, each in rows.items() if key[0] != "_"}
    row = rows[number]
    return row.item() if isinstance(row, np.generic) else row
