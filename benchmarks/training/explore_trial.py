"""Evaluation of a learned explorer on many floor plans that were not used in training."""

from collections.abc import Sequence

import gymnasium as gym
import numpy as np

import limslam_env  # noqa: F401 (registers the environments)
from benchmarks.training.explore_env import ExploreConfig, ExploreVectorEnv
from limslam_agent.policies.learned.network import DirectionNetwork
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan

_LONGEST = 240.0  # s: duration of each episode


class Trial:
    """Repeated evaluation on the same plans.

    Parameters
    ----------
    seeds
        Seeds of the floor plans.
    noise
        Standard deviation of the ranges, m.
    config
        Settings of observation and motion.
    """

    def __init__(self, seeds: Sequence[int], noise: float, config: ExploreConfig) -> None:
        radius = RobotSpec().radius
        worlds = [floor_plan(FloorPlanConfig(), np.random.default_rng(seed), radius) for seed in seeds]
        batch = gym.make_vec(
            "LimSlam-World-v0", len(worlds), world=worlds, autoreset_mode="SameStep", sensor_noise=noise,
            coverage_goal=None, max_episode_steps=None, num_threads=1,
        )  # fmt: skip
        self._env = ExploreVectorEnv(batch, config)
        self.period = config.drive.hold * self._env.robot.control_period
        self._decisions = round(_LONGEST / self.period)

    def explore(self, network: DirectionNetwork, temperature: float, seed: int = 0) -> tuple[FloatArray, FloatArray]:
        """The coverage (plans, decisions + 1) after each decision, and the number of touches (plans,).

        Directions are drawn with the softmax of scores / ``temperature``; 0 takes the direction with the best score.
        """
        generator = np.random.default_rng(seed)
        told, info = self._env.reset(seed=seed)
        rows = [info["coverage"].copy()]
        for _ in range(self._decisions):
            scores = np.stack([network.scores(row) for row in told]).astype(float)
            # The argmax of scores with added Gumbel noise is a sample from their softmax.
            chosen = (scores + temperature * generator.gumbel(size=scores.shape)).argmax(axis=1)
            told, _, _, _, info = self._env.step(chosen)
            rows.append(info["coverage"].copy())
        return np.array(rows).T, self._env.touches.astype(float)


def times_to(coverage: FloatArray, goal: float, period: float) -> FloatArray:
    """The time (n,) at which each plan reached a coverage, s; infinity if it never did.

    The columns of ``coverage`` (n, k) are ``period`` (s) apart.
    """
    reached = coverage >= goal
    return np.where(reached.any(axis=1), reached.argmax(axis=1) * period, np.inf)
