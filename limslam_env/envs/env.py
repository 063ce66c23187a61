"""The single-robot environment of Gymnasium: a thin adapter over the simulation."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from limslam_env.config import NoiseConfig, RewardConfig, Setting
from limslam_env.envs.adapter import (
    Action,
    PlaceSource,
    Staged,
    action_space,
    info_of,
    observation_of,
    observation_space,
    wheel_speeds,
)
from limslam_env.interface import Observation, RobotSpec
from limslam_env.rendering.painter import RENDER_FPS, RENDER_MODES
from limslam_env.simulation.task import is_done, reward


class LimSlamEnv(Staged, gym.Env[Observation, NDArray[np.floating[Any]]]):
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
    `wall_seen` (n_beams,) int, the wall that each beam hit, -1 for nothing
    (-2 for another robot, where there are several). The `pose` that `reset`
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
    | world         | the id's world    | name of a shipped world, path of a world file, a `World`, or a `FloorPlanConfig` (`"random"` for the default one) that draws a floor plan at each reset |
    | robot         | `RobotSpec()`     | body, wheels and beams                                        |
    | sensor_noise  | None              | std of the ranges, m, or a range (low, high) drawn at reset; overrides `noise` |
    | noise         | `NoiseConfig()`   | all the noise there is                                        |
    | coverage_goal | 0.99              | see Episode End                                               |
    | rewards       | `RewardConfig()`  | see Rewards                                                   |
    | render_mode   | None              | `"rgb_array"` draws pictures, `"human"` shows them in a window (extra `play`) |

    `reset(options={"world": ...})` takes another world for one episode; the next reset is back in the env's own.

    ## Version History
    * v0: first release.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as the base class declares it)
        "render_modes": list(RENDER_MODES),
        "render_fps": RENDER_FPS,
    }

    def __init__(
        self,
        world: PlaceSource,
        *,
        robot: RobotSpec | None = None,
        sensor_noise: Setting | None = None,
        noise: NoiseConfig | None = None,
        coverage_goal: float | None = 0.99,
        rewards: RewardConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._set_up(world, 1, robot, sensor_noise, noise, coverage_goal, rewards, render_mode)
        self.action_space = action_space()  # type: ignore[assignment]
        self.observation_space = observation_space(self.robot)  # type: ignore[assignment]

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
        readings, truth = self._stage.reset(self.np_random, options)
        self._painter.follow(self._stage.simulation, readings, truth)
        return observation_of(readings, 0), info_of(truth, 0)

    def step(self, action: Action) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for one control period.

        Raises
        ------
        ValueError
            If the action is not two finite numbers.
        gymnasium.error.ResetNeeded
            If there was no reset yet.
        """
        readings, truth = self._stage.step((wheel_speeds(action),))
        self._painter.follow(self._stage.simulation, readings, truth)
        value = reward(self.task.reward, truth.new_area[0], truth.contact[0])
        is_over = is_done(self.task, truth.coverage)
        return observation_of(readings, 0), value, is_over, False, info_of(truth, 0)
