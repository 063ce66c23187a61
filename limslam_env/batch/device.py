"""A batch on a GPU: the kernels of :mod:`limslam_env.kernels`, compiled for CUDA, with a thread for
each environment.

Only this module knows of CUDA. Its kernel calls the functions that the step on the processor calls,
and numba compiles them for the GPU. What differs is here: each thread has scratch memory of its
own, nothing is prefetched, and an episode that is over begins again without Python.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
from numba import cuda
from numba.core import config

from limslam_env.batch.batch import NOISE, PLACES, BatchSimulation, no_results
from limslam_env.batch.places import Places
from limslam_env.compilation import merged
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec
from limslam_env.kernels.batch_state import Episodes, Results, Scratch, Settings, Starts, lanes_for
from limslam_env.kernels.batch_step import BEGIN, STEP, advance_one, hand_out
from limslam_env.kernels.random_numbers import (
    FreeCells,
    Words,
    chosen,
    derived,
    draw_row,
    draw_start,
)
from limslam_env.simulation.starts import TRIES

_BLOCK = 128  # threads

# numba's simulator of CUDA runs the same code on arrays of numpy.
_IS_SIMULATED = getattr(config, "ENABLE_CUDASIM", False)
_to_device = np.array if _IS_SIMULATED else cuda.to_device
_device_array = np.empty if _IS_SIMULATED else cuda.device_array


class Renewal(NamedTuple):
    """How episodes that are over begin again.

    Attributes
    ----------
    homes, numbers, slots, over
        (n,): keys of the environments' random numbers, the number of the episode that each is in,
        its world, and whether its episode is over.
    num_plans
        How many floor plans there are for an episode to get one of; 0 if environments keep their
        worlds.
    """

    homes: Words
    numbers: IntArray
    slots: IntArray
    num_plans: int
    over: BoolArray


class DeviceSimulation(BatchSimulation):
    """A batch on a GPU, made like :class:`limslam_env.batch.batch.BatchSimulation`.

    Actions and results are arrays on the device. Each step writes its results into the same arrays.

    A RuntimeError says that there is no GPU that numba can use, a ValueError that each episode is
    to have a floor plan of its own, which only a processor can generate.
    """

    def __init__(self, places: Places, robot: RobotSpec, *arguments: Any) -> None:
        if not cuda.is_available():
            raise RuntimeError(
                "device='cuda' needs a GPU of NVIDIA, its driver and numba-cuda (extra gpu)"
            )
        if places.num_plans is None:
            raise ValueError(
                "on a device, floor plans are generated once and then drawn from: plans=256, for "
                "instance"
            )
        super().__init__(places, robot, *arguments)
        self._results: Results = _uploaded(
            no_results(self.num_envs, self.num_robots, len(robot.beams))
        )
        self._renewal: Renewal | None = None
        self._kernel: Any = None
        self._arguments: tuple[Any, ...] = ()

    def reset(
        self,
        mask: BoolArray,
        start: FloatArray | None = None,
        homes: Words | None = None,
    ) -> Results:
        """Begin new episodes in all environments, and observe them; all of ``mask`` (n,) is
        true.
        """
        if self._renewal is not None:
            self._numbers[:] = np.asarray(self._renewal.numbers)
        self.begin(mask, start, homes)
        places = self._places
        worlds = self._places.sites.worlds
        size = self.num_envs * worlds.coverable.shape[1]
        width = worlds.coverable.shape[1]
        # A kernel may read a little beyond these words, as on the processor.
        unseen = _device_array(size + 3 * width + 3, np.uint64)[:size].reshape(self.num_envs, width)
        over = np.zeros(self.num_envs, dtype=bool)
        num_plans = places.num_plans or 0
        self._episodes_there: Episodes = _uploaded(self._episodes._replace(unseen=unseen))
        self._renewal = _uploaded(Renewal(self._homes, self._numbers, places.home, num_plans, over))
        self._arguments = (
            _uploaded(self._robots),
            _uploaded(worlds),
            self._episodes_there,
            self._task,
            self._results,
            _uploaded(self._settings),
            _uploaded(places.starts()),
            self._renewal,
        )
        return self._run(_to_device(np.zeros((self.num_envs, 2), dtype=np.float32)), is_first=True)

    def step(self, actions: Any, fresh: BoolArray | None = None) -> Results:
        """Drive for one control period, or begin the next episode where the last step ended one.

        ``actions`` (n, 2 m) are float32 arrays on the device, or arrays of numpy. ``fresh`` is not
        needed: the device knows.
        """
        del fresh
        there = (
            cuda.as_cuda_array(actions)
            if hasattr(actions, "__cuda_array_interface__")
            else self.to_device(actions)
        )
        shape = self.num_envs, 2 * self.num_robots
        if there.shape != shape or there.dtype != np.float32 or there.strides != (4 * shape[1], 4):
            raise ValueError(
                f"actions must be {shape[0]} rows of {shape[1]} numbers of float32, one row after "
                "the other in memory, "
                f"not {there.dtype} of shape {there.shape}"
            )
        return self._run(there, is_first=False)

    def to_device(self, array: Any) -> Any:
        """A copy of an array on the device, as float32."""
        return _to_device(np.ascontiguousarray(array, dtype=np.float32))

    def synchronize(self) -> None:
        """Wait until the device has done all steps."""
        cuda.synchronize()

    def seen(self, env: int) -> BoolArray:
        """Which coverable cells of an environment's grid (rows, columns) have been seen."""
        slot = int(self._episodes_there.world_of[env])
        sites = self._places.sites
        return sites.to_cells(
            slot, sites.tiles[slot] & ~np.asarray(self._episodes_there.unseen[env])
        )

    def _run(self, actions: Any, *, is_first: bool) -> Results:
        # The simulator hands arrays in a tuple on as they are.
        arguments = (
            is_first,
            (actions.reshape(self.num_envs, self.num_robots, 2),),
            *self._arguments,
        )
        if self._kernel is None:
            self._kernel = _kernel_for(
                self.num_robots, lanes_for(len(self.robot.beams))
            ).specialize(*arguments)
        self._kernel[-(-self.num_envs // _BLOCK), _BLOCK](*arguments)
        return self._results


def _uploaded(parts: Any) -> Any:
    """A named tuple with its arrays on the device."""
    return type(parts)(
        *(_to_device(part) if isinstance(part, np.ndarray) else part for part in parts)
    )


@merged
def _begin_again(
    env: int, settings: Settings, starts: Starts, renewal: Renewal, episodes: Episodes
) -> None:
    """Draw world, start and noise of an episode, as :meth:`BatchSimulation.begin` does on the
    processor.
    """
    renewal.numbers[env] += 1
    home = renewal.homes[env]
    number = renewal.numbers[env]
    key = derived(home, number, PLACES)
    slot = chosen(key, renewal.num_plans) if renewal.num_plans > 0 else renewal.slots[env]
    episodes.world_of[env], episodes.keys[env], episodes.covered[env] = (
        slot,
        derived(home, number, 0),
        0,
    )
    noise = derived(home, number, NOISE)
    draw_row(noise, settings.lowest, settings.spans, settings.places, episodes.noise[env])
    for robot in range(starts.num_given[slot]):
        for place in range(3):
            episodes.poses[env, robot, place] = starts.given[slot, robot, place]
    runs = starts.runs[starts.firsts[slot] : starts.firsts[slot + 1]]
    cells = FreeCells(runs, starts.counts[slot], starts.spaces[slot])
    draw_start(key, starts.num_given[slot], cells, starts.apart, episodes.poses[env], TRIES)


@functools.cache
def _kernel_for(num_robots: int, lanes: int) -> Any:
    """The step of environments with so many robots and lanes: a GPU's scratch memory needs to know
    how many.
    """

    @cuda.jit
    def step(
        is_first: Any,
        actions: Any,
        robots: Any,
        worlds: Any,
        episodes: Any,
        task: Any,
        results: Any,
        settings: Any,
        starts: Any,
        renewal: Any,
    ) -> None:
        env = cuda.grid(1)
        if env >= len(episodes.steps):
            return
        scratch = Scratch(
            cuda.local.array((4, lanes), np.float64),
            cuda.local.array((4, lanes), np.float64),
            cuda.local.array((num_robots, 2), np.float64),
            cuda.local.array((num_robots, 2), np.float64),
            cuda.local.array((num_robots, 2), np.float64),
            cuda.local.array(num_robots, np.bool_),
            cuda.local.array(num_robots, np.int64),
        )
        does = BEGIN if is_first or renewal.over[env] else STEP
        if renewal.over[env]:
            _begin_again(env, settings, starts, renewal, episodes)
        advance_one(env, does, actions[0], robots, worlds, episodes, scratch)
        hand_out(env, does, worlds, episodes, scratch, task, results)
        renewal.over[env] = results.terminated[env] or results.truncated[env]

    return step
