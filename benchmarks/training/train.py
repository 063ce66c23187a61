"""``python -m benchmarks train``: PPO on the batched environment, for a fixed budget (extra
``rl``).

The trained network is `DirectionNetwork`. The reward is the newly seen area according to the ground
truth of the simulator.
"""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from torch import Tensor, nn
from torch.nn import functional

import limslam_env  # noqa: F401 (registers the environments)
from benchmarks.training.explore_env import VIEW, ExploreVectorEnv
from limslam_agent.output.provenance import commit, versions
from limslam_agent.policies.learned.learned import HOLD, TEMPERATURE
from limslam_agent.policies.learned.network import (
    COMPASS,
    LAYERS,
    SPREAD,
    DirectionNetwork,
    save_network,
)
from limslam_agent.policies.learned.polar_view import ViewConfig
from limslam_env.config import RewardConfig
from limslam_env.envs.sb3 import Sb3VecEnv

LOG = "trials.jsonl"
CONFIG = "train.json"
WEIGHTS = "explorer.npz"
LEAST_SHARE = 0.05
GOAL = 0.8
WIDTH = 48  # channels of a layer
_SMALL = 0.01  # factor of the initial weights of the last layer
_TRIAL = 240.0  # s: duration of each episode of a trial


@dataclass(frozen=True)
class TrainConfig:
    """The settings of a training by PPO (Schulman et al. 2017)."""

    decisions: int = 300_000  # the budget: number of decisions of all robots together
    # plans, held_out: seeds of the floor plans for training, and of those for periodic evaluation.
    # The suite ``explore`` uses others.
    plans: Sequence[int] = range(100_000, 101_000)
    held_out: Sequence[int] = range(200_000, 200_030)
    noise: float = 0.02  # standard deviation of the ranges, m
    # robots, rollout: number of robots that drive at once, and number of decisions of each robot in
    # a rollout
    robots: int = 64
    rollout: int = 64
    # batch, epochs, learning_rate, gamma, entropy: parameters of PPO. Learning rate and entropy
    # weight decrease to a twentieth.
    batch: int = 512
    epochs: int = 3
    learning_rate: float = 7e-4
    gamma: float = 0.985
    entropy: float = 0.01
    # coverage_goal, max_time: an episode ends at this coverage, or after this time, s
    coverage_goal: float = 0.9
    max_time: float = 200.0
    # time_cost, collision_cost: costs that are subtracted from the reward (new area in m^2) for
    # each step of 0.1 s, and for each such step in contact. A touch of a few steps costs as much as
    # seeing a square metre gains.
    time_cost: float = 0.02
    collision_cost: float = 0.3
    try_every: int = 70_000  # number of decisions between two evaluations on the held-out plans
    seed: int = 0  # seed of all random numbers


