"""Two baselines with known algorithms, trained from several seeds and tried after equal numbers of decisions.

``recurrent`` is PPO with a recurrent network (LSTM) on the raw readings, without a map. ``belief`` is PPO on the
observations of `SlamVectorObservation`: readings, and a crop of the grid around the robot. Both are the algorithms of
Stable-Baselines3 and sb3-contrib with small networks, choose wheel speeds twice a second, and get the same number of
decisions on the same plans. Explorers that do not learn stand beside them.

An action is held for half a second. Ten decisions a second would make a minute of driving five times as long for a
learner, and differ little from each other.
"""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

import limslam_env  # noqa: F401 (registers the environments)
from limslam_agent.measurements.statistics import interquartile_mean, probability_of_improvement
from limslam_agent.output.atomic_write import replace_content
from limslam_agent.runs.evaluate import evaluate
from limslam_agent.wrappers.vector import SlamVectorObservation
from limslam_env.envs.sb3 import Sb3VecEnv
from limslam_env.geometry import FloatArray

TRAINING_PLANS, HELD_OUT_PLANS = 100_000, 200_000
"""First seeds of the plans that are learned on, and of those that are tried, as in the suite ``explore``."""

CONFIG = "baselines.json"
LEARNERS = ("recurrent", "belief")
REFERENCES = ("random", "frontier", "frontier_fast")
"""Policies of ``limslam run`` that drive once on the held-out plans. Their rows have 0 steps of training."""

_ROLLOUT, _BATCH, _EPOCHS, _RATE, _GAMMA, _UNITS = 60, 768, 5, 7e-4, 0.97, 64


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


def trial(model: Any, learner: str, config: BaselineConfig) -> list[float]:
    """Coverage after an episode on each held-out plan. Actions are drawn, as in training."""
    env = environment(learner, config, is_trial=True)
    observation, info = env.reset(seed=0)
    state, starts = None, np.ones(env.num_envs, dtype=bool)
    for _ in range(config.episode):
        actions, state = model.predict(observation, state, starts, deterministic=False)
        starts[:] = False
        observation, *_, info = env.step(actions)
    env.close()
    coverage: list[float] = np.asarray(info["coverage"], dtype=float).tolist()
    return coverage


def reference_trial(policy: str, config: BaselineConfig) -> dict[int, list[float]]:
    """Coverage after an episode on each held-out plan by a policy of ``limslam run``."""
    settings: dict[str, Any] = {"sensor_noise": config.noise, "max_time": 0.1 * config.episode * config.hold}
    plans = range(HELD_OUT_PLANS, HELD_OUT_PLANS + config.held_out)
    drives = [evaluate(policy, "LimSlam-World-v0", [0], world=f"random:{plan}", **settings)[0] for plan in plans]
    return {0: [drive["coverage_true"] for drive in drives]}


def train_baselines(config: BaselineConfig, folder: Path, say: Callable[[str], None] = print) -> None:
    """Train what is missing in a folder: a file for each learner and seed. What was interrupted begins anew.

    Raises
    ------
    ValueError
        If the folder holds results of other settings.
    """
    settings, path = json.dumps(asdict(config)).encode(), folder / CONFIG
    if path.is_file() and path.read_bytes() != settings:
        raise ValueError(f"{folder}: holds results of other settings: choose another folder")
    replace_content(path, settings)
    tasks = {f"{name}-0": partial(reference_trial, name, config) for name in REFERENCES}
    for seed in range(config.seeds):
        tasks |= {f"{learner}-{seed}": partial(_train, learner, config, seed) for learner in LEARNERS}
    for name, scores in tasks.items():
        if not (path := folder / f"{name}.json").is_file():
            begin = time.process_time()
            replace_content(path, json.dumps(scores()).encode())
            say(f"{name}: {time.process_time() - begin:.0f} s of processor time")


