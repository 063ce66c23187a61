"""The batched environment on a GPU: a thin adapter over the batched simulation there."""

from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from limslam_env.batch.batch import BatchSimulation, Results
from limslam_env.batch.device import DeviceSimulation
from limslam_env.envs.arguments import BatchSource
from limslam_env.envs.batch_adapter import Seed
from limslam_env.envs.vector_env import LimSlamVectorEnv


class LimSlamDeviceEnv(LimSlamVectorEnv):
    """The environments of :class:`limslam_env.envs.vector_env.LimSlamVectorEnv` on a GPU of NVIDIA
    (extra ``gpu``).

    ``gym.make_vec("LimSlam-Env1-v0", num_envs=65536, device="cuda")`` makes such a batch. Spaces,
    arguments and the results of a seed are those of the batch on processors, up to rounding, with
    these differences:

    * Observations, rewards, ends and info are arrays on the device, which torch, JAX and CuPy take
      without a copy (``__cuda_array_interface__``). The next step writes into the same arrays:
      clone what is to be kept.
    * Actions (n, 2) are float32. A step takes those of a GPU without a copy, and does not look for
      NaN in them, which counts as -1.
    * ``autoreset_mode`` is NEXT_STEP. ``reset`` begins episodes in all environments, and has no
      ``reset_mask``.
    * Floor plans are generated beforehand: ``LimSlam-Random-v0`` needs ``plans``.
    * Info has no masks and no ``cost``. There are no pictures.

    The kernel is compiled at the first reset, in about 20 s.
    """

    _kind: ClassVar[type[BatchSimulation]] = DeviceSimulation
    _simulation: DeviceSimulation

    def __init__(self, world: BatchSource, num_envs: int = 1, **arguments: Any) -> None:
        if arguments.get("render_mode") is not None:
            raise ValueError("a batch on a device draws no pictures: render_mode must be None")
        super().__init__(world, num_envs, autoreset_mode=AutoresetMode.NEXT_STEP, **arguments)

    def reset(
        self, *, seed: Seed = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start new episodes in all environments, as :class:`LimSlamVectorEnv` does, but without a
        ``reset_mask``.
        """
        if options and "reset_mask" in options:
            raise ValueError(
                "on a device there is no reset_mask: all environments are reset together"
            )
        results, _ = self._begun(seed, options)
        self._handed = _handed_out(results)
        return self._handed[0].copy(), self._handed[-1].copy()

    def step(self, actions: Any) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
        """Drive for one control period; ``actions`` (n, 2), float32, are left and right wheel
        speeds, -1 to 1.

        Raises
        ------
        ValueError
            If the actions have another shape or type, or rows that do not follow each other in
            memory.
        gymnasium.error.ResetNeeded
            If there was no reset yet.
        """
        self._check_begun()
        self._simulation.step(actions)
        observation, rewards, terminated, truncated, info = self._handed
        return observation.copy(), rewards, terminated, truncated, info.copy()

    def to_device(self, array: NDArray[np.float32]) -> Any:
        """A copy of an array on the device, for actions that are made without a library for
        GPUs.
        """
        return self._simulation.to_device(array)

    def synchronize(self) -> None:
        """Wait until all steps are done. JAX needs this before it takes results, and torch does
        not.
        """
        self._simulation.synchronize()


def _handed_out(results: Results) -> tuple[dict[str, Any], Any, Any, Any, dict[str, Any]]:
    """What each step returns: views of the results, in which there is one robot in each
    environment.
    """
    count = len(results.time)
    ranges, wheels, pose, collision, wall_seen, rewards = (
        part.reshape(count, *part.shape[2:])
        for part in (
            results.ranges,
            results.wheels,
            results.poses,
            results.contact,
            results.wall_seen,
            results.rewards,
        )
    )
    info = {
        "pose": pose,
        "time": results.time,
        "coverage": results.coverage,
        "collision": collision,
        "wall_seen": wall_seen,
    }
    return (
        {"ranges": ranges, "wheels": wheels},
        rewards,
        results.terminated,
        results.truncated,
        info,
    )
