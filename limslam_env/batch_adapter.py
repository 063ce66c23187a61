"""What the batched adapters share: arguments, actions, seeds, info in Gymnasium's vector form."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from limslam_env.adapter import PlaceSource, is_random
from limslam_env.batch import BatchReadings, BatchSimulation, BatchTruth
from limslam_env.batch_places import Places
from limslam_env.config import NoiseConfig, RewardConfig, Setting, TaskConfig
from limslam_env.floor_plans import FloorPlanConfig
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.task import is_done, reward
from limslam_env.world import World, load_world

BatchSource: TypeAlias = PlaceSource | Sequence[PlaceSource]
"""What a single environment takes, or a sequence of worlds, one for each environment."""

Plans: TypeAlias = int | Sequence[int] | None
"""How many floor plans to make beforehand, or their seeds; None for one of its own at each reset."""

BatchObservation: TypeAlias = dict[str, NDArray[np.float32]]
"""The readings of one robot of each environment: ``ranges`` (n, n_beams) and ``wheels`` (n, 2), m."""

OPTIONS = frozenset({"start", "reset_mask"})


class Outcome(NamedTuple):
    """What comes of a step.

    Attributes
    ----------
    readings, truth
        Of the episodes that run now, new ones among them.
    rewards
        (n, m).
    terminated, truncated
        (n,).
    last
        Readings and truth of the episodes that ended in this step, and in which environments (n,) they did, if new
        ones have begun already.
    """

    readings: BatchReadings
    truth: BatchTruth
    rewards: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    last: tuple[BatchReadings, BatchTruth, BoolArray] | None


class Batched:
    """What the batched environments have in common.

    Attributes
    ----------
    robot, task
        What each robot is, and what is asked of it.
    noise
        The noise of each environment, or one for all.
    autoreset_mode
        As Gymnasium names it.
    """

    def _set_up(
        self,
        world: BatchSource,
        num_envs: int,
        num_robots: int,
        robot: RobotSpec | None,
        sensor_noise: Setting | Sequence[Setting] | FloatArray | None,
        noise: NoiseConfig | Sequence[NoiseConfig] | None,
        coverage_goal: float | None,
        rewards: RewardConfig | None,
        max_steps: int | None,
        plans: Plans,
        num_threads: int | None,
        autoreset_mode: AutoresetMode | str,
    ) -> None:
        """Take an environment's arguments; see its class for what they mean, and what is refused."""
        if not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs must be 1 or more, not {num_envs}")
        if max_steps is not None and max_steps < 1:
            raise ValueError(f"the steps of an episode must be 1 or more, or None, not {max_steps}")
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads must be 1 or more, or None, not {num_threads}")
        self.robot = robot or RobotSpec()
        self.task = TaskConfig(coverage_goal, rewards or RewardConfig())
        self.noise = _noise_of_each(noise, sensor_noise, num_envs)
        self._max_steps, self._num_robots, self._count = max_steps, num_robots, num_envs
        places = Places(_worlds(world, num_envs), self.robot, num_robots, num_envs, _seeds(plans, world))
        self._simulation = BatchSimulation(places, self.robot, self.noise, num_threads)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self._lengths, self._is_over = np.zeros(num_envs, dtype=np.int64), np.zeros(num_envs, dtype=bool)
        self._is_running = False

    def seen(self, env: int) -> BoolArray:
        """Which cells of an environment's coverage grid have truly been seen (rows, columns), of those that count."""
        return self._simulation.seen(env)

    def _begin(
        self, generator: np.random.Generator, seed: int | None, options: dict[str, Any] | None
    ) -> tuple[BatchReadings, BatchTruth, BoolArray]:
        """Begin new episodes; which environments (n,) they are of comes last. See the adapters' ``reset``."""
        mask, start = self._asked(options)
        if seed is not None or not self._is_running:
            self._simulation.seed(np.random.SeedSequence(int(generator.integers(2**63))))
        readings, truth = self._simulation.reset(mask, start)
        self._is_running = True
        self._is_over[mask], self._lengths[mask] = False, 0
        return readings, truth, mask

    def _drive(self, actions: FloatArray) -> Outcome:
        """Drive all robots with actions (n, m, 2), and reset where the mode says so."""
        fresh = self._is_over if self._is_over.any() else None
        if fresh is not None:
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise gym.error.ResetNeeded(f"the episode of environment {int(np.argmax(fresh))} is over")
            self._simulation.begin(fresh)
        readings, truth = self._simulation.step(actions, fresh)
        self._lengths += 1
        rewards = np.asarray(reward(self.task.reward, truth.new_area, truth.contact))
        if fresh is not None:
            self._lengths[fresh], rewards[fresh] = 0, 0.0
        terminated, truncated = self._ends(truth)
        if fresh is not None:
            terminated[fresh] = truncated[fresh] = False
        over = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and over.any():
            last = readings, truth, over
            readings, truth = self._simulation.reset(over)
            self._lengths[over] = 0
            return Outcome(readings, truth, rewards, terminated, truncated, last)
        self._is_over = over
        return Outcome(readings, truth, rewards, terminated, truncated, None)

    def _asked(self, options: dict[str, Any] | None) -> tuple[BoolArray, FloatArray | None]:
        """Which environments a reset is for (n,), and where robots are to start (n, s, 3)."""
        options = options or {}
        unknown = sorted(set(options) - OPTIONS)
        if unknown:
            raise ValueError(f"unknown reset option {unknown[0]!r}; there are 'start' and 'reset_mask'")
        return self._mask(options.get("reset_mask")), self._start(options.get("start"))

    def _mask(self, option: Any) -> BoolArray:
        if option is None:
            return np.ones(self._count, dtype=bool)
        mask = np.asarray(option)
        if mask.shape != (self._count,) or mask.dtype != bool or not mask.any():
            raise ValueError(f"the reset_mask must be {self._count} booleans, one of them true at least")
        if not (self._is_running or mask.all()):
            raise gym.error.ResetNeeded("the first reset is of all environments")
        return mask

    def _start(self, option: Any) -> FloatArray | None:
        if option is None:
            return None
        try:
            start = np.asarray(option, dtype=float)
        except (TypeError, ValueError):
            start = np.zeros(0)
        if start.ndim < 3 and start.shape[-1:] == (3,):
            # One pose for all, or as many as there are robots or, with one robot, environments.
            start = start.reshape(-1, 1, 3) if self._num_robots == 1 else start.reshape(1, -1, 3)
        is_fitting = start.ndim == 3 and start.shape[2] == 3 and start.shape[0] in {1, self._count}
        if not is_fitting or not 1 <= start.shape[1] <= self._num_robots:
            raise ValueError(
                "the start is a pose (x, y, theta) for all environments, or an array of poses "
                f"({self._count}, {self._num_robots}, 3), not {option!r:.60}"
            )
        return np.broadcast_to(start, (self._count, *start.shape[1:]))

    def _ends(self, truth: BatchTruth) -> tuple[BoolArray, BoolArray]:
        """Which environments (n,) have reached the goal, and which have run out of steps."""
        terminated = np.zeros(self._count, dtype=bool) | is_done(self.task, truth.coverage)
        late = np.zeros(self._count, dtype=bool) if self._max_steps is None else self._lengths >= self._max_steps
        return terminated, late


