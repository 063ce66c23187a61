"""What the adapters of single environments share: spaces, actions, info, resets with another world, and rendering."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias, TypeGuard

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from limslam_env.config import NoiseConfig, RewardConfig, Setting, TaskConfig
from limslam_env.envs.argument_types import check_noise, nominal_noise, rewards_of, robot_of
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import NominalNoise, Observation, RobotSpec
from limslam_env.messages import described, one_line
from limslam_env.rendering.overlay import Overlay
from limslam_env.rendering.painter import Painter
from limslam_env.simulation.coverage import CoverageGrid
from limslam_env.simulation.simulation import Readings, Simulation, Truth
from limslam_env.worlds.formats.loading import WorldSource, load_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.worlds.world import World

if TYPE_CHECKING:
    from limslam_env.rendering.window import Window

PlaceSource: TypeAlias = WorldSource | FloorPlanConfig
"""A world, its name or its file; or settings of random floor plans, or ``"random"`` for the default settings."""

Action: TypeAlias = NDArray[np.floating[Any]] | Sequence[float]

MAX_ROBOTS = 8

RESET_OPTIONS = frozenset({"start", "world"})

# Seeds 0 to 3 are the simulation's: starts, ranges, wheels, settings.
_TASK_SEED = 4


def action_space() -> spaces.Box:
    """Left and right wheel speed, fractions of the maximum."""
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
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(one_line(f"an action is two finite numbers, left and right wheel speed, not {described(action)}"))


def observation_of(readings: Readings, robot: int) -> Observation:
    """The observation of one robot."""
    return {"ranges": readings.ranges[robot], "wheels": readings.wheels[robot]}


def info_of(truth: Truth, robot: int) -> dict[str, Any]:
    """The ground truth of one robot, for evaluation."""
    return {
        "pose": truth.poses[robot],
        "time": truth.time,
        "coverage": truth.coverage,
        "collision": truth.contact[robot],
        "cost": float(truth.contact[robot]),
        "wall_seen": truth.wall_seen[robot],
    }


class EpisodeSimulation:
    """A simulation that is replaced when a reset asks for another world.

    Parameters
    ----------
    source
        The world, unless a reset asks for another one.
    robot, num_robots
        The robots' specification and their number.
    noise
        The noise; values are drawn from its intervals at each reset.

    Raises
    ------
    WorldError
        If the world cannot be used.
    ValueError
        If floor plans for such a robot cannot be drawn.
    """

    def __init__(self, source: PlaceSource, robot: RobotSpec, num_robots: int, noise: NoiseConfig) -> None:
        self._source = FloorPlanConfig() if is_random(source) else source
        self._robot, self._num_robots, self._noise = robot, num_robots, noise
        self._home: Simulation | None = None
        if isinstance(self._source, FloorPlanConfig):
            # This plan is not used: it shows at once whether the settings can be used.
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
            raise gym.error.ResetNeeded("the world is drawn at the first reset: call reset first")
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
            raise gym.error.ResetNeeded("there is no episode yet: call reset first")
        return self.simulation

    def reset(self, generator: np.random.Generator, options: dict[str, Any] | None) -> tuple[Readings, Truth]:
        """Begin an episode. A reset that raises an error leaves the running episode unchanged.

        Raises
        ------
        ValueError
            If an option is unknown.
        WorldError
            If the world or the start cannot be used.
        """
        options = options or {}
        if not isinstance(options, Mapping):
            raise ValueError(  # noqa: TRY004 (all refused arguments are ValueErrors)
                f"reset options are a dictionary, not {described(options)}"
            )
        unknown = sorted(map(str, set(options) - RESET_OPTIONS))
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
        if is_random(source):
            source = FloorPlanConfig()
        if isinstance(source, FloorPlanConfig):
            task = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(_TASK_SEED,)))
            return Simulation(floor_plan(source, task, self._robot.radius), self._robot, self._num_robots)
        return Simulation(load_world(source), self._robot, self._num_robots)


class SimulationEnv:
    """Base of the single environments: their simulation and its pictures, and all methods but reset and step.

    Attributes
    ----------
    robot, noise, task
        Specification of the robots, their noise, and the task.
    render_mode
        As Gymnasium and PettingZoo name it.
    """

    render_mode: str | None

    def _set_up(
        self,
        world: PlaceSource,
        num_robots: int,
        robot: RobotSpec | None,
        sensor_noise: Setting | None,
        noise: NoiseConfig | None,
        coverage_goal: float | None,
        rewards: RewardConfig | None,
        render_mode: str | None,
    ) -> None:
        """Take an environment's arguments; its class documents them and the errors raised."""
        self.render_mode = render_mode
        self._painter = Painter(render_mode)
        self.robot = robot_of(robot)
        self.task = TaskConfig(coverage_goal, rewards_of(rewards))
        noise = NoiseConfig() if noise is None else noise
        check_noise(noise)
        self.noise = noise if sensor_noise is None else replace(noise, sensor_noise=sensor_noise)
        self._episode = EpisodeSimulation(world, self.robot, num_robots, self.noise)

    @property
    def nominal_noise(self) -> NominalNoise:
        """The noise that the robot's data sheets give: an agent may know it."""
        return nominal_noise(self.noise)

    @property
    def world(self) -> World:
        """The world that the robots are in."""
        return self._episode.simulation.world

    @property
    def coverage_grid(self) -> CoverageGrid:
        """The cells that count for coverage. Known after the first reset."""
        return self._episode.running.coverage_grid

    @property
    def seen(self) -> BoolArray:
        """Which cells of the coverage grid have truly been seen (rows, columns); a copy, for scoring only."""
        return self._episode.running.seen

    @property
    def true_poses(self) -> FloatArray:
        """True pose of each robot (n, 3), m and rad; a copy, for scoring and pictures only."""
        return self._episode.running.poses

    def carry(self, robot: int, pose: FloatArray) -> None:
        """Carry a robot to another pose (3,) without a turn of its wheels, as a test of what an agent does then.

        Raises
        ------
        WorldError
            If the robot collides there or is outside.
        """
        self._episode.running.carry(robot, pose)

    @property
    def overlay(self) -> Sequence[Overlay]:
        """The agents' estimates, drawn over later pictures; the first one has the colour of the first robot.

        It can be set at any time, to one overlay or to several. An empty overlay draws nothing.
        """
        return self._painter.overlay

    @overlay.setter
    def overlay(self, overlay: Overlay | Sequence[Overlay]) -> None:
        self._painter.overlay = (overlay,) if isinstance(overlay, Overlay) else tuple(overlay)

    @property
    def window(self) -> "Window | None":
        """The window of the human mode, once it is open."""
        return self._painter.window

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3) of world, robots, beams and paths; None without a render mode or in a window."""
        if self.render_mode is None:
            return None
        return self._painter.paint(self._episode.simulation)

    def close(self) -> None:
        """Close the window, if there is one. May be called again."""
        self._painter.close()


def is_random(source: object) -> TypeGuard[str]:
    """Whether a world is to be drawn by the default settings."""
    return isinstance(source, str) and source == "random"


def check_robots(num_robots: Any) -> None:
    """Refuse a number of robots that is not a whole number from 1 to 8.

    Raises
    ------
    ValueError
        If it is something else.
    """
    if (
        isinstance(num_robots, bool)
        or not isinstance(num_robots, int | np.integer)
        or not 1 <= num_robots <= MAX_ROBOTS
    ):
        raise ValueError(f"there can be 1 to {MAX_ROBOTS} robots, not {described(num_robots)}")


def _starts(option: Any, num_robots: int) -> FloatArray | None:
    if option is None:
        return None
    try:
        starts = np.atleast_2d(np.asarray(option, dtype=float))
    except (TypeError, ValueError, OverflowError):
        starts = np.zeros((0, 0))
    if starts.ndim != 2 or starts.shape[1] != 3 or not 1 <= len(starts) <= num_robots:
        wanted = "(x, y, theta)" if num_robots == 1 else f"up to {num_robots} rows (x, y, theta)"
        raise ValueError(f"the start is {wanted}, not {described(option)}")
    return starts
