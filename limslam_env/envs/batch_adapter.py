"""What the adapters of batches share: arguments, actions, seeds, pictures, and info in Gymnasium's
form for vectors.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from limslam_env.batch.batch import BatchSimulation, Results
from limslam_env.batch.places import Places
from limslam_env.envs.adapter import Configured, info_of, observation_of
from limslam_env.envs.arguments import (
    MOST_ENVS,
    MOST_STEPS,
    MOST_THREADS,
    BatchSource,
    Plans,
    listed_seeds,
    reset_options,
    seeds_of,
    worlds_of,
)
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.numbers import check_count, floats
from limslam_env.messages import described
from limslam_env.overlay import Overlay
from limslam_env.worlds.world import World

if TYPE_CHECKING:
    from limslam_env.rendering.rendering import Background

BatchObservation: TypeAlias = dict[str, NDArray[np.float32]]
"""The readings of one robot of each environment: ``ranges`` (n, n_beams) and ``wheels`` (n, 2),
m.
"""

Seed: TypeAlias = int | Sequence[int | None] | None
"""The seed of a batch, or one for each environment."""

Ended: TypeAlias = tuple[Results, BoolArray] | None
"""The results of the episodes that ended in a step, and in which environments (n,) they did, if new
ones have begun.
"""


class Batched(Configured):
    """Base of the batches of environments.

    Attributes
    ----------
    num_envs
        How many there are.
    autoreset_mode
        As Gymnasium names it.
    """

    _kind: ClassVar[type[BatchSimulation]] = BatchSimulation

    def _set_up(
        self,
        world: BatchSource,
        num_envs: int,
        num_robots: int,
        max_steps: int | None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        plans: Plans = None,
        num_threads: int | None = None,
        **arguments: Any,
    ) -> None:
        """Take a batch's arguments; its class documents them and the errors raised."""
        num_envs = check_count("num_envs", num_envs, MOST_ENVS)
        if max_steps is not None:
            max_steps = check_count("the steps of an episode", max_steps, MOST_STEPS)
        if num_threads is not None:
            num_threads = check_count("num_threads", num_threads, MOST_THREADS)
        self._configure(**arguments)
        self._num_robots = num_robots
        self.num_envs = num_envs
        source = worlds_of(world, num_envs)
        seeds = seeds_of(plans, source)
        places = Places(source, self.robot, num_robots, num_envs, seeds, num_threads)
        self._simulation = self._kind(
            places, self.robot, self.noise, self.task, max_steps, num_threads
        )
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self._is_over = np.zeros(num_envs, dtype=bool)
        self._is_running = False

    def seen(self, env: int) -> BoolArray:
        """The coverable cells (rows, columns) of an environment's coverage grid that have been
        seen.
        """
        return self._simulation.seen(env)

    def _begin(
        self, generator: np.random.Generator, seed: Seed, options: dict[str, Any] | None
    ) -> tuple[Results, BoolArray]:
        """Begin new episodes as the adapters' ``reset`` describes; also returns a mask (n,) of
        their environments.
        """
        asked = reset_options(options, "start", "reset_mask")
        homes = None
        mask = self._mask(asked.get("reset_mask"))
        start = self._start(asked.get("start"))
        if seed is not None or not self._is_running:
            homes = self._homes(generator, seed)
        results = self._simulation.reset(mask, start, homes)
        self._is_running = True
        self._is_over[mask] = False
        return results, mask

    def _check_begun(self) -> None:
        if not self._is_running:
            raise gym.error.ResetNeeded("call reset before step")

    def _drive(self, actions: FloatArray) -> tuple[Results, Ended]:
        """Drive all robots with actions (n, m, 2), and reset where the mode says so.

        The results have the readings and the truth of the episodes that run now, new ones among
        them.
        """
        fresh = self._is_over if self._is_over.any() else None
        if fresh is not None:
            if self.autoreset_mode is AutoresetMode.DISABLED:
                raise gym.error.ResetNeeded(
                    f"the episode of environment {int(np.argmax(fresh))} is over"
                )
            self._simulation.begin(fresh)
        results = self._simulation.step(actions, fresh)
        over = results.terminated | results.truncated
        if self.autoreset_mode is not AutoresetMode.SAME_STEP or not over.any():
            self._is_over = over
            return results, None
        now = self._simulation.reset(over)._replace(
            rewards=results.rewards, terminated=results.terminated, truncated=results.truncated
        )
        return now, (results, over)

    def _homes(self, generator: np.random.Generator, seed: Seed) -> NDArray[np.uint64]:
        """The words (n,) that the random numbers of each environment are functions of."""
        if seed is None or isinstance(seed, int):
            return _words(int(generator.integers(2**63)), self.num_envs)
        return np.concatenate(
            [
                _words(int(generator.integers(2**63)) if each is None else each, 1)
                for each in listed_seeds(seed, self.num_envs)
            ]
        )

    def _mask(self, option: Any) -> BoolArray:
        """Which environments (n,) a reset is for."""
        if option is None:
            return np.ones(self.num_envs, dtype=bool)
        mask = np.asarray(option)
        if mask.shape != (self.num_envs,) or mask.dtype != bool or not mask.any():
            raise ValueError(
                f"the reset_mask must be {self.num_envs} booleans, one of them true at least"
            )
        if not (self._is_running or mask.all()):
            raise gym.error.ResetNeeded("the first reset is of all environments")
        return mask

    def _start(self, option: Any) -> FloatArray | None:
        """Where the first robots are to start (n, s, 3)."""
        if option is None:
            return None
        start = floats(option)
        if start.ndim < 3 and start.shape[-1:] == (3,):
            # One pose for all, or as many as there are robots or, with one robot, environments.
            start = start.reshape(-1, 1, 3) if self._num_robots == 1 else start.reshape(1, -1, 3)
        is_fitting = (
            start.ndim == 3 and start.shape[2] == 3 and start.shape[0] in {1, self.num_envs}
        )
        if not is_fitting or not 1 <= start.shape[1] <= self._num_robots:
            raise ValueError(
                "the start is a pose (x, y, theta) for all environments, or an array of poses "
                f"({self.num_envs}, {self._num_robots}, 3), not {described(option)}"
            )
        return np.broadcast_to(start, (self.num_envs, *start.shape[1:]))


