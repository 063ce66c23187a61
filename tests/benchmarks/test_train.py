"""The learned explorer: what it trains in, and a small training where the extra rl is."""

import json

import gymnasium as gym
import numpy as np
import pytest

import limslam_env  # noqa: F401 (registers the environments)
from benchmarks.suite.suite import load_suite
from benchmarks.training.explore_env import VIEW, ExploreVectorEnv
from limslam_agent.policies.learned.learned import HOLD


def batch(**arguments):
    settings = {"sensor_noise": 0.02, "autoreset_mode": "SameStep", "plans": [5, 6], **arguments}
    return gym.make_vec("LimSlam-Random-v0", num_envs=3, **settings)


def test_a_robot_drives_where_it_is_told_and_touches_nothing():
    explore = ExploreVectorEnv(batch(max_episode_steps=None))
    told, info = explore.reset(seed=3)
    assert explore.observation_space.contains(told)
    start = info["pose"].copy()
    heading = info["pose"][:, 2] + VIEW.angle(4)
    *_, info = explore.step(np.full(3, 4))
    for _ in range(5):
        *_, info = explore.step(np.zeros(3, dtype=int))
    turned = np.abs((info["pose"][:, 2] - heading + np.pi) % (2 * np.pi) - np.pi)
    assert (turned < 0.2).all(), "4 of 24 directions are 60 degrees to the left"
    assert (np.hypot(*(info["pose"] - start)[:, :2].T) > 0.05).all()
    generator = np.random.default_rng(0)
    for _ in range(40):
        explore.step(np.where(generator.random(3) < 0.4, generator.integers(0, 24, 3), 0))
    assert explore.touches.sum() <= 3


def test_an_episode_ends_with_a_last_look_and_the_next_begins_with_an_empty_grid():
    explore = ExploreVectorEnv(batch(max_episode_steps=2 * HOLD))
    first, _ = explore.reset(seed=1)
    explore.step(np.zeros(3, dtype=int))
    told, rewards, terminated, truncated, info = explore.step(np.zeros(3, dtype=int))
    assert truncated.all()
    assert not terminated.any()
    assert rewards.shape == (3,)
    last = np.stack(list(info["final_obs"]))
    size = VIEW.rings * VIEW.directions
    # The last look knows more than a first one.
    assert (last[:, :size].mean(axis=1) < told[:, :size].mean(axis=1)).all()
    assert told.dtype == first.dtype == last.dtype == np.float32


def test_episodes_that_begin_a_step_later_are_refused():
    with pytest.raises(ValueError, match="autoreset_mode"):
        ExploreVectorEnv(gym.make_vec("LimSlam-Env1-v0", num_envs=2))


def test_a_training_leaves_its_weights(tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    pytest.importorskip("tensorboard", reason="needs the extra rl")
    from benchmarks.training.train import TrainConfig, train
    from limslam_agent.policies.learned.network import load_network

    shipped = TrainConfig()
    apart = [
        set(shipped.plans),
        set(shipped.held_out),
        {int(job.world[7:]) for job in load_suite("explore").jobs},
    ]
    assert sum(map(len, apart)) == len(set.union(*apart)), "what is learned on is not tried"
    config = TrainConfig(
        96,
        range(10, 12),
        range(20, 21),
        robots=4,
        rollout=8,
        batch=16,
        epochs=1,
        try_every=64,
        learning_rate=1e-2,
    )
    weights = train(config, tmp_path / "run")
    scores = load_network(weights).scores(np.linspace(0, 1, 800, dtype=np.float32))
    assert np.isfinite(scores).all()
    assert np.ptp(scores) > 1e-3, "learning makes a difference"
    rows = [
        json.loads(line)
        for line in (tmp_path / "run" / "trials.jsonl").read_text(encoding="utf-8").splitlines()
    ]
    assert [row["decisions"] for row in rows] == [64, 96]
    assert list((tmp_path / "run" / "tensorboard").rglob("events*"))
    assert (
        json.loads((tmp_path / "run" / "train.json").read_text(encoding="utf-8"))["config"][
            "robots"
        ]
        == 4
    )
    with pytest.raises(ValueError, match="choose another folder"):
        train(config, tmp_path / "run")
