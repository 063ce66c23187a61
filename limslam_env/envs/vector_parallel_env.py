"""The batched environment for several robots in each building: dicts of arrays, a thin adapter over the simulation."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from limslam_env.envs.adapter import action_space, observation_space
from limslam_env.envs.arguments import BatchSource, check_robots
from limslam_env.envs.batch_adapter import (
    Batched,
    BatchObservation,
    checked_actions,
    info_of,
    infos_of,
    observation_of,
)
from limslam_env.geometry import BoolArray, FloatArray


class LimSlamParallelVectorEnv(Batched):
    """Many environments like ``LimSlamParallelEnv``, stepped together by compiled code.

    Actions, observations, rewards, ends and infos are dicts with one entry per robot. Each entry has the form that
    ``LimSlamVectorEnv`` uses: arrays over the n environments. Beams detect other robots, and bodies that collide push
    each other. A policy that all robots share can stack the values of these dicts; independent policies can take one
    entry each.

    The arguments are those of ``LimSlamVectorEnv``, but for ``max_episode_steps``, and these:

    | Argument      | Default | Meaning                                       |
    |---------------|---------|-----------------------------------------------|
    | num_robots    | 2       | robots in each environment, 1 to 8            |
    | shared_reward | False   | each robot gets the mean reward of all        |
    | max_cycles    | 18000   | steps of an episode; None never truncates     |

    Attributes
    ----------
    num_envs
        How many environments there are.
    possible_agents, agents
        Names of the robots. All of them act at each step: episodes end for all robots of an environment at once.
    """

    def __init__(
        self,
        world: BatchSource,
        num_envs: int = 1,
        *,
        num_robots: int = 2,
        shared_reward: bool = False,
        max_cycles: int | None = 18_000,
        **arguments: Any,
    ) -> None:
        check_robots(num_robots)
        self._set_up(world, num_envs, num_robots, max_cycles, **arguments)
        self._shares_reward = shared_reward
        self.metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.possible_agents = [f"robot_{number}" for number in range(num_robots)]
        self.agents = list(self.possible_agents)
        self.single_action_space, self.single_observation_space = action_space(), observation_space(self.robot)
        self.observation_spaces = {
            name: batch_space(self.single_observation_space, self.num_envs) for name in self.possible_agents
        }
        self.action_spaces = {
            name: batch_space(self.single_action_space, self.num_envs) for name in self.possible_agents
        }
        self._generator: np.random.Generator | None = None

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The observations of a robot in all environments: the same object at each call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The actions of a robot in all environments: the same object at each call."""
        return self.action_spaces[agent]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, BatchObservation], dict[str, dict[str, Any]]]:
        """Start new episodes.

        Parameters
        ----------
        seed
            Of all random numbers from now on; without it they go on.
        options
            ``start``: poses (s, 3) of the first robots, m and rad, or such poses for each environment (n, s, 3).
            ``reset_mask`` (n,): which environments are reset; the others stay as they are.

        Raises
        ------
        ValueError
            If an option is unknown or has another shape.
        WorldError
            If a start cannot be used, or there is no room for all. Then episodes go on as if nothing had been asked.
        """
        generator = self._generator
        if seed is not None or generator is None:
            generator, _ = seeding.np_random(seed)
        results, mask = self._begin(generator, seed, options)
        self._generator = generator
        robots = list(enumerate(self.possible_agents))
        observations = {name: observation_of(results, number) for number, name in robots}
        return observations, {name: info_of(results, number, mask) for number, name in robots}

    def step(
        self, actions: dict[str, ArrayLike]
    ) -> tuple[
        dict[str, BatchObservation],
        dict[str, FloatArray],
        dict[str, BoolArray],
        dict[str, BoolArray],
        dict[str, dict[str, Any]],
    ]:
        """Drive all robots for one control period; ``actions`` are (n, 2) for each, wheel speeds from -1 to 1.

        Raises
        ------
        ValueError
            If there are not n rows of two finite numbers for each robot.
        gymnasium.error.ResetNeeded
            If there was no reset yet, or an episode is over and there is no autoreset.
        """
        if not self._is_running:
            raise gym.error.ResetNeeded("call reset before step")
        if set(actions) != set(self.possible_agents):
            names = ", ".join(self.possible_agents)
            raise ValueError(f"there must be actions for each of {names}, not {list(actions)}")
        rows = [checked_actions(actions[name], self.num_envs, f" of {name}") for name in self.possible_agents]
        outcome = self._drive(np.stack(rows, axis=1))
        rewards = outcome.rewards
        if self._shares_reward:
            rewards = np.broadcast_to(rewards.mean(axis=1, keepdims=True), rewards.shape)
        robots = list(enumerate(self.possible_agents))
        return (
            {name: observation_of(outcome.now, number) for number, name in robots},
            {name: rewards[:, number].copy() for number, name in robots},
            {name: outcome.terminated.copy() for _, name in robots},
            {name: outcome.truncated.copy() for _, name in robots},
            {name: infos_of(outcome, number) for number, name in robots},
        )

    def close(self) -> None:
        """End the threads. May be called again."""
        self._simulation.close()


def parallel_vector_env(world: BatchSource = "env1", **arguments: Any) -> LimSlamParallelVectorEnv:
    """A batch of environments for several robots; ``arguments`` are those of :class:`LimSlamParallelVectorEnv`."""
    return LimSlamParallelVectorEnv(world, **arguments)
