"""BatchSlam: the consistent estimator, occupancy grid included, for many robots at once."""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from limslam_agent.config.consistent import ConsistentConfig
from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.kernels import tables
from limslam_agent.readings import TURN_LENGTH
from limslam_agent.slam.batch import compiled_steps as steps
from limslam_agent.slam.batch.grid import crop, update
from limslam_agent.slam.batch.state import (
    REFUSED,
    STEP,
    Capacity,
    Spec,
    States,
    spec_of,
    states_for,
)
from limslam_agent.slam.consistent.pending_readings import (
    DRIVEN_AT,
    TURNED_AT,
    Belief,
    Pending,
    Scan,
    Setup,
)
from limslam_agent.slam.consistent.wall_map import drawn_walls, intervals_of
from limslam_env.compilation import compiled, next_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.numbers import LARGEST_COORDINATE
from limslam_env.interface import RobotSpec


class Beliefs(NamedTuple):
    """Estimates for n robots.

    Attributes
    ----------
    pose
        Estimated poses (n, 3), m, m, rad.
    covariance
        Of the poses (n, 3, 3).
    grid
        Occupancy around the robots (n, 1, size, size), 0 unknown, 127 free, 255 occupied; the robot
        is in the middle and looks up.
    """

    pose: FloatArray
    covariance: FloatArray
    grid: NDArray[np.uint8]