def checked_actions(actions: ArrayLike, num_envs: int, whose: str = "") -> FloatArray:
    """Actions as an array (n, 2).

    Raises
    ------
    ValueError
        If they are not n rows of two finite numbers.
    """
    try:
        array = np.asarray(actions, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != (num_envs, 2):
        raise ValueError(
            f"actions{whose} must be {num_envs} rows of two numbers, left and right wheel, not shape {array.shape}"
        )
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0, 0])
        raise ValueError(f"actions{whose} must be finite numbers; those of environment {row} are {array[row].tolist()}")
    return array


def observation_of(readings: BatchReadings, robot: int) -> BatchObservation:
    """What one robot of each environment is told."""
    return {"ranges": readings.ranges[:, robot], "wheels": readings.wheels[:, robot]}


def infos_of(outcome: Outcome, robot: int) -> dict[str, Any]:
    """What is true of one robot of each environment after a step; and what was last of the episodes that ended in it.

    As Gymnasium's own vector environments give it, each key with a mask (n,) beside it.
    """
    info = info_of(outcome.truth, robot, np.ones(len(outcome.terminated), dtype=bool))
    if outcome.last is None:
        return info
    readings, truth, over = outcome.last
    observation, final = observation_of(readings, robot), np.full(len(over), None, dtype=object)
    for env in np.flatnonzero(over):
        final[env] = {key: value[env].copy() for key, value in observation.items()}
    info |= {"final_obs": final, "_final_obs": over.copy()}
    return info | {"final_info": info_of(truth, robot, over), "_final_info": over.copy()}


