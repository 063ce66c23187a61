"""A wrapper for learning agents: `wrappers.single.SlamObservation` for a batch of environments."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from limslam_agent.config.presets import AgentConfig
from limslam_agent.slam.batch.batch_slam import BatchSlam
from limslam_agent.slam.batch.state import Capacity
from limslam_agent.wrappers.single import (
    Observation,
    belief_space,
    default_config,
    observed_covariance,
    observed_pose,
    ranges_space,
)
from limslam_env.geometry import BoolArray
from limslam_env.interface import RobotSpec
from limslam_env.overlay import Overlay


class SlamVectorObservation(VectorWrapper):  # type: ignore[type-arg, misc, unused-ignore]
    """Observe what n robots believe instead of raw readings. The start poses are the only truth
    that the SLAM gets.

    The observation has the keys of ``SlamObservation``, each with n rows, in new arrays. A belief
    is reset whenever its episode starts, for all autoreset modes. ``final_obs`` in ``info`` holds
    beliefs, too. Only ``SlamObservation`` adds a status to ``info``.

    Parameters
    ----------
    env
        A vector of LimSlam environments for one robot each, whose observation holds unscaled
        `ranges` and `wheels`.
    agent_config
        Settings of the SLAM, with the noise that the SLAM is told. By default the preset `graph`
        with the nominal noise of the environments (their ``nominal_noise``), the largest where they
        differ.
    size
        Side of the grid in cells.
    capacity
        Largest number of each thing that a belief can store.
    num_threads
        Number of threads that update the beliefs. As many as there are processors by default.

    Raises
    ------
    ValueError
        If the size is below 1, the environments are on a GPU, one of them has no `robot`, its
        observation has another form, or the estimator is not the consistent one.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_agent import SlamVectorObservation
    >>> envs = gym.make_vec("LimSlam-Env1-v0", num_envs=4, sensor_noise=0.02)
    >>> envs = SlamVectorObservation(envs)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations["grid"].shape
    (4, 1, 40, 40)
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        agent_config: AgentConfig | None = None,
        size: int = 40,
        capacity: Capacity | None = None,
        num_threads: int | None = None,
    ) -> None:
        super().__init__(env)
        if size < 1:
            raise ValueError(f"a grid needs at least one cell, not {size}")
        if hasattr(env.unwrapped, "to_device"):
            raise ValueError(
                "beliefs are computed by the processor: make the environments without device='cuda'"
            )
        robot = _robot_of(env)
        ranges = ranges_space(env.single_observation_space, robot)
        self._spaces = dict(env.single_observation_space.items())  # type: ignore[attr-defined]
        self.single_observation_space = belief_space(ranges, size)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        config = agent_config or default_config(_values_of(env.unwrapped, "nominal_noise"))
        self.slam = BatchSlam(robot, config, env.num_envs, capacity, num_threads, size)
        self._starts = np.zeros((env.num_envs, 3))
        self._poses = np.zeros((env.num_envs, 3))
        self._covariances = np.zeros((env.num_envs, 3, 3))
        self._ended = np.zeros(env.num_envs, dtype=bool)
        self._last: Observation = {}

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start new episodes with empty maps. With a ``reset_mask`` among the options, only where
        the mask is true.

        Raises
        ------
        ValueError
            If the options are not a dictionary, or the environment refuses them.
        """
        if not (options is None or isinstance(options, dict)):
            raise ValueError(
                f"reset options are a dictionary, not {' '.join(repr(options).split()):.60}"
            )
        mask = None if options is None else options.get("reset_mask")
        # The mask is read first, because gymnasium's environments remove it from the options.
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.array(mask)
        seen, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._ended = self._ended & ~mask
        self._reset_beliefs(info, mask)
        return self._believed(seen, mask), info

    def step(
        self, actions: Any
    ) -> tuple[Observation, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Drive for one control period and give the new observations to the SLAM."""
        seen, reward, terminated, truncated, info = self.env.step(actions)
        ended = terminated | truncated
        everywhere = np.ones(self.num_envs, dtype=bool)
        mode = AutoresetMode(self.env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        if mode == AutoresetMode.NEXT_STEP:
            self._reset_beliefs(info, self._ended)
        elif mode == AutoresetMode.SAME_STEP and ended.any():
            self._observe_final(info, ended)
            self._reset_beliefs(info, ended)
        self._ended = ended
        return self._believed(seen, everywhere), reward, terminated, truncated, info

    def render(self) -> Any:
        """The pictures of the environments, with the beliefs over the truth."""
        if self.render_mode is not None:
            believed = zip(self._poses, self._covariances, strict=True)
            self.unwrapped.overlays = [  # type: ignore[attr-defined]
                Overlay(pose, covariance, self.slam.segments(number))
                for number, (pose, covariance) in enumerate(believed)
            ]
        return self.env.render()

    def close(self, **kwargs: Any) -> None:
        """Close the environments and end the threads of the SLAM. May be called again."""
        # An object whose constructor raised an error has no SLAM.
        if "slam" in vars(self):
            self.slam.close()
        super().close(**kwargs)

    def _reset_beliefs(self, info: dict[str, Any], begun: BoolArray) -> None:
        """Reset the beliefs whose episodes start. Of ``info``, only the start pose is used."""
        if begun.any():
            self._starts[begun] = np.asarray(info["pose"], dtype=float)[begun]
            self.slam.reset(self._starts, begun)

    def _observe_final(self, info: dict[str, Any], ended: BoolArray) -> None:
        """Update the beliefs with the last observations of episodes, and put them into
        ``final_obs``.
        """
        last = info["final_obs"]
        places = np.flatnonzero(ended)
        seen = {key: np.zeros((self.num_envs, *box.shape)) for key, box in self._spaces.items()}
        for key, rows in seen.items():
            for place in places:
                rows[place] = last[key][place] if isinstance(last, dict) else last[place][key]
        beliefs = self._believed(seen, ended)
        final = np.full(self.num_envs, None, dtype=object)
        for place in places:
            final[place] = {key: rows[place].copy() for key, rows in beliefs.items()}
        info["final_obs"] = final

    def _believed(self, seen: Observation, mask: BoolArray) -> Observation:
        """The beliefs after observations. Environments outside of the mask keep the last ones."""
        beliefs = self.slam.step(seen["ranges"], seen["wheels"], mask)
        self._poses[mask] = beliefs.pose[mask]
        self._covariances[mask] = beliefs.covariance[mask]
        observation: Observation = {
            "pose": observed_pose(self._starts, beliefs.pose),
            "covariance": observed_covariance(beliefs.covariance),
            "grid": beliefs.grid,
            "ranges": np.array(seen["ranges"], dtype=np.float32),
        }
        if not mask.all():
            for key, rows in self._last.items():
                observation[key][~mask] = rows[~mask]
        self._last = observation
        return {key: rows.copy() for key, rows in observation.items()}


def _robot_of(env: VectorEnv[Any, Any, Any]) -> RobotSpec:
    """The robot that all environments have."""
    robots = _values_of(env.unwrapped, "robot")
    if not robots or not isinstance(robots[0], RobotSpec):
        raise ValueError(f"{env.unwrapped} has no LimSLAM robot")
    if any(other != robots[0] for other in robots):
        raise ValueError("all environments of a batch must have the same robot")
    first: RobotSpec = robots[0]
    return first


def _values_of(env: Any, name: str) -> list[Any]:
    """An attribute of a batch, or of each of its environments. Empty if they do not have it."""
    value = getattr(env, name, None)
    if value is not None:
        return [value]
    try:
        return list(env.get_attr(name))
    except AttributeError:
        return []
