"""What the baselines learn on and are tried on: batches of environments, and the drives that they are compared with.

An action is held for half a second. Ten decisions a second would make a minute of driving five times as long for a
learner, and differ little from each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

import limslam_env  # noqa: F401 (registers the environments)
from limslam_agent.mapping.team import LimSlamTeam
from limslam_agent.runs.oracle import policies_by_belief
from limslam_agent.wrappers.single import default_config
from limslam_agent.wrappers.vector import SlamVectorObservation

TRAINING_PLANS, HELD_OUT_PLANS = 100_000, 200_000
"""First seeds of the plans that are learned on, and of those that are tried, as in the suite ``explore``."""


@dataclass(frozen=True)
class BaselineConfig:
    """The budget of the baselines.

    Attributes
    ----------
    steps, seeds
        Decisions for each learner and seed, and number of seeds.
    every
        Decisions after which each network is tried, again and again.
    plans, held_out
        Number of plans that are learned on, and of those that are tried.
    envs
        Number of environments in the batch.
    episode, hold
        Decisions of an episode, in training and in a trial, and control periods of a decision.
    noise
        Standard deviation of the ranges, m.

    Raises
    ------
    ValueError
        If there are no steps or no seeds.
    """

    steps: int = 100_000
    seeds: int = 5
    every: int = 20_000
    plans: int = 1000
    held_out: int = 20
    envs: int = 64
    episode: int = 120
    hold: int = 5
    noise: float = 0.02

    def __post_init__(self) -> None:
        if min(self.steps, self.seeds) < 1:
            raise ValueError(f"steps and seeds must be 1 or more, not {self.steps} and {self.seeds}")

    @property
    def trials(self) -> tuple[int, ...]:
        """Numbers of decisions after which a network is tried, at least all of them."""
        return (*range(self.every, self.steps, self.every), self.steps)


class HeldActions(gym.vector.VectorWrapper):  # type: ignore[type-arg, misc, unused-ignore]
    """Hold each action of a batch for some control periods, and add up the rewards.

    All episodes of the batch must end together, at the end of a decision.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], hold: int) -> None:
        super().__init__(env)
        self._hold = hold

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Drive for one decision."""
        rewards = np.zeros(self.num_envs)
        for _ in range(self._hold):
            observation, reward, terminated, truncated, info = self.env.step(actions)
            rewards += reward
        return observation, rewards, terminated, truncated, info


class RawReadings(HeldActions):
    """All readings and wheel travels of a decision as vectors (n, hold * 8) from -1 to 1, those of ``final_obs`` too.

    At the start of an episode, the first readings stand for the earlier ones.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], hold: int) -> None:
        super().__init__(env, hold)
        parts: Any = env.single_observation_space
        self._low, self._high = (
            np.concatenate([getattr(parts[name], side) for name in ("ranges", "wheels")]) for side in ("low", "high")
        )
        self.single_observation_space = spaces.Box(-1.0, 1.0, (hold * len(self._low),), np.float32)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(self, **arguments: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin new episodes."""
        observation, info = self.env.reset(**arguments)
        return self._joined([self._vectors(observation)] * self._hold), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Drive for one decision."""
        rewards, vectors = np.zeros(self.num_envs), []
        for _ in range(self._hold):
            observation, reward, terminated, truncated, info = self.env.step(actions)
            rewards += reward
            vectors.append(self._vectors(observation))
        found = self._joined(vectors)
        for number in np.flatnonzero(terminated | truncated):
            last = self._vectors(info["final_obs"][number])
            info["final_obs"][number] = np.concatenate((found[number, : -len(last)], last))
            found[number] = np.tile(vectors[-1][number], self._hold)
        return found, rewards, terminated, truncated, info

    def _vectors(self, observation: Any) -> NDArray[np.float32]:
        values = np.concatenate((observation["ranges"], observation["wheels"]), axis=-1)
        return np.asarray(2.0 * (values - self._low) / (self._high - self._low) - 1.0, dtype=np.float32)

    def _joined(self, vectors: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        return np.concatenate(vectors, axis=-1)


def environment(learner: str, config: BaselineConfig, *, is_trial: bool) -> Any:
    """The batch that a learner sees. For a trial: endless episodes, one on each held-out plan."""
    batch = _batch(config, is_trial=is_trial)
    if learner == "belief":
        return HeldActions(SlamVectorObservation(batch, num_threads=1), config.hold)
    return RawReadings(batch, config.hold)


def _batch(config: BaselineConfig, *, is_trial: bool) -> Any:
    shared: dict[str, Any] = {"autoreset_mode": "SameStep", "sensor_noise": config.noise, "num_threads": 1}
    # Without a coverage goal, all episodes take the same time.
    shared["coverage_goal"] = None
    if is_trial:
        worlds = [f"random:{HELD_OUT_PLANS + number}" for number in range(config.held_out)]
        return gym.make_vec("LimSlam-World-v0", config.held_out, world=worlds, max_episode_steps=None, **shared)
    plans = list(range(TRAINING_PLANS, TRAINING_PLANS + config.plans))
    length = config.episode * config.hold
    return gym.make_vec("LimSlam-Random-v0", config.envs, plans=plans, max_episode_steps=length, **shared)


def trial(model: Any, learner: str, config: BaselineConfig) -> dict[str, list[float]]:
    """Coverage and return of an episode on each held-out plan. Actions are drawn, as in training."""
    env = environment(learner, config, is_trial=True)
    observation, info = env.reset(seed=0)
    returns, state = np.zeros(env.num_envs), None
    starts = np.ones(env.num_envs, dtype=bool)
    for _ in range(config.episode):
        actions, state = model.predict(observation, state, starts, deterministic=False)
        starts[:] = False
        observation, reward, *_, info = env.step(actions)
        returns += reward
    env.close()
    return _scores(info, returns)


def reference_trial(policy: str, config: BaselineConfig) -> dict[str, list[float]]:
    """The same scores of a policy of ``limslam run``, from the same starts and with the same noise."""
    env = _batch(config, is_trial=True)
    observation, info = env.reset(seed=0)
    robot = env.unwrapped.robot
    settings = default_config([env.unwrapped.nominal_noise])
    teams = []
    for number, pose in enumerate(info["pose"]):
        teams.append(
            LimSlamTeam(robot, settings, 1, policies_by_belief(policy, robot, settings, robots=1, seed=number))
        )
        teams[-1].reset(np.array(pose)[None], number)
    returns = np.zeros(env.num_envs)
    for _ in range(config.episode * config.hold):
        for number, team in enumerate(teams):
            team.observe([{"ranges": observation["ranges"][number], "wheels": observation["wheels"][number]}])
        observation, reward, *_, info = env.step(np.array([team.decide()[0] for team in teams], dtype=np.float32))
        returns += reward
    env.close()
    return _scores(info, returns)


def _scores(info: dict[str, Any], returns: NDArray[Any]) -> dict[str, list[float]]:
    return {"coverage": np.asarray(info["coverage"], dtype=float).tolist(), "return": returns.tolist()}