class BatchSlam:
    """The consistent estimator for many independent robots, each with an occupancy grid.

    Each robot's estimates equal those of ``LineSlam`` and ``OccupancyGrid`` after the same
    observations, to 1e-6, as long as nothing overflows its capacity and ``LineSlam`` finds no
    constant error of the odometry: a batch does not calibrate odometry, even if the settings say
    ``if_needed``. Threads share the robots; the result does not depend on their number.

    Parameters
    ----------
    robot
        Body and beams of each robot.
    config
        Settings of every stage; by default those of the preset ``consistent``.
    num_envs
        Number of robots, n.
    capacity
        Sizes of the arrays of each robot.
    num_threads
        By default the number of processors.
    size
        Side of the grids that ``step`` returns, in cells; 0 for none.

    Raises
    ------
    ValueError
        If the settings name another estimator or always calibrate the odometry, or a number is too
        small.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_agent import BatchSlam
    >>> envs = gym.make_vec("LimSlam-Env1-v0", num_envs=4, sensor_noise=0.02)
    >>> observations, infos = envs.reset(seed=0)
    >>> slam = BatchSlam(envs.unwrapped.robot, num_envs=4)
    >>> slam.reset(infos["pose"])
    >>> slam.step(observations["ranges"], observations["wheels"]).pose.shape
    (4, 3)
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
        config = config or preset("consistent")
        threads = num_threads
        if threads is None:
            threads = os.cpu_count() or 1
        if not isinstance(config.estimator, ConsistentConfig):
            raise ValueError(f"a batch needs the preset consistent, not {config.preset!r}")  # noqa: TRY004 (a setting)
        if config.estimator.self_calibration.calibrate == "always":
            raise ValueError("a batch does not calibrate odometry by itself; LineSlam does")
        for name, value, least in (
            ("num_envs", num_envs, 1),
            ("num_threads", threads, 1),
            ("size", size, 0),
        ):
            if value < least:
                raise ValueError(f"{name} must be {least} or more, not {value}")
        self.robot = robot
        self.config = config
        self.num_envs = num_envs
        self.size = size
        self.capacity = capacity or Capacity()
        self._extents = config.estimator.extents
        self._spec = spec_of(robot, config, config.estimator)
        self._states = states_for(robot, config.estimator, num_envs, self.capacity)
        self._pool: ThreadPoolExecutor | None = None
        self._threads = threads
        self.reset(np.zeros((num_envs, tables.POSE)))

    def reset(self, start_poses: ArrayLike, mask: ArrayLike | None = None) -> None:
        """Start again from known poses (n, 3), m, m, rad, with empty maps; with a mask (n,), only
        where it is true.

        Raises
        ------
        ValueError
            If there is not one pose for each robot, or it is not finite where it is wanted.
        """
        starts = np.array(start_poses, dtype=float)
        chosen = self._chosen(mask)
        if starts.shape != (self.num_envs, tables.POSE):
            raise ValueError(
                f"{self.num_envs} robots need start poses ({self.num_envs}, 3), not {starts.shape}"
            )
        _refuse_if_not_finite(starts, chosen, "start pose")
        begin_some(self._states, starts, chosen, self.config.grid.cell)

    def step(self, ranges: ArrayLike, wheels: ArrayLike, mask: ArrayLike | None = None) -> Beliefs:
        """Update each robot's estimates by one observation, and return them.

        Parameters
        ----------
        ranges
            Readings (n, n_beams), m. `limslam_agent.readings` defines what they mean.
        wheels
            Left and right wheel travel since the last step (n, 2), m.
        mask
            Which robots (n,) have an observation; by default all. The estimates of the other robots
            are returned as zeros.

        Raises
        ------
        ValueError
            If an argument has the wrong shape, or wheel travel is not finite. Then no state has
            changed.
        """
        seen = np.asarray(ranges, dtype=float)
        travel = np.asarray(wheels, dtype=float)
        chosen = self._chosen(mask)
        beams = len(self.robot.beams)
        if seen.shape != (self.num_envs, beams) or travel.shape != (self.num_envs, 2):
            raise ValueError(
                f"ranges and wheels must be ({self.num_envs}, {beams}) and ({self.num_envs}, 2), "
                f"not {seen.shape} and {travel.shape}"
            )
        _refuse_if_not_finite(travel, chosen, "wheel travel")
        seen = np.ascontiguousarray(seen)
        travel = np.ascontiguousarray(travel)
        beliefs = Beliefs(
            np.zeros((self.num_envs, tables.POSE)),
            np.zeros((self.num_envs, tables.POSE, tables.POSE)),
            np.zeros((self.num_envs, 1, self.size, self.size), dtype=np.uint8),
        )
        begun = np.zeros(1, dtype=np.int64)
        self._share(
            len(chosen),
            lambda: step_some(self._states, self._spec, seen, travel, chosen, begun, beliefs),
        )
        return beliefs

    def close(self) -> None:
        """End the threads. A later step starts new ones."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def __getstate__(self) -> dict[str, Any]:
        # A copy starts its own threads when it needs them.
        return {**vars(self), "_pool": None}

    def segments(self, number: int) -> FloatArray:
        """The walls of one robot's map (k, 4), m, in the world: those of ``WallMap.segments``."""
        belief = self._states.belief
        ekf = tables.Filter(*(each[number] for each in belief.ekf[:-1]))
        walls = tables.Walls(*(each[number] for each in belief.walls))
        intervals = [intervals_of(walls, index) for index in range(ekf.counts[tables.LINES])]
        return drawn_walls(ekf, walls, intervals, self._extents)[0]

    @property
    def num_landmarks(self) -> IntArray:
        """Number of landmarks of each robot (n,), provisional ones included."""
        return self._states.belief.ekf.counts[:, tables.LINES].copy()

    @property
    def num_closures(self) -> IntArray:
        """Number of pairs of landmarks that each robot has merged (n,)."""
        return self._states.belief.walls.tally[:, tables.CLOSURES].copy()

    @property
    def overflows(self) -> IntArray:
        """How often each robot's capacity was too small (n,).

        While the number is 0, the robot's estimates equal those of ``LineSlam``.
        """
        return self._states.belief.walls.tally[:, tables.OVERFLOWS].copy()

    @property
    def refused_readings(self) -> IntArray:
        """Number of readings of each robot that were skipped (n,): no readings (NaN), and negative
        numbers.
        """
        return self._states.belief.ekf.counts[:, REFUSED].copy()

    def _chosen(self, mask: ArrayLike | None) -> IntArray:
        if mask is None:
            return np.arange(self.num_envs)
        wanted: BoolArray = np.asarray(mask)
        if wanted.shape != (self.num_envs,) or wanted.dtype != bool:
            raise ValueError(
                f"a mask must be {self.num_envs} booleans, not {wanted.shape} of {wanted.dtype}"
            )
        return np.flatnonzero(wanted)

    def _share(self, robots: int, work: Callable[[], Any]) -> None:
        """Let each thread do the work for some robots, of which it takes one after the other."""
        others = min(self._threads, robots) - 1
        if others > 0 and self._pool is None:
            self._pool = ThreadPoolExecutor(self._threads - 1)
        running = [self._pool.submit(work) for _ in range(others)] if self._pool is not None else []
        work()
        for each in running:
            # A thread that has not started by now has nothing left to do.
            if not each.cancel():
                each.result()


def _refuse_if_not_finite(values: FloatArray, chosen: IntArray, name: str) -> None:
    bad = chosen[~(np.abs(values[chosen]) <= LARGEST_COORDINATE).all(axis=1)]
    if len(bad):
        raise ValueError(
            f"the {name} of robot {bad[0]} must be finite, and at most {LARGEST_COORDINATE:g} m or "
            f"rad, not {values[bad[0]]}"
        )


@compiled
def state_of(states: States, number: int) -> States:
    """The state of one robot, as views of the arrays."""
    ekf = states.belief.ekf
    walls = states.belief.walls
    pending = states.belief.pending
    return States(
        Belief(
            tables.Filter(
                ekf.x[number],
                ekf.P[number],
                ekf.by_errors[number],
                ekf.anchors[number],
                ekf.clones[number],
                ekf.counts[number],
                ekf.bend,
            ),
            tables.Walls(
                walls.table[number],
                walls.counted[number],
                walls.reached[number],
                walls.ends[number],
                walls.tally[number],
            ),
            Pending(pending.travel[number], pending.rows[number], pending.fill[number]),
        ),
        states.contact[number],
        states.ticks[number],
        states.repeats[number],
        states.grid[number],
        states.window[number],
    )


