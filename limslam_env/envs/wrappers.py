"""Wrappers around :class:`limslam_env.envs.env.LimSlamEnv` that are common in reinforcement
learning.

Flat vectors and stacked frames are Gymnasium's own wrappers, named here so that they are found:
``FlattenObservation(FrameStackObservation(env, 4))``.
"""

from collections.abc import Sequence
from typing import Any, SupportsFloat, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from gymnasium.wrappers import FlattenObservation, FrameStackObservation
from numpy.typing import NDArray
from scipy import ndimage

from limslam_env.envs.env import LimSlamEnv
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.numbers import LARGEST_COORDINATE, check_number, plain
from limslam_env.geometry.se2 import transform_points
from limslam_env.geometry.segment import sample
from limslam_env.geometry.shapes import places_around
from limslam_env.simulation.coverage import CELL

__all__ = [
    "DiscreteAction",
    "FlattenObservation",
    "FrameStackObservation",
    "NormalizedObservation",
    "NormalizedVectorObservation",
    "PrivilegedLocalMap",
    "VelocityAction",
]

Observation: TypeAlias = dict[str, Any]
Env: TypeAlias = gym.Env[Observation, Any]

UNSEEN = 0
FREE = 127
WALL = 255
"""Values of a local map's cells."""

_LOWEST = {"ranges": 0.0, "wheels": -1.0, "pose": -1.0, "std": 0.0}
"""Bounds of what is scaled, up to 1."""

_VARIANCES = [0, 3, 5]
"""Places of the variances in the upper triangle of a pose's covariance."""

FORWARD = (1.0, 1.0)
LEFT = (-0.4, 0.4)
RIGHT = (0.4, -0.4)
"""Wheel speeds of the usual discrete actions, fractions of the maximum."""


class NormalizedObservation(
    gym.ObservationWrapper[Observation, Any, Observation], gym.utils.RecordConstructorArgs
):
    """Readings and beliefs, scaled to what networks learn from.

    | Key        | Becomes                                                                      |
    |------------|------------------------------------------------------------------------------|
    | ranges     | from 0 (a beam's shortest) to 1 (its longest, or nothing seen)               |
    | wheels     | from -1 to 1                                                                 |
    | pose       | (4,), -1 to 1: place as a share of ``reach``, cosine and sine of the heading |
    | covariance | ``std`` (3,), 0 to 1: standard deviations of the pose (m, m, rad), at most 1 |

    Other keys stay as they are.

    Parameters
    ----------
    env
        An environment with ``ranges`` in its observation, such as ``SlamObservation``.
    reach
        Distance from the start at which a place is 1, m.

    Raises
    ------
    ValueError
        If there are no ranges, or the reach is not above 0.

    Examples
    --------
    >>> import gymnasium as gym
    >>> from limslam_agent import SlamObservation
    >>> from limslam_env.envs.wrappers import NormalizedObservation
    >>> env = NormalizedObservation(SlamObservation(gym.make("LimSlam-Env1-v0")))
    >>> {key: part.shape for key, part in env.reset(seed=0)[0].items()}
    {'ranges': (6,), 'grid': (1, 40, 40), 'pose': (4,), 'std': (3,)}
    """

    def __init__(self, env: Env, reach: float = 10.0) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, reach=plain(reach))
        super().__init__(env)
        self._scaling = _Scaling(env.observation_space, reach)
        self.observation_space = self._scaling.space

    def observation(self, observation: Observation) -> Observation:
        """The observation, scaled."""
        return self._scaling.scaled(observation)


