"""The Gymnasium environment with one robot: an adapter of the simulation to Gymnasium's
interface.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from limslam_env.config import NoiseConfig, RewardConfig, Setting
from limslam_env.envs.adapter import (
    Action,
    SimulationEnv,
    action_space,
    info_of,
    observation_of,
    observation_space,
    wheel_speeds,
)
from limslam_env.envs.arguments import PlaceSource
from limslam_env.interface import Observation, RobotSpec
from limslam_env.rendering.painter import RENDER_MODES


class LimSlamEnv(SimulationEnv, gym.Env[Observation, NDArray[np.floating[Any]]]):
    """Explore an unknown building with a few range beams and wheel encoders.

    ## Description
    A round differential-drive robot explores a building without a map. Its sensors are a few range
    beams, which measure the distance to the nearest wall, and two wheel encoders, which measure the
    travel of the wheels. All measurements are noisy. The task is to see every visible part of the
    building.

    ## Action Space
    `Box(-1.0, 1.0, (2,), float32)`

    | Num | Action            | Min | Max | Unit                         |
    |-----|-------------------|-----|-----|------------------------------|
    | 0   | left wheel speed  | -1  | 1   | fraction of maximum speed    |
    | 1   | right wheel speed | -1  | 1   | fraction of maximum speed    |

    Values outside of these bounds are clipped. NaN, infinity and wrong shapes raise a `ValueError`.

    ## Observation Space
    A `Dict` of two `Box` spaces, float32. The arrays are new at each step:

    | Key    | Shape      | Min                  | Max                 | Unit | Meaning                                             |
    |--------|------------|----------------------|---------------------|------|-----------------------------------------------------|
    | ranges | (n_beams,) | the beams' min_range | the beams' max_range| m    | distance along each beam; max_range without a hit   |
    | wheels | (2,)       | -max_wheel_travel    | max_wheel_travel    | m    | left and right wheel travel since the last step     |

    With `imu=True` there is a third key: `yaw` (1,), from -pi to pi, rad, is the heading by an
    inertial measurement unit, counter-clockwise, in a frame of its own that drifts.

    The default robot's beams point at +90, +45, +15, -15, -45 and -90 degrees and reach from 0.05
    to 1.5 m; `max_wheel_travel` is 0.06 m.

    ## Info
    `info` holds the ground truth. It is meant for evaluation, not for agents. The exception is the
    `pose` that `reset` returns: it is the start pose, which an agent may know.

    | Key       | Type              | Unit      | Meaning                                                                 |
    |-----------|-------------------|-----------|-------------------------------------------------------------------------|
    | pose      | (3,) float        | m, m, rad | true pose x, y, theta                                                   |
    | time      | float             | s         | time since the reset                                                    |
    | coverage  | float, 0 to 1     |           | fraction of the coverable cells that have been seen                     |
    | collision | bool              |           | whether the robot touches a wall, an obstacle or another robot          |
    | cost      | float             |           | 1 in a step in contact, else 0, for learning under constraints          |
    | wall_seen | (n_beams,) int    |           | index of the wall that each beam hit; -1 for no hit, -2 for a robot     |

    ## Rewards
    The reward of a step is the sum of three terms (`RewardConfig`):

    | Term      | Default | Meaning                                                    |
    |-----------|---------|------------------------------------------------------------|
    | new_area  | 1       | for each square metre that is seen for the first time      |
    | step      | -0.001  | for each step                                              |
    | collision | -0.05   | for each step in which the robot touches something         |

    ## Starting State
    The robot starts at the world's first start pose. If the world has none, the pose is random (by
    the seed). `reset(options={"start": (x, y, theta)})` sets the start pose.

    ## Episode End
    The episode terminates when `coverage` reaches `coverage_goal` (default 0.99); with `None` it
    never terminates. An environment made by `gymnasium.make` truncates the episode after
    `max_episode_steps` steps (18000 by default: 30 minutes).

    ## Arguments
    | Argument      | Default           | Meaning                                                       |
    |---------------|-------------------|---------------------------------------------------------------|
    | world         | the id's world    | name of an included world, path of a world file, a `World`, or a `FloorPlanConfig` for a random floor plan at each reset (`"random"` for the default settings) |
    | robot         | `RobotSpec()`     | body, wheels and beams                                        |
    | sensor_noise  | None              | standard deviation of the ranges, m, or an interval (low, high) to draw it from at each reset; overrides `noise` |
    | noise         | `NoiseConfig()`   | noise of the ranges, the wheels and the heading               |
    | imu           | False             | whether the heading is observed, as `yaw`                     |
    | coverage_goal | 0.99              | see Episode End                                               |
    | rewards       | `RewardConfig()`  | see Rewards                                                   |
    | render_mode   | None              | `"rgb_array"` draws pictures, `"human"` shows them in a window (extra `play`) |

    `reset(options={"world": ...})` uses another world for one episode; later resets use the
    environment's own world.

    ## Version History
    * v0: first release.

    Raises
    ------
    ValueError
        If an argument is out of bounds.
    WorldError
        If the world cannot be used.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> env = gym.make("LimSlam-Env1-v0", sensor_noise=0.02)
    >>> observation, info = env.reset(seed=0)
    >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    >>> observation["ranges"].shape, observation["wheels"].shape
    ((6,), (2,))
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (as the base class declares it)
        "render_modes": list(RENDER_MODES),
    }

    def __init__(
        self,
        world: PlaceSource,
        *,
        robot: RobotSpec | None = None,
        sensor_noise: Setting | None = None,
        noise: NoiseConfig | None = None,
        imu: bool = False,
        coverage_goal: float | None = 0.99,
        rewards: RewardConfig | None = None,
        render_mode: str | None = None,
    ) -> None:
        self._set_up(
            world,
            1,
            render_mode,
            robot=robot,
            sensor_noise=sensor_noise,
            noise=noise,
            imu=imu,
            coverage_goal=coverage_goal,
            rewards=rewards,
        )
        self.action_space = action_space()  # type: ignore[assignment]
        self.observation_space = observation_space(self.robot, imu=imu)  # type: ignore[assignment]

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
        readings, truth = self._begin(self.np_random, options)
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
        readings, truth = self._drive((wheel_speeds(action),))
        value = self.task.reward.of_step(truth.new_area[0], truth.contact[0])
        is_over = self.task.is_over(truth.coverage)
        return observation_of(readings, 0), value, is_over, False, info_of(truth, 0)
