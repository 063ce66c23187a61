"""The batched environments, of Gymnasium for one robot and of dicts for several: thin adapters over
the simulation.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from limslam_env.batch.batch import Results
from limslam_env.config import NoiseConfig, RewardConfig, Setting
from limslam_env.envs.adapter import NamedRobots, action_space, observation_space
from limslam_env.envs.arguments import MAX_ROBOTS, BatchSource, Plans
from limslam_env.envs.batch_adapter import (
    Batched,
    BatchObservation,
    BatchPictures,
    Seed,
    checked_actions,
    generator_of,
    infos_of,
    observations_of,
)
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.numbers import check_count
from limslam_env.interface import RobotSpec
from limslam_env.overlay import Overlay


class LimSlamVectorEnv(
    Batched, gym.vector.VectorEnv[BatchObservation, NDArray[np.floating[Any]], NDArray[Any]]
):
    """Many environments like :class:`limslam_env.envs.env.LimSlamEnv`, driven together by compiled
    code.

    ## Description
    `gym.make_vec("LimSlam-Env1-v0", num_envs=8192)` makes such a batch. Without noise the
    observations equal those of the single environment; with noise they have the same distributions.
    No step loops over all environments in Python, and from 1024 environments on several threads
    share the work. The results depend on the seed and the number of environments, but not on the
    number of threads. `gym.make_vec(..., device="cuda")` makes a batch on a GPU
    (:class:`limslam_env.envs.device_env.LimSlamDeviceEnv`).

    ## Spaces
    `single_action_space` and `single_observation_space` are those of the single environment.
    Actions have the shape (n, 2); values outside of -1 to 1 are clipped. An observation is a dict
    of two new float32 arrays in metres: `ranges` (n, n_beams) and `wheels` (n, 2).

    ## Info
    The keys are those of the single environment: `pose` (n, 3), `time` (n,), `coverage` (n,),
    `collision` (n,), `cost` (n,) and `wall_seen` (n, n_beams). For each key a mask (n,) with the
    key's name after an underscore, such as `_pose`, tells for which environments the value is set.

    ## Episode End
    An episode terminates at `coverage_goal` and is truncated after `max_episode_steps`. The
    argument `autoreset_mode`, which is also an entry of `metadata`, selects how the next episode
    begins:

    | Mode      | Meaning                                                                                    |
    |-----------|--------------------------------------------------------------------------------------------|
    | NEXT_STEP | the next step ignores that environment's action and gives the first observation, reward 0   |
    | SAME_STEP | the step gives the new episode's first observation; the last one is in `info["final_obs"]`, an array of dicts, its info in `info["final_info"]` |
    | DISABLED  | `reset(options={"reset_mask": mask})` is called before the next step                         |

    ## Arguments
    | Argument          | Default          | Meaning                                                              |
    |-------------------|------------------|----------------------------------------------------------------------|
    | world             | the id's world   | as in the single environment, or one world per environment           |
    | num_envs          | 1                | how many                                                             |
    | robot             | `RobotSpec()`    | body, wheels and beams of all                                        |
    | sensor_noise      | None             | as in the single environment                                         |
    | noise             | `NoiseConfig()`  | as in the single environment; intervals are drawn from at each reset, for each environment |
    | coverage_goal     | 0.99             | see Episode End                                                      |
    | rewards           | `RewardConfig()` | as in the single environment                                         |
    | max_episode_steps | 18000            | see Episode End; None never truncates                                |
    | autoreset_mode    | NEXT_STEP        | see Episode End                                                      |
    | plans             | None             | number or seeds of floor plans that are generated once and then drawn from; None generates a new floor plan for each environment at each reset, which takes about 10 ms |
    | num_threads       | None             | largest number of threads; None for one per core                                 |
    | render_mode       | None             | `"rgb_array"`: `render` draws a picture (640, 640, 3) of each environment        |

    ## Version History
    * v0: first release.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> envs = gym.make_vec("LimSlam-Random-v0", num_envs=8, plans=2, sensor_noise=0.02)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations, rewards, *_ = envs.step(envs.action_space.sample())
    >>> observations["ranges"].shape, rewards.shape
    ((8, 6), (8,))
    >>> envs.close()
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        world: BatchSource,
        num_envs: int = 1,
        *,
        robot: RobotSpec | None = None,
        sensor_noise: Setting | None = None,
        noise: NoiseConfig | None = None,
        coverage_goal: float | None = 0.99,
        rewards: RewardConfig | None = None,
        max_episode_steps: int | None = 18_000,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        plans: Plans = None,
        num_threads: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in {None, "rgb_array"}:
            raise ValueError(
                f"render_mode of a batch must be rgb_array or None, not {render_mode!r}"
            )
        self._set_up(
            world,
            num_envs,
            1,
            max_episode_steps,
            robot=robot,
            sensor_noise=sensor_noise,
            noise=noise,
            coverage_goal=coverage_goal,
            rewards=rewards,
            autoreset_mode=autoreset_mode,
            plans=plans,
            num_threads=num_threads,
        )
        self.render_mode = render_mode
        self.overlays: Sequence[Overlay] = ()
        self._pictures = None if render_mode is None else BatchPictures(self._simulation)
        self.single_action_space, self.single_observation_space = (
            action_space(),
            observation_space(self.robot),
        )
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: Seed = None, options: dict[str, Any] | None = None
    ) -> tuple[BatchObservation, dict[str, Any]]:
        """Start new episodes.

        Parameters
        ----------
        seed
            Of all random numbers from now on; without it they go on. A list has a seed for each
            environment, whose numbers then depend on nothing else, or None for any seed.
        options
            ``start``: a pose (3,), m and rad, or one for each environment (n, 3). ``reset_mask``
            (n,): which environments are reset; the others stay as they are.

        Raises
        ------
        ValueError
            If an option is unknown or has another shape, or there are not n seeds.
        WorldError
            If a start cannot be used. Then episodes go on as if nothing had been asked.
        """
        results, mask = self._begun(seed, options)
        if self._pictures is not None:
            self._pictures.begin(results)
        return observations_of(results, 0), infos_of(results, 0, mask=mask)

    def step(
        self, actions: ArrayLike
    ) -> tuple[BatchObservation, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Drive for one control period; ``actions`` (n, 2) are left and right wheel speeds, -1 to
        1.

        Raises
        ------
        ValueError
            If the actions are not n rows of two finite numbers.
        gymnasium.error.ResetNeeded
            If there was no reset yet, or an episode is over and there is no autoreset.
        """
        self._check_begun()
        now, ended = self._drive(checked_actions(actions, self.num_envs)[:, None])
        if self._pictures is not None:
            self._pictures.follow(now)
        return (
            observations_of(now, 0),
            now.rewards[:, 0],
            now.terminated,
            now.truncated,
            infos_of(now, 0, ended),
        )

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture (640, 640, 3) of each environment, with what its agent believes, if the
        attribute ``overlays`` has an `Overlay` for each; None without a render mode, and before the
        first reset.
        """
        return None if self._pictures is None else self._pictures.paint(self.overlays)

    def _begun(self, seed: Seed, options: dict[str, Any] | None) -> tuple[Results, BoolArray]:
        generator = generator_of(seed, self.np_random)
        begun = self._begin(generator, seed, options)
        if isinstance(seed, int):
            self._np_random = generator
            self._np_random_seed = seed
        return begun

    def close_extras(self, **_: Any) -> None:
        """End the threads."""
        self._simulation.close()


class LimSlamParallelVectorEnv(NamedRobots, Batched):
    """Many environments like ``LimSlamParallelEnv``, stepped together by compiled code.

    Actions, observations, rewards, ends and infos are dicts with one entry per robot. Each entry
    has the form that ``LimSlamVectorEnv`` uses: arrays over the n environments. Beams detect other
    robots, and bodies that collide push each other. A policy that all robots share can stack the
    values of these dicts; independent policies can take one entry each.

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
        Names of the robots. All of them act at each step: episodes end for all robots of an
        environment at once.

    Examples
    --------
    >>> import numpy as np
    >>> from limslam_env import LimSlamParallelVectorEnv
    >>> envs = LimSlamParallelVectorEnv("env1", num_envs=4, num_robots=2)
    >>> observations, infos = envs.reset(seed=0)
    >>> observations, *_ = envs.step({name: np.full((4, 2), 0.5) for name in envs.agents})
    >>> observations["robot_1"]["ranges"].shape
    (4, 6)
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (as gymnasium declares it)

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
        check_count("the number of robots", num_robots, MAX_ROBOTS)
        self._set_up(world, num_envs, num_robots, max_cycles, **arguments)
        self._shares_reward = shared_reward
        self.single_action_space, self.single_observation_space = (
            action_space(),
            observation_space(self.robot),
        )
        self._name(
            num_robots,
            lambda: batch_space(self.single_observation_space, self.num_envs),
            lambda: batch_space(self.single_action_space, self.num_envs),
        )
        self.agents = list(self.possible_agents)
        self._generator: np.random.Generator | None = None

    def reset(
        self, *, seed: Seed = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, BatchObservation], dict[str, dict[str, Any]]]:
        """Start new episodes, as ``LimSlamVectorEnv`` does, with a seed and options, and with its
        errors.

        The option ``start`` has poses (s, 3) of the first robots, m and rad, or such poses for each
        environment (n, s, 3).
        """
        generator = generator_of(seed, self._generator)
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
        """Drive all robots for one control period; ``actions`` are (n, 2) for each, wheel speeds
        from -1 to 1.

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
    """A batch of environments for several robots; ``arguments`` are those of
    :class:`LimSlamParallelVectorEnv`.

    Examples
    --------
    >>> import limslam_env
    >>> envs = limslam_env.parallel_vector_env(world="square", num_robots=2, num_envs=16)
    >>> envs.num_envs
    16
    """
    return LimSlamParallelVectorEnv(world, **arguments)
