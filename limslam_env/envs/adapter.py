"""What the adapters of single environments share: spaces, actions, info, resets with another world, and rendering."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from limslam_env.config import NoiseConfig, RewardConfig, Setting, TaskConfig
from limslam_env.envs.arguments import PlaceSource, given, is_random, noise_of, nominal_noise
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import NominalNoise, Observation, RobotSpec
from limslam_env.messages import described, one_line
from limslam_env.rendering.overlay import Overlay
from limslam_env.rendering.painter import Painter
from limslam_env.simulation.coverage import CoverageGrid
from limslam_env.simulation.simulation import Readings, Simulation, Truth
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.worlds.world import World

if TYPE_CHECKING:
    from limslam_env.rendering.window import Window

Action: TypeAlias = NDArray[np.floating[Any]] | Sequence[float]

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
        self.robot = given("robot", robot, RobotSpec)
        self.task = TaskConfig(coverage_goal, given("rewards", rewards, RewardConfig))
        self.noise = noise_of(noise, sensor_noise)
        self._source = FloorPlanConfig() if is_random(world) else world
        self._num_robots, self._home, self._is_running = num_robots, None, False
        if isinstance(self._source, FloorPlanConfig):
            # This plan is not used: it shows at once whether the settings can be used.
            floor_plan(self._source, np.random.default_rng(0), self.robot.radius)
        else:
            self._home = Simulation(load_world(self._source), self.robot, num_robots)
        self._simulation: Simulation | None = self._home

    @property
    def nominal_noise(self) -> NominalNoise:
        """The noise that the robot's data sheets give: an agent may know it."""
        return nominal_noise(self.noise)

    @property
    def world(self) -> World:
        """The world that the robots are in."""
        if self._simulation is None:
            raise gym.error.ResetNeeded("the world is drawn at the first reset: call reset first")
        return self._simulation.world

    @property
    def coverage_grid(self) -> CoverageGrid:
        """The cells that count for coverage. Known after the first reset."""
        return self._running.coverage_grid

    @property
    def seen(self) -> BoolArray:
        """Which cells of the coverage grid have truly been seen (rows, columns); a copy, for scoring only."""
        return self._running.seen

    @property
    def true_poses(self) -> FloatArray:
        """True pose of each robot (n, 3), m and rad; a copy, for scoring and pictures only."""
        return self._running.poses

    def carry(self, robot: int, pose: FloatArray) -> None:
        """Carry a robot to another pose (3,) without a turn of its wheels, as a test of what an agent does then.

        Raises
        ------
        WorldError
            If the robot collides there or is outside.
        """
        self._running.carry(robot, pose)

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
        return None if self.render_mode is None else self._painter.paint(self._running)

    def close(self) -> None:
        """Close the window, if there is one. May be called again."""
        self._painter.close()

    @property
    def _running(self) -> Simulation:
        """The simulation, once an episode has begun."""
        if self._simulation is None or not self._is_running:
            raise gym.error.ResetNeeded("there is no episode yet: call reset first")
        return self._simulation

    def _begin(self, generator: np.random.Generator, options: dict[str, Any] | None) -> tuple[Readings, Truth]:
        """Begin an episode. A reset that raises an error leaves the running episode unchanged."""
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
        readings, truth = simulation.reset(np.random.SeedSequence(entropy), self.noise, start)
        self._simulation, self._is_running = simulation, True
        self._painter.follow(simulation, readings, truth)
        return readings, truth

    def _drive(self, actions: Sequence[tuple[float, float]]) -> tuple[Readings, Truth]:
        """Drive for one control period."""
        simulation = self._running
        readings, truth = simulation.step(actions)
        self._painter.follow(simulation, readings, truth)
        return readings, truth

    def _simulation_for(self, source: PlaceSource, entropy: int) -> Simulation:
        if source is self._source and self._home is not None:
            return self._home
        if is_random(source):
            source = FloorPlanConfig()
        if isinstance(source, FloorPlanConfig):
            task = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(_TASK_SEED,)))
            return Simulation(floor_plan(source, task, self.robot.radius), self.robot, self._num_robots)
        return Simulation(load_world(source), self.robot, self._num_robots)


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
