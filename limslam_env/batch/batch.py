"""The simulation of many environments at once."""

import math
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np

from limslam_env.batch.places import Places, cores
from limslam_env.config import NoiseConfig, TaskConfig, bounds_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.batch_rays import MOST_LANES
from limslam_env.kernels.batch_state import (
    Episodes,
    Results,
    Robots,
    Settings,
    Task,
    fan_of,
    lanes_for,
    scratch_for,
)
from limslam_env.kernels.batch_step import BEGIN, SKIP, STEP, advance
from limslam_env.kernels.coverage import BODY_MARGIN, LONGEST_LOOK, RAY_MARGIN
from limslam_env.kernels.random_numbers import Words, derive_keys, draw_rows
from limslam_env.kernels.readings import LONGEST_RANGE, NUM_NOISES, OFFSET
from limslam_env.simulation.coverage import CELL, CoverageGrid
from limslam_env.simulation.sensors import beam_table, noise_table
from limslam_env.worlds.world import World

__all__ = ["BatchSimulation", "Results"]

THREADS_FROM = 1024
"""Number of robots from which on a second thread is worth its waking."""

# Environments that a thread takes at once.
_PORTION = 512

# The setting that each column of the table of noise depends on. The limit of the encoders, column
# 10, depends on none.
_SETTINGS = (
    "sensor_noise",
    "range_noise_growth",
    "dropout",
    "range_resolution",
    "fold_back",
    "cone",
    "wheel_mismatch",
    "wheel_mismatch",
    "wheel_variance",
    "encoder_resolution",
    "encoder_resolution",
    "slip_rate",
    "slip_share",
    "axle_mismatch",
)

NOISE = 1
PLACES = 2
"""Purposes of random numbers, besides those of the steps, 0."""


