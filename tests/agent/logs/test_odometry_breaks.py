"""Breaks of odometry: jumps, gaps and poses off the path, by what the robot does in the rest of the
log.
"""

import numpy as np
import pytest

from limslam_agent.logs.pose_log import beam, pose_log
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.replay.checks import log_warnings
from limslam_env import RobotSpec
from limslam_env.geometry import se2

COUNT = 600
TIME = 0.1 * np.arange(COUNT)


def winding(speed=0.3):
    """Poses (n, 3) of a robot that winds ahead, and stands in between."""
    steps = np.zeros((COUNT - 1, 3))
    steps[:, 0] = 0.1 * speed
    steps[:, 2] = 0.05 * np.sin(0.05 * np.arange(COUNT - 1))
    steps[200:260] = 0.0
    poses = [np.array([40.0, -7.0, 3.0])]
    for step in steps:
        poses.append(se2.compose(poses[-1], step))
    return np.array(poses)


def as_log(poses, time=TIME):
    count = len(poses)
    ranges = np.full((count, 2), 2.0)
    beams = [beam(angle, 5.0) for angle in (0.0, 1.0)]
    return pose_log(beams, time, poses, ranges, np.ones(count, dtype=bool))


def moved_from(poses, row, motion):
    """The poses with all from a row on in another frame."""
    after = se2.compose(np.asarray(motion), poses[row:])
    return np.vstack((poses[:row], after))


@pytest.mark.parametrize("speed", [0.05, 0.3, 3.0])
def test_a_drive_has_no_breaks_whatever_its_speed(speed):
    log = as_log(winding(speed))
    assert log.breaks == ()
    assert log.notes == ()


@pytest.mark.parametrize(
    ("motion", "distance"),
    [([0.0, 0.4, 0.0], 0.4), ([700.0, -20.0, 0.0], 700.0), ([5.0, 3.0, 2.0], None)],
)
def test_a_jump_is_found_at_its_event_and_the_robot_stays(motion, distance):
    log = as_log(moved_from(winding(), 300, motion))
    (found,) = log.breaks
    assert (found.row, found.is_jump) == (300, True)
    assert (found.begin, found.end) == pytest.approx((29.9, 30.0))
    if distance is not None:
        assert found.distance == pytest.approx(distance, rel=0.1)
    moves = np.array([each["odometry"] for each in log.observations()])
    assert not moves[300].any()
    assert np.hypot(*moves[:, :2].T).max() < 0.04
    (warning,) = [each for each in log_warnings(log) if "odometry jumps" in each]
    assert "at 30.0 s: how the robot moved there is not known" in warning


def test_a_robot_that_begins_again_at_the_origin_has_jumped():
    poses = winding()
    poses[300:] = se2.between(poses[300], poses[300:])
    assert [each.row for each in as_log(poses).breaks] == [300]


def test_a_sprint_is_no_jump():
    poses = winding(0.05)
    for row in range(300, 320):
        poses = moved_from(
            poses,
            row,
            se2.compose(se2.compose(poses[row], [0.4, 0.0, 0.0]), se2.inverse(poses[row])),
        )
    assert as_log(poses).breaks == ()


def test_poses_of_another_program_that_are_mixed_in_are_replaced():
    poses = winding()
    mixed = poses.copy()
    mixed[::10] = se2.compose(np.array([0.5, 0.4, 0.1]), mixed[::10])
    mixed[0] = poses[0]
    mixed[455:458, 2] += 2.5
    log = as_log(mixed)
    assert log.breaks == ()
    np.testing.assert_allclose(log.odometry[:, :2], poses[:, :2], atol=0.02)
    (note,) = log.notes
    assert note.startswith("62 odometry poses, the first one at 1.0 s, were off the path")


def test_a_pause_in_which_odometry_counts_on_is_no_break():
    poses = winding()
    rows = np.r_[0:100, 160:COUNT]
    assert as_log(poses[rows], TIME[rows]).breaks == ()


def test_a_pause_in_which_a_moving_robot_does_not_count_is_a_break():
    time = np.concatenate((TIME[:100], TIME[100:] + 6.0))
    (found,) = as_log(winding(), time).breaks
    assert (found.row, found.is_jump) == (100, False)
    assert found.end - found.begin == pytest.approx(6.1)
    standing = np.concatenate((TIME[:230], TIME[230:] + 6.0))
    assert as_log(winding(), standing).breaks == ()


def test_few_poses_say_nothing_about_what_is_usual():
    poses = winding()[:10]
    poses[5:, 0] += 3.0
    assert as_log(poses, TIME[:10]).breaks == ()
    poses[5:, 0] += 100.0
    with pytest.raises(ValueError, match=r"odometry jumps by 103 m in row 5: is it in metres\?"):
        as_log(poses, TIME[:10])


def test_wheels_that_are_not_counted_for_a_while_are_named():
    wheels = np.full((COUNT, 2), 0.02)
    time = np.concatenate((TIME[:100], TIME[100:] + 4.0))
    ranges = np.ones((COUNT, 6))
    scans = np.ones(COUNT, dtype=bool)
    log = RecordedLog(RobotSpec(), time, ranges, scans, wheels=wheels)
    (warning,) = [each for each in log_warnings(log) if "gap" in each]
    assert "has a gap of 4.1 s at 9.9 s, over 0.02 m" in warning
    assert "--accumulated" in warning
    wheels[100] = 41 * 0.02
    log = RecordedLog(RobotSpec(), time, ranges, scans, wheels=wheels)
    assert not [each for each in log_warnings(log) if "has a gap" in each]
