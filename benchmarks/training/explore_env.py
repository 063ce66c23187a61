"""The batched environment for a learned explorer: polar views of each robot's grid, and headings as
actions.
"""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from limslam_agent.config.presets import GridConfig
from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.policies.controller import CollisionGuard
from limslam_agent.policies.learned.learned import HOLD, wheels_towards
from limslam_agent.policies.learned.polar_view import ViewConfig, observe
from limslam_env.geometry import BoolArray, FloatArray, ReadingArray
from limslam_env.interface import RobotSpec

VIEW = ViewConfig()
REWARD_SCALE = 0.2


class _Explorer:
    """The grid and the collision guard of one robot in one episode, from noisy readings at true
    poses.
    """

    def __init__(self, robot: RobotSpec, pose: FloatArray, ranges: ReadingArray) -> None:
        self._robot = robot
        self._grid = OccupancyGrid(GridConfig())
        self._guard = CollisionGuard(robot)
        self.take_in(pose, ranges)

    def take_in(self, pose: FloatArray, ranges: ReadingArray) -> None:
        self.pose = np.array(pose)
        self._ranges = ranges.astype(float)
        self._grid.update(self.pose, self._robot, self._ranges, np.ones(len(ranges), dtype=bool))
        self._guard.add_readings(self.pose, self._ranges)

    def look(self) -> NDArray[np.float32]:
        return observe(self._grid.view, self.pose, self._ranges, self._robot, VIEW)

    def wheels(self, heading: float) -> FloatArray:
        return self._guard.limit_speed(self.pose, wheels_towards(heading, self.pose, self._robot))


class ExploreVectorEnv(gym.vector.VectorWrapper):
    """Many robots that see and drive as `LearnedPolicy` does, by their true poses, and whose
    actions are headings.

    Training on what an estimator believes gained nothing, so that no estimator is asked.

    An action is the number of a direction, counter-clockwise from straight ahead. The robot turns
    to this direction and drives at full speed for ``HOLD`` steps. Its collision guard keeps it away
    from observed obstacles. The reward is the sum of the rewards of the steps, scaled.

    Parameters
    ----------
    env
        Environments that end an episode and begin the next episode in the same step, with the
        default kind of robot: observations with ``ranges`` (n, n_beams), info with ``pose`` (n, 3).

    Attributes
    ----------
    touches
        How often each robot (n,) has begun to touch something since the last reset.

    Raises
    ------
    ValueError
        If the environments begin episodes in another way.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any]) -> None:
        super().__init__(env)
        if env.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
            raise ValueError(
                "episodes must begin in the step in which others end: autoreset_mode='SameStep'"
            )
        self.robot: RobotSpec = env.unwrapped.robot  # type: ignore[attr-defined]
        self.single_action_space = spaces.Discrete(VIEW.directions)
        # What driving ahead would show has no smaller bound.
        self.single_observation_space = spaces.Box(
            -1.0, 5.0, (VIEW.size(len(self.robot.beams)),), np.float32
        )
        self.action_space = batch_space(self.single_action_space, env.num_envs)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self.touches = np.zeros(env.num_envs, dtype=np.int64)
        self._in_contact = np.zeros(env.num_envs, dtype=bool)
        self._explorers: list[_Explorer] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Reset all environments and empty the grids."""
        told, info = self.env.reset(seed=seed, options=options)
        self._in_contact[:] = False
        self.touches[:] = 0
        self._explorers = [
            _Explorer(self.robot, pose, ranges)
            for pose, ranges in zip(info["pose"], told["ranges"], strict=True)
        ]
        return self._views(), info

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[np.float32], FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Drive with headings ``actions`` (n,) for some steps.

        A robot whose episode ends early waits in its next episode.
        """
        headings = [
            each.pose[2] + VIEW.angle(action)
            for each, action in zip(self._explorers, actions, strict=True)
        ]
        rewards, terminated, truncated = (
            np.zeros(self.num_envs),
            *np.zeros((2, self.num_envs), dtype=bool),
        )
        final = np.full(self.num_envs, None, dtype=object)
        for _ in range(HOLD):
            over = terminated | truncated
            wheels = [
                each.wheels(heading)
                for each, heading in zip(self._explorers, headings, strict=True)
            ]
            told, reward, ended, cut, info = self.env.step(np.where(over[:, None], 0.0, wheels))
            rewards += np.where(over, 0.0, reward)
            contact = np.asarray(info["collision"], dtype=bool)
            self.touches += contact & ~self._in_contact
            self._in_contact = contact
            for number in range(self.num_envs):
                if ended[number] or cut[number]:
                    last = info["final_info"]["pose"][number], info["final_obs"][number]["ranges"]
                    self._explorers[number].take_in(*last)
                    final[number] = self._explorers[number].look()
                    self._explorers[number] = _Explorer(
                        self.robot, info["pose"][number], told["ranges"][number]
                    )
                else:
                    self._explorers[number].take_in(info["pose"][number], told["ranges"][number])
            terminated = terminated | ended
            truncated = truncated | cut
        over = terminated | truncated
        info = {**info, "final_obs": final, "_final_obs": over} if over.any() else info
        return self._views(), REWARD_SCALE * rewards, terminated, truncated, info

    def _views(self) -> NDArray[np.float32]:
        return np.stack([explorer.look() for explorer in self._explorers])