def info_of(truth: BatchTruth, robot: int, mask: BoolArray) -> dict[str, Any]:
    """What is true of one robot of each environment, with a mask (n,) for each key."""
    info: dict[str, Any] = {
        "pose": truth.poses[:, robot],
        "time": truth.time,
        "coverage": truth.coverage,
        "collision": truth.contact[:, robot],
        "wall_seen": truth.wall_seen[:, robot],
    }
    # In one step the values of all are known; a reset of some leaves zeros for the others, as Gymnasium has it.
    if not mask.all():
        info = {key: np.where(mask.reshape(-1, *[1] * (value.ndim - 1)), value, 0) for key, value in info.items()}
        info["collision"] = info["collision"].astype(bool)
    return info | {f"_{key}": mask.copy() for key in info}


def _worlds(source: BatchSource, num_envs: int) -> World | list[World] | FloorPlanConfig:
    if isinstance(source, FloorPlanConfig):
        return source
    if isinstance(source, Sequence) and not isinstance(source, str):
        if len(source) != num_envs:
            raise ValueError(f"{len(source)} worlds for {num_envs} environments; give one for each, or one for all")
        if any(isinstance(place, FloorPlanConfig) or is_random(place) for place in source):
            raise ValueError("floor plans are drawn for all environments or for none")
        loaded: dict[Any, World] = {}
        for place in source:
            if place not in loaded:
                loaded[place] = load_world(place)  # type: ignore[arg-type]
        return [loaded[place] for place in source]
    return FloorPlanConfig() if is_random(source) else load_world(source)


def _seeds(plans: Plans, source: BatchSource) -> Sequence[int] | None:
    if plans is None:
        return None
    if not (isinstance(source, FloorPlanConfig) or (isinstance(source, str) and source == "random")):
        raise ValueError("plans are for worlds that are drawn")
    seeds: Sequence[int] = range(plans) if isinstance(plans, int) else plans
    if not len(seeds) or min(seeds) < 0:
        raise ValueError(f"plans must be 1 or more, or seeds of 0 and more, not {plans}")
    return seeds


def _noise_of_each(
    noise: NoiseConfig | Sequence[NoiseConfig] | None,
    sensor_noise: Setting | Sequence[Setting] | FloatArray | None,
    num_envs: int,
) -> list[NoiseConfig]:
    """The noise of each environment, or of all."""
    each = [noise or NoiseConfig()] if noise is None or isinstance(noise, NoiseConfig) else list(noise)
    if len(each) not in {1, num_envs}:
        raise ValueError(f"{len(each)} noise settings for {num_envs} environments")
    if sensor_noise is None:
        return each
    if isinstance(sensor_noise, float | int | tuple):
        return [replace(one, sensor_noise=sensor_noise) for one in each]
    settings = [tuple(value) if isinstance(value, Sequence | np.ndarray) else float(value) for value in sensor_noise]
    if len(settings) != num_envs:
        raise ValueError(f"{len(settings)} values of sensor_noise for {num_envs} environments")
    each = each * num_envs if len(each) == 1 else each
    return [replace(one, sensor_noise=value) for one, value in zip(each, settings, strict=True)]
