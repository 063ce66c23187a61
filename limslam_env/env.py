"""The single-robot environment of Gymnasium: a thin adapter over the simulation."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from limslam_env.config import NoiseConfig, RewardConfig, Setting, TaskConfig
from limslam_env.coverage import CoverageGrid
from limslam_env.geometry import FloatArray
from limslam_env.interface import Observation, RobotSpec
from limslam_env.simulation import Simulation, Truth
from limslam_env.task import is_done, reward
from limslam_env.world import World, WorldSource, load_world


class LimSlamEnv(gym.Env[Observation, NDArray[np.floating[Any]]]):
    """Explore an unknown building with a few range beams and wheel encoders.

    ## Description
    A round differential-drive robot stands in a building that it knows nothing of. It senses the
    distance to the nearest wall along a few narrow beams, and how far its wheels have turned, both
    with noise. The task is to see every place that can be seen.

    ## Action Space
    `Box(-1.0, 1.0, (2,), float32)`

    | Num | Action            | Min | Max | Unit                         |
    |-----|-------------------|-----|-----|------------------------------|
    | 0   | left wheel speed  | -1  | 1   | share of the maximal speed   |
    | 1   | right wheel speed | -1  | 1   | share of the maximal speed   |

    Numbers outside are clipped. NaN and wrong shapes are refused with a `ValueError`.

    ## Observation Space
    `Dict` of `Box(float32)`, new arrays at each step:

    | Key    | Shape      | Min                  | Max                 | Unit | Meaning                                             |
    |--------|------------|----------------------|---------------------|------|-----------------------------------------------------|
    | ranges | (n_beams,) | the beams' min_range | the beams' max_range| m    | distance along each beam, its maximum for nothing   |
    | wheels | (2,)       | -max_wheel_travel    | max_wheel_travel    | m    | left and right wheel travel since the last step     |

    The default robot's beams point at +90, +45, +15, -15, -45 and -90 degrees and reach from 0.05 to
    1.5 m; `max_wheel_travel` is 0.06 m.

    ## Info
    The truth, for scoring only: `pose` (3,) m, m, rad; `time` s; `coverage` 0 to 1; `collision` bool;
    `wall_seen` (n_beams,) int, the wall that each beam hit, -1 for nothing. The `pose` that `reset`
    gives is the start pose, the only truth that an agent may be told.

    ## Rewards
    `new_area` times the newly covered square metres, plus `step` at each step, plus `collision` while
    the robot touches something (`RewardConfig`: 1, -0.001 and -0.05).

    ## Starting State
    The first of the world's starts, or one drawn by seed where it has none;
    `reset(options={"start": (x, y, theta)})` sets it.

    ## Episode End
    Terminated when `coverage` reaches `coverage_goal` (0.99; `None` never ends it). Truncated after
    18000 steps (30 minutes) when made by `gymnasium.make`, unless `max_episode_steps` says otherwise.

    ## Arguments
    | Argument      | Default           | Meaning                                                       |
    |---------------|-------------------|---------------------------------------------------------------|
    | world         | the id's world    | name of a shipped world, path of a world file, or a `World`   |
    | robot         | `RobotSpec()`     | body, wheels and beams                                        |
    | sensor_noise  | None              | std of the ranges, m, or a range (low, high) drawn at reset; overrides `noise` |
    | noise         | `NoiseConfig()`   | all the noise there is                                        |
    | coverage_goal | 0.99              | see Episode End                                               |
    | rewards       | `RewardConfig()`  | see Rewards                                                   |
    | render_mode   | None              | `"rgb_array"` draws pictures                                  |

    `reset(options={"world": ...})` moves to another world.

    ## Version History
    * v0: first release.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as the base class declares it)
        "render_modes": ["rgb_array"],
        "render_fps": 10,
    }

    def __init__(
        self,
        world: WorldSource,
        *,
        robot: RobotSpec | None = None,
        sensor_noise: Setting | None = None,
        noise: NoiseConfig | None = None,
        coverage_goal: float | None = 0.99,
        rewards: RewardConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode must be one of {self.metadata['render_modes']} or None, not {render_mode!r}")
        self.render_mode = render_mode
        self.robot = robot or RobotSpec()
        self.task = TaskConfig(coverage_goal, rewards or RewardConfig())
        self.noise = _with_sensor_noise(noise or NoiseConfig(), sensor_noise)
        self._simulation = Simulation(load_world(world), self.robot)
        beams = self.robot
        limit = np.full(2, beams.max_wheel_travel, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space: spaces.Dict = spaces.Dict(  # type: ignore[assignment]
            {
                "ranges": spaces.Box(beams.min_ranges.astype(np.float32), beams.max_ranges.astype(np.float32)),
                "wheels": spaces.Box(-limit, limit),
            }
        )
        self._truth: Truth | None = None
        self._path: list[FloatArray] = []

    @property
    def world(self) -> World:
        """The world that the robot is in."""
        return self._simulation.world

    @property
    def coverage_grid(self) -> CoverageGrid:
        """The cells that count for coverage. Known after the first reset."""
        return self._simulation.coverage_grid

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a new episode; options: `start` (x, y, theta) and `world`.

        Raises
        ------
        ValueError
            If an option is unknown.
        WorldError
            If the world or the start cannot be used.
        """
        super().reset(seed=seed)
        options = options or {}
        unknown = sorted(set(options) - {"start", "world"})
        if unknown:
            raise ValueError(f"unknown reset option {unknown[0]!r}; there are 'start' and 'world'")
        start = _start(options.get("start"))
        simulation = Simulation(load_world(options["world"]), self.robot) if "world" in options else self._simulation
        seeds = np.random.SeedSequence(int(self.np_random.integers(2**63)))
        observations, truth = simulation.reset(seeds, self.noise, start)
        # A refused reset leaves the episode as it was.
        self._simulation, self._path = simulation, []
        return self._result(observations[0], truth)

    def step(
        self, action: NDArray[np.floating[Any]] | Sequence[float]
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for one control period.

        Raises
        ------
        ValueError
            If the action is not two finite numbers.
        """
        wheels = np.asarray(action, dtype=float)
        if wheels.shape != (2,) or not np.isfinite(wheels).all():
            raise ValueError(f"an action is two finite numbers, left and right wheel speed, not {action!r}")
        if self._truth is None:
            raise gym.error.ResetNeeded("call reset before step")
        observations, truth = self._simulation.step(wheels[None])
        observation, info = self._result(observations[0], truth)
        value = reward(self.task.reward, truth.new_area, bool(truth.contact[0]))
        return observation, float(value), is_done(self.task, truth.coverage), False, info

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3) of world, robot, beams and path; None without a render mode."""
        if self.render_mode is None or self._truth is None:
            return None
        from limslam_env.rendering import RenderState, render

        state = RenderState(
            self.world, self.robot, self._truth.poses, self._truth.wall_seen, self._ranges, [np.array(self._path)],
            self._truth.time, self._truth.coverage,
        )  # fmt: skip
        return render(state)

    def _result(self, observation: Observation, truth: Truth) -> tuple[Observation, dict[str, Any]]:
        self._truth = truth
        if self.render_mode is not None:
            self._path.append(truth.poses[0, :2])
            self._ranges = observation["ranges"][None].copy()
        info = {
            "pose": truth.poses[0].copy(),
            "time": truth.time,
            "coverage": truth.coverage,
            "collision": bool(truth.contact[0]),
            "wall_seen": truth.wall_seen[0].copy(),
        }
        return observation, info


def _with_sensor_noise(noise: NoiseConfig, sensor_noise: Setting | None) -> NoiseConfig:
    if sensor_noise is None:
        return noise
    return replace(noise, sensor_noise=sensor_noise)


def _start(option: Any) -> FloatArray | None:
    if option is None:
        return None
    start = np.asarray(option, dtype=float)
    if start.shape != (3,):
        raise ValueError(f"the start is (x, y, theta), not {option!r}")
    return start
