"""``python -m benchmarks train``: PPO on the batched environment, for a fixed budget (extra ``rl``).

The trained network is `DirectionNetwork`. The reward is the newly seen area according to the ground truth of the
simulator. The observations are those of a robot, except in phases with the true pose.
"""

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

import limslam_env  # noqa: F401 (registers the environments)
from benchmarks.suite.provenance import package_versions
from benchmarks.suite.train_config import Phase, Pose, TrainConfig
from benchmarks.training.direction_policy import DirectionPolicy
from benchmarks.training.explore_env import ExploreConfig, ExploreVectorEnv
from benchmarks.training.explore_trial import Trial, times_to
from limslam_agent.output.atomic_write import atomic_write
from limslam_agent.output.provenance import commit
from limslam_agent.policies.learned.learned import TEMPERATURE
from limslam_agent.policies.learned.network import DirectionNetwork, save_network
from limslam_env.config import RewardConfig
from limslam_env.envs.sb3 import Sb3VecEnv

CHECKPOINT, LOG, CONFIG = "checkpoint.pt", "trials.jsonl", "train.json"
LEAST_SHARE = 0.05
GOAL = 0.8

SAVE_EVERY = 60.0
"""Time between two checkpoints, s."""


@dataclass
class Progress:
    """The progress of a training: number of decisions, and processor time (s)."""

    decisions: int = 0
    spent: float = 0.0


def train(config: TrainConfig, folder: Path, *, resume: bool = False) -> Path:
    """Train a policy, and write weights, checkpoint, TensorBoard logs and evaluations to a folder.

    Parameters
    ----------
    config
        Settings of the training.
    folder
        Folder for the output; created if it does not exist.
    resume
        Continue from the checkpoint in the folder.

    Returns
    -------
    weights
        Weights of the last phase that was reached within the time limit.

    Raises
    ------
    ValueError
        If the folder contains a training and ``resume`` is false, or contains no training to resume, or another
        training.
    """
    saved = _claim(config, folder, resume=resume)
    torch.set_num_threads(1)
    progress = Progress()
    model, weights = _model(config, config.phases[0], folder), folder
    if saved is not None:
        progress = Progress(int(saved["decisions"]), float(saved["spent"]))
        model.policy.load_state_dict(saved["policy"])
        model.policy.optimizer.load_state_dict(saved["optimizer"])
        model.num_timesteps = progress.decisions
    end = 0
    for number, phase in enumerate(config.phases):
        end += phase.decisions
        if progress.decisions < end and progress.spent < 60.0 * config.minutes:
            if number:
                model.set_env(_batch(config, phase))
            keeper = _Keeper(config, phase, folder, progress)
            # The learning rate decreases over all decisions up to the end of the phase: later phases begin with a low
            # rate.
            model.learn(end - progress.decisions, callback=keeper, reset_num_timesteps=False, tb_log_name=phase.pose)
            keeper.keep()
            save_network(folder / f"{_name(phase.pose)}.npz", _network(model))
        # A phase that does not begin within the time limit writes no weights.
        if (folder / f"{_name(phase.pose)}.npz").exists():
            weights = folder / f"{_name(phase.pose)}.npz"
    return weights


def _name(pose: Pose) -> str:
    return "true_pose" if pose == "true" else pose