class BatchSimulation:
    """Environments of one kind, ``m`` robots in each, driven together.

    Parameters
    ----------
    places, robot
        The worlds of the environments, and the specification of all robots.
    noise
        Ranges in it are drawn from at each reset, for each environment.
    task, max_steps
        What steps are worth, and when episodes end; None for no largest number of steps.
    num_threads
        How many threads to use at most; None for one a core. The result is the same to the last
        bit.
    """

    def __init__(
        self,
        places: Places,
        robot: RobotSpec,
        noise: NoiseConfig,
        task: TaskConfig,
        max_steps: int | None = None,
        num_threads: int | None = None,
    ) -> None:
        count = places.num_envs
        robots = places.num_robots
        num_beams = len(robot.beams)
        self.robot = robot
        self.num_envs = count
        self.num_robots = robots
        self._places = places
        self._settings = noise_settings(noise, robot)
        beams = beam_table(robot)
        longest = max(float((beams[:, OFFSET] + beams[:, LONGEST_RANGE]).max()), 2.0 * robot.radius)
        is_small = (
            longest / CELL - RAY_MARGIN <= LONGEST_LOOK and lanes_for(num_beams) <= MOST_LANES
        )
        period = robot.control_period
        fan = fan_of(beams, robot.radius - BODY_MARGIN)
        self._robots = Robots(robot.max_wheel_speed * period, robot.radius, beams, fan, is_small)
        self._task = _as_numbers(task, max_steps, period)
        self._homes: Words = np.zeros(count, dtype=np.uint64)
        self._numbers = np.zeros(count, dtype=np.int64)
        # A seed changes the two above for all environments, but the places of only those that begin
        # an episode.
        self._place_keys: Words = np.zeros(count, dtype=np.uint64)
        self._episodes = _no_episodes(places.world_of, robots, num_beams)
        self._scratch = scratch_for(robots, num_beams)
        self._threads = num_threads or cores()
        self._pool: ThreadPoolExecutor | None = None

    def reset(
        self,
        mask: BoolArray,
        start: FloatArray | None = None,
        homes: Words | None = None,
    ) -> Results:
        """Begin new episodes, as :meth:`begin` does, and observe them."""
        self.begin(mask, start, homes)
        tasks = np.where(mask, BEGIN, SKIP)
        return self._advance(tasks, np.zeros((self.num_envs, self.num_robots, 2)))

    def begin(
        self,
        mask: BoolArray,
        start: FloatArray | None = None,
        homes: Words | None = None,
    ) -> None:
        """Draw world, start and noise of new episodes where a mask (n,) is true; a later step
        observes them.

        ``start`` (n, s, 3) are the first robots' poses. With ``homes`` (n,), all sequences of
        random numbers begin anew from these words, those of other environments, too.

        Raises
        ------
        WorldError
            If a start cannot be used, or there is no room. Then all is as it was.
        """
        envs = np.flatnonzero(mask)
        numbers = self._numbers.copy() if homes is None else 0 * self._numbers
        homes = self._homes if homes is None else homes
        numbers[envs] += 1
        keys, settings, places = (
            derive_keys(homes[envs], numbers[envs], purpose) for purpose in (0, NOISE, PLACES)
        )
        episodes = self._episodes
        episodes.poses[envs] = self._places.begin(
            envs, places, None if start is None else start[envs]
        )
        self._homes = homes
        self._numbers = numbers
        episodes.keys[envs] = keys
        self._place_keys[envs] = places
        noise = np.empty((len(envs), NUM_NOISES))
        draw_rows(settings, *self._settings, noise)
        episodes.noise[envs] = noise
        episodes.covered[envs] = 0
        width = self._places.sites.tiles.shape[1]
        if width > episodes.unseen.shape[1]:
            self._episodes = episodes._replace(unseen=_padded(episodes.unseen, width))

    def step(self, actions: FloatArray, fresh: BoolArray | None = None) -> Results:
        """Drive for one control period with left and right wheel speeds (n, m, 2), fractions of the
        maximum.

        ``fresh`` (n,) are the environments with a new episode that is to be observed first; they
        are not driven.
        """
        tasks = np.full(self.num_envs, STEP) if fresh is None else np.where(fresh, BEGIN, STEP)
        return self._advance(tasks, actions)

    def seen(self, env: int) -> BoolArray:
        """Which coverable cells of an environment's grid (rows, columns) have been seen."""
        slot = int(self._places.world_of[env])
        sites = self._places.sites
        return sites.to_cells(slot, sites.tiles[slot] & ~self._episodes.unseen[env])

    def world(self, env: int) -> World:
        """The world that an environment has in its episode."""
        return self._places.world(env, self._place_keys[[env]])

    def coverage_grid(self, env: int) -> CoverageGrid:
        """The cells that count for the coverage of an environment."""
        slot = int(self._places.world_of[env])
        sites = self._places.sites
        return CoverageGrid(sites.areas[slot, :2], sites.to_cells(slot, sites.tiles[slot]))

    def close(self) -> None:
        """End the threads. May be called again; a later step starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        # Threads cannot be copied. A copy starts its own.
        return {**vars(self), "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        # These words have memory behind them, which a copy lacks.
        unseen = self._episodes.unseen
        self._episodes = self._episodes._replace(unseen=_padded(unseen, unseen.shape[1]))

    def _advance(self, tasks: IntArray, actions: FloatArray) -> Results:
        results = no_results(self.num_envs, self.num_robots, len(self.robot.beams))
        begun = np.zeros(1, dtype=np.int64)
        worlds = self._places.sites.worlds
        shared: tuple[Any, ...] = (
            tasks,
            actions,
            self._robots,
            worlds,
            self._episodes,
            self._task,
            results,
        )
        others: list[Future[None]] = []
        if self._threads > 1 and self.num_envs * self.num_robots >= THREADS_FROM:
            self._pool = self._pool or ThreadPoolExecutor(self._threads - 1)
            for _ in range(self._threads - 1):
                scratch = scratch_for(self.num_robots, len(self.robot.beams))
                others.append(self._pool.submit(advance, begun, _PORTION, scratch, *shared))
        advance(begun, _PORTION, self._scratch, *shared)
        for other in others:
            # A thread that has not started by now has nothing left to do.
            if not other.cancel():
                other.result()
        return results


def noise_settings(noise: NoiseConfig, robot: RobotSpec) -> Settings:
    """The noise of a configuration as kernels draw it."""
    names = list(vars(noise))
    lowest, highest = (
        noise_table({name: bounds_of(setting)[end] for name, setting in vars(noise).items()}, robot)
        for end in (0, 1)
    )
    return Settings(lowest, highest - lowest, np.array([names.index(name) for name in _SETTINGS]))


def _as_numbers(task: TaskConfig, max_steps: int | None, control_period: float) -> Task:
    """A task as the kernel takes it."""
    return Task(
        new_area=float(task.reward.new_area),
        step=float(task.reward.step),
        collision=float(task.reward.collision),
        goal=math.inf if task.coverage_goal is None else float(task.coverage_goal),
        max_steps=np.iinfo(np.int64).max if max_steps is None else int(max_steps),
        control_period=control_period,
    )


def _no_episodes(world_of: IntArray, num_robots: int, num_beams: int) -> Episodes:
    """Arrays for the episodes of all environments, before the first reset; ``world_of`` (n,) is
    shared.
    """
    count = len(world_of)
    return Episodes(
        world_of=world_of,
        noise=np.zeros((count, NUM_NOISES)),
        keys=np.zeros(count, dtype=np.uint64),
        steps=np.zeros(count, dtype=np.int64),
        clearances=np.zeros(count),
        poses=np.zeros((count, num_robots, 3)),
        unreported=np.zeros((count, num_robots, 2)),
        unseen=_padded(np.zeros((count, 0), dtype=np.uint64), 0),
        covered=np.zeros(count, dtype=np.int64),
        hits=np.zeros((count, num_robots, num_beams), dtype=np.int64),
        ranges=np.zeros((count, num_robots, num_beams), dtype=np.float32),
        wheels=np.zeros((count, num_robots, 2), dtype=np.float32),
        contact=np.zeros((count, num_robots), dtype=bool),
    )


def no_results(count: int, num_robots: int, num_beams: int) -> Results:
    """New arrays for the results of a step."""
    robots = count, num_robots
    return Results(
        ranges=np.empty((*robots, num_beams), dtype=np.float32),
        wheels=np.empty((*robots, 2), dtype=np.float32),
        poses=np.empty((*robots, 3)),
        time=np.empty(count),
        coverage=np.empty(count),
        contact=np.empty(robots, dtype=bool),
        wall_seen=np.empty((*robots, num_beams), dtype=np.int64),
        rewards=np.empty(robots),
        terminated=np.empty(count, dtype=bool),
        truncated=np.empty(count, dtype=bool),
    )


def _padded(words: Words, columns: int) -> Words:
    """Words (rows, k) with zeros up to so many columns; a kernel may read a little beyond, for
    words that it masks.
    """
    rows, used = words.shape
    buffer = np.zeros(rows * columns + 3 * columns + 3, dtype=np.uint64)
    padded = buffer[: rows * columns].reshape(rows, columns)
    padded[:, :used] = words
    return padded
