"""Training: its table in a suite, and a small one where the extra rl is."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.suite.suite import load_suite
from benchmarks.suite.train_config import Phase, Plans, TrainConfig

SUITE = """
name = "small"
description = "A training."

[[grid]]
worlds = ["square"]
noises = [0.0]
seeds = [0]

[train]
phases = [{ pose = "true", decisions = 96 }, { pose = "odometry", decisions = 32 }]
plans = { first = 10, count = 2 }
held_out = { first = 20, count = 1 }
robots = 4
rollout = 8
batch = 16
epochs = 1
try_every = 64
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def parsed(text):
    Path("small.toml").write_text(text)
    return load_suite("small.toml").train


def test_a_suite_says_what_is_trained():
    train = parsed(SUITE)
    assert train.phases == (Phase("true", 96), Phase("odometry", 32))
    assert list(train.plans.seeds) == [10, 11]
    assert train.minutes == 20.0
    assert load_suite("smoke").train is None


def test_the_shipped_training_is_tried_on_other_plans():
    suite = load_suite("explore")
    apart = [set(suite.train.plans.seeds), set(suite.train.held_out.seeds), set(range(1000, 1100))]
    assert sum(map(len, apart)) == len(set.union(*apart))
    assert {job.world for job in suite.jobs} == {f"random:{seed}" for seed in range(1000, 1100)}


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("robots = 4", "robot = 4", r"small.toml: train.robot: there is no such setting"),
        ('pose = "true", ', "", r"phases\[0\].pose: is missing"),
        ('pose = "true"', 'pose = "false"', "pose: must be one of true, odometry, belief"),
        ("decisions = 96", "decisions = 0", "decisions must be a number from 1"),
        ("first = 20", "first = 11", "held_out: shares floor plans"),
        ('["square"]', '["random:11"]', "random:11 is learned on"),
        ("batch = 16", "batch = 16.5", "batch: must be a whole number"),
        ("epochs = 1", "gamma = 1.5", "gamma must be a number from 1e-06 to 1"),
        ("epochs = 1", "minutes = nan", "minutes must be a number"),
        ("plans = { first = 10, count = 2 }\n", "", "plans: is missing"),
    ],
)
def test_what_is_no_training_is_refused(before, after, message):
    assert before in SUITE
    with pytest.raises(ValueError, match=message):
        parsed(SUITE.replace(before, after, 1))


def test_a_training_without_phases_is_refused():
    with pytest.raises(ValueError, match="phases"):
        TrainConfig((), Plans(0, 1), Plans(1, 1))


def test_a_training_leaves_its_weights(tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    pytest.importorskip("tensorboard", reason="needs the extra rl")
    from benchmarks.training.train import train
    from limslam_agent.policies.learned.network import load_network

    config, folder = parsed(SUITE), tmp_path / "run"
    weights = train(config, folder)
    assert weights == folder / "odometry.npz"
    assert np.isfinite(load_network(weights).scores(np.zeros(800, dtype=np.float32))).all()
    rows = [json.loads(line) for line in (folder / "trials.jsonl").read_text(encoding="utf-8").splitlines()]
    assert [(row["pose"], row["decisions"]) for row in rows] == [("true", 64), ("true", 96), ("odometry", 128)]
    assert list((folder / "tensorboard").rglob("events*"))
    assert json.loads((folder / "train.json").read_text(encoding="utf-8"))["config"]["robots"] == 4
    with pytest.raises(ValueError, match="choose another folder"):
        train(config, folder)


def test_learning_makes_a_difference(tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra rl")
    from benchmarks.training.train import train
    from limslam_agent.policies.learned.network import load_network

    settings = {"robots": 4, "rollout": 8, "batch": 16, "epochs": 1, "try_every": 1000, "learning_rate": 1e-2}
    short = TrainConfig((Phase("true", 64),), Plans(10, 2), Plans(20, 1), **settings)
    scores = load_network(train(short, tmp_path / "run")).scores(np.linspace(0, 1, 800, dtype=np.float32))
    assert np.ptp(scores) > 1e-3
