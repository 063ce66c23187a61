"""What the adapters share: spaces, the check of actions, info, and a simulation whose world a reset may change."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, TypeAlias, TypeGuard

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from limslam_env.config import NoiseConfig, Setting
from limslam_env.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec
from limslam_env.simulation import Readings, Simulation, Truth
from limslam_env.world import WorldSource, load_world

PlaceSource: TypeAlias = WorldSource | FloorPlanConfig
"""A world, its name or its file; or what floor plans are drawn by at each reset, or ``"random"`` for the default."""

Action: TypeAlias = NDArray[np.floating[Any]] | Sequence[float]

RESET_OPTIONS = frozenset({"start", "world"})

# Seeds 0 to 3 are the simulation's: starts, ranges, wheels, settings.
_TASK_SEED = 4


def action_space() -> spaces.Box:
    """Left and right wheel speed, shares of the maximum."""
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def observation_space(robot: RobotSpec) -> spaces.Dict:
    """Ranges and wheel travel of a robot, m."""
    limit = np.full(2, robot.max_wheel_travel, dtype=np.float32)
    ranges = spaces.Box(robot.min_ranges.astype(np.float32), robot.max_ranges.astype(np.float32))
    return spaces.Dict({"ranges": ranges, "wheels": spaces.Box(-limit, limit)})


def wheel_speeds(action: Action) -> tuple[float, float]:
    """An action as two numbers.

    Raises
    ------
    ValueError
        If it is not two finite numbers.
    """
    try:
        left, right = (action if isinstance(action, np.ndarray) else np.asarray(action, dtype=float)).tolist()
        if math.isfinite(left) and math.isfinite(right):
            return left, right
    except (TypeError, ValueError):
        pass
    raise ValueError(f"an action is two finite numbers, left and right wheel speed, not {action!r}")


def observation_of(readings: Readings, robot: int) -> Observation:
    """What one robot is told."""
    return {"ranges": readings.ranges[robot], "wheels": readings.wheels[robot]}


def info_of(truth: Truth, robot: int) -> dict[str, Any]:
    """What is true of one robot, for scoring."""
    return {
        "pose": truth.poses[robot],
        "time": truth.time,
        "coverage": truth.coverage,
        "collision": truth.contact[robot],
        "wall_seen": truth.wall_seen[robot],
    }


def with_sensor_noise(noise: NoiseConfig | None, sensor_noise: Setting | None) -> NoiseConfig:
    """The noise, its ``sensor_noise`` replaced if one is given."""
    noise = noise or NoiseConfig()
    return noise if sensor_noise is None else replace(noise, sensor_noise=sensor_noise)


class Stage:
    """A simulation that is exchanged when a reset asks for another world.

    Parameters
    ----------
    source
        Where the robots are, unless a reset says otherwise.
    robot, num_robots
        What they are, and how many.
    noise
        Ranges in it are drawn from at each reset.

    Raises
    ------
    WorldError
        If the world cannot be used.
    ValueError
        If floor plans for such a robot cannot be drawn.
    """

    def __init__(self, source: PlaceSource, robot: RobotSpec, num_robots: int, noise: NoiseConfig) -> None:
        self._source = FloorPlanConfig() if _is_random(source) else source
        self._robot, self._num_robots, self._noise = robot, num_robots, noise
        self._home: Simulation | None = None
        if isinstance(self._source, FloorPlanConfig):
            # A plan that nobody sees: what is wrong with the settings shows at once.
            floor_plan(self._source, np.random.default_rng(0), robot.radius)
        else:
            self._home = Simulation(load_world(self._source), robot, num_robots)
        self._simulation = self._home
        self._is_running = False

    @property
    def simulation(self) -> Simulation:
        """The simulation.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If its world is drawn at the first reset.
        """
        if self._simulation is None:
            raise gym.error.ResetNeeded("there is no floor plan before the first reset")
        return self._simulation

    @property
    def running(self) -> Simulation:
        """The simulation, once an episode has begun.

        Raises
        ------
        gymnasium.error.ResetNeeded
            Before that.
        """
        if not self._is_running:
            raise gym.error.ResetNeeded("nothing has been seen before the first reset")
        return self.simulation

    def reset(self, generator: np.random.Generator, options: dict[str, Any] | None) -> tuple[Readings, Truth]:
        """Begin an episode; a reset that is refused leaves the running one as it was.

        Raises
        ------
        ValueError
            If an option is unknown.
        WorldError
            If the world or the start cannot be used.
        """
        options = options or {}
        unknown = sorted(set(options) - RESET_OPTIONS)
        if unknown:
            raise ValueError(f"unknown reset option {unknown[0]!r}; there are 'start' and 'world'")
        entropy = int(generator.integers(2**63))
        start = _starts(options.get("start"), self._num_robots)
        simulation = self._simulation_for(options.get("world", self._source), entropy)
        result = simulation.reset(np.random.SeedSequence(entropy), self._noise, start)
        self._simulation, self._is_running = simulation, True
        return result

    def step(self, actions: Sequence[tuple[float, float]]) -> tuple[Readings, Truth]:
        """Drive for one control period.

        Raises
        ------
        gymnasium.error.ResetNeeded
            If there was no reset yet.
        """
        if not self._is_running:
            raise gym.error.ResetNeeded("call reset before step")
        return self.simulation.step(actions)

    def _simulation_for(self, source: PlaceSource, entropy: int) -> Simulation:
        if source is self._source and self._home is not None:
            return self._home
        if _is_random(source):
            source = FloorPlanConfig()
        if isinstance(source, FloorPlanConfig):
            task = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(_TASK_SEED,)))
            return Simulation(floor_plan(source, task, self._robot.radius), self._robot, self._num_robots)
        return Simulation(load_world(source), self._robot, self._num_robots)


def _is_random(source: PlaceSource) -> TypeGuard[str]:
    return isinstance(source, str) and source == "random"


def _starts(option: Any, num_robots: int) -> FloatArray | None:
    if option is None:
        return None
    try:
        starts = np.atleast_2d(np.asarray(option, dtype=float))
    except (TypeError, ValueError):
        starts = np.zeros((0, 0))
    if starts.ndim != 2 or starts.shape[1] != 3 or not 1 <= len(starts) <= num_robots:
        wanted = "(x, y, theta)" if num_robots == 1 else f"up to {num_robots} rows (x, y, theta)"
        raise ValueError(f"the start is {wanted}, not {option!r}")
    return starts
