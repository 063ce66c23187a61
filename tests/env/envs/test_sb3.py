"""Batches as Stable-Baselines3 takes them. Only where that is installed (extra rl)."""

import gymnasium as gym
import numpy as np
import pytest

import limslam_env  # noqa: F401 (registers the environments)

pytest.importorskip("stable_baselines3", reason="needs the extra rl", exc_type=ImportError)

from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor

from limslam_agent import SlamVectorObservation
from limslam_env.envs.sb3 import Sb3VecEnv
from limslam_env.envs.wrappers import NormalizedVectorObservation

AHEAD = np.full((3, 2), 0.5, dtype=np.float32)


def batch(**arguments):
    settings = {
        "num_envs": 3,
        "max_episode_steps": 4,
        "coverage_goal": None,
    }
    return gym.make_vec("LimSlam-Env1-v0", **{**settings, **arguments})


@pytest.mark.parametrize("mode", AutoresetMode)
def test_it_passes_on_what_the_batch_says_whenever_that_begins_its_episodes(mode):
    env = Sb3VecEnv(batch(autoreset_mode=mode))
    plain = batch(autoreset_mode="SameStep")
    env.seed(7)
    told = env.reset()
    expected = plain.reset(seed=7)[0]
    for _ in range(6):
        for key in ("ranges", "wheels"):
            np.testing.assert_array_equal(told[key], expected[key])
        told, rewards, ends, _ = env.step(AHEAD)
        expected, wanted, terminated, truncated, _ = plain.step(AHEAD)
        np.testing.assert_allclose(rewards, wanted, rtol=1e-6)
        np.testing.assert_array_equal(ends, terminated | truncated)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_episodes_that_end_one_by_one_go_on_in_the_next_one(mode):
    # One robot drives into what the other one has seen: they reach the goal at different times.
    settings = {"coverage_goal": 0.15, "max_episode_steps": 60, "sensor_noise": 0.02}
    env = Sb3VecEnv(batch(autoreset_mode=mode, **settings))
    plain = batch(autoreset_mode="SameStep", **settings)
    actions = np.array([[0.5, 0.5], [0.3, 0.6], [0.0, 0.0]], dtype=np.float32)
    env.seed(7)
    env.reset()
    plain.reset(seed=7)
    ended = set()
    for _ in range(130):
        told, _, ends, infos = env.step(actions)
        expected, *_, found = plain.step(actions)
        np.testing.assert_array_equal(told["ranges"], expected["ranges"])
        for number in np.flatnonzero(ends):
            last = found["final_obs"][number]["wheels"]
            np.testing.assert_array_equal(infos[number]["terminal_observation"]["wheels"], last)
            assert infos[number]["coverage"] == found["final_info"]["coverage"][number]
            ended.add(tuple(ends.tolist()))
    assert len(ended) > 1


@pytest.mark.parametrize("wrap", [None, SlamVectorObservation, NormalizedVectorObservation])
def test_a_monitor_finds_the_coverage_of_each_episode(wrap):
    envs = batch() if wrap is None else wrap(batch())
    env = VecMonitor(Sb3VecEnv(envs), info_keywords=("coverage", "time"))
    env.reset()
    for _ in range(4):
        infos = env.step(AHEAD)[-1]
    assert [info["episode"]["time"] for info in infos] == [pytest.approx(0.4)] * 3
    assert all(0.0 < info["episode"]["coverage"] < 0.2 for info in infos)
    assert all(
        env.observation_space["ranges"].contains(info["terminal_observation"]["ranges"])
        for info in infos
    )


def test_other_batches_of_gymnasium_work_too():
    env = Sb3VecEnv(gym.make_vec("CartPole-v1", num_envs=2))
    env.reset()
    infos = [info for _ in range(60) for info in env.step(np.ones(2, dtype=np.int64))[3]]
    ends = [info for info in infos if "episode" in info]
    assert len(ends) > 4
    assert all(info["episode"]["l"] == info["episode"]["r"] for info in ends)
    assert all(np.abs(info["terminal_observation"][2]) > 0.2 for info in ends)


def test_the_last_step_of_an_episode_says_so():
    env = Sb3VecEnv(batch())
    plain = batch(max_episode_steps=None)
    env.seed(7)
    env.reset()
    plain.reset(seed=7)
    total = np.zeros(3)
    for step in range(1, 5):
        _, rewards, ends, infos = env.step(AHEAD)
        last = plain.step(AHEAD)[0]
        total += rewards
        assert ends.tolist() == [step == 4] * 3
        assert ["episode" in info for info in infos] == [step == 4] * 3
    for number, info in enumerate(infos):
        np.testing.assert_array_equal(
            info["terminal_observation"]["ranges"], last["ranges"][number]
        )
        assert info["TimeLimit.truncated"] is True
        assert info["episode"] == {"r": pytest.approx(total[number]), "l": 4}
    assert env.step(AHEAD)[3][0] == {"cost": 0.0}


def test_every_step_has_its_cost_the_last_one_of_an_episode_too():
    # Into a wall, where the episode ends.
    steps = 150
    fast = 2.0 * AHEAD
    env = Sb3VecEnv(batch(max_episode_steps=steps))
    plain = batch(max_episode_steps=None)
    env.seed(7)
    env.reset()
    plain.reset(seed=7)
    costs = []
    expected = []
    for _ in range(steps):
        costs.append([info["cost"] for info in env.step(fast)[3]])
        expected.append(plain.step(fast)[-1]["cost"].tolist())
    assert costs == expected
    assert costs[0] == [0.0] * 3
    assert costs[-1] == [1.0] * 3


def test_it_has_the_pictures_of_the_batch():
    assert Sb3VecEnv(batch()).get_images() == [None] * 3
    env = Sb3VecEnv(batch(render_mode="rgb_array"))
    env.reset()
    assert [picture.shape for picture in env.get_images()] == [(640, 640, 3)] * 3
    assert env.render("rgb_array").shape == (1280, 1280, 3)
    # A VecVideoRecorder reads it here.
    assert env.metadata["render_fps"] == 10


def test_ppo_learns_on_it():
    model = PPO(
        "MultiInputPolicy",
        Sb3VecEnv(batch()),
        n_steps=8,
        batch_size=12,
        n_epochs=1,
        seed=0,
        device="cpu",
    )
    model.learn(48)
    assert model.num_timesteps == 48
    assert len(model.ep_info_buffer) > 0
