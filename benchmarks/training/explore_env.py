"""The batched environment for a learned explorer: polar views of each robot's grid, and headings as actions."""

from dataclasses import dataclass, field
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from benchmarks.training.explore_kernels import look_round, steer, take_in
from limslam_agent.config.presets import GridConfig, preset
from limslam_agent.policies.collision_guard import MEMORY
from limslam_agent.policies.learned.learned import DriveConfig
from limslam_agent.policies.learned.polar_view import ViewConfig
from limslam_agent.slam.batch.batch_slam import BatchSlam
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import NominalNoise, RobotSpec

PoseSource = Literal["true", "odometry", "belief"]

SIDE = 256
"""Cells along a side of a grid, which extends half as far from the start."""


@dataclass(frozen=True)
class ExploreConfig:
    """The observation and the motion of a learned explorer.

    Attributes
    ----------
    view, drive, grid
        Settings as for `LearnedPolicy` and for the agent's grid.
    pose
        The pose by which the grid is drawn. ``true`` is the true pose, which no robot knows. ``odometry`` is the pose
        from wheel odometry since the start. ``belief`` is the pose of the consistent estimator after the same readings.
    range_std
        Standard deviation of the ranges that the estimator assumes, m.
    reward_scale
        Scale factor of the environment's rewards.
    """

    view: ViewConfig = field(default_factory=ViewConfig)
    drive: DriveConfig = field(default_factory=DriveConfig)
    grid: GridConfig = field(default_factory=GridConfig)
    pose: PoseSource = "true"
    range_std: float = 0.02
    reward_scale: float = 0.2