def train(config: TrainConfig, folder: Path) -> Path:
    """Train a policy, and write weights, TensorBoard logs and evaluations to a new folder.

    Parameters
    ----------
    config
        Settings of the training.
    folder
        Folder for the output; created if it does not exist.

    Returns
    -------
    weights
        File of the weights.

    Raises
    ------
    ValueError
        If the folder contains a training.
    """
    if (folder / CONFIG).exists():
        raise ValueError(f"{folder}: holds a training: choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    settings = {**asdict(config), "plans": list(config.plans), "held_out": list(config.held_out)}
    text = json.dumps({"config": settings, "commit": commit(), "versions": versions()}, indent=1)
    (folder / CONFIG).write_text(text + "\n", encoding="utf-8")
    torch.set_num_threads(1)
    batch = gym.make_vec(
        "LimSlam-Random-v0",
        config.robots,
        autoreset_mode="SameStep",
        plans=config.plans,
        sensor_noise=config.noise,
        coverage_goal=config.coverage_goal,
        max_episode_steps=round(10.0 * config.max_time),
        rewards=RewardConfig(1.0, -config.time_cost, -config.collision_cost),
        num_threads=1,
    )
    model = PPO(
        DirectionPolicy,
        Sb3VecEnv(ExploreVectorEnv(batch)),
        n_steps=config.rollout,
        batch_size=config.batch,
        n_epochs=config.epochs,
        gamma=config.gamma,
        ent_coef=config.entropy,
        seed=config.seed,
        device="cpu",
        learning_rate=lambda left: config.learning_rate * max(left, LEAST_SHARE),
        tensorboard_log=str(folder / "tensorboard"),
        policy_kwargs={"view": VIEW},
    )
    model.learn(config.decisions, callback=_Keeper(config, folder), tb_log_name="explore")
    save_network(folder / WEIGHTS, model.policy.mlp_extractor.to_numpy())
    return folder / WEIGHTS


class _Keeper(BaseCallback):
    """Evaluates the policy on the held-out plans, the same ones each time."""

    def __init__(self, config: TrainConfig, folder: Path) -> None:
        super().__init__()
        self._config = config
        self._folder = folder
        self._begin = time.process_time()
        self._tried = 0
        batch = gym.make_vec(
            "LimSlam-World-v0",
            len(config.held_out),
            world=[f"random:{seed}" for seed in config.held_out],
            autoreset_mode="SameStep",
            sensor_noise=config.noise,
            coverage_goal=None,
            max_episode_steps=None,
            num_threads=1,
        )
        self._env = ExploreVectorEnv(batch)

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        left = float(self.model._current_progress_remaining)  # noqa: SLF001 (it has no other name)
        self.model.ent_coef = self._config.entropy * max(left, LEAST_SHARE)
        if self.num_timesteps - self._tried >= self._config.try_every:
            self._try()

    def _on_training_end(self) -> None:
        self._try()

    def _try(self) -> None:
        self._tried, network = self.num_timesteps, self.model.policy.mlp_extractor.to_numpy()
        period = HOLD * self._env.robot.control_period
        generator = np.random.default_rng(0)
        told, info = self._env.reset(seed=0)
        rows = [info["coverage"].copy()]
        for _ in range(round(_TRIAL / period)):
            scores = np.stack([network.scores(row) for row in told]).astype(float)
            # Directions are drawn as by `LearnedPolicy`.
            chosen = (scores + TEMPERATURE * generator.gumbel(size=scores.shape)).argmax(axis=1)
            told, _, _, _, info = self._env.step(chosen)
            rows.append(info["coverage"].copy())
        coverage = np.array(rows).T  # (plans, decisions + 1)
        reached = coverage >= GOAL
        times = np.where(reached.any(axis=1), reached.argmax(axis=1) * period, np.inf)
        # There is no median of a time that half of the plans did not reach.
        middle = float(np.median(times))
        row = {
            "decisions": self.num_timesteps,
            "minutes": (time.process_time() - self._begin) / 60.0,
            "time_to_80_s": middle if np.isfinite(middle) else None,
            "reached_80": float(np.isfinite(times).mean()),
            "coverage_at_120_s": float(np.median(coverage[:, round(120.0 / period)])),
            "touches": float(self._env.touches.mean()),
        }
        with (self._folder / LOG).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        for name, value in row.items():
            if isinstance(value, float):
                self.logger.record(f"held_out/{name}", value)
        print(json.dumps(row), flush=True)


class DirectionExtractor(nn.Module):
    """Circular convolutions that give a score for each direction, and features for the value.

    Parameters
    ----------
    view
        Shape of the view.
    readings
        Number of entries that follow the view in an observation.
    """

    def __init__(self, view: ViewConfig, readings: int) -> None:
        super().__init__()
        self.view = view
        self.latent_dim_pi = view.directions
        self.latent_dim_vf = 64
        inputs = view.rows
        self._size = inputs * view.directions
        self.first = nn.Conv1d(inputs + COMPASS, WIDTH, 5)
        self.state = nn.Linear(readings, WIDTH)
        self.second = nn.Conv1d(WIDTH, WIDTH, 3, dilation=SPREAD["second"])
        self.third = nn.Conv1d(WIDTH, WIDTH, 3, dilation=SPREAD["third"])
        self.score = nn.Conv1d(WIDTH + inputs + COMPASS, 1, 1)
        self.value = nn.Sequential(nn.Linear(2 * WIDTH + readings, 64), nn.ReLU())
        angles = 2.0 * np.pi * np.arange(view.directions) / view.directions
        compass = torch.as_tensor(np.stack((np.cos(angles), np.sin(angles))), dtype=torch.float32)
        self.register_buffer("compass", compass)

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Scores (n, directions), and features for the value (n, 64)."""
        count = len(observation)
        state = observation[:, self._size :]
        view = observation[:, : self._size].reshape(count, -1, self.view.directions)
        told = torch.cat((view, torch.as_tensor(self.compass).expand(count, -1, -1)), dim=1)
        values = functional.relu(_around(self.first, told) + self.state(state)[:, :, None])
        values = functional.relu(_around(self.third, functional.relu(_around(self.second, values))))
        features = torch.cat((values.mean(dim=2), values.amax(dim=2), state), dim=1)
        scores = torch.as_tensor(self.score(torch.cat((values, told), dim=1))[:, 0])
        return scores, torch.as_tensor(self.value(features))

    def forward_actor(self, observation: Tensor) -> Tensor:
        """Scores (n, directions)."""
        return self.forward(observation)[0]

    def forward_critic(self, observation: Tensor) -> Tensor:
        """Features for the value (n, 64)."""
        return self.forward(observation)[1]

    def to_numpy(self) -> DirectionNetwork:
        """The policy in the form that a robot runs."""
        weights = {
            f"{layer}.{part}": getattr(getattr(self, layer), part).detach().cpu().numpy().copy()
            for layer in LAYERS
            for part in ("weight", "bias")
        }
        return DirectionNetwork(weights, self.view)


def _around(layer: nn.Conv1d, values: Tensor) -> Tensor:
    half = layer.dilation[0] * (layer.kernel_size[0] // 2)
    if half == 0:
        return torch.as_tensor(layer(values))
    return torch.as_tensor(
        layer(torch.cat((values[:, :, -half:], values, values[:, :, :half]), dim=2))
    )


class DirectionPolicy(ActorCriticPolicy):
    """Actor and critic with shared layers; the scores are the logits.

    Parameters
    ----------
    *args, **kwargs
        Arguments from Stable-Baselines3.
    view
        Shape of the view.
    """

    def __init__(self, *args: Any, view: ViewConfig, **kwargs: Any) -> None:
        self._view = view
        super().__init__(*args, ortho_init=False, **kwargs)

    def _build_mlp_extractor(self) -> None:
        view = self._view
        readings = self.features_dim - view.rows * view.directions
        self.mlp_extractor = DirectionExtractor(view, readings)

    def _build(self, lr_schedule: Callable[[float], float]) -> None:
        super()._build(lr_schedule)
        # No parameters are needed between scores and logits. Small initial weights of the last
        # layer give nearly equal probabilities.
        self.action_net = nn.Identity()
        with torch.no_grad():
            self.mlp_extractor.score.weight.mul_(_SMALL)
        self.optimizer = self.optimizer_class(
            self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs
        )
