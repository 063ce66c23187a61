"""What the environments share: arguments, spaces, observations and info; and the simulation of
single ones.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from limslam_env.config import NoiseConfig, RewardConfig, Setting, TaskConfig, bounds_of
from limslam_env.envs.arguments import PlaceSource, given, place_of, reset_options
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.numbers import floats, plain
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.messages import described, one_line
from limslam_env.overlay import Overlay
from limslam_env.rendering.painter import Painter
from limslam_env.simulation.coverage import CoverageGrid
from limslam_env.simulation.simulation import Readings, Simulation, Truth
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.worlds.world import World

if TYPE_CHECKING:
    from limslam_env.rendering.window import Window

Action: TypeAlias = NDArray[np.floating[Any]] | Sequence[float]

RESET_OPTIONS = "start", "world"

# Seeds 0 to 3 are the simulation's: starts, ranges, wheels, settings.
_TASK_SEED = 4


def action_space() -> spaces.Box:
    """Left and right wheel speed, fractions of the maximum."""
    return spaces.Box(-1.0, 1.0, (2,), np.float32)


def observation_space(robot: RobotSpec, *, imu: bool = False) -> spaces.Dict:
    """Ranges and wheel travel of a robot, m, and its heading by an inertial measurement unit, rad,
    if it has one.
    """
    limit = np.full(2, robot.max_wheel_travel, dtype=np.float32)
    ranges = spaces.Box(robot.min_ranges.astype(np.float32), robot.max_ranges.astype(np.float32))
    known: dict[str, spaces.Space[Any]] = {"ranges": ranges, "wheels": spaces.Box(-limit, limit)}
    if imu:
        known["yaw"] = spaces.Box(-np.float32(np.pi), np.float32(np.pi), (1,), np.float32)
    return spaces.Dict(known)


def wheel_speeds(action: Action) -> tuple[float, float]:
    """An action as two numbers; a ValueError where it is not two finite numbers."""
    try:
        left, right = (
            action if isinstance(action, np.ndarray) else np.asarray(action, dtype=float)
        ).tolist()
        if math.isfinite(left) and math.isfinite(right):
            return left, right
    except (TypeError, ValueError, OverflowError):
        pass
    raise ValueError(
        one_line(
            f"an action is two finite numbers, left and right wheel speed, not {described(action)}"
        )
    )


def observation_of(readings: Any, which: Any) -> Any:
    """The observation of the robot at an index ``which`` of the readings."""
    found = {"ranges": readings.ranges[which], "wheels": readings.wheels[which]}
    if isinstance(readings, Readings) and readings.yaw is not None:
        found["yaw"] = readings.yaw[which]
    return found


def info_of(truth: Any, which: Any) -> dict[str, Any]:
    """The ground truth, for evaluation, of the robot at an index ``which`` of the arrays."""
    contact = truth.contact[which]
    return {
        "pose": truth.poses[which],
        "time": truth.time,
        "coverage": truth.coverage,
        "collision": contact,
        "cost": 1.0 * contact,
        "wall_seen": truth.wall_seen[which],
    }


class Configured:
    """Base of all environments.

    Attributes
    ----------
    robot, noise, task
        Specification of the robots, their noise, and the task.
    metadata
        What Gymnasium asks for; pictures are shown at the speed of the robots' steps.
    """

    metadata: dict[str, Any]
    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What Gymnasium made the environment from, if it did, with arguments as JSON has them."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec and replace(spec, kwargs=plain(spec.kwargs))

    def _configure(
        self,
        *,
        robot: RobotSpec | None = None,
        sensor_noise: Setting | None = None,
        noise: NoiseConfig | None = None,
        coverage_goal: float | None = 0.99,
        rewards: RewardConfig | None = None,
    ) -> None:
        """Take the arguments of all environments; their classes document them and the errors
        raised.
        """
        self.robot = given("robot", robot, RobotSpec)
        self.task = TaskConfig(coverage_goal, given("rewards", rewards, RewardConfig))
        told = given("noise", noise, NoiseConfig)
        self.noise = told if sensor_noise is None else replace(told, sensor_noise=sensor_noise)
        steps_a_second = max(1, round(1.0 / self.robot.control_period))
        self.metadata = {**self.metadata, "render_fps": steps_a_second}

    @property
    def nominal_noise(self) -> NominalNoise:
        """The noise that the robot's data sheets give, and that an agent may therefore know.

        Of a range of values it is the upper end. The variance of the wheels is never below that of
        ``NominalNoise()``, because no data sheet promises ideal wheels. Noise that a standard
        deviation cannot describe (dropouts, slip, unequal wheels and so on) is not part of it.
        """
        wheel_variance = max(bounds_of(self.noise.wheel_variance)[1], NominalNoise().wheel_variance)
        yaw_std = max(bounds_of(self.noise.yaw_std)[1], NominalNoise().yaw_std)
        return NominalNoise(bounds_of(self.noise.sensor_noise)[1], wheel_variance, yaw_std)


class NamedRobots:
    """The names and the spaces of several robots, as PettingZoo asks for them."""

    def _name(
        self, num_robots: int, observations: Callable[[], Any], actions: Callable[[], Any]
    ) -> None:
        """Name the robots, and give each of them a space of observations and of actions."""
        self.possible_agents = [f"robot_{number}" for number in range(num_robots)]
        self.observation_spaces = self._each(lambda _: observations())
        self.action_spaces = self._each(lambda _: actions())

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """The observation space of a robot: the same object at each call."""
        space: spaces.Space[Any] = self.observation_spaces[agent]
        return space

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """The action space of a robot: the same object at each call."""
        space: spaces.Space[Any] = self.action_spaces[agent]
        return space

    def _each(self, value_of: Callable[[int], Any]) -> dict[str, Any]:
        """A value for each robot, of its number."""
        return {name: value_of(number) for number, name in enumerate(self.possible_agents)}

    def _in_order(self, actions: dict[str, Any]) -> list[Any]:
        """The actions of all robots, in the order of the robots; a ValueError where there is not
        one for each.
        """
        if not isinstance(actions, Mapping) or set(actions) != set(self.possible_agents):
            names = ", ".join(self.possible_agents)
            raise ValueError(
                f"there must be one action for each of {names}, not {described(actions)}"
            )
        return [actions[name] for name in self.possible_agents]


class SimulationEnv(Configured):
    """Base of the single environments: their simulation and its pictures, and all methods but reset
    and step.

    Attributes
    ----------
    has_imu
        Whether the robots observe their heading.
    """

    render_mode: str | None

    def _set_up(
        self,
        world: PlaceSource,
        num_robots: int,
        render_mode: str | None,
        *,
        imu: bool,
        **arguments: Any,
    ) -> None:
        """Take an environment's arguments; its class documents them and the errors raised."""
        self.render_mode = render_mode
        self.has_imu = bool(imu)
        self._configure(**arguments)
        self._painter = Painter(render_mode, self.metadata["render_fps"])
        self._source = place_of(world)
        self._num_robots = num_robots
        self._home = None
        self._is_running = False
        if isinstance(self._source, FloorPlanConfig):
            self._source.check(self.robot.radius)
        else:
            self._home = Simulation(self._source, self.robot, num_robots)
        self._simulation: Simulation | None = self._home

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
        """Which cells of the coverage grid have truly been seen (rows, columns); a copy, for
        scoring only.
        """
        return self._running.seen

    @property
    def true_poses(self) -> FloatArray:
        """True pose of each robot (n, 3), m and rad; a copy, for scoring and pictures only."""
        return self._running.poses

    def carry(self, robot: int, pose: FloatArray) -> None:
        """Carry a robot to another pose (3,) without a turn of its wheels, as a test of what an
        agent does then.

        Raises
        ------
        WorldError
            If the robot collides there or is outside.
        """
        self._running.carry(robot, pose)

    @property
    def overlay(self) -> Sequence[Overlay]:
        """The agents' estimates, drawn over later pictures; the first one has the colour of the
        first robot.

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
        """A picture (height, width, 3) of world, robots, beams and paths; None without a render
        mode or in a window.
        """
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

    def _begin(
        self, generator: np.random.Generator, options: dict[str, Any] | None
    ) -> tuple[Readings, Truth]:
        """Begin an episode. A reset that raises an error leaves the running episode unchanged."""
        asked = reset_options(options, *RESET_OPTIONS)
        entropy = int(generator.integers(2**63))
        start = _starts(asked.get("start"), self._num_robots)
        simulation = self._simulation_for(asked.get("world", self._source), entropy)
        seeds = np.random.SeedSequence(entropy)
        readings, truth = simulation.reset(seeds, self.noise, start, imu=self.has_imu)
        self._simulation = simulation
        self._is_running = True
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
        place = place_of(source)
        if isinstance(place, FloorPlanConfig):
            task = np.random.default_rng(np.random.SeedSequence(entropy, spawn_key=(_TASK_SEED,)))
            return Simulation(
                floor_plan(place, task, self.robot.radius), self.robot, self._num_robots
            )
        return Simulation(place, self.robot, self._num_robots)


def _starts(option: Any, num_robots: int) -> FloatArray | None:
    if option is None:
        return None
    starts = np.atleast_2d(floats(option))
    if starts.ndim != 2 or starts.shape[1] != 3 or not 1 <= len(starts) <= num_robots:
        wanted = "(x, y, theta)" if num_robots == 1 else f"up to {num_robots} rows (x, y, theta)"
        raise ValueError(f"the start is {wanted}, not {described(option)}")
    return starts