def _claim(config: TrainConfig, folder: Path, *, resume: bool) -> dict[str, Any] | None:
    """The checkpoint for resuming, if there is one. A folder belongs to one training."""
    asked = json.loads(json.dumps(asdict(config)))
    path = folder / CONFIG
    if resume:
        try:
            known = json.loads(path.read_text(encoding="utf-8"))["config"]
            # The checkpoint contains only tensors and numbers: loading it executes no code.
            saved: dict[str, Any] = torch.load(folder / CHECKPOINT, weights_only=True)
        except (OSError, ValueError, KeyError, RuntimeError, EOFError) as error:
            raise ValueError(f"{folder}: no training to resume: {error}") from error
        if known != asked:
            raise ValueError(f"{folder}: holds a training with other settings")
        return saved
    if path.exists():
        raise ValueError(f"{folder}: holds a training: go on with --resume, or choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"config": asked, "commit": commit(), "versions": package_versions()}, indent=1)
    path.write_text(text + "\n", encoding="utf-8")
    return None


def _batch(config: TrainConfig, phase: Phase) -> Sb3VecEnv:
    explore = ExploreConfig(pose=phase.pose, range_std=config.noise)
    batch = gym.make_vec(
        "LimSlam-Random-v0", config.robots, autoreset_mode="SameStep", plans=config.plans.seeds,
        sensor_noise=config.noise, coverage_goal=config.coverage_goal, max_episode_steps=round(10.0 * config.max_time),
        rewards=RewardConfig(1.0, -config.time_cost, -config.collision_cost), num_threads=1,
    )  # fmt: skip
    return Sb3VecEnv(ExploreVectorEnv(batch, explore))


def _model(config: TrainConfig, phase: Phase, folder: Path) -> PPO:
    return PPO(
        DirectionPolicy, _batch(config, phase), n_steps=config.rollout, batch_size=config.batch,
        n_epochs=config.epochs, gamma=config.gamma, ent_coef=config.entropy, seed=config.seed, device="cpu",
        learning_rate=lambda left: config.learning_rate * max(left, LEAST_SHARE),
        tensorboard_log=str(folder / "tensorboard"), policy_kwargs={"view": ExploreConfig().view},
    )  # fmt: skip


def _network(model: PPO) -> DirectionNetwork:
    network: DirectionNetwork = model.policy.mlp_extractor.to_numpy()
    return network


class _Keeper(BaseCallback):
    """Measures the time, writes checkpoints, and evaluates the policy on the held-out plans."""

    def __init__(self, config: TrainConfig, phase: Phase, folder: Path, progress: Progress) -> None:
        super().__init__()
        self._config, self._phase, self._folder, self._progress = config, phase, folder, progress
        self._trial: Trial | None = None
        self._begin, self._before = time.process_time(), progress.spent
        self._saved, self._tried = time.monotonic(), progress.decisions

    def _on_step(self) -> bool:
        self._note()
        return self._progress.spent < 60.0 * self._config.minutes

    def _on_rollout_end(self) -> None:
        left = float(self.model._current_progress_remaining)  # noqa: SLF001 (it has no other name)
        self.model.ent_coef = self._config.entropy * max(left, LEAST_SHARE)
        if time.monotonic() - self._saved > SAVE_EVERY:
            self.keep()
            self._saved = time.monotonic()
        if self.num_timesteps - self._tried >= self._config.try_every:
            self._try()
            self._tried = self.num_timesteps

    def _on_training_end(self) -> None:
        self._try()

    def keep(self) -> None:
        """Write a checkpoint."""
        self._note()
        policy = self.model.policy
        held = {"policy": policy.state_dict(), "optimizer": policy.optimizer.state_dict(), **asdict(self._progress)}
        with atomic_write(self._folder / CHECKPOINT) as beside:
            torch.save(held, beside)

    def _note(self) -> None:
        self._progress.decisions = self.num_timesteps
        self._progress.spent = self._before + time.process_time() - self._begin

    def _try(self) -> None:
        config = self._config
        if self._trial is None:
            explore = ExploreConfig(pose=self._phase.pose, range_std=config.noise)
            self._trial = Trial(config.held_out.seeds, config.noise, explore)
        coverage, touches = self._trial.explore(_network(self.model), TEMPERATURE)
        times = times_to(coverage, GOAL, self._trial.period)
        # There is no median of a time that half of the plans did not reach.
        middle = float(np.median(times))
        self._note()
        row = {
            "decisions": self.num_timesteps, "minutes": self._progress.spent / 60.0, "pose": self._phase.pose,
            "time_to_80_s": middle if np.isfinite(middle) else None, "reached_80": float(np.isfinite(times).mean()),
            "coverage_at_120_s": float(np.median(coverage[:, round(120.0 / self._trial.period)])),
            "touches": float(touches.mean()),
        }  # fmt: skip
        with (self._folder / LOG).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        for name, value in row.items():
            if isinstance(value, float):
                self.logger.record(f"held_out/{name}", value)
        print(
            " ".join(
                f"{name} {value:.3g}" if isinstance(value, float) else f"{name} {value}" for name, value in row.items()
            ),
            flush=True,
        )
