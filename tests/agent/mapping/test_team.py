"""Several robots: one filter over all poses, one map, and beams on teammates that become no
walls.
"""

import operator

import numpy as np
import pytest

from limslam_agent import AgentConfig, FrontierPolicy, LimSlamTeam, LineSlam, preset
from limslam_env import LimSlamParallelEnv, NominalNoise, RobotSpec

ROBOT = RobotSpec()
STARTS = np.array([[1.0, 1.0, 0.3], [2.0, 0.5, -2.0]])


def test_dropped_readings_are_neither_measured_nor_collected():
    slam = LineSlam(ROBOT, AgentConfig(), np.array([[0.0, 0.0, 0.0], [0.0, 0.7, 0.0]]))
    still = {"ranges": ROBOT.max_ranges.astype(np.float32), "wheels": np.zeros(2, dtype=np.float32)}
    left = {**still, "ranges": still["ranges"].copy()}
    left["ranges"][0] = 0.5
    slam.step(left, still)
    first, second = slam.robots
    assert first.dropped.tolist() == [True] + [False] * 5
    assert not first.measured[0]
    assert sum(len(side.points) for side in slam.pending_points) == 0
    # The other robot's beams see nothing, so nothing of theirs can be dropped.
    assert not second.dropped.any()
    # A robot alone drops nothing.
    alone = LineSlam(ROBOT, AgentConfig(), np.zeros(3))
    alone.step(left)
    assert not alone.robots[0].dropped.any()
    assert sum(len(side.points) for side in alone.pending_points) == 1


def test_a_team_explores_together_without_touching():
    count = 2
    env = LimSlamParallelEnv(
        "env1", num_robots=count, sensor_noise=0.02, coverage_goal=None, max_cycles=None
    )
    told, infos = env.reset(seed=100)
    team = LimSlamTeam(ROBOT, preset("paper", NominalNoise(0.02)), count)
    team.reset(np.array([infos[name]["pose"] for name in team.names]))
    hits = 0
    for _ in range(2500):
        told, _, _, _, infos = env.step(team.act(told))
        on_robot = np.array([infos[name]["wall_seen"] == -2 for name in team.names])
        hits += np.count_nonzero(on_robot)
        if team.done:
            break
    assert team.done
    assert team.stop_reason.startswith("explored")
    assert infos["robot_0"]["coverage"] > 0.97
    assert hits > 0, "they never met, and the test shows nothing"
    poses = np.array([infos[name]["pose"] for name in team.names])
    assert np.linalg.norm(team.slam.poses[:, :2] - poses[:, :2], axis=1).max() < 0.8
    snapshot = team.snapshot()
    assert snapshot.poses.shape == (count, 3)
    assert snapshot.covariances.shape == (count, 3, 3)
    assert len(snapshot.plans) == count
    assert 12 <= len(snapshot.segments) <= 40


def test_the_policies_of_a_team_keep_what_they_know_when_their_map_is_moved():
    team = LimSlamTeam(ROBOT)
    seen = {"ranges": ROBOT.max_ranges, "wheels": np.zeros(2)}
    team.act(dict.fromkeys(team.names, seen))
    before = list(team.policies)
    team.mapper._frames.frame += 1
    team.act(dict.fromkeys(team.names, seen))
    assert all(map(operator.is_, team.policies, before))


def test_bad_teams_are_refused():
    with pytest.raises(ValueError, match="must be a whole number from 1 to 64"):
        LimSlamTeam(ROBOT, num_robots=0)
    with pytest.raises(ValueError, match="1 policies for 2 robots"):
        LimSlamTeam(ROBOT, policies=[FrontierPolicy(ROBOT, AgentConfig().policy)])
    with pytest.raises(ValueError, match=r"2 robots need start poses \(2, 3\)"):
        LimSlamTeam(ROBOT).reset(np.zeros((3, 3)))


def test_an_observation_that_is_refused_changes_nothing_for_anybody():
    slam = LineSlam(ROBOT, AgentConfig(), STARTS)
    good = {"ranges": ROBOT.max_ranges, "wheels": np.array([0.02, 0.02])}
    for bad in ({**good, "wheels": np.array([np.nan, 0.0])}, {**good, "ranges": np.ones(3)}):
        with pytest.raises(ValueError, match=r"wheel|ranges"):
            slam.step(good, bad)
        np.testing.assert_array_equal(slam.poses, STARTS)
        assert [front.step for front in slam.robots] == [-1, -1]
