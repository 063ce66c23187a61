"""A wrapper for learning agents: the observation is what the SLAM believes instead of raw
readings.
"""

from collections.abc import Mapping, Sequence
from typing import Any, SupportsFloat, TypeAlias, cast

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from limslam_agent.belief import Belief
from limslam_agent.config import DEFAULT_PRESET
from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.config.tables import built
from limslam_agent.grid.occupancy import GridView
from limslam_agent.mapping.mapper import Mapper
from limslam_env.geometry import FloatArray
from limslam_env.geometry.numbers import plain
from limslam_env.geometry.se2 import between
from limslam_env.interface import NominalNoise, RobotSpec, largest_noise
from limslam_env.interface import Observation as Readings
from limslam_env.overlay import Overlay

_READINGS = ("ranges", "wheels", "yaw")

Observation: TypeAlias = dict[str, Any]

FARTHEST = 1000.0
"""Bound of the distance from the start in an observed pose, m."""

LARGEST_COVARIANCE = 1e6
"""Bound of the numbers of an observed covariance, m^2, m rad, rad^2."""

UNKNOWN = 0
FREE = 127
OCCUPIED = 255
"""Values of an observed grid's cells."""

_UPPER = np.triu_indices(3)
_FARTHEST = np.array([FARTHEST, FARTHEST, np.pi + 1e-6], dtype=np.float32)


class SlamObservation(
    gym.Wrapper[Observation, Any, Observation, Any], gym.utils.RecordConstructorArgs
):
    """Observe what the SLAM believes instead of raw readings. The start pose is the only truth that
    the SLAM gets.

    The observation is a `Dict` of new arrays:

    | Key        | Shape           | Type    | Meaning                                                               |
    |------------|-----------------|---------|-----------------------------------------------------------------------|
    | pose       | (3,)            | float32 | estimated pose relative to the start pose: m ahead, m left, rad       |
    | covariance | (6,)            | float32 | of the estimated pose in the world: xx, xy, xt, yy, yt, tt            |
    | grid       | (1, size, size) | uint8   | believed occupancy around the robot: 0 unknown, 127 free, 255 occupied |
    | ranges     | (n_beams,)      | float32 | the readings, m                                                       |

    The robot is in the middle of the grid, and its heading points up. The configuration sets the
    size of a cell, which is 0.10 m by default.

    `info` gets two more keys: `status` says whether the estimate can be trusted (`"ok"`, `"unsure"`
    or `"lost"`), and `status_reason` says in words why it cannot. The covariance grows while the
    robot is lost.

    Parameters
    ----------
    env
        A LimSlam environment for one robot whose observation holds unscaled `ranges` and `wheels`.
    agent_config
        Settings of the SLAM, with the noise that the SLAM is told. By default the preset `graph`
        with the nominal noise of the environment (its ``nominal_noise``): the data sheets of the
        robot are no secret. A table of all settings stands for them.
    size
        Side of the grid in cells.

    Attributes
    ----------
    mapper
        The `Mapper` that believes. Pictures of the environment show its belief over the truth.

    Raises
    ------
    ValueError
        If the size is below 1, the environment has no `robot`, or its observation has another form.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_agent import SlamObservation
    >>> env = SlamObservation(gym.make("LimSlam-Env1-v0", sensor_noise=0.02))
    >>> observation, info = env.reset(seed=0)
    >>> observation["grid"].shape, info["status"]
    ((1, 40, 40), 'ok')
    """

    def __init__(
        self,
        env: gym.Env[Observation, Any],
        agent_config: AgentConfig | Mapping[str, Any] | None = None,
        size: int = 40,
    ) -> None:
        # With its arguments in the environment's spec, Gymnasium and Minari can make the wrapped
        # environment again.
        gym.utils.RecordConstructorArgs.__init__(self, agent_config=plain(agent_config), size=size)
        super().__init__(env)
        if size < 1:
            raise ValueError(f"a grid needs at least one cell, not {size}")
        robot = getattr(env.unwrapped, "robot", None)
        if not isinstance(robot, RobotSpec):
            raise ValueError(f"{env.unwrapped} has no LimSLAM robot")  # noqa: TRY004 (a wrong value)
        ranges = ranges_space(env.observation_space, robot)
        if isinstance(agent_config, Mapping):
            agent_config = built(AgentConfig, agent_config, "agent_config")
        self.mapper = Mapper(
            robot, agent_config or default_config([getattr(env.unwrapped, "nominal_noise", None)])
        )
        self._start = np.zeros(3)
        self.observation_space = belief_space(ranges, size)
        self._size = size

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Any]:
        """Start a new episode with an empty map. Of `info`, only the start pose is used."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._start = np.array(info["pose"], dtype=float)
        self.mapper.reset(self._start)
        return self._believed(observation), self._with_status(info)

    def step(self, action: Any) -> tuple[Observation, SupportsFloat, bool, bool, Any]:
        """Drive for one control period and give the new observation to the SLAM."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._believed(observation), reward, terminated, truncated, self._with_status(info)

    @property
    def belief(self) -> Belief:
        """What the SLAM believes now, for a policy."""
        return self.mapper.belief

    def _believed(self, observation: Observation) -> Observation:
        known = {name: observation[name] for name in _READINGS if name in observation}
        self.mapper.step(cast(Readings, known))
        belief = self.mapper.belief
        if self.render_mode is not None:
            shown: Any = self.unwrapped
            shown.overlay = Overlay(belief.pose, belief.covariance, belief.segments)
        return observed_belief(belief, self._start, observation["ranges"], self._size)

    def _with_status(self, info: Any) -> dict[str, Any]:
        """The info with the status after the latest observation."""
        status = self.mapper.statuses[0]
        return {**info, "status": status.level, "status_reason": status.reason}


