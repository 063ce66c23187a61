"""The heading by an inertial measurement unit, which environments observe where it is asked for."""

import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import limslam_env
from limslam_agent import SlamObservation
from limslam_env import LimSlamEnv, NoiseConfig
from limslam_env.geometry.se2 import wrap_angle

AHEAD = np.array([0.5, 0.8], dtype=np.float32)
EXACT = NoiseConfig(yaw_std=0.0, yaw_drift=0.0, yaw_resolution=0.0)


def driven(noise: NoiseConfig, seed: int = 0, *, imu: bool = True, steps: int = 60):
    """Observations of a drive, and the true headings."""
    env = LimSlamEnv("env1", noise=noise, imu=imu)
    observation, info = env.reset(seed=seed)
    seen = [observation]
    headings = [info["pose"][2]]
    for _ in range(steps):
        observation, _, _, _, info = env.step(AHEAD)
        seen.append(observation)
        headings.append(info["pose"][2])
    return seen, np.array(headings)


def errors(noise: NoiseConfig, seed: int = 0):
    """By how much the heading goes off, rad, from the first one on."""
    seen, headings = driven(noise, seed)
    yaw = np.array([each["yaw"].item() for each in seen])
    return wrap_angle(yaw - headings - yaw[0] + headings[0])


def test_the_observation_space_has_the_heading_only_where_it_is_asked_for():
    with_heading = gym.make("LimSlam-Env1-v0", imu=True)
    check_env(with_heading.unwrapped, skip_render_check=True)
    assert set(with_heading.observation_space.spaces) == {"ranges", "wheels", "yaw"}
    assert set(gym.make("LimSlam-Env1-v0").observation_space.spaces) == {"ranges", "wheels"}


def test_the_heading_changes_no_other_number():
    with_heading = driven(NoiseConfig())
    without = driven(NoiseConfig(), imu=False)
    for one, other in zip(with_heading[0], without[0], strict=True):
        for name in ("ranges", "wheels"):
            np.testing.assert_array_equal(one[name], other[name])
        assert set(other) == {"ranges", "wheels"}
    np.testing.assert_array_equal(with_heading[1], without[1])


def test_an_exact_heading_turns_as_the_robot_does_from_a_random_direction():
    np.testing.assert_allclose(errors(EXACT), 0.0, atol=1e-6)
    starts = [driven(EXACT, seed, steps=0)[0][0]["yaw"].item() for seed in range(40)]
    assert min(starts) < -1.5
    assert max(starts) > 1.5


def test_a_heading_drifts():
    noise = NoiseConfig(yaw_std=0.0, yaw_drift=0.05, yaw_resolution=0.0)
    np.testing.assert_allclose(errors(noise), 0.005 * np.arange(61), atol=1e-5)


def test_a_heading_walks_at_random():
    noise = NoiseConfig(yaw_std=0.02, yaw_drift=0.0, yaw_resolution=0.0)
    steps = np.concatenate([np.diff(errors(noise, seed)) for seed in range(5)])
    assert np.std(steps) == pytest.approx(0.02 * math.sqrt(0.1), rel=0.15)


def test_a_heading_has_steps():
    noise = NoiseConfig(yaw_resolution=0.1)
    yaw = np.array([each["yaw"].item() for each in driven(noise)[0]])
    turns = wrap_angle(np.diff(yaw)) / 0.1
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-4)
    assert set(np.round(turns)) == {0.0, 1.0}


def test_each_of_several_robots_has_its_heading():
    env = limslam_env.parallel_env(world="env1", num_robots=2, imu=True, noise=EXACT)
    observations, _ = env.reset(seed=1)
    for name in env.agents:
        assert env.observation_space(name).contains(observations[name])
    first, second = (observations[name]["yaw"].item() for name in env.agents)
    assert first != second


def test_the_wrapper_of_an_agent_uses_the_heading():
    beliefs = []
    for imu in (False, True):
        env = SlamObservation(
            gym.make("LimSlam-Env1-v0", imu=imu, noise=NoiseConfig(slip_rate=1.0))
        )
        env.reset(seed=0)
        for _ in range(40):
            env.step(AHEAD)
        beliefs.append(env.belief.pose)
    assert not np.allclose(*beliefs)


@pytest.mark.parametrize("name", ["yaw_std", "yaw_drift", "yaw_resolution"])
def test_noise_that_no_unit_has_is_refused(name):
    with pytest.raises(ValueError, match=name):
        NoiseConfig(**{name: 100000.0})
