"""Batches as Stable-Baselines3 takes them. Only where that is installed (extra rl)."""

import gymnasium as gym
import numpy as np
import pytest

import limslam_env  # noqa: F401 (registers the environments)

pytest.importorskip("stable_baselines3", reason="needs the extra rl", exc_type=ImportError)

from stable_baselines3 import PPO

from limslam_env.envs.sb3 import Sb3VecEnv

AHEAD = np.full((3, 2), 0.5, dtype=np.float32)


def batch(**arguments):
    settings = {
        "num_envs": 3,
        "autoreset_mode": "SameStep",
        "max_episode_steps": 4,
        "coverage_goal": None,
    }
    return gym.make_vec("LimSlam-Env1-v0", **{**settings, **arguments})


def test_it_passes_on_what_the_batch_says():
    env = Sb3VecEnv(batch())
    plain = batch()
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


def test_episodes_that_begin_a_step_later_are_refused():
    with pytest.raises(ValueError, match="autoreset_mode"):
        Sb3VecEnv(batch(autoreset_mode="NextStep"))


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
