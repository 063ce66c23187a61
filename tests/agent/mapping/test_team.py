"""Several robots: one filter over all poses, one map, and beams on teammates that become no walls."""

import numpy as np
import pytest

from limslam_agent.config.presets import AgentConfig, preset
from limslam_agent.mapping.team import _NEWS, LimSlamTeam
from limslam_agent.policies.frontier_policy import FrontierPolicy
from limslam_agent.slam.core.ekf import LineEKF
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.slam.core.teammates import may_hit_others
from limslam_agent.slam.slam import LineSlam
from limslam_env.envs.parallel_env import LimSlamParallelEnv
from limslam_env.geometry.line import to_frame
from limslam_env.geometry.se2 import compose
from limslam_env.interface import NominalNoise, RobotSpec

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
        poses[1] = compose(poses[1], increment)
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
    seen = to_frame(ekf.lines[0], ekf.poses[1])
    before = ekf.joint_pose_covariance
    ekf.observe_line(seen, LINE_NOISE, 0, 1)
    after = ekf.joint_pose_covariance
    assert np.abs(after[:3, 3:]).max() > 0.0
    assert np.linalg.eigvalsh(before - after).min() > -1e-12, "nobody becomes less certain by a measurement"


def test_the_filter_of_two_equals_the_dense_one():
    ekf = moved_pair()
    x, covariance = ekf.x.copy(), ekf.P.copy()
    seen = to_frame(ekf.lines[0], ekf.poses[1]) + np.array([0.02, -0.01])
    columns = ekf.columns_of(0, 1)
    jacobian = np.zeros((2, len(x)))
    for column in columns:
        step = np.zeros(len(x))
        step[column] = 1e-6
        jacobian[:, column] = (ekf._observed(x + step, columns) - ekf._observed(x - step, columns)) / 2e-6
    gain = covariance @ jacobian.T @ np.linalg.inv(jacobian @ covariance @ jacobian.T + LINE_NOISE)
    expected = x + gain @ (seen - ekf._observed(x, columns))
    ekf.observe_line(seen, LINE_NOISE, 0, 1)
    np.testing.assert_allclose(ekf.x, expected, atol=1e-8)
    np.testing.assert_allclose(ekf.P, (np.eye(len(x)) - gain @ jacobian) @ covariance, atol=1e-9)


def test_covariance_stays_symmetric_and_positive_with_eight_robots():
    generator = np.random.default_rng(0)
    starts = np.column_stack((generator.uniform(0.0, 5.0, (8, 2)), generator.uniform(-3.0, 3.0, 8)))
    ekf = LineEKF(starts)
    for step in range(200):
        robot = step % 8
        ekf.predict(np.array([0.05, 0.0, generator.normal(0.0, 0.1)]), NOISE, robot)
        if step % 17 == 0:
            ekf.augment(np.array([generator.uniform(0.2, 1.5), generator.uniform(-3.0, 3.0)]), LINE_NOISE, robot)
        else:
            index = int(generator.integers(ekf.num_lines))
            seen = to_frame(ekf.lines[index], ekf.poses[robot]) + generator.normal(0.0, 0.01, 2)
            ekf.observe_line(seen, LINE_NOISE, index, robot)
    np.testing.assert_allclose(ekf.P, ekf.P.T, atol=1e-10)
    assert np.linalg.eigvalsh(ekf.P).min() > -1e-10
    assert ekf.poses.shape == (8, 3)


def suspicious(other: tuple[float, float], ranges: dict[int, float], covariance: np.ndarray | None = None):
    """Which beams of a robot at the origin, looking along x, may hit one at ``other``."""
    readings = ROBOT.max_ranges.copy()
    for beam, reading in ranges.items():
        readings[beam] = reading
    poses = np.array([[0.0, 0.0, 0.0], [*other, 0.0]])
    joint = np.zeros((6, 6)) if covariance is None else covariance
    return may_hit_others(0, readings, poses, joint, ROBOT, RangeSensor(0.01)).tolist()


def test_a_beam_that_ends_on_a_teammate_is_suspicious_and_others_are_not():
    # Beam 0 points to the left, from 0.1 m on: a reading of 0.5 ends at (0, 0.6).
    assert suspicious((0.0, 0.7), {0: 0.5, 5: 0.5}) == [True, False, False, False, False, False]
    assert suspicious((0.0, 1.5), {0: 0.5}) == [False] * 6
    # A wall before the teammate, or behind it, is a wall.
    assert suspicious((0.0, 1.0), {0: 0.3}) == [False] * 6
    assert suspicious((0.0, 0.5), {0: 0.9}) == [False] * 6


def test_the_less_is_known_of_a_teammate_the_more_is_suspicious():
    place, reading = (0.0, 0.95), {0: 0.5}
    assert not suspicious(place, reading)[0]
    vague = np.zeros((6, 6))
    vague[4, 4] = 0.1**2
    assert suspicious(place, reading, vague)[0]
    # Not knowing the teammate's place across the beam says little about the distance along it.
    across = np.zeros((6, 6))
    across[3, 3] = 0.1**2
    assert not suspicious(place, reading, across)[0]
    # The measuring robot's heading swings the end of the beam past the teammate.
    heading = np.zeros((6, 6))
    heading[2, 2] = 0.5**2
    assert suspicious((0.25, 0.6), reading, heading)[0]
    assert not suspicious((0.35, 0.6), reading)[0]


def test_what_both_do_alike_makes_nobody_suspicious():
    # Both are off by the same: between them nothing is uncertain.
    common = np.zeros((6, 6))
    for i in (0, 1, 3, 4):
        common[i, i] = 0.2**2
    common[0, 3] = common[3, 0] = common[1, 4] = common[4, 1] = 0.2**2
    assert not suspicious((0.0, 0.95), {0: 0.5}, common)[0]


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


@pytest.mark.parametrize("count", [2, 4])
def test_a_team_explores_together_without_touching(count):
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


def test_who_had_nothing_left_to_do_looks_again_once_for_each_piece_of_news():
    env = LimSlamParallelEnv("env1", num_robots=2, coverage_goal=None)
    told, infos = env.reset(seed=105)
    team = LimSlamTeam(ROBOT, preset("paper"), 2)
    team.reset(np.array([infos[name]["pose"] for name in team.names]))
    team.policies[1].stop_reason = "explored: for a test"
    seen = {id(team.policies[1]): team.policies[1]}
    for _ in range(120):
        told, *_ = env.step(team.act(told))
        seen[id(team.policies[1])] = team.policies[1]
        team.policies[1].stop_reason = "explored: for a test"
    known = np.count_nonzero(team.snapshot().grid.values)
    assert 2 <= len(seen) <= 2 + known / _NEWS


def test_a_team_needs_a_start_for_each():
    with pytest.raises(ValueError, match=r"2 robots need start poses \(2, 3\)"):
        LimSlamTeam(ROBOT).reset(np.zeros((3, 3)))


def policies_after(team: LimSlamTeam, frame: int, map_number: int) -> list[object]:
    team.mapper.frame, team.mapper.map_number = frame, map_number
    team._renew_in_another_frame()
    return list(team.policies)


def test_only_a_new_map_has_new_policies() -> None:
    team = LimSlamTeam(ROBOT, num_robots=1)
    (first,) = team.policies
    assert policies_after(team, 1, 0) == [first], "a renewal has moved the map"
    (local,) = policies_after(team, 2, 1)
    assert local is not first, "the robot is lost, and has a local map"
    assert policies_after(team, 3, 0) == [first], "it has found its place in the map that it was lost from"
    team.reset(np.zeros((1, 3)))
    assert policies_after(team, 1, 0) != [first]
