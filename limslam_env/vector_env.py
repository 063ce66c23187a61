"""The batched environment of Gymnasium: a thin adapter over the batched simulation."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from limslam_env.adapter import action_space, observation_space
from limslam_env.batch import BatchReadings, BatchTruth
from limslam_env.batch_adapter import Batched, BatchSource, Plans, info_of
from limslam_env.config import NoiseConfig, RewardConfig, Setting
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

BatchObservation = dict[str, NDArray[np.float32]]


class LimSlamVectorEnv(Batched, gym.vector.VectorEnv[BatchObservation, NDArray[np.floating[Any]], NDArray[Any]]):
    """Many environments of :class:`limslam_env.env.LimSlamEnv`, driven together by compiled code."""

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        world: BatchSource,
        num_envs: int = 1,
        *,
        robot: RobotSpec | None = None,
        sensor_noise: Setting | Sequence[Setting] | FloatArray | None = None,
        noise: NoiseConfig | Sequence[NoiseConfig] | None = None,
        coverage_goal: float | None = 0.99,
        rewards: RewardConfig | None = None,
        max_episode_steps: int | None = 18_000,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        plans: Plans = None,
        num_threads: int | None = None,
        render_mode: None = None,
    ) -> None:
        if render_mode is not None:
            raise ValueError(f"a batch cannot be rendered: render_mode must be None, not {render_mode!r}")
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._set_up(
            world, num_envs, 1, robot, sensor_noise, noise, coverage_goal, rewards, max_episode_steps, plans, num_threads
        )  # fmt: skip
        self.num_envs = num_envs
        self.single_action_space, self.single_observation_space = action_space(), observation_space(self.robot)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._is_over = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[BatchObservation, dict[str, Any]]:
        """Start new episodes.

        Parameters
        ----------
        seed
            Of all random numbers from now on; without it they go on.
        options
            ``start``: a pose (3,), m and rad, or one for each environment (n, 3). ``reset_mask`` (n,): which
            environments are reset, the others stay as they are.

        Raises
        ------
        ValueError
            If an option is unknown or has another shape.
        WorldError
            If a start cannot be used.
        """
        super().reset(seed=seed)
        mask, start = self._asked(options)
        if seed is not None or not self._is_running:
            self._simulation.seed(np.random.SeedSequence(int(self.np_random.integers(2**63))))
        readings, truth = self._simulation.reset(mask, start)
        self._is_running = True
        self._is_over[mask], self._lengths[mask] = False, 0
        return _observation(readings), info_of(truth, 0, mask)

    def step(self, actions: ArrayLike) -> tuple[BatchObservation, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Drive for one control period; ``actions`` (n, 2) are left and right wheel speeds, -1 to 1.

        Raises
        ------
        ValueError
            If the actions are not n rows of two finite numbers.
        gymnasium.error.ResetNeeded
            If there was no reset yet, or an episode is over and there is no autoreset.
        """
        wanted = self._checked(actions)
        if self.autoreset_mode is AutoresetMode.DISABLED and self._is_over.any():
            raise gym.error.ResetNeeded(f"the episode of environment {int(np.argmax(self._is_over))} is over")
        fresh = self._is_over if self.autoreset_mode is AutoresetMode.NEXT_STEP and self._is_over.any() else None
        if fresh is not None:
            self._simulation.begin(fresh)
        readings, truth = self._simulation.step(wanted, fresh)
        self._lengths += 1
        rewards = self._rewards(truth)[:, 0]
        if fresh is not None:
            self._lengths[fresh], rewards[fresh] = 0, 0.0
        terminated, truncated = self._ends(truth)
        if fresh is not None:
            terminated[fresh], truncated[fresh] = False, False
        self._is_over = terminated | truncated
        everywhere = np.ones(self.num_envs, dtype=bool)
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._is_over.any():
            return self._renewed(readings, truth, rewards, terminated, truncated)
        return _observation(readings), rewards, terminated, truncated, info_of(truth, 0, everywhere)

    def _renewed(
        self,
        readings: BatchReadings,
        truth: BatchTruth,
        rewards: FloatArray,
        terminated: BoolArray,
        truncated: BoolArray,
    ) -> tuple[BatchObservation, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """The result of a step that ended episodes, in whose places new ones begin."""
        over, last = self._is_over, _observation(readings)
        final = np.full(self.num_envs, None, dtype=object)
        for env in np.flatnonzero(over):
            final[env] = {key: value[env].copy() for key, value in last.items()}
        readings, begun = self._simulation.reset(over)
        self._is_over, self._lengths[over] = np.zeros(self.num_envs, dtype=bool), 0
        info = info_of(begun, 0, np.ones(self.num_envs, dtype=bool))
        info |= {"final_obs": final, "_final_obs": over.copy()}
        info |= {"final_info": info_of(truth, 0, over), "_final_info": over.copy()}
        return _observation(readings), rewards, terminated, truncated, info

    def close_extras(self, **_: Any) -> None:
        """End the threads."""
        self._simulation.close()


def _observation(readings: BatchReadings) -> BatchObservation:
    return {"ranges": readings.ranges[:, 0], "wheels": readings.wheels[:, 0]}
