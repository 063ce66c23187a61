"""``python -m benchmarks train``: PPO on the batched environment, for a fixed budget (extra ``rl``).

The trained network is `DirectionNetwork`. The reward is the newly seen area according to the ground truth of the
simulator. The observations are those of a robot, except in phases with the true pose.
"""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

import limslam_env  # noqa: F401 (registers the environments)
from benchmarks.suite.runner import package_versions
from benchmarks.suite.train_config import Phase, TrainConfig
from benchmarks.training.direction_policy import DirectionPolicy
from benchmarks.training.explore_env import ExploreConfig, ExploreVectorEnv
from limslam_agent.output.provenance import commit
from limslam_agent.policies.learned.learned import TEMPERATURE
from limslam_agent.policies.learned.network import DirectionNetwork, save_network
from limslam_env.config import RewardConfig
from limslam_env.envs.sb3 import Sb3VecEnv
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan

LOG, CONFIG = "trials.jsonl", "train.json"
LEAST_SHARE = 0.05
GOAL = 0.8
_TRIAL = 240.0  # s: duration of each episode of a trial


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
        Weights of the last phase that was reached within the time limit.

    Raises
    ------
    ValueError
        If the folder contains a training.
    """
    if (folder / CONFIG).exists():
        raise ValueError(f"{folder}: holds a training: choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"config": asdict(config), "commit": commit(), "versions": package_versions()}, indent=1)
    (folder / CONFIG).write_text(text + "\n", encoding="utf-8")
    torch.set_num_threads(1)
    model, weights = _model(config, config.phases[0], folder), folder
    begin, end = time.process_time(), 0
    for number, phase in enumerate(config.phases):
        if time.process_time() - begin >= 60.0 * config.minutes:
            break
        if number:
            model.set_env(_batch(config, phase))
        end += phase.decisions
        # The learning rate decreases over all decisions up to the end of the phase: later phases begin with a low rate.
        keeper = _Keeper(config, phase, folder, begin)
        model.learn(end - model.num_timesteps, callback=keeper, reset_num_timesteps=False, tb_log_name=phase.pose)
        weights = folder / f"{'true_pose' if phase.pose == 'true' else phase.pose}.npz"
        save_network(weights, _network(model))
    return weights


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


class Trial:
    """Repeated evaluation on the same plans.

    Parameters
    ----------
    seeds
        Seeds of the floor plans.
    noise
        Standard deviation of the ranges, m.
    config
        Settings of observation and motion.
    """

    def __init__(self, seeds: Sequence[int], noise: float, config: ExploreConfig) -> None:
        radius = RobotSpec().radius
        worlds = [floor_plan(FloorPlanConfig(), np.random.default_rng(seed), radius) for seed in seeds]
        batch = gym.make_vec(
            "LimSlam-World-v0", len(worlds), world=worlds, autoreset_mode="SameStep", sensor_noise=noise,
            coverage_goal=None, max_episode_steps=None, num_threads=1,
        )  # fmt: skip
        self._env = ExploreVectorEnv(batch, config)
        self.period = config.drive.hold * self._env.robot.control_period

    def explore(self, network: DirectionNetwork, temperature: float, seed: int = 0) -> tuple[FloatArray, FloatArray]:
        """The coverage (plans, decisions + 1) after each decision, and the number of touches (plans,).

        Directions are drawn with the softmax of scores / ``temperature``; 0 takes the direction with the best score.
        """
        generator = np.random.default_rng(seed)
        told, info = self._env.reset(seed=seed)
        rows = [info["coverage"].copy()]
        for _ in range(round(_TRIAL / self.period)):
            scores = np.stack([network.scores(row) for row in told]).astype(float)
            # The argmax of scores with added Gumbel noise is a sample from their softmax.
            chosen = (scores + temperature * generator.gumbel(size=scores.shape)).argmax(axis=1)
            told, _, _, _, info = self._env.step(chosen)
            rows.append(info["coverage"].copy())
        return np.array(rows).T, self._env.touches.astype(float)


def times_to(coverage: FloatArray, goal: float, period: float) -> FloatArray:
    """The time (n,) at which each plan reached a coverage, s; infinity if it never did.

    The columns of ``coverage`` (n, k) are ``period`` (s) apart.
    """
    reached = coverage >= goal
    return np.where(reached.any(axis=1), reached.argmax(axis=1) * period, np.inf)


class _Keeper(BaseCallback):
    """Ends the training when its time is over, and evaluates the policy on the held-out plans."""

    def __init__(self, config: TrainConfig, phase: Phase, folder: Path, begin: float) -> None:
        super().__init__()
        self._config, self._phase, self._folder, self._begin = config, phase, folder, begin
        self._trial = Trial(config.held_out.seeds, config.noise, ExploreConfig(pose=phase.pose, range_std=config.noise))
        self._tried = 0

    @property
    def _minutes(self) -> float:
        return (time.process_time() - self._begin) / 60.0

    def _on_training_start(self) -> None:
        self._tried = self.num_timesteps

    def _on_step(self) -> bool:
        return self._minutes < self._config.minutes

    def _on_rollout_end(self) -> None:
        left = float(self.model._current_progress_remaining)  # noqa: SLF001 (it has no other name)
        self.model.ent_coef = self._config.entropy * max(left, LEAST_SHARE)
        if self.num_timesteps - self._tried >= self._config.try_every:
            self._try()

    def _on_training_end(self) -> None:
        self._try()

    def _try(self) -> None:
        self._tried = self.num_timesteps
        coverage, touches = self._trial.explore(_network(self.model), TEMPERATURE)
        times = times_to(coverage, GOAL, self._trial.period)
        # There is no median of a time that half of the plans did not reach.
        middle = float(np.median(times))
        row = {
            "decisions": self.num_timesteps, "minutes": self._minutes, "pose": self._phase.pose,
            "time_to_80_s": middle if np.isfinite(middle) else None, "reached_80": float(np.isfinite(times).mean()),
            "coverage_at_120_s": float(np.median(coverage[:, round(120.0 / self._trial.period)])),
            "touches": float(touches.mean()),
        }  # fmt: skip
        with (self._folder / LOG).open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        for name, value in row.items():
            if isinstance(value, float):
                self.logger.record(f"held_out/{name}", value)
        print(json.dumps(row), flush=True)
