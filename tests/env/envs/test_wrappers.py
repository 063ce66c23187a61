"""The wrapper that scales observations: outputs within their spaces, values worked out by hand, and refusals."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation, FrameStackObservation

from limslam_env import LimSlamEnv, NoiseConfig, RobotSpec
from limslam_env.envs.wrappers import NormalizedObservation
from limslam_env.interface import beams_on_rim

FRONT = RobotSpec(beams=beams_on_rim((0.0, 90.0, -90.0), 0.10))
NO_NOISE = NoiseConfig(wheel_variance=0.0)


def test_it_works_with_the_wrappers_of_gymnasium():
    env = gym.make("LimSlam-Random-v0", noise=NoiseConfig.sharp(wheel_variance=1e-3), max_episode_steps=100)
    env = FlattenObservation(FrameStackObservation(NormalizedObservation(env), 2))
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    for _ in range(100):
        assert env.observation_space.contains(observation)
        observation, *_ = env.step(env.action_space.sample())


def test_normalized_readings_by_hand():
    env = NormalizedObservation(LimSlamEnv("square", robot=FRONT, noise=NO_NOISE))
    # Walls at x = 7 and y = 0; the rim stands 0.5 m from one and 0.775 m from the other, and nothing is on the left.
    observation, _ = env.reset(seed=0, options={"start": (6.4, 0.875, 0.0)})
    np.testing.assert_allclose(observation["ranges"], [0.45 / 1.45, 1.0, 0.5], atol=1e-6)
    assert observation["ranges"][1] == 1.0
    np.testing.assert_array_equal(observation["wheels"], 0.0)
    # A wheel at full speed does half of what an encoder can tell.
    observation, *_ = env.step([1.0, -0.5])
    np.testing.assert_allclose(observation["wheels"], [0.5, -0.25], atol=1e-6)
    assert observation["ranges"].dtype == observation["wheels"].dtype == np.float32


def test_each_beam_is_normalized_by_its_own_limits():
    beams = (*beams_on_rim((0.0,), 0.1, max_range=1.0), *beams_on_rim((0.0,), 0.1, min_range=0.2, max_range=4.2))
    env = NormalizedObservation(LimSlamEnv("square", robot=RobotSpec(beams=beams), noise=NO_NOISE))
    observation, _ = env.reset(seed=0, options={"start": (6.4, 1.0, 0.0)})
    np.testing.assert_allclose(observation["ranges"], [0.45 / 0.95, 0.3 / 4.0], atol=1e-6)


def test_observations_without_ranges_and_wheels_are_refused():
    for other in (gym.make("CartPole-v1"), FlattenObservation(LimSlamEnv("env1"))):
        with pytest.raises(ValueError, match="must hold ranges and wheels"):
            NormalizedObservation(other)
