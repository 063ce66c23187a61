"""The collision guard: it slows the robot down before points that the beams have seen."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.beliefs import CLEAR, ROBOT, drive

from limslam_agent.policies.controller import CollisionGuard
from limslam_env.geometry import FloatArray

# A post seen by the beam at 45 degrees before the robot came nearer: 0.21 m from the centre, ahead and to the left.
POST = np.array([0.15, 0.15])
AHEAD = np.array([0.6, 0.6])


def reading_of(post: FloatArray, beam: int) -> FloatArray:
    """Readings at the origin with a post on one beam, at its distance."""
    ranges = CLEAR.copy()
    ranges[beam] = np.hypot(*post) - ROBOT.radius
    return ranges


def test_a_robot_is_slowed_down_if_it_turns_towards_a_post_and_not_if_it_turns_away() -> None:
    left, right = np.array([0.1, 0.9]), np.array([0.9, 0.1])
    for side, beam, towards, away in ((1.0, 1, left, right), (-1.0, 4, right, left)):
        guard, bearing = CollisionGuard(ROBOT), side * 0.6
        # The reading is taken by a robot that looks so that the beam meets the post.
        looking = np.array([0.0, 0.0, bearing - float(ROBOT.beam_angles[beam])])
        ranges = CLEAR.copy()
        ranges[beam] = 0.16 - ROBOT.radius
        guard.add_readings(looking, ranges)
        assert guard.limit_speed(np.zeros(3), towards).sum() < 0.6 * towards.sum()
        np.testing.assert_array_equal(guard.limit_speed(np.zeros(3), away), away)


def test_points_are_forgotten_after_four_seconds() -> None:
    guard = CollisionGuard(ROBOT)
    guard.add_readings(np.zeros(3), reading_of(POST, 1))
    pose = np.array([0.08, 0.05, 0.5])
    for _ in range(39):
        guard.add_readings(pose, CLEAR)
    assert guard.limit_speed(pose, AHEAD).sum() < AHEAD.sum()
    guard.add_readings(pose, CLEAR)
    np.testing.assert_array_equal(guard.limit_speed(pose, AHEAD), AHEAD)


def test_the_robot_does_not_approach_what_is_too_near_to_be_measured() -> None:
    guard, close = CollisionGuard(ROBOT), CLEAR.copy()
    close[1] = 0.05
    guard.add_readings(np.zeros(3), close)
    np.testing.assert_allclose(guard.limit_speed(np.zeros(3), AHEAD), 0.0, atol=1e-12)
    np.testing.assert_array_equal(guard.limit_speed(np.zeros(3), -AHEAD), -AHEAD)
    # Beside the robot it is not in the way, and a moment later it is forgotten: it may have been noise.
    close[:2] = 0.05, 1.5
    for _ in range(3):
        guard.add_readings(np.zeros(3), close)
    np.testing.assert_array_equal(guard.limit_speed(np.zeros(3), AHEAD), AHEAD)


@settings(deadline=None, max_examples=50)
@given(st.floats(-1.2, 1.2), st.floats(0.16, 0.5), st.floats(-0.3, 0.3))
def test_a_post_that_was_seen_is_not_run_into(bearing: float, distance: float, turn: float) -> None:
    post = distance * np.array([math.cos(bearing), math.sin(bearing)])
    guard, pose = CollisionGuard(ROBOT), np.zeros(3)
    beam = 1 if bearing > 0.0 else 4
    robot_sees = CLEAR.copy()
    robot_sees[beam] = distance - ROBOT.radius
    # The reading is taken by a robot that looks so that the beam meets the post.
    guard.add_readings(np.array([0.0, 0.0, bearing - ROBOT.beam_angles[beam]]), robot_sees)
    for _ in range(30):
        pose = drive(pose, guard.limit_speed(pose, np.array([0.6 - turn, 0.6 + turn])))
        assert np.hypot(*(pose[:2] - post)) > ROBOT.radius