@compiled
def predict(state: States, values: FloatArray, wheels: FloatArray, spec: Spec) -> Scan:
    """Predict a robot's pose by the wheel travel (2,), m, and sort the values (b,) that its sensor
    reports.
    """
    settings = spec.settings[0]
    ekf = state.belief.ekf
    ekf.counts[STEP] += 1
    step = ekf.counts[STEP]
    increment, covariance = steps.wheel_motion(
        wheels, settings.axle, settings.wheel_variance, (0.0, 0.0)
    )
    moved = math.hypot(increment[0], increment[1]) + TURN_LENGTH * abs(increment[2])
    ranges = np.empty(len(values))
    measured = (step % spec.schedule[0] == spec.schedule[1]) | (step == 0)
    hits = np.empty(len(values), dtype=np.bool_)
    ekf.counts[REFUSED] += steps.sort(
        values, spec.limits, moved, state.repeats, ranges, measured, hits
    )
    before = state.ticks.copy()
    for wheel in range(2):
        state.ticks[wheel] = steps.tick_by(before[wheel], wheels[wheel])
    covariance += steps.first_jitter(before, state.ticks, settings.axle)
    variance, angle = steps.slip(
        state.contact,
        ranges,
        measured,
        increment[0],
        spec.table[:, tables.ANGLE],
        spec.table[:, tables.TOO_NEAR],
        settings.radius,
        settings.std,
    )
    if variance:
        covariance = covariance + steps.slip_covariance(variance, angle)
    derivatives = np.zeros((2, tables.POSE, tables.POSE))
    steps.move(ekf, 0, increment, covariance, derivatives[0], derivatives[1])
    steps.note_motion(state.belief.pending, 0, increment)
    return Scan(step, ranges, measured, hits, steps.jitter_of(state.ticks, settings.axle))


@steps.entry
def step_some(
    states: States,
    spec: Spec,
    ranges: FloatArray,
    wheels: FloatArray,
    chosen: IntArray,
    begun: IntArray,
    beliefs: Beliefs,
) -> None:
    """Update chosen robots by one observation each, and fill their rows of the beliefs.

    ``begun`` (1,) counts the chosen robots that some thread has begun with. Steps differ in cost,
    so each thread takes the next robot when it has finished one.
    """
    # The compiler processes a function and all below it again for each function above it, so there
    # are few levels.
    stamps = np.zeros((states.grid.shape[1], states.grid.shape[2]), dtype=np.int32)
    settings = spec.settings[0]
    setup = Setup(settings, spec.table, spec.sides)
    place = next_of(begun)
    while place < len(chosen):
        number = chosen[place]
        state = state_of(states, number)
        scan = predict(state, ranges[number], wheels[number], spec)
        steps.measure(state.belief, 0, scan, setup, None)
        ekf = state.belief.ekf
        pose = ekf.x[: tables.POSE]
        beliefs.pose[number] = pose
        beliefs.covariance[number] = ekf.P[: tables.POSE, : tables.POSE] + steps.turned(
            scan.jitter, pose[2]
        )
        update(state, scan, setup, stamps, place + 1)
        if beliefs.grid.shape[3]:
            crop(pose, state.grid, state.window, settings.cell, beliefs.grid[number, 0])
        place = next_of(begun)


@compiled
def begin(state: States, start: FloatArray, cell: float) -> None:
    """Reset one robot to a known pose (3,), m, m, rad, with empty maps."""
    ekf = state.belief.ekf
    pending = state.belief.pending
    ekf.counts[:] = 0
    ekf.counts[tables.POSES_END] = tables.POSE
    ekf.counts[tables.LINES_FROM] = tables.POSE
    ekf.counts[STEP] = -1
    ekf.x[: tables.POSE] = start
    ekf.P[: tables.POSE, : tables.POSE] = 0.0
    pending.travel[:] = 0.0
    pending.travel[0, DRIVEN_AT] = -np.inf
    pending.travel[0, TURNED_AT] = -np.inf
    pending.fill[:] = 0
    state.belief.walls.tally[:] = 0
    state.contact[:] = -1.0
    state.ticks[:] = 0.0
    state.repeats[:] = 0.0
    state.repeats[:, tables.PREVIOUS] = math.nan
    state.grid[:] = 0
    half = state.grid.shape[0] // 2
    state.window[0] = math.floor(start[1] / cell) - half
    state.window[1] = math.floor(start[0] / cell) - half


@steps.entry
def begin_some(states: States, starts: FloatArray, chosen: IntArray, cell: float) -> None:
    """Reset the chosen robots to known poses (n, 3)."""
    for number in chosen:
        begin(state_of(states, number), starts[number], cell)
