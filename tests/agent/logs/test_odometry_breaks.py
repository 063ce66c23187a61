"""Breaks of odometry: jumps, gaps and poses off the path, by what the robot does in the rest of the
log.
"""

from itertools import accumulate

import numpy as np
import pytest
from numpy.testing import assert_allclose

from limslam_agent.logs.pose_log import beam, pose_log
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.replay.checks import log_warnings
from limslam_env import RobotSpec
from limslam_env.geometry import se2

COUNT = 600
STEPS = np.arange(COUNT)
TIME = 0.1 * STEPS


def winding(speed=0.3):
    """Poses (n, 3) of a robot that winds ahead, and stands in between."""
    steps = np.zeros((COUNT - 1, 3))
    steps[:, 0] = 0.1 * speed
    steps[:, 2] = 0.05 * np.sin(0.05 * np.arange(COUNT - 1))
    steps[200:260] = 0.0
    return np.array([*accumulate(steps, se2.compose, initial=np.array([40.0, -7.0, 3.0]))])


def as_log(poses, time=TIME):
    count = len(poses)
    ranges = np.full((count, 2), 2.0)
    beams = [beam(angle, 5.0) for angle in (0.0, 1.0)]
    return pose_log(beams, time, poses, ranges=ranges, has_scan=np.ones(count, dtype=bool))


def moved_from(poses, row, motion):
    """The poses with all from a row on in another frame."""
    return np.vstack((poses[:row], se2.compose(np.asarray(motion), poses[row:])))


@pytest.mark.parametrize("speed", [0.05, 0.3, 3.0])
def test_a_drive_has_no_breaks_whatever_its_speed(speed):
    log = as_log(winding(speed))
    assert log.breaks == ()
    assert log.notes == ()


@pytest.mark.parametrize("motion", [[0.0, 0.4, 0.0], [700.0, -20.0, 0.0], [5.0, 3.0, 2.0]])
def test_a_jump_is_found_at_its_event_and_the_robot_stays(motion):
    log = as_log(moved_from(winding(), 300, motion))
    (found,) = log.breaks
    assert (found.row, found.is_jump) == (300, True)
    assert (found.begin, found.end) == pytest.approx((29.9, 30.0))
    if not motion[2]:
        assert found.distance == pytest.approx(np.hypot(*motion[:2]), rel=0.1)
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
    steps = se2.between((poses := winding(0.05))[:-1], poses[1:])
    steps[300:320, 0] += 0.4
    sprint = np.array([*accumulate(steps, se2.compose, initial=poses[0])])
    assert as_log(sprint).breaks == ()


def test_poses_of_another_program_that_are_mixed_in_are_replaced():
    poses = winding()
    mixed = poses.copy()
    mixed[::10] = se2.compose(np.array([0.5, 0.4, 0.1]), mixed[::10])
    mixed[0] = poses[0]
    mixed[455:458, 2] += 2.5
    log = as_log(mixed)
    assert log.breaks == ()
    assert_allclose(log.odometry[:, :2], poses[:, :2], atol=0.02)
    (note,) = log.notes
    assert note.startswith("62 odometry poses, the first one at 1.0 s, were off the path")


def test_a_pause_in_which_odometry_counts_on_is_no_break():
    poses = winding()
    rows = np.r_[0:100, 160:COUNT]
    assert as_log(poses[rows], TIME[rows]).breaks == ()


def test_a_pause_in_which_a_moving_robot_does_not_count_is_a_break():
    (found,) = as_log(winding(), TIME + 6.0 * (STEPS >= 100)).breaks
    assert (found.row, found.is_jump) == (100, False)
    assert found.end - found.begin == pytest.approx(6.1)
    assert as_log(winding(), TIME + 6.0 * (STEPS >= 230)).breaks == ()  # it stood


def test_few_poses_say_nothing_about_what_is_usual():
    poses = winding()[:10]
    poses[5:, 0] += 3.0
    assert as_log(poses, TIME[:10]).breaks == ()
    poses[5:, 0] += 100.0
    with pytest.raises(ValueError, match=r"odometry jumps by 103 m in row 5: is it in metres\?"):
        as_log(poses, TIME[:10])


@pytest.mark.parametrize("counted_on", [False, True])
def test_wheels_that_are_not_counted_for_a_while_are_named(counted_on):
    wheels = np.full((COUNT, 2), 0.02)
    wheels[100] *= 41 if counted_on else 1
    time = TIME + 4.0 * (STEPS >= 100)
    scans = np.ones(COUNT, dtype=bool)
    log = RecordedLog(RobotSpec(), time, np.ones((COUNT, 6)), scans, wheels=wheels)
    warnings = [each for each in log_warnings(log) if "has a gap" in each]
    assert len(warnings) == (not counted_on)
    assert all("of 4.1 s at 9.9 s, over 0.02 m" in each for each in warnings)
    assert all("--accumulated" in each for each in warnings)
