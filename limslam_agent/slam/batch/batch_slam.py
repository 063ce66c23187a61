"""BatchSlam: the consistent estimator, occupancy grid included, for many robots at once."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limslam_agent.config.presets import AgentConfig, ConsistentConfig, preset
from limslam_agent.slam.batch.state import (
    CLOSURES,
    LINES,
    NO_PLACE,
    POSE,
    REFUSED,
    Capacity,
    minds_for,
    spec_of,
)
from limslam_agent.slam.batch.step import begin_some, step_some
from limslam_agent.slam.consistent.wall_extent import WallExtent
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import at
from limslam_env.geometry.segment import lengths
from limslam_env.interface import RobotSpec

_SLICES = 4


@dataclass(frozen=True, eq=False)
class Beliefs:
    """What n robots believe.

    Attributes
    ----------
    pose
        (n, 3), m, m, rad.
    covariance
        Of the poses (n, 3, 3).
    grid
        Occupancy around the robots (n, 1, size, size), 0 unknown, 127 free, 255 occupied; the robot is in the middle
        and looks up.
    """

    pose: FloatArray
    covariance: FloatArray
    grid: NDArray[np.uint8]


class BatchSlam:
    """The consistent estimator for many robots that know nothing of each other.

    What each of them believes is what ``LineSlam`` and ``OccupancyGrid`` believe after the same observations, to 1e-6,
    as long as there is room for it. Robots are worked off by threads; what comes out does not depend on how many.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage; those of the preset ``consistent`` if left out.
    num_envs
        How many robots there are, n.
    capacity
        How much there is room for, and what happens when there is none.
    num_threads
        As many as there are processors if left out.
    size
        Side of the grids that are told, in cells; 0 for none.

    Raises
    ------
    ValueError
        If the settings name another estimator or ask for self-calibration, or a number is too small.
    """

    def __init__(
        self,
        robot: RobotSpec,
        config: AgentConfig | None = None,
        num_envs: int = 1,
        capacity: Capacity | None = None,
        num_threads: int | None = None,
        size: int = 40,
    ) -> None:
        config, threads = config or preset("consistent"), num_threads
        if threads is None:
            threads = os.cpu_count() or 1
        if not isinstance(config.estimator, ConsistentConfig):
            raise ValueError(f"a batch needs the preset consistent, not {config.preset!r}")  # noqa: TRY004 (a setting)
        if config.estimator.self_calibration.enabled:
            raise ValueError("a batch does not calibrate odometry by itself; LineSlam does")
        for name, value, least in (("num_envs", num_envs, 1), ("num_threads", threads, 1), ("size", size, 0)):
            if value < least:
                raise ValueError(f"{name} must be {least} or more, not {value}")
        self.robot, self.config, self.num_envs, self.size = robot, config, num_envs, size
        self.capacity = capacity or Capacity()
        self._extents = config.estimator.extents
        self._spec = spec_of(robot, config, config.estimator)
        self._minds = minds_for(robot, config.estimator, num_envs, self.capacity)
        self._pool: ThreadPoolExecutor | None = None
        self._threads = threads
        self.reset(np.zeros((num_envs, POSE)))

    def reset(self, start_poses: ArrayLike, mask: ArrayLike | None = None) -> None:
        """Forget everything and begin at known poses (n, 3), m, m, rad; of a mask (n,), only where it is true.

        Raises
        ------
        ValueError
            If there is not one pose for each robot, or it is not finite where it is wanted.
        """
        starts = np.array(start_poses, dtype=float)
        chosen = self._chosen(mask)
        if starts.shape != (self.num_envs, POSE):
            raise ValueError(f"{self.num_envs} robots need start poses ({self.num_envs}, 3), not {starts.shape}")
        _refuse_if_not_finite(starts, chosen, "start pose")
        begin_some(self._minds, starts, chosen, self.config.grid.cell)

    def step(self, ranges: ArrayLike, wheels: ArrayLike, mask: ArrayLike | None = None) -> Beliefs:
        """Take in an observation of each robot, and say what they believe then.

        Parameters
        ----------
        ranges
            Readings (n, n_beams), m. Those that are not finite are left out.
        wheels
            Left and right wheel travel since the last step (n, 2), m.
        mask
            Which robots (n,) have observed anything; all if left out. Of the others nothing is said: zeros.

        Raises
        ------
        ValueError
            If something has the wrong shape, or wheel travel is not finite. Then nothing has been taken in.
        """
        seen, travel, chosen = np.asarray(ranges, dtype=float), np.asarray(wheels, dtype=float), self._chosen(mask)
        beams = len(self.robot.beams)
        if seen.shape != (self.num_envs, beams) or travel.shape != (self.num_envs, 2):
            raise ValueError(
                f"ranges and wheels must be ({self.num_envs}, {beams}) and ({self.num_envs}, 2), "
                f"not {seen.shape} and {travel.shape}"
            )
        _refuse_if_not_finite(travel, chosen, "wheel travel")
        seen, travel = np.ascontiguousarray(seen), np.ascontiguousarray(travel)
        poses, covariances = np.zeros((self.num_envs, POSE)), np.zeros((self.num_envs, POSE, POSE))
        grids = np.zeros((self.num_envs, 1, self.size, self.size), dtype=np.uint8)
        self._share(
            chosen,
            lambda some: step_some(self._minds, self._spec, seen, travel, some, poses, covariances, grids),
        )
        return Beliefs(poses, covariances, grids)

    def close(self) -> None:
        """End the threads. May be called again; a later step starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        # Threads stay where they are; a copy starts its own when it needs them.
        return {**vars(self), "_pool": None}

    def segments(self, number: int) -> FloatArray:
        """The walls of one robot's map (k, 4), m, as ``WallMap.segments`` draws them."""
        settings, (belief, walls) = self._extents, (self._minds.filter, self._minds.walls)
        found = [np.zeros((0, 4))]
        for index in range(belief.counts[number, LINES]):
            low, length, _, readings = walls.table[number, index]
            if readings < settings.min_readings:
                continue
            counts, reached = walls.counted[number, index, :, :length], walls.reached[number, index, :, :length]
            extent = WallExtent.counted(int(low), counts, reached)
            line = belief.x[number, POSE + 2 * index : POSE + 2 * index + 2]
            pieces = extent.pieces(settings.max_gap, settings.through_tolerance)
            found.append((belief.anchors[number, index] + at(line, pieces)).reshape(-1, 4))
        every = np.concatenate(found)
        return np.asarray(every[lengths(every) >= settings.min_length])

    @property
    def num_landmarks(self) -> IntArray:
        """How many walls each robot knows (n,), provisional ones included."""
        return self._minds.filter.counts[:, LINES].copy()

    @property
    def num_closures(self) -> IntArray:
        """How often each robot has taken two landmarks for one wall (n,)."""
        return self._minds.filter.counts[:, CLOSURES].copy()

    @property
    def left_out(self) -> IntArray:
        """How often there was no room for something in each robot's mind (n,): while 0, it is what a single one is."""
        return self._minds.filter.counts[:, NO_PLACE].copy()

    @property
    def refused_readings(self) -> IntArray:
        """How many readings of each robot were not finite (n,)."""
        return self._minds.filter.counts[:, REFUSED].copy()

    @property
    def bytes_per_env(self) -> int:
        """Memory set aside for one robot. What has not been needed yet is not taken from the system."""
        minds = self._minds
        return sum(each.nbytes for each in (*minds.filter, *minds.walls, *minds[2:])) // self.num_envs

    def _chosen(self, mask: ArrayLike | None) -> IntArray:
        if mask is None:
            return np.arange(self.num_envs)
        wanted: BoolArray = np.asarray(mask)
        if wanted.shape != (self.num_envs,) or wanted.dtype != bool:
            raise ValueError(f"a mask must be {self.num_envs} booleans, not {wanted.shape} of {wanted.dtype}")
        return np.flatnonzero(wanted)

    def _share(self, chosen: IntArray, work: Callable[[IntArray], Any]) -> None:
        """Have all robots dealt with, some by each thread."""
        if self._threads == 1 or len(chosen) < 2:
            work(chosen)
            return
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads)
        # Some steps take long: threads that are done early find another slice.
        slices = np.array_split(chosen, min(_SLICES * self._threads, len(chosen)))
        for done in [self._pool.submit(work, some) for some in slices]:
            done.result()


def _refuse_if_not_finite(values: FloatArray, chosen: IntArray, name: str) -> None:
    bad = chosen[~np.isfinite(values[chosen]).all(axis=1)]
    if len(bad):
        raise ValueError(f"the {name} of robot {bad[0]} must be finite, not {values[bad[0]]}")