class NormalizedVectorObservation(VectorWrapper):  # type: ignore[type-arg, misc, unused-ignore]
    """`NormalizedObservation` for a batch of environments, also for its ``final_obs``.

    Examples
    --------
    >>> import gymnasium as gym
    >>> from limslam_env.envs.wrappers import NormalizedVectorObservation
    >>> envs = NormalizedVectorObservation(gym.make_vec("LimSlam-Env1-v0", num_envs=4))
    >>> float(envs.reset(seed=0)[0]["ranges"].max())
    1.0
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], reach: float = 10.0) -> None:
        super().__init__(env)
        self._scaling = _Scaling(env.single_observation_space, reach)
        self.single_observation_space = self._scaling.space
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: Any = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start new episodes."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._scaling.scaled(observation), info

    def step(self, actions: Any) -> tuple[Observation, Any, Any, Any, dict[str, Any]]:
        """Drive for one control period."""
        observation, rewards, terminated, truncated, info = self.env.step(actions)
        for place in np.flatnonzero(info.get("_final_obs", ())):
            info["final_obs"][place] = self._scaling.scaled(info["final_obs"][place])
        return self._scaling.scaled(observation), rewards, terminated, truncated, info


class _Scaling:
    """How the parts of an observation are scaled, of one environment or of many in rows."""

    def __init__(self, space: gym.Space[Any], reach: float) -> None:
        if not isinstance(space, spaces.Dict) or "ranges" not in space.spaces:
            raise ValueError(f"the observation must hold ranges, not {space}")
        check_number("the reach", reach, 1e-3, LARGEST_COORDINATE, "m")
        self._parts = space
        self._reach = reach
        example = {key: np.zeros(part.shape or ()) for key, part in space.items()}
        self.space = spaces.Dict(
            {
                key: spaces.Box(_LOWEST[key], 1.0, part.shape, np.float32)
                if key in _LOWEST
                else space[key]
                for key, part in self.scaled(example).items()
            }
        )

    def scaled(self, seen: Observation) -> Observation:
        """The observation, in new arrays where it is scaled."""
        ranges: Any = self._parts["ranges"]
        found = {"ranges": (seen["ranges"] - ranges.low) / (ranges.high - ranges.low)}
        kept = {key: part for key, part in seen.items() if key != "covariance"}
        if "wheels" in seen:
            wheels: Any = self._parts["wheels"]
            found["wheels"] = seen["wheels"] / wheels.high
        if "pose" in seen:
            place, heading = seen["pose"][..., :2], seen["pose"][..., 2:]
            turned = np.cos(heading), np.sin(heading)
            found["pose"] = np.concatenate((place / self._reach, *turned), axis=-1)
        if "covariance" in seen:
            found["std"] = np.sqrt(seen["covariance"][..., _VARIANCES].clip(0.0))
        return kept | {
            key: part.clip(_LOWEST[key], 1.0).astype(np.float32) for key, part in found.items()
        }


class VelocityAction(
    gym.ActionWrapper[Observation, NDArray[np.floating[Any]], Any], gym.utils.RecordConstructorArgs
):
    """Act by (v, omega): speed ahead and rate of turn (counter-clockwise), each a fraction of its
    maximum, -1 to 1.

    At 1 and 0 both wheels run at full speed ahead, at 0 and 1 they run against each other. Where
    both together ask a wheel for more than it can, both are scaled down, so that the curve stays
    the same.
    """

    def __init__(self, env: Env) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)

    def action(self, action: NDArray[np.floating[Any]]) -> NDArray[np.float32]:
        """Left and right wheel speed.

        Raises
        ------
        ValueError
            If the action is not two numbers.
        """
        if np.shape(action) != (2,):
            raise ValueError(f"an action is two finite numbers, v and omega, not {action!r}")
        ahead, turn = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        wheels = np.array([ahead - turn, ahead + turn])
        return np.asarray(wheels / max(1.0, float(np.abs(wheels).max())), dtype=np.float32)


class DiscreteAction(gym.ActionWrapper[Observation, int, Any], gym.utils.RecordConstructorArgs):
    """Act by the number of a move: ahead, turn left, turn right, unless ``moves`` says otherwise.

    Parameters
    ----------
    env
        An environment that takes wheel speeds.
    moves
        Left and right wheel speed of each move, fractions of the maximum.

    Raises
    ------
    ValueError
        If the moves are no pairs from -1 to 1.
    """

    def __init__(
        self, env: Env, moves: Sequence[tuple[float, float]] = (FORWARD, LEFT, RIGHT)
    ) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, moves=plain(moves))
        super().__init__(env)
        self._moves = np.array(moves, dtype=np.float32)
        if (
            self._moves.ndim != 2
            or self._moves.shape[1] != 2
            or not (np.abs(self._moves) <= 1.0).all()
        ):
            raise ValueError(f"moves are pairs of wheel speeds from -1 to 1, not {moves!r}")
        self.action_space = spaces.Discrete(len(self._moves))  # type: ignore[assignment]

    def action(self, action: int) -> NDArray[np.float32]:
        """Left and right wheel speed.

        Raises
        ------
        ValueError
            If there is no such move.
        """
        if not self.action_space.contains(action):
            raise ValueError(
                f"an action is the number of a move, 0 to {len(self._moves) - 1}, not {action!r}"
            )
        return np.array(self._moves[action])


class PrivilegedLocalMap(
    gym.Wrapper[Observation, Any, Observation, Any], gym.utils.RecordConstructorArgs
):
    """Add ``local_map``: the cells seen so far around the robot's true pose. **Privileged**: it
    uses the ground truth.

    A picture (1, size, size), uint8, of 0.10 m cells with the robot in the middle, looking up: 0
    where nothing has been seen, 127 free, 255 walls. Good for teachers, upper bounds and debugging;
    an agent that is to run on a robot must do without.

    Parameters
    ----------
    env
        A LimSlam environment for one robot, wrapped or not.
    size
        Side of the map in cells.

    Raises
    ------
    ValueError
        If the size is below 1, or the environment is no LimSlam environment for one robot.
    """

    def __init__(self, env: Env, size: int = 40) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, size=size)
        super().__init__(env)
        if size < 1:
            raise ValueError(f"a local map needs at least one cell, not {size}")
        truth = env.unwrapped
        if not isinstance(truth, LimSlamEnv):
            raise ValueError(f"there is no truth to show in {truth}")  # noqa: TRY004 (a wrong value, to its user)
        self._truth = truth
        picture = spaces.Box(0, 255, (1, size, size), np.uint8)
        self.observation_space = spaces.Dict({**_dict_space(env).spaces, "local_map": picture})
        self._places = places_around(size, CELL)
        self._size = size
        self._walls = np.zeros((0, 0), dtype=bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Any]:
        """Start a new episode."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._walls = self._wall_cells()
        return {**observation, "local_map": self._local_map(info["pose"])}, info

    def step(self, action: Any) -> tuple[Observation, SupportsFloat, bool, bool, Any]:
        """Drive for one control period."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return (
            {**observation, "local_map": self._local_map(info["pose"])},
            reward,
            terminated,
            truncated,
            info,
        )

    def _wall_cells(self) -> BoolArray:
        grid = self._truth.coverage_grid
        points, _ = sample(self._truth.world.edges, 0.5 * CELL)
        # One more row and column: walls stand on the grid's far border, too.
        walls = np.zeros(np.add(grid.coverable.shape, 1), dtype=bool)
        column, row = np.floor((points - grid.low) / CELL + 1e-6).astype(int).T
        walls[row, column] = True
        return walls

    def _local_map(self, pose: FloatArray) -> NDArray[np.uint8]:
        seen = np.pad(self._truth.seen, ((0, 1), (0, 1)))
        cells = np.where(seen, FREE, UNSEEN)
        cells[self._walls & ndimage.binary_dilation(seen, np.ones((3, 3), dtype=bool))] = WALL
        column, row = (
            np.floor((transform_points(pose, self._places) - self._truth.coverage_grid.low) / CELL)
            .astype(int)
            .T
        )
        is_inside = (row >= 0) & (row < cells.shape[0]) & (column >= 0) & (column < cells.shape[1])
        picture = np.zeros(self._size**2, dtype=np.uint8)
        picture[is_inside] = cells[row[is_inside], column[is_inside]]
        return picture.reshape(1, self._size, self._size)


def _dict_space(env: Env) -> spaces.Dict:
    space = env.observation_space
    if not isinstance(space, spaces.Dict) or not {"ranges", "wheels"} <= set(space.spaces):
        raise ValueError(f"the observation must hold ranges and wheels, not {space}")
    return space