def _train(learner: str, config: BaselineConfig, seed: int) -> dict[int, list[float]]:
    """The trials of a network, by the steps of training until then."""
    # Threads that wait for each other lose more than they gain on networks of this size.
    torch.set_num_threads(1)
    env = Sb3VecEnv(environment(learner, config, is_trial=False))
    rollout = max(min(_ROLLOUT, min(config.every, config.steps) // config.envs), 2)
    shared: dict[str, Any] = {
        "n_steps": rollout, "batch_size": min(_BATCH, rollout * config.envs), "n_epochs": _EPOCHS,
        "learning_rate": _RATE, "gamma": _GAMMA, "seed": seed, "device": "cpu",
    }  # fmt: skip
    trials = _Trials(learner, config)
    _model(learner, env, shared).learn(config.steps, callback=trials)
    env.close()
    return trials.scores


def _model(learner: str, env: Sb3VecEnv, shared: dict[str, Any]) -> Any:
    if learner == "belief":
        networks: dict[str, Any] = {"features_extractor_class": GridAndRanges, "net_arch": [_UNITS]}
        return PPO("MultiInputPolicy", env, policy_kwargs=networks, **shared)
    networks = {"lstm_hidden_size": _UNITS, "shared_lstm": True, "enable_critic_lstm": False, "net_arch": [_UNITS]}
    return RecurrentPPO("MlpLstmPolicy", env, policy_kwargs=networks, **shared)


class GridAndRanges(BaseFeaturesExtractor):  # type: ignore[misc, unused-ignore]
    """Features of a belief: two convolutions over the shares of free and occupied cells, and the readings.

    The pose and its covariance are left out. Where the robot is in the world says nothing about where to go.
    """

    def __init__(self, space: spaces.Dict, features: int = 128) -> None:
        super().__init__(space, features)
        parts: Any = space
        self.register_buffer("farthest", torch.from_numpy(parts["ranges"].high))
        self.near = nn.Sequential(
            nn.AvgPool2d(2, ceil_mode=True),
            nn.Conv2d(2, 16, 4, stride=4),
            nn.ReLU(),
            nn.Conv2d(16, 32, 3, stride=2, padding=1),
            nn.ReLU(),
            nn.Flatten(),
        )
        cells = self.near(torch.zeros(1, 2, *parts["grid"].shape[1:])).shape[1]
        self.head = nn.Sequential(nn.Linear(cells + len(self.farthest), features), nn.ReLU())

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """The features (n, features). Stable-Baselines3 has scaled the grid to the values 0, 0.5 and 1."""
        grid = observations["grid"]
        occupied = grid > 0.75
        free = (grid > 0.25) & ~occupied
        near = self.near(torch.cat((free, occupied), dim=1).float())
        found: Tensor = self.head(torch.cat((near, observations["ranges"] / self.farthest), dim=1))
        return found


class _Trials(BaseCallback):  # type: ignore[misc, unused-ignore]
    """Tries the network on the held-out plans after equal numbers of steps."""

    def __init__(self, learner: str, config: BaselineConfig) -> None:
        super().__init__()
        self._learner, self._config, self._due = learner, config, list(config.trials)
        self.scores: dict[int, list[float]] = {}

    def _on_rollout_start(self) -> None:
        # A network has learned from all rollouts that have ended.
        self._try()

    def _on_training_end(self) -> None:
        self._try()

    def _on_step(self) -> bool:
        return True

    def _try(self) -> None:
        while self._due and self.num_timesteps >= self._due[0]:
            self.scores[self._due.pop(0)] = trial(self.model, self._learner, self._config)


def efficiency_table(folder: Path) -> str:
    """Markdown: interquartile means of the coverage after so many steps, and probabilities of improvement."""
    curves: dict[str, dict[int, FloatArray]] = {}
    for name in (*REFERENCES, *LEARNERS):
        trials = [json.loads(path.read_bytes()) for path in sorted(folder.glob(f"{name}-[0-9]*.json"))]
        curves[name] = {int(steps): np.array([each[steps] for each in trials]) for steps in trials[0]}
    lines = ["| learner | steps | coverage | seeds |", "|---|---:|---:|---:|"]
    for name, curve in curves.items():
        lines += [f"| {name} | {n} | {interquartile_mean(each).text(2)} | {len(each)} |" for n, each in curve.items()]
    lines += ["", "Interquartile means over seeds and plans, with 95 % bootstrap intervals over seeds.", ""]
    last = {name: curve[max(curve)] for name, curve in curves.items()}
    lines += [
        f"P({first} sees more than {second} after training) = {_probability(last, first, second)}"
        for first, second in combinations((*LEARNERS, *REFERENCES), 2)
        if first in LEARNERS
    ]
    return "\n".join([*lines, ""])


def _probability(last: Mapping[str, FloatArray], first: str, second: str) -> str:
    return probability_of_improvement(last[first], last[second]).text(2)
