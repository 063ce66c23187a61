"""Impossible arguments of any type are refused in one short line."""

import gymnasium as gym
import numpy as np
import pytest

import limslam_env
from limslam_env import LimSlamParallelEnv, World, load_world


@pytest.fixture(scope="module")
def env():
    return gym.make("LimSlam-Env1-v0", disable_env_checker=True).unwrapped


@pytest.mark.parametrize(
    "options",
    [{"world": 3}, {"world": None}, {"world": ["env1"]}, {"start": [10**400, 0, 0]}, {"start": 10**6000}, {3: 1}, 3],
)
def test_impossible_options_of_a_reset(env, options):
    with pytest.raises(ValueError, match=r"a world is|the start is|unknown reset option|a dictionary"):
        env.reset(options=options)


@pytest.mark.parametrize("count", [2.5, "2", True])
def test_an_impossible_number_of_robots(count):
    with pytest.raises(ValueError, match="1 to 8 robots"):
        LimSlamParallelEnv("env1", num_robots=count)
    with pytest.raises(ValueError, match="1 to 8 robots"):
        limslam_env.parallel_vector_env(world="env1", num_robots=count, num_envs=1)


@pytest.mark.parametrize("source", [3, None])
def test_what_is_no_world(source):
    with pytest.raises(ValueError, match="a world is a name, the path of a file, or a World"):
        load_world(source)


def test_very_long_names_are_cut_in_messages():
    with pytest.raises(ValueError) as caught:
        load_world("x" * 20_000)
    assert len(str(caught.value)) <= 500


def test_very_many_long_walls_are_refused_before_they_take_minutes():
    ends = np.random.default_rng(0).uniform(0.0, 60.0, (99_000, 4))
    with pytest.raises(ValueError, match="km long; 50 km can be used"):
        World("many", (60.0, 60.0), ends)


MAKERS = {
    "single": lambda **arguments: gym.make("LimSlam-Env1-v0", **arguments),
    "batch": lambda **arguments: gym.make_vec("LimSlam-Env1-v0", num_envs=2, **arguments),
    "parallel": lambda **arguments: limslam_env.parallel_env(world="env1", **arguments),
    "parallel batch": lambda **arguments: limslam_env.parallel_vector_env(world="env1", num_envs=2, **arguments),
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=list(MAKERS))
@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"noise": 0.02}, r"noise must be a NoiseConfig, such as NoiseConfig\(sensor_noise=\.\.\.\), not 0\.02"),
        ({"rewards": {"step": -0.1}}, r"rewards must be a RewardConfig, such as RewardConfig\("),
        ({"robot": "e_puck"}, r"robot must be a RobotSpec, such as RobotSpec\(radius=\.\.\.\), not 'e_puck'"),
        ({"sensor_noise": "0.02"}, r"sensor_noise must be a number"),
        ({"coverage_goal": "0.9"}, r"coverage_goal must lie in"),
    ],
)
def test_an_argument_of_a_wrong_type(make, arguments, words):
    with pytest.raises(ValueError, match=words) as caught:
        make(**arguments)
    assert len(str(caught.value)) <= 500
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("make", [MAKERS["single"], MAKERS["parallel"]], ids=["single", "parallel"])
def test_a_window_without_pygame_names_the_extra(monkeypatch, make):
    monkeypatch.setattr("limslam_env.rendering.painter.find_spec", lambda _: None)
    with pytest.raises(gym.error.DependencyNotInstalled, match=r"pip install 'limslam\[play\]'"):
        make(render_mode="human")


def test_the_nominal_noise_is_the_upper_end_of_what_a_reset_may_draw():
    noise = limslam_env.NoiseConfig(sensor_noise=(0.01, 0.03), wheel_variance=(0.0, 1e-4), slip_rate=0.5)
    assert MAKERS["single"](noise=noise).unwrapped.nominal_noise == limslam_env.NominalNoise(0.03, 1e-4)
    assert MAKERS["parallel"](sensor_noise=0.02).nominal_noise == limslam_env.NominalNoise(0.02)
    ideal = limslam_env.NoiseConfig(wheel_variance=0.0)
    assert MAKERS["batch"](noise=ideal).nominal_noise == limslam_env.NominalNoise()
