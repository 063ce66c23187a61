"""Two baselines with known algorithms, trained from several seeds and tried after equal numbers of steps.

``recurrent`` is PPO with a recurrent network (LSTM) on the raw readings, without a map. ``belief`` is PPO on the
observations of `SlamVectorObservation`: pose, covariance, readings, and a crop of the grid. Both are those of
Stable-Baselines3 with its default networks, act on the wheels at every step, and get the same steps on the same plans.
"""

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from sb3_contrib import RecurrentPPO
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

import limslam_env  # noqa: F401 (registers the environments)
from benchmarks.training.efficiency import RESULTS
from limslam_agent.output.atomic_write import append_line, mend_lines, replace_content
from limslam_agent.wrappers.vector import SlamVectorObservation
from limslam_env.envs.sb3 import Sb3VecEnv

LEARNERS = ("recurrent", "belief")
TRAINING_PLANS, HELD_OUT_PLANS = 100_000, 200_000
"""First seeds of the plans that are learned on, and of those that are tried, as in the suite ``explore``."""

_SETTINGS = "baselines.json"


@dataclass(frozen=True)
class BaselineConfig:
    """The budget of the baselines.

    Attributes
    ----------
    steps, seeds
        Steps of the environment for each learner and seed, and number of seeds.
    tries
        How often each network is tried while it is trained, after equal numbers of steps.
    plans, held_out
        Number of plans that are learned on, and of those that are tried.
    envs
        Number of environments in the batch.
    episode
        Steps of an episode, in training and in a trial.
    noise
        Standard deviation of the ranges, m.

    Raises
    ------
    ValueError
        If a number is below 1, or the noise is no standard deviation.
    """

    steps: int = 100_000
    seeds: int = 5
    tries: int = 5
    plans: int = 1000
    held_out: int = 20
    envs: int = 16
    episode: int = 600
    noise: float = 0.02

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if name != "noise" and value < 1:
                raise ValueError(f"{name} must be 1 or more, not {value}")
        if not 0.0 <= self.noise <= 1.0:
            raise ValueError(f"the noise is a standard deviation from 0 to 1 m, not {self.noise:g}")


class RawReadings(gym.vector.VectorWrapper):  # type: ignore[type-arg, misc, unused-ignore]
    """Readings and wheel travel of a batch as vectors (n, 8) from -1 to 1, those of ``final_obs`` too."""

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any]) -> None:
        super().__init__(env)
        parts: Any = env.single_observation_space
        self._low, self._high = (
            np.concatenate([getattr(parts[name], side) for name in ("ranges", "wheels")]) for side in ("low", "high")
        )
        self.single_observation_space = spaces.Box(-1.0, 1.0, self._low.shape, np.float32)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(self, **arguments: Any) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin new episodes."""
        observation, info = self.env.reset(**arguments)
        return self._vectors(observation), info

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Drive for one control period."""
        observation, reward, terminated, truncated, info = self.env.step(actions)
        for number in np.flatnonzero(terminated | truncated):
            info["final_obs"][number] = self._vectors(info["final_obs"][number])
        return self._vectors(observation), reward, terminated, truncated, info

    def _vectors(self, observation: Any) -> NDArray[np.float32]:
        values = np.concatenate((observation["ranges"], observation["wheels"]), axis=-1)
        return np.asarray(2.0 * (values - self._low) / (self._high - self._low) - 1.0, dtype=np.float32)


def environment(learner: str, config: BaselineConfig, *, is_trial: bool) -> Any:
    """The batch that a learner sees. For a trial: endless episodes, one on each held-out plan."""
    shared: dict[str, Any] = {"autoreset_mode": "SameStep", "sensor_noise": config.noise, "num_threads": 1}
    if is_trial:
        worlds = [f"random:{HELD_OUT_PLANS + number}" for number in range(config.held_out)]
        endless = {"coverage_goal": None, "max_episode_steps": None}
        batch = gym.make_vec("LimSlam-World-v0", config.held_out, world=worlds, **endless, **shared)
    else:
        plans = range(TRAINING_PLANS, TRAINING_PLANS + config.plans)
        batch = gym.make_vec(
            "LimSlam-Random-v0", config.envs, plans=list(plans), max_episode_steps=config.episode, **shared
        )
    return SlamVectorObservation(batch, num_threads=1) if learner == "belief" else RawReadings(batch)


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
    for seed in range(config.seeds):
        for learner in learners:
            if _rows_of(folder, learner, seed) < config.tries:
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


def _train(learner: str, config: BaselineConfig, seed: int, path: Path) -> None:
    env = Sb3VecEnv(environment(learner, config, is_trial=False))
    rollout = max(min(128, config.steps // (config.envs * config.tries)), 2)
    shared = {
        "n_steps": rollout,
        "batch_size": min(256, rollout * config.envs),
        "n_epochs": 4,
        "seed": seed,
        "device": "cpu",
    }
    model: Any = (
        PPO("MultiInputPolicy", env, **shared) if learner == "belief" else RecurrentPPO("MlpLstmPolicy", env, **shared)
    )
    model.learn(config.steps, callback=_Trials(learner, config, seed, path))
    env.close()


class _Trials(BaseCallback):  # type: ignore[misc, unused-ignore]
    """Tries the network on the held-out plans after equal numbers of steps."""

    def __init__(self, learner: str, config: BaselineConfig, seed: int, path: Path) -> None:
        super().__init__()
        self._learner, self._config, self._seed, self._path = learner, config, seed, path
        self._due = [config.steps * (number + 1) // config.tries for number in range(config.tries)]

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
            row = {"learner": self._learner, "seed": self._seed, "steps": self._due.pop(0), **scores}
            append_line(self._path, json.dumps(row).encode() + b"\n")


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
    return {"coverage": np.asarray(info["coverage"], dtype=float).tolist(), "return": returns.tolist()}
