"""Several robots: one filter over all poses, one map, and beams on teammates that become no walls."""

import numpy as np
import pytest

from limslam_agent import AgentConfig, FrontierPolicy, LimSlamTeam, LineSlam, preset
from limslam_agent.slam.core.ekf import LineEKF
from limslam_env import LimSlamParallelEnv, NominalNoise, RobotSpec
from limslam_env.geometry import line as line_geometry
from limslam_env.geometry import se2

ROBOT = RobotSpec()
NOISE = np.diag([1e-5, 1e-6, 1e-5])
LINE_NOISE = np.diag([1e-4, 1e-4])
STARTS = np.array([[1.0, 1.0, 0.3], [2.0, 0.5, -2.0]])


def moved_pair() -> LineEKF:
    """Two robots that have moved, and a line that the first has seen."""
    ekf = LineEKF(STARTS)
    for step in range(20):
        ekf.predict(np.array([0.03, 0.0, 0.02]), NOISE, 0)
        ekf.predict(np.array([0.02, 0.0, -0.01 * (step % 3)]), NOISE, 1)
    ekf.augment(np.array([0.8, 1.2]), LINE_NOISE, 0)
    return ekf


def test_each_robot_moves_alone():
    ekf, poses = LineEKF(STARTS), STARTS.copy()
    for increment in (np.array([0.1, 0.0, 0.2]), np.array([0.05, 0.01, -0.1])):
        ekf.predict(increment, NOISE, 1)
        poses[1] = se2.compose(poses[1], increment)
    np.testing.assert_allclose(ekf.poses, poses)
    joint = ekf.joint_pose_covariance
    assert not joint[:3].any(), "the first has not moved and knows where it is"
    assert np.linalg.eigvalsh(joint[3:, 3:]).min() > 0.0


def test_the_filter_of_two_is_two_filters_until_they_see_one_wall():
    together, alone = LineEKF(STARTS), [LineEKF(start) for start in STARTS]
    for robot, ekf in enumerate(alone):
        for turn in (0.1, -0.05, 0.2):
            for filter_, number in ((together, robot), (ekf, 0)):
                filter_.predict(np.array([0.05, 0.0, turn]), NOISE, number)
        line = np.array([0.7 + 0.2 * robot, 0.4])
        together.augment(line, LINE_NOISE, robot)
        ekf.augment(line, LINE_NOISE)
        together.observe_line(line + 0.01, LINE_NOISE, robot, robot)
        ekf.observe_line(line + 0.01, LINE_NOISE, 0)
    for robot, ekf in enumerate(alone):
        np.testing.assert_allclose(together.poses[robot], ekf.pose, atol=1e-12)
        part = slice(3 * robot, 3 * robot + 3)
        np.testing.assert_allclose(together.joint_pose_covariance[part, part], ekf.joint_pose_covariance, atol=1e-12)
        np.testing.assert_allclose(together.lines[robot], ekf.lines[0], atol=1e-12)
    assert not together.P[:3, 3:6].any()


def test_a_wall_that_both_see_ties_their_poses_together():
    ekf = moved_pair()
    seen = line_geometry.to_frame(ekf.lines[0], ekf.poses[1])
    before = ekf.joint_pose_covariance
    ekf.observe_line(seen, LINE_NOISE, 0, 1)
    after = ekf.joint_pose_covariance
    assert np.abs(after[:3, 3:]).max() > 0.0
    assert np.linalg.eigvalsh(before - after).min() > -1e-12, "nobody becomes less certain by a measurement"


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


def test_there_must_be_one_observation_for_each_robot():
    slam = LineSlam(ROBOT, AgentConfig(), STARTS)
    with pytest.raises(ValueError, match="1 observations for 2 robots"):
        slam.step({"wheels": np.zeros(2)})


def test_a_team_explores_together_without_touching():
    count = 2
    env = LimSlamParallelEnv("env1", num_robots=count, sensor_noise=0.02, coverage_goal=None, max_cycles=None)
    told, infos = env.reset(seed=104)
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


def test_bad_teams_are_refused():
    with pytest.raises(ValueError, match="one robot or more"):
        LimSlamTeam(ROBOT, num_robots=0)
    with pytest.raises(ValueError, match="1 policies for 2 robots"):
        LimSlamTeam(ROBOT, policies=[FrontierPolicy(ROBOT, AgentConfig().policy)])


def test_an_observation_that_is_refused_changes_nothing_for_anybody():
    slam = LineSlam(ROBOT, AgentConfig(), STARTS)
    good = {"ranges": ROBOT.max_ranges, "wheels": np.array([0.02, 0.02])}
    for bad in ({**good, "wheels": np.array([np.nan, 0.0])}, {**good, "ranges": np.ones(3)}):
        with pytest.raises(ValueError, match=r"wheel|ranges"):
            slam.step(good, bad)
        np.testing.assert_array_equal(slam.poses, STARTS)
        assert [front.step for front in slam.robots] == [-1, -1]


def test_a_team_needs_a_start_for_each():
    with pytest.raises(ValueError, match=r"2 robots need start poses \(2, 3\)"):
        LimSlamTeam(ROBOT).reset(np.zeros((3, 3)))
