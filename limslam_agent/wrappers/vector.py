"""A wrapper that tells learning agents what each of many robots believes: `wrappers.SlamObservation` for a batch."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from limslam_agent.config.presets import AgentConfig
from limslam_agent.slam.batch.batch_slam import BatchSlam
from limslam_agent.slam.batch.state import Capacity
from limslam_agent.wrappers.single import Observation, belief_space, ranges_space, told_covariance, told_pose
from limslam_env.geometry import BoolArray
from limslam_env.interface import RobotSpec


class SlamVectorObservation(VectorWrapper):  # type: ignore[type-arg, misc, unused-ignore]
    """Observe what n robots believe instead of raw readings. No truth goes in after the start poses.

    The observation has the keys of ``SlamObservation``, each with n rows, in new arrays. Beliefs begin anew where an
    episode does, whichever way the environment resets itself; ``final_obs`` in ``info`` holds beliefs, too.

    Parameters
    ----------
    env
        A vector of LimSlam environments for one robot each, whose observation holds `ranges` and `wheels` as they
        are, not scaled.
    agent_config
        Settings of the SLAM and what it is told of the noise; those of the preset `consistent` if left out.
    size
        Side of the grid in cells.
    capacity
        How much each belief has room for.
    num_threads
        That work on the beliefs; as many as there are processors if left out.

    Raises
    ------
    ValueError
        If the size is below 1, or the environment does not tell its robot, or its observation is another one, or the
        estimator is not the consistent one.
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
        robot = _robot_of(env)
        ranges = ranges_space(env.single_observation_space, robot)
        self._spaces = dict(env.single_observation_space.items())  # type: ignore[attr-defined]
        self.single_observation_space = belief_space(ranges, size)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.slam = BatchSlam(robot, agent_config, env.num_envs, capacity, num_threads, size)
        self._starts = np.zeros((env.num_envs, 3))
        self._ended = np.zeros(env.num_envs, dtype=bool)
        self._told: Observation = {}

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start new episodes and new maps, of a ``reset_mask`` among the options only where it is true.

        Raises
        ------
        ValueError
            If the options are no dictionary, or the environment refuses them.
        """
        if not (options is None or isinstance(options, dict)):
            raise ValueError(f"reset options are a dictionary, not {' '.join(repr(options).split()):.60}")
        mask = None if options is None else options.get("reset_mask")
        # gymnasium's environments take the mask out of the options.
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.array(mask)
        seen, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._ended = self._ended & ~mask
        self._begin(info, mask)
        return self._believed(seen, mask), info

    def step(
        self, actions: Any
    ) -> tuple[Observation, NDArray[Any], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Drive for one control period, and let the SLAM take in what is observed."""
        seen, reward, terminated, truncated, info = self.env.step(actions)
        ended, everywhere = terminated | truncated, np.ones(self.num_envs, dtype=bool)
        mode = AutoresetMode(self.env.metadata.get("autoreset_mode", AutoresetMode.NEXT_STEP))
        if mode == AutoresetMode.NEXT_STEP:
            self._begin(info, self._ended)
        elif mode == AutoresetMode.SAME_STEP and ended.any():
            self._tell_last(info, ended)
            self._begin(info, ended)
        self._ended = ended
        return self._believed(seen, everywhere), reward, terminated, truncated, info

    def close(self, **kwargs: Any) -> None:
        """Close the environments, and end the threads of the SLAM. May be called again."""
        # What was refused when it was made has no SLAM to end.
        if "slam" in vars(self):
            self.slam.close()
        super().close(**kwargs)

    def _begin(self, info: dict[str, Any], begun: BoolArray) -> None:
        """Forget what was believed where an episode begins; the start pose is all that is taken from ``info``."""
        if begun.any():
            self._starts[begun] = np.asarray(info["pose"], dtype=float)[begun]
            self.slam.reset(self._starts, begun)

    def _tell_last(self, info: dict[str, Any], ended: BoolArray) -> None:
        """Let the last observations of episodes be taken in, and put what is believed then in their place."""
        last, places = info["final_obs"], np.flatnonzero(ended)
        seen = {key: np.zeros((self.num_envs, *box.shape)) for key, box in self._spaces.items()}
        for key, rows in seen.items():
            for place in places:
                rows[place] = last[key][place] if isinstance(last, dict) else last[place][key]
        told, final = self._believed(seen, ended), np.full(self.num_envs, None, dtype=object)
        for place in places:
            final[place] = {key: rows[place].copy() for key, rows in told.items()}
        info["final_obs"] = final

    def _believed(self, seen: Observation, mask: BoolArray) -> Observation:
        """What is believed after observations; where there is none, what was told before."""
        beliefs = self.slam.step(seen["ranges"], seen["wheels"], mask)
        told: Observation = {
            "pose": told_pose(self._starts, beliefs.pose),
            "covariance": told_covariance(beliefs.covariance),
            "grid": beliefs.grid,
            "ranges": np.array(seen["ranges"], dtype=np.float32),
        }
        if not mask.all():
            for key, rows in self._told.items():
                told[key][~mask] = rows[~mask]
        self._told = told
        return {key: rows.copy() for key, rows in told.items()}


def _robot_of(env: VectorEnv[Any, Any, Any]) -> RobotSpec:
    """The robot that all of the environments have."""
    inner = env.unwrapped
    robot = getattr(inner, "robot", None)
    robots = [robot] if robot is not None else list(_asked(inner))
    if not robots or not isinstance(robots[0], RobotSpec):
        raise ValueError(f"{inner} does not tell what its robot is")
    if any(other != robots[0] for other in robots):
        raise ValueError("a batch has robots of one kind")
    first: RobotSpec = robots[0]
    return first


def _asked(env: Any) -> tuple[Any, ...]:
    try:
        found: tuple[Any, ...] = env.get_attr("robot")
    except AttributeError:
        return ()
    return found