class ExploreVectorEnv(gym.vector.VectorWrapper):
    """Many robots, each with an occupancy grid from its noisy ranges, whose actions are headings.

    An action is the number of a direction, counter-clockwise from straight ahead. The robot turns to this direction and
    drives at full speed for ``drive.hold`` steps. Its collision guard keeps it away from observed obstacles. The reward
    is the sum of the rewards of the steps.

    Parameters
    ----------
    env
        Environments that end an episode and begin the next episode in the same step, with the default kind of robot:
        observations with ``ranges`` (n, n_beams) and ``wheels`` (n, 2), info with ``pose`` (n, 3).
    config
        Settings of observation and motion.

    Raises
    ------
    ValueError
        If the environments begin episodes in another way, or do not describe their robot.
    """

    def __init__(self, env: gym.vector.VectorEnv[Any, Any, Any], config: ExploreConfig | None = None) -> None:
        super().__init__(env)
        robot = getattr(env.unwrapped, "robot", None)
        if not isinstance(robot, RobotSpec):
            raise ValueError(f"{env.unwrapped} has no robot of LimSLAM")  # noqa: TRY004 (a wrong value)
        if env.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
            raise ValueError("episodes must begin in the step in which others end: autoreset_mode='SameStep'")
        self.config, self.robot = config or ExploreConfig(), robot
        view, grid, drive, count = self.config.view, self.config.grid, self.config.drive, env.num_envs
        self.single_action_space = spaces.Discrete(view.directions)
        # What driving ahead would show has no smaller bound.
        self.single_observation_space = spaces.Box(-1.0, 5.0, (view.size(len(robot.beams)),), np.float32)
        self.action_space = batch_space(self.single_action_space, count)
        self.observation_space = batch_space(self.single_observation_space, count)
        self._beams = np.column_stack((robot.beam_origins, robot.beam_directions, robot.too_near, robot.too_far))
        self._rules = np.array([grid.cell, grid.seen_through, grid.hit, grid.limit], dtype=float)
        self._drive = np.array([drive.gain, drive.turn_rate, robot.max_wheel_speed, robot.axle, robot.radius])
        self._make_room(count, len(robot.beams))
        self._slam: BatchSlam | None = None
        if self.config.pose == "belief":
            told = preset("consistent", NominalNoise(self.config.range_std))
            self._slam = BatchSlam(robot, told, count, num_threads=1, size=0)

    def _make_room(self, count: int, beams: int) -> None:
        self._values = np.zeros((count, SIDE, SIDE), dtype=np.int8)
        self._corners, self._boxes = np.zeros((count, 2), dtype=np.int64), np.zeros((count, 4), dtype=np.int64)
        self._stamps, self._stamp = np.zeros((SIDE, SIDE), dtype=np.int32), 1
        self._points, self._ages = np.zeros((count, MEMORY, beams, 2)), np.full((count, MEMORY, beams), -1)
        self._slots, self._poses = np.zeros(count, dtype=np.int64), np.zeros((count, 3))
        self._steps, self._tolls = np.zeros((SIDE, SIDE), dtype=np.int32), np.zeros((SIDE, SIDE), dtype=np.int32)
        self._queue = np.zeros(SIDE * SIDE + 1, dtype=np.int32)
        self._ranges = np.zeros((count, beams), dtype=np.float32)
        self.touches, self._in_contact = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=bool)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Reset all environments and empty the grids."""
        told, info = self.env.reset(seed=seed, options=options)
        everywhere = np.ones(self.num_envs, dtype=bool)
        self._in_contact[:], self.touches[:] = False, 0
        self._begin(everywhere, told, info)
        return self._look(everywhere), info

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[NDArray[np.float32], FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Drive with headings ``actions`` (n,) for some steps.

        A robot whose episode ends early waits in its next episode.
        """
        headings = self._poses[:, 2] + np.asarray(actions) * (2.0 * np.pi / self.config.view.directions)
        rewards, wheels = np.zeros(self.num_envs), np.zeros((self.num_envs, 2), dtype=np.float32)
        terminated, truncated = np.zeros((2, self.num_envs), dtype=bool)
        final = np.full(self.num_envs, None, dtype=object)
        for _ in range(self.config.drive.hold):
            over = terminated | truncated
            steer(headings, self._poses, self._points, self._ages, self._slots, self._drive, wheels)
            wheels[over] = 0.0
            told, reward, ended, cut, info = self.env.step(wheels)
            rewards += np.where(over, 0.0, reward)
            self._count_touches(info)
            now = ended | cut
            if now.any():
                self._finish(now, info, final)
                terminated |= ended
                truncated |= cut
                self._begin(now, told, info)
            self._take_in(~now, told, info)
        over = terminated | truncated
        info = {**info, "final_obs": final, "_final_obs": over} if over.any() else info
        return (
            self._look(np.ones(self.num_envs, dtype=bool)),
            self.config.reward_scale * rewards,
            terminated,
            truncated,
            info,
        )

    def _count_touches(self, info: dict[str, Any]) -> None:
        contact = np.asarray(info["collision"], dtype=bool)
        self.touches += contact & ~self._in_contact
        self._in_contact = contact

    def _begin(self, which: BoolArray, told: dict[str, Any], info: dict[str, Any]) -> None:
        """Empty the grids of robots that start an episode, and add the first readings."""
        self._values[which], self._ages[which], self._slots[which] = 0, -1, 0
        # The start pose is the only part of the ground truth that a robot receives.
        self._poses[which] = info["pose"][which]
        self._corners[which] = np.floor(self._poses[which, :2] / self.config.grid.cell).astype(np.int64) - SIDE // 2
        self._boxes[which] = (SIDE, 0, SIDE, 0)
        if self._slam is not None:
            self._slam.reset(self._poses, which)
            self._move(which, told, self._poses)
        self._add(which, told["ranges"])

    def _take_in(self, which: BoolArray, told: dict[str, Any], info: dict[str, Any]) -> None:
        self._move(which, told, info["pose"])
        self._add(which, told["ranges"])

    def _add(self, which: BoolArray, ranges: NDArray[np.float32]) -> None:
        self._stamp += self.num_envs
        self._ranges[which] = ranges[which]
        take_in(
            which, self._poses, self._ranges, self._values, self._corners, self._boxes, self._stamps, self._stamp,
            self._points, self._ages, self._slots, self._beams, self.robot.radius, self._rules,
        )  # fmt: skip

    def _move(self, which: BoolArray, told: dict[str, Any], true: FloatArray) -> None:
        if self.config.pose == "true":
            self._poses[which] = true[which]
        elif self._slam is not None:
            self._poses[which] = self._slam.step(told["ranges"], told["wheels"], which).pose[which]
        else:
            left, right = np.asarray(told["wheels"][which], dtype=float).T
            half = 0.5 * (right - left) / self.robot.axle
            # numpy's sinc(x) is sin(pi x) / (pi x).
            chord, middle = 0.5 * (left + right) * np.sinc(half / np.pi), self._poses[which, 2] + half
            ahead = np.column_stack((chord * np.cos(middle), chord * np.sin(middle)))
            self._poses[which, :2] += ahead
            self._poses[which, 2] = wrap_angle(middle + half)

    def _finish(self, which: BoolArray, info: dict[str, Any], final: NDArray[Any]) -> None:
        """Add the last readings of episodes that end, for the final observation."""
        last = {"ranges": np.zeros_like(self._ranges), "wheels": np.zeros((self.num_envs, 2), dtype=np.float32)}
        for robot in np.flatnonzero(which):
            for key, values in last.items():
                values[robot] = info["final_obs"][robot][key]
        self._take_in(which, last, info["final_info"])
        views = self._look(which)
        for robot in np.flatnonzero(which):
            final[robot] = views[robot].copy()

    def _look(self, which: BoolArray) -> NDArray[np.float32]:
        view = self.config.view
        views = np.zeros((self.num_envs, view.size(len(self.robot.beams))), dtype=np.float32)
        look_round(
            which, self._poses, self._ranges, self._values, self._corners, self._boxes, self._steps, self._tolls,
            self._queue, view.samples, view.radii, self.config.grid.cell, self._beams, self.robot.radius,
            self.robot.max_ranges, views,
        )  # fmt: skip
        return views
