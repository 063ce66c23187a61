"""Two baselines with known algorithms, trained from several seeds and tried after equal numbers of decisions.

``recurrent`` is PPO with a recurrent network (LSTM) on the raw readings, without a map. ``belief`` is PPO on the
observations of `SlamVectorObservation`: readings, and a crop of the grid around the robot. Both are the algorithms of
Stable-Baselines3 and sb3-contrib with small networks, choose wheel speeds twice a second, and get the same number of
decisions on the same plans. Explorers that do not learn stand beside them.
"""

import json
import time
from collections.abc import Sequence
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

from benchmarks.training.baseline_envs import BaselineConfig, environment, reference_trial, trial
from benchmarks.training.efficiency import RESULTS
from limslam_agent.output.atomic_write import append_line, mend_lines, replace_content
from limslam_env.envs.sb3 import Sb3VecEnv

LEARNERS = ("recurrent", "belief")
REFERENCES = ("random", "frontier", "frontier_fast")
"""Policies of ``limslam run`` that drive once on the held-out plans. Their rows have 0 steps of training."""

_SETTINGS = "baselines.json"
_ROLLOUT, _BATCH, _EPOCHS, _RATE, _GAMMA, _UNITS = 60, 768, 5, 7e-4, 0.97, 64


def train_baselines(config: BaselineConfig, folder: Path, learners: Sequence[str] = LEARNERS, say: Any = print) -> None:
    """Train what is missing in a folder. A seed that was interrupted begins anew.

    Raises
    ------
    ValueError
        If a learner does not exist, or the folder holds results of other settings.
    """
    if unknown := [name for name in learners if name not in LEARNERS]:
        raise ValueError(f"no baseline is called {unknown[0]!r}; there are {', '.join(LEARNERS)}")
    _open(folder, config)
    for name in REFERENCES:
        if not _rows_of(folder, name, 0):
            _note(folder / RESULTS, name, 0, 0, reference_trial(name, config))
    for seed in range(config.seeds):
        for learner in learners:
            if _rows_of(folder, learner, seed) < len(config.trials):
                _drop(folder, learner, seed)
                begin = time.process_time()
                _train(learner, config, seed, folder / RESULTS)
                spent = time.process_time() - begin
                say(f"{learner}, seed {seed}: {config.steps} steps, {spent:.0f} s of processor time")


def _open(folder: Path, config: BaselineConfig) -> None:
    path, settings = folder / _SETTINGS, json.dumps(asdict(config), indent=2) + "\n"
    if path.is_file() and path.read_text(encoding="utf-8") != settings:
        raise ValueError(f"{folder}: holds baselines with other settings (see {_SETTINGS}): choose another folder")
    if not path.is_file() and folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ValueError(f"{folder}: is not empty and holds no baselines")
    replace_content(path, settings.encode())
    mend_lines(folder / RESULTS)


def _lines(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / RESULTS).read_bytes().splitlines()]


def _rows_of(folder: Path, learner: str, seed: int) -> int:
    return sum(row["learner"] == learner and row["seed"] == seed for row in _lines(folder))


def _drop(folder: Path, learner: str, seed: int) -> None:
    """Remove the trials of a seed that was interrupted."""
    kept = [row for row in _lines(folder) if (row["learner"], row["seed"]) != (learner, seed)]
    replace_content(folder / RESULTS, b"".join(json.dumps(row).encode() + b"\n" for row in kept))


def _note(path: Path, learner: str, seed: int, steps: int, scores: dict[str, list[float]]) -> None:
    append_line(path, json.dumps({"learner": learner, "seed": seed, "steps": steps, **scores}).encode() + b"\n")


def _train(learner: str, config: BaselineConfig, seed: int, path: Path) -> None:
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
    model.learn(config.steps, callback=_Trials(learner, config, seed, path))
    env.close()


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

    def __init__(self, learner: str, config: BaselineConfig, seed: int, path: Path) -> None:
        super().__init__()
        self._learner, self._config, self._seed, self._path = learner, config, seed, path
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
            scores = trial(self.model, self._learner, self._config)
            _note(self._path, self._learner, self._seed, self._due.pop(0), scores)
