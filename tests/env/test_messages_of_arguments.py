"""Impossible arguments of any type are refused in one short line."""

import gymnasium as gym
import numpy as np
import pytest

import limslam_env
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.world import MAX_EDGES, MAX_LENGTH, World, WorldError


@pytest.fixture(scope="module")
def env():
    return gym.make("LimSlam-Env1-v0", disable_env_checker=True).unwrapped


@pytest.mark.parametrize("action", [[10**400, 0], [10**6000, 0], ["x" * 10_000, 0], {}, [0.1] * 5000])
def test_an_impossible_action(env, action):
    env.reset(seed=0)
    with pytest.raises(ValueError, match="two finite numbers") as caught:
        env.step(action)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "options",
    [{"world": 3}, {"world": None}, {"world": ["env1"]}, {"start": [10**400, 0, 0]}, {"start": 10**6000}, {3: 1}, 3],
)
def test_impossible_options_of_a_reset(env, options):
    with pytest.raises(ValueError, match=r"a world is|the start is|unknown reset option|a dictionary"):
        env.reset(options=options)


@pytest.mark.parametrize("count", [2.5, "2", None, True, [2], np.nan])
def test_an_impossible_number_of_robots(count):
    with pytest.raises(ValueError, match="1 to 8 robots"):
        LimSlamParallelEnv("env1", num_robots=count)
    with pytest.raises(ValueError, match="1 to 8 robots"):
        limslam_env.parallel_vector_env(world="env1", num_robots=count, num_envs=1)


@pytest.mark.parametrize("source", [3, None, 2.5, [], b"env1"])
def test_what_is_no_world(source):
    with pytest.raises(WorldError, match="a world is a name, the path of a file, or a World"):
        load_world(source)


def test_very_long_names_are_cut_in_messages():
    with pytest.raises(WorldError) as caught:
        load_world("x" * 20_000)
    assert len(str(caught.value)) <= 500


def test_very_many_long_walls_are_refused_before_they_take_minutes():
    ends = np.random.default_rng(0).uniform(0.0, 60.0, (MAX_EDGES - 1000, 4))
    with pytest.raises(WorldError, match=rf"km long; {MAX_LENGTH / 1e3:g} km can be used"):
        World("many", (60.0, 60.0), ends)