def generator_of(seed: Seed, generator: np.random.Generator | None) -> np.random.Generator:
    """The generator that seeds are drawn from: a new one for a number, else the one there is."""
    if generator is None or isinstance(seed, int):
        return seeding.np_random(seed if isinstance(seed, int) else None)[0]
    return generator


def _words(seed: int, count: int) -> NDArray[np.uint64]:
    return np.asarray(np.random.SeedSequence(seed).generate_state(count, np.uint64))


def checked_actions(actions: ArrayLike, num_envs: int, whose: str = "") -> FloatArray:
    """Actions as an array (n, 2); a ValueError where they are not n rows of two finite numbers."""
    array = floats(actions)
    if array.shape != (num_envs, 2):
        raise ValueError(
            f"actions{whose} must be {num_envs} rows of two numbers, left and right wheel, not "
            f"shape {array.shape}"
        )
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0, 0])
        raise ValueError(
            f"actions{whose} must be finite numbers; those of environment {row} are "
            f"{array[row].tolist()}"
        )
    return array


def observations_of(results: Results, robot: int) -> BatchObservation:
    """The observations of one robot in each environment."""
    observations: BatchObservation = observation_of(results, np.s_[:, robot])
    return observations


def infos_of(
    results: Results, robot: int, ended: Ended = None, mask: BoolArray | None = None
) -> dict[str, Any]:
    """What is true of one robot of each environment, or those of a ``mask`` (n,); and of episodes
    that have ended.

    As Gymnasium's own vector environments give it, each key with a mask (n,) beside it.
    """
    info = info_of(results, np.s_[:, robot])
    mask = np.ones(len(results.time), dtype=bool) if mask is None else mask
    # A step knows the values of all environments. After a reset of some, the others have zeros, as
    # Gymnasium asks.
    if not mask.all():
        info = {
            key: np.where(mask.reshape(-1, *[1] * (value.ndim - 1)), value, 0)
            for key, value in info.items()
        }
        info["collision"] = info["collision"].astype(bool)
    info |= {f"_{key}": mask.copy() for key in info}
    if ended is None:
        return info
    last, over = ended
    observations = observations_of(last, robot)
    final = np.full(len(over), None, dtype=object)
    for env in np.flatnonzero(over):
        final[env] = {key: value[env].copy() for key, value in observations.items()}
    info |= {"final_obs": final, "_final_obs": over.copy()}
    return info | {"final_info": infos_of(last, robot, mask=over), "_final_info": over.copy()}


class BatchPictures:
    """Pictures of all environments of a batch, as the single environment draws them, but square."""

    def __init__(self, simulation: BatchSimulation) -> None:
        self._simulation = simulation
        self._last: Results | None = None
        # Positions (n, m, 2) after each step, and for each environment the row in which its episode
        # begins.
        self._trail: list[FloatArray] = []
        self._begins = np.zeros(simulation.num_envs, dtype=np.int64)
        # Where environments are, until their next episodes: to draw a world takes longer than a
        # picture.
        self._places: dict[int, tuple[World, Background]] = {}

    def begin(self, results: Results) -> None:
        """Remember the state after a reset of some environments. The others are where they were."""
        if self._trail:
            self._trail.pop()
        self.follow(results)

    def follow(self, results: Results) -> None:
        """Remember the state after a step."""
        # The caller may change these arrays, and the pictures must not change with them.
        self._last = results._replace(
            ranges=results.ranges.copy(),
            poses=results.poses.copy(),
            time=results.time.copy(),
            coverage=results.coverage.copy(),
            wall_seen=results.wall_seen.copy(),
        )
        self._trail.append(self._last.poses[:, :, :2])
        has_begun = results.time == 0.0
        if has_begun.any():
            for env in np.flatnonzero(has_begun):
                self._places.pop(int(env), None)
            self._begins[has_begun] = len(self._trail) - 1
            first = int(self._begins.min())
            del self._trail[:first]
            self._begins -= first

    def paint(self, overlays: Sequence[Overlay]) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture (height, width, 3) of each environment, with what its agent believes; None
        before the first reset.
        """
        last = self._last
        if last is None:
            return None
        from limslam_env.rendering.rendering import RenderState, render, square_background

        trail = np.stack(self._trail)
        simulation = self._simulation
        pictures = []
        for env in range(simulation.num_envs):
            if env not in self._places:
                world = simulation.world(env)
                self._places[env] = world, square_background(world)
            (world, background), grid = self._places[env], simulation.coverage_grid(env)
            paths = trail[self._begins[env] :, env].swapaxes(0, 1)
            state = RenderState(
                world,
                simulation.robot,
                last.poses[env],
                last.wall_seen[env],
                last.ranges[env],
                list(paths),
                float(last.time[env]),
                float(last.coverage[env]),
                simulation.seen(env) & grid.coverable,
                grid.low,
                overlay=overlays[env : env + 1],
            )
            pictures.append(render(state, background=background))
        return tuple(pictures)
