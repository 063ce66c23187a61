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
from gymnasium.wrappers import FlattenObservation, FrameStackObservation
from numpy.typing import NDArray
from scipy import ndimage

from limslam_env.envs.env import LimSlamEnv
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.geometry.segment import sample
from limslam_env.geometry.shapes import places_around
from limslam_env.simulation.coverage import CELL

__all__ = [
    "DiscreteAction",
    "FlattenObservation",
    "FrameStackObservation",
    "NormalizedObservation",
    "PrivilegedLocalMap",
    "VelocityAction",
]

Observation: TypeAlias = dict[str, Any]
Env: TypeAlias = gym.Env[Observation, Any]

UNSEEN = 0
FREE = 127
WALL = 255
"""Values of a local map's cells."""

FORWARD = (1.0, 1.0)
LEFT = (-0.4, 0.4)
RIGHT = (0.4, -0.4)
"""Wheel speeds of the usual discrete actions, fractions of the maximum."""


class NormalizedObservation(gym.ObservationWrapper[Observation, Any, Observation]):
    """Ranges from 0 (a beam's shortest) to 1 (its longest, or nothing seen), wheel travel from -1
    to 1.

    Parameters
    ----------
    env
        An environment with ``ranges`` and ``wheels`` in its observation; other keys stay as they
        are.
    """

    def __init__(self, env: Env) -> None:
        super().__init__(env)
        space = _dict_space(env)
        self._ranges = _box(space, "ranges")
        self._wheels = _box(space, "wheels")
        scaled = {
            "ranges": spaces.Box(0.0, 1.0, self._ranges.shape, np.float32),
            "wheels": spaces.Box(-1.0, 1.0, self._wheels.shape, np.float32),
        }
        self.observation_space = spaces.Dict({**space.spaces, **scaled})

    def observation(self, observation: Observation) -> Observation:
        """The observation, scaled."""
        low = self._ranges.low
        high = self._ranges.high
        ranges = np.clip((observation["ranges"] - low) / (high - low), 0.0, 1.0)
        wheels = np.clip(observation["wheels"] / self._wheels.high, -1.0, 1.0)
        return {
            **observation,
            "ranges": ranges.astype(np.float32),
            "wheels": wheels.astype(np.float32),
        }


class VelocityAction(gym.ActionWrapper[Observation, NDArray[np.floating[Any]], Any]):
    """Act by (v, omega): speed ahead and rate of turn (counter-clockwise), each a fraction of its
    maximum, -1 to 1.

    At 1 and 0 both wheels run at full speed ahead, at 0 and 1 they run against each other. Where
    both together ask a wheel for more than it can, both are scaled down, so that the curve stays
    the same.
    """

    def __init__(self, env: Env) -> None:
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


class DiscreteAction(gym.ActionWrapper[Observation, int, Any]):
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


class PrivilegedLocalMap(gym.Wrapper[Observation, Any, Observation, Any]):
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


def _box(space: spaces.Dict, key: str) -> spaces.Box:
    box = space[key]
    if isinstance(box, spaces.Box):
        return box
    raise ValueError(f"{key} must be a Box, not {box}")
