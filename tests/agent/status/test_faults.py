"""The status of robots with faults that begin in the middle of an exploration, and of a healthy robot."""

import numpy as np
import pytest
from support.faults import Fault, steps_with

from limslam_agent import preset, read_log
from limslam_agent.output.summary import run_summary
from limslam_agent.replay.replay import replay_log
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_env.interface import NominalNoise

BEGIN, NOISE = 30.0, 0.02


@pytest.mark.parametrize(
    ("kind", "world", "seed"),
    [("kidnapped", "env2", 1), ("reversed", "env3", 1), ("swapped", "env1", 1), ("jump", "env2", 3)],
)
def test_a_fault_is_noticed_within_ten_seconds(kind, world, seed):
    levels = []
    agent, rows = steps_with(Fault(kind, BEGIN, seed), world, NOISE, 10.0, seed=seed, note=levels)
    before, after = levels[: round(BEGIN / 0.1)], levels[round(BEGIN / 0.1) :]
    assert set(before) == {"ok"}
    assert {"unsure", "lost"} & set(after)
    assert len(rows) == len(levels)
    assert agent.status_reason or agent.status == "ok"


def test_the_uncertainty_of_a_kidnapped_robot_outgrows_its_error():
    agent, rows = steps_with(Fault("kidnapped", BEGIN, 1), "env2", NOISE, 25.0, seed=1, finds_places=False)
    error = np.hypot(*(rows[-1]["pose"] - agent.snapshot().pose)[:2])
    snapshot = agent.snapshot()
    assert error > 1.0
    assert (agent.status, snapshot.status) == ("lost", "lost")
    assert snapshot.status_reason == snapshot.statuses[0].reason == agent.status_reason != ""
    assert np.sqrt(snapshot.covariance[0, 0] + snapshot.covariance[1, 1]) > error
    np.testing.assert_array_equal(agent.mapper.belief.covariance, snapshot.covariance)
    assert agent.mapper.belief.status == snapshot.statuses[0]
    assert np.trace(agent.slam.covariance) < 1.0


def test_results_of_runs_and_replays_have_the_status(tmp_path, monkeypatch):
    settings = preset("paper", NominalNoise(NOISE))
    # Every motion of the wheels counts as a jump.
    monkeypatch.setattr("limslam_agent.status.monitor._MAX_JUMP", 0.005)
    episode = run_episode(RunConfig("env2", NOISE, "paper", max_time=10.0, settings=settings))
    scores = score(episode)
    assert scores["status"] == episode.snapshot.status == "lost"
    assert scores["status_reason"].startswith("the odometry reports a motion")
    assert 0.0 <= scores["first_lost_s"] <= 10.0 - scores["lost_s"] + 1e-9
    assert "status      lost: the odometry reports" in "".join(run_summary(scores, {}))
    assert np.trace(episode.covariances[-1, 0]) > np.trace(episode.covariances[1, 0]) + 1.0
    arrays = {
        "ranges": episode.ranges, "wheels": episode.wheels, "action": episode.actions, "true_pose": episode.true,
        "wall_seen": episode.wall_seen,
    }  # fmt: skip
    known = {"start_pose": episode.true[0, 0], "robot": np.array(episode.config.robot.to_json()), "time": episode.time}
    np.savez(tmp_path / "log.npz", **known, **{name: rows[:, 0] for name, rows in arrays.items()})
    replay = replay_log(read_log(tmp_path / "log.npz"), settings)
    np.testing.assert_array_equal(replay.levels, episode.levels[:, 0])
    assert replay.status == episode.snapshot.statuses[0]
    np.testing.assert_allclose(replay.covariances, episode.covariances[:, 0])