def default_config(noises: Sequence[NominalNoise | None]) -> AgentConfig:
    """The default preset for environments with these nominal noises. None means that a noise is
    unknown.
    """
    known = [noise for noise in noises if noise is not None]
    return preset(DEFAULT_PRESET, largest_noise(known) if known else None)


def belief_space(ranges: spaces.Box, size: int) -> spaces.Dict:
    """The observation space, with the readings' space ``ranges`` and a grid of ``size`` cells a
    side.
    """
    return spaces.Dict(
        {
            "pose": spaces.Box(-_FARTHEST, _FARTHEST),
            "covariance": spaces.Box(-LARGEST_COVARIANCE, LARGEST_COVARIANCE, (6,), np.float32),
            "grid": spaces.Box(0, 255, (1, size, size), np.uint8),
            "ranges": ranges,
        }
    )


def observed_belief(
    belief: Belief, start: FloatArray, ranges: NDArray[Any], size: int
) -> Observation:
    """The observation of one robot, in new arrays.

    Parameters
    ----------
    belief
        What the robot believes.
    start
        Its start pose (3,), m and rad.
    ranges
        Its latest readings (n_beams,), m.
    size
        Side of the observed grid in cells.
    """
    return {
        "pose": observed_pose(start, belief.pose),
        "covariance": observed_covariance(belief.covariance),
        "grid": crop(belief.grid, belief.pose, size)[None],
        "ranges": np.array(ranges),
    }


def crop(grid: GridView, pose: FloatArray, size: int) -> NDArray[np.uint8]:
    """The grid (size, size) around a robot at ``pose`` (3,), m and rad, which is in the middle and
    looks up.
    """
    (rows, columns), (cos, sin) = grid.values.shape, (np.cos(pose[2]), np.sin(pose[2]))
    away = (0.5 * (size - 1) - np.arange(size)) * grid.cell
    ahead, left, (x, y) = away[:, None], away[None], pose[:2] - grid.low
    row = np.floor((ahead * sin + left * cos + y) / grid.cell).astype(int)
    column = np.floor((ahead * cos - left * sin + x) / grid.cell).astype(int)
    is_known = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    values = np.where(is_known, grid.values[row.clip(0, rows - 1), column.clip(0, columns - 1)], 0)
    return np.asarray(np.array([OCCUPIED, UNKNOWN, FREE], dtype=np.uint8)[np.sign(values) + 1])


def observed_pose(start: FloatArray, pose: FloatArray) -> NDArray[np.float32]:
    """A pose (..., 3) relative to the start (..., 3), clipped to the bounds of the space."""
    return np.clip(between(start, pose).astype(np.float32), -_FARTHEST, _FARTHEST)


def observed_covariance(covariance: FloatArray) -> NDArray[np.float32]:
    """The upper triangle (..., 6) of a covariance (..., 3, 3), clipped to the bounds of the
    space.
    """
    upper = covariance[..., *_UPPER]
    return np.clip(upper, -LARGEST_COVARIANCE, LARGEST_COVARIANCE).astype(np.float32)


def ranges_space(space: gym.Space[Any], robot: RobotSpec) -> spaces.Box:
    """The part of a robot's observation space that holds the readings.

    Raises
    ------
    ValueError
        If the observation does not hold unscaled ranges and wheels.
    """
    if not isinstance(space, spaces.Dict) or not {"ranges", "wheels"} <= set(space.spaces):
        raise ValueError(f"the observation must hold ranges and wheels, not {space}")
    ranges = space["ranges"]
    if not isinstance(ranges, spaces.Box) or not np.array_equal(
        ranges.high, robot.max_ranges.astype(np.float32)
    ):
        raise ValueError(f"ranges must be those of the robot, in metres, not {ranges}")
    return ranges
