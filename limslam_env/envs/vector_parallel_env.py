"""The batched environment for several robots in each building: dicts of arrays, a thin adapter over the simulation."""

from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike

from limslam_env.envs.adapter import NamedRobots, action_space, observation_space
from limslam_env.envs.arguments import BatchSource, check_robots
from limslam_env.envs.batch_adapter import Batched, BatchObservation, checked_actions, infos_of, observations_of
from limslam_env.geometry import BoolArray, FloatArray


class LimSlamParallelVectorEnv(NamedRobots, Batched):
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
        self.single_action_space, self.single_observation_space = action_space(), observation_space(self.robot)
        self._name(
            num_robots,
            lambda: batch_space(self.single_observation_space, self.num_envs),
            lambda: batch_space(self.single_action_space, self.num_envs),
        )
        self.agents = list(self.possible_agents)
        self._generator: np.random.Generator | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, BatchObservation], dict[str, dict[str, Any]]]:
        """Start new episodes, as ``LimSlamVectorEnv`` does, with a seed and options, and with its errors.

        The option ``start`` has poses (s, 3) of the first robots, m and rad, or such poses for each environment
        (n, s, 3).
        """
        generator = self._generator
        if seed is not None or generator is None:
            generator, _ = seeding.np_random(seed)
        results, mask = self._begin(generator, seed, options)
        self._generator = generator
        observations = self._each(lambda robot: observations_of(results, robot))
        return observations, self._each(lambda robot: infos_of(results, robot, mask=mask))

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
        self._check_begun()
        rows = [
            checked_actions(action, self.num_envs, f" of robot_{robot}")
            for robot, action in enumerate(self._in_order(actions))
        ]
        now, ended = self._drive(np.stack(rows, axis=1))
        rewards = now.rewards
        if self._shares_reward:
            rewards = np.broadcast_to(rewards.mean(axis=1, keepdims=True), rewards.shape)
        return (
            self._each(lambda robot: observations_of(now, robot)),
            self._each(lambda robot: rewards[:, robot].copy()),
            self._each(lambda _: now.terminated.copy()),
            self._each(lambda _: now.truncated.copy()),
            self._each(lambda robot: infos_of(now, robot, ended)),
        )

    def close(self) -> None:
        """End the threads. May be called again."""
        self._simulation.close()


def parallel_vector_env(world: BatchSource = "env1", **arguments: Any) -> LimSlamParallelVectorEnv:
    """A batch of environments for several robots; ``arguments`` are those of :class:`LimSlamParallelVectorEnv`."""
    return LimSlamParallelVectorEnv(world, **arguments)
