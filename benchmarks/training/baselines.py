"""Two baselines with known algorithms, trained from several seeds and tried after equal numbers of decisions.

``recurrent`` is PPO with a recurrent network (LSTM) on the raw readings, without a map. ``belief`` is PPO on the
observations of `SlamVectorObservation`: readings, and a crop of the grid around the robot. Both are the algorithms of
Stable-Baselines3 and sb3-contrib with small networks, choose wheel speeds twice a second, and get the same number of
decisions on the same plans. Explorers that do not learn stand beside them.
"""

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor, nn

from benchmarks.suite.runner import package_versions
from benchmarks.training.baseline_envs import BaselineConfig, environment, reference_trial, trial
from benchmarks.training.efficiency import FORMAT, Row, Stamp
from limslam_agent.measurements.store import open_store
from limslam_agent.output.provenance import commit
from limslam_env.envs.sb3 import Sb3VecEnv

LEARNERS = ("recurrent", "belief")
REFERENCES = ("random", "frontier", "frontier_fast")
"""Policies of ``limslam run`` that drive once on the held-out plans. Their rows have 0 steps of training."""

_ROLLOUT, _BATCH, _EPOCHS, _RATE, _GAMMA, _UNITS = 60, 768, 5, 7e-4, 0.97, 64


def train_baselines(config: BaselineConfig, folder: Path, say: Any = print) -> None:
    """Train what is missing in a folder. A seed that was interrupted begins anew.

    Raises
    ------
    ValueError
        If the folder holds results of other settings, versions or commit.
    """
    stamp = Stamp(asdict(config), package_versions(), commit())
    with open_store(FORMAT, folder, stamp) as store:
        for name in REFERENCES:
            if (name, 0) not in store.rows:
                scores = reference_trial(name, config)
                store.append(Row(name, 0, {"0": scores["coverage"]}, {"0": scores["return"]}))
        for seed in range(config.seeds):
            for learner in LEARNERS:
                if (learner, seed) not in store.rows:
                    begin = time.process_time()
                    store.append(_train(learner, config, seed))
                    spent = time.process_time() - begin
                    say(f"{learner}, seed {seed}: {config.steps} steps, {spent:.0f} s of processor time")


def _train(learner: str, config: BaselineConfig, seed: int) -> Row:
    row = Row(learner, seed, {}, {})
    # Threads that wait for each other lose more than they gain on networks of this size.
    torch.set_num_threads(1)
    env = Sb3VecEnv(environment(learner, config, is_trial=False))
    rollout = max(min(_ROLLOUT, min(config.every, config.steps) // config.envs), 2)
    shared = {
        "n_steps": rollout,
        "batch_size": min(_BATCH, rollout * config.envs),
        "n_epochs": _EPOCHS,
        "learning_rate": _RATE,
        "gamma": _GAMMA,
        "seed": seed,
        "device": "cpu",
    }
    model = _model(learner, env, shared)
    model.learn(config.steps, callback=_Trials(row, config))
    env.close()
    return row


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

    def __init__(self, row: Row, config: BaselineConfig) -> None:
        super().__init__()
        self._row, self._config = row, config
        self._due = list(config.trials)

    def _on_rollout_start(self) -> None:
        # A network has learned from all rollouts that have ended.
        self._try()

    def _on_training_end(self) -> None:
        self._try()

    def _on_step(self) -> bool:
        return True

    def _try(self) -> None:
        while self._due and self.num_timesteps >= self._due[0]:
            steps = str(self._due.pop(0))
            scores = trial(self.model, self._row.learner, self._config)
            self._row.coverage[steps], self._row.returns[steps] = scores["coverage"], scores["return"]
