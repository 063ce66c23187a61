"""The PettingZoo environment with several robots in one building: an adapter of the simulation to
its interface.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from numpy.typing import NDArray
from pettingzoo import AECEnv, ParallelEnv
from pettingzoo.utils.conversions import parallel_to_aec

from limslam_env.config import NoiseConfig, RewardConfig, Setting
from limslam_env.envs.adapter import (
    RESET_OPTIONS,
    Action,
    NamedRobots,
    SimulationEnv,
    action_space,
    info_of,
    observation_of,
    observation_space,
    wheel_speeds,
)
from limslam_env.envs.arguments import MAX_ROBOTS, MOST_STEPS, PlaceSource
from limslam_env.geometry.numbers import check_count
from limslam_env.interface import Observation, RobotSpec
from limslam_env.rendering.painter import RENDER_MODES
from limslam_env.simulation.simulation import Readings, Truth


class LimSlamParallelEnv(NamedRobots, SimulationEnv, ParallelEnv[str, Observation, Action]):
    """Explore an unknown building with several robots, each with a few range beams and wheel
    encoders.

    The agents are called `robot_0`, `robot_1`, and so on. They act simultaneously, their beams
    detect the other robots' bodies, and bodies that collide push each other. The action space, the
    observation space and the keys of `info` of each agent are those of
    :class:`limslam_env.envs.env.LimSlamEnv`. A beam that hits another robot has the value -2 in
    `wall_seen`; the observation itself does not distinguish robots from walls.

    With `flat`, an observation is one array, `ranges` first, then `wheels` and `yaw`, if it is
    there. `state()` is for critics that see everything while they learn, an array of 4 + k numbers
    for each robot, and one more at its end, in `state_space`:

    | Numbers | Meaning                                                               |
    |---------|-----------------------------------------------------------------------|
    | 2       | true x and y as shares of the building's width and height, 0 to 1     |
    | 2       | cosine and sine of the true heading                                   |
    | k       | the robot's observation as one array, m and rad                       |
    | 1       | coverage, 0 to 1                                                      |

    ## Rewards
    The terms are those of `LimSlamEnv`; an area counts for the robot that is the first to see it.
    With `shared_reward` each robot gets the mean of all rewards.

    ## Starting State
    The robots take the world's start poses in order. The first robot starts where it would start
    alone. Robots for which the world has no start pose start at random (by the seed) in the region
    that the first robot can reach. `reset(options={"start": [(x, y, theta), ...]})` sets the poses
    of the first robots.

    ## Episode End
    The episode ends for all robots at once. It terminates when their joint coverage reaches
    `coverage_goal`. It is truncated after `max_cycles` steps.

    ## Arguments
    | Argument      | Default           | Meaning                                                     |
    |---------------|-------------------|-------------------------------------------------------------|
    | world         | the id's world    | as for `LimSlamEnv`                                         |
    | num_robots    | 2                 | 1 to 8                                                      |
    | robot         | `RobotSpec()`     | body, wheels and beams of each                              |
    | sensor_noise  | None              | as for `LimSlamEnv`                                         |
    | noise         | `NoiseConfig()`   | noise of the ranges and wheels; values drawn from intervals are the same for all robots |
    | imu           | False             | as for `LimSlamEnv`                                         |
    | coverage_goal | 0.99              | see Episode End                                             |
    | rewards       | `RewardConfig()`  | see Rewards                                                 |
    | shared_reward | False             | see Rewards                                                 |
    | flat          | False             | whether an observation is one array instead of a dict       |
    | max_cycles    | 18000             | see Episode End; None never truncates                       |
    | render_mode   | None              | `"rgb_array"` or `"human"`                                  |

    Raises
    ------
    ValueError
        If an argument is out of bounds.
    WorldError
        If the world cannot be used.

    Examples
    --------
    >>> from limslam_env import LimSlamParallelEnv
    >>> env = LimSlamParallelEnv("env1", num_robots=2, sensor_noise=0.02)
    >>> observations, infos = env.reset(seed=0)
    >>> actions = {name: env.action_space(name).sample() for name in env.agents}
    >>> observations, rewards, terminations, truncations, infos = env.step(actions)
    >>> list(rewards)
    ['robot_0', 'robot_1']
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as the base class declares it)
        "name": "limslam_v0",
        "render_modes": list(RENDER_MODES),
        "is_parallelizable": True,
    }

    def __init__(
        self,
        world: PlaceSource,
        *,
        num_robots: int = 2,
        robot: RobotSpec | None = None,
        sensor_noise: Setting | None = None,
        noise: NoiseConfig | None = None,
        imu: bool = False,
        coverage_goal: float | None = 0.99,
        rewards: RewardConfig | None = None,
        shared_reward: bool = False,
        flat: bool = False,
        max_cycles: int | None = 18_000,
        render_mode: str | None = None,
    ) -> None:
        check_count("the number of robots", num_robots, MAX_ROBOTS)
        if max_cycles is not None:
            check_count("max_cycles", max_cycles, MOST_STEPS)
        self._set_up(
            world,
            num_robots,
            render_mode,
            robot=robot,
            sensor_noise=sensor_noise,
            noise=noise,
            imu=imu,
            coverage_goal=coverage_goal,
            rewards=rewards,
        )
        self._shares_reward = shared_reward
        self._max_cycles = max_cycles
        self._cycles = 0
        self._generator: np.random.Generator | None = None
        parts = observation_space(self.robot, imu=imu)
        flattened: Any = spaces.flatten_space(parts)
        self._is_flat = flat
        self._name(num_robots, lambda: flattened if flat else parts, action_space)
        self.agents: list[str] = []
        self._last = np.zeros((num_robots, *flattened.shape), dtype=np.float32)
        self._coverage = 0.0
        # Place, heading and observation of each robot, and the coverage.
        low = np.array([*[0.0, 0.0, -1.0, -1.0, *flattened.low] * num_robots, 0.0], np.float32)
        high = np.array([*[1.0, 1.0, 1.0, 1.0, *flattened.high] * num_robots, 1.0], np.float32)
        self.state_space = spaces.Box(low, high)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start a new episode; options: `start`, one pose or a list of them, and `world`. Others
        are ignored.

        Raises
        ------
        ValueError
            If the start is no list of poses.
        WorldError
            If the world or a start cannot be used, or has no room for all.
        """
        if seed is not None or self._generator is None:
            self._generator, _ = seeding.np_random(seed)
        # PettingZoo's own test hands over options that no environment knows.
        known = {key: value for key, value in (options or {}).items() if key in RESET_OPTIONS}
        readings, truth = self._begin(self._generator, known)
        self.agents = list(self.possible_agents)
        self._cycles = 0
        return self._observed(readings, truth), self._each(lambda robot: info_of(truth, robot))

    def step(
        self, actions: dict[str, Action]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Drive all robots for one control period.

        Raises
        ------
        ValueError
            If there is not one action of two finite numbers for each robot.
        gymnasium.error.ResetNeeded
            If there was no reset yet, or the episode is over.
        """
        if not self.agents:
            raise gym.error.ResetNeeded("call reset before step, and after an episode's end")
        readings, truth = self._drive([wheel_speeds(action) for action in self._in_order(actions)])
        self._cycles += 1
        is_over = self.task.is_over(truth.coverage)
        is_late = self._max_cycles is not None and self._cycles >= self._max_cycles
        if is_over or is_late:
            self.agents = []
        rewards = list(map(self.task.reward.of_step, truth.new_area, truth.contact))
        if self._shares_reward:
            rewards = [sum(rewards) / len(rewards)] * len(rewards)
        return (
            self._observed(readings, truth),
            self._each(rewards.__getitem__),
            dict.fromkeys(self.possible_agents, is_over),
            dict.fromkeys(self.possible_agents, is_late),
            self._each(lambda robot: info_of(truth, robot)),
        )

    def state(self) -> NDArray[np.float32]:
        """What is true of all robots, and what they observe; the class says in which order.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If there was no reset yet.
        """
        poses = self.true_poses
        corners = self.world.edges.reshape(-1, 2)
        low = corners.min(axis=0)
        places = ((poses[:, :2] - low) / (corners.max(axis=0) - low)).clip(0.0, 1.0)
        headings = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        rows = np.concatenate((places, *headings, self._last), axis=1)
        return np.append(rows, self._coverage).astype(np.float32)

    def _observed(self, readings: Readings, truth: Truth) -> dict[str, Any]:
        """The observations of all robots, which the state remembers."""
        observations = self._each(lambda robot: observation_of(readings, robot))
        rows = [np.concatenate(list(seen.values())) for seen in observations.values()]
        self._last = np.array(rows)
        self._coverage = truth.coverage
        return self._each(rows.__getitem__) if self._is_flat else observations


def parallel_env(world: PlaceSource = "env1", **arguments: Any) -> LimSlamParallelEnv:
    """PettingZoo's parallel environment; ``arguments`` are those of :class:`LimSlamParallelEnv`.

    Examples
    --------
    >>> import limslam_env
    >>> env = limslam_env.parallel_env(world="square", num_robots=3)
    >>> env.possible_agents
    ['robot_0', 'robot_1', 'robot_2']
    """
    return LimSlamParallelEnv(world, **arguments)


def aec_env(world: PlaceSource = "env1", **arguments: Any) -> AECEnv[str, Observation, Action]:
    """The same, one robot acting after the other, as PettingZoo's AEC interface has it.

    Examples
    --------
    >>> import limslam_env
    >>> env = limslam_env.aec_env(world="square", num_robots=2)
    >>> env.reset(seed=0)
    >>> env.agent_selection
    'robot_0'
    """
    return parallel_to_aec(LimSlamParallelEnv(world, **arguments))
