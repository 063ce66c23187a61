"""The controller: it turns to its target, stops in front of walls, and asks no more of the wheels than they can do."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.beliefs import CLEAR, CONFIG, ROBOT, drive

from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.controller import (
    back_off,
    bearing_of,
    steer,
    turn_by,
    wheel_speeds,
)
from limslam_env.geometry import FloatArray, se2

angles = st.floats(-math.pi, math.pi)


def ahead_of(pose: FloatArray, bearing: float, distance: float = 1.0) -> FloatArray:
    """A point at a bearing (rad) as the robot sees it."""
    return se2.transform_points(pose, distance * np.array([[math.cos(bearing), math.sin(bearing)]]))[0]


def wall_ranges(pose: FloatArray, line: FloatArray) -> FloatArray:
    """Exact readings of all beams before one endless wall (r, theta)."""
    readings = []
    for beam in ROBOT.beams:
        x, y = se2.transform_points(pose, np.array([[beam.x, beam.y]]))[0]
        approach = math.cos(pose[2] + beam.angle - line[1])
        left = line[0] - x * math.cos(line[1]) - y * math.sin(line[1])
        hits = approach > 1e-9
        readings.append(min(max(left / approach, beam.min_range), beam.max_range) if hits else beam.max_range)
    return np.array(readings)


@settings(deadline=None, max_examples=200)
@given(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0), angles, angles)
def test_the_robot_turns_to_the_side_of_its_target_by_the_shorter_way(
    x: float, y: float, yaw: float, bearing: float
) -> None:
    pose = np.array([x, y, yaw])
    target = ahead_of(pose, bearing)
    for action in (
        steer(pose, target, CLEAR, ROBOT, CONFIG.speed),
        turn_by(bearing_of(pose, target), ROBOT),
    ):
        if 1e-3 < abs(bearing) < math.pi - 1e-3:
            assert np.sign(action[1] - action[0]) == np.sign(bearing)
        assert np.abs(action).max() <= 1.0 + 1e-12


@pytest.mark.parametrize("bearing_deg", [41.0, 179.0, -120.0])
def test_far_off_its_heading_it_turns_where_it_stands(bearing_deg: float) -> None:
    pose = np.array([1.0, 2.0, 3.0])
    action = steer(pose, ahead_of(pose, math.radians(bearing_deg)), CLEAR, ROBOT, CONFIG.speed)
    assert action.sum() == pytest.approx(0.0, abs=1e-12)
    assert np.abs(action).max() > 0.3


@settings(deadline=None, max_examples=50)
@given(angles, angles, st.floats(0.5, 3.0))
def test_it_arrives(yaw: float, bearing: float, distance: float) -> None:
    pose = np.array([0.3, -0.7, yaw])
    target = ahead_of(pose, bearing, distance)
    for _ in range(400):
        if np.hypot(*(target - pose[:2])) < 0.05:
            break
        pose = drive(pose, steer(pose, target, CLEAR, ROBOT, CONFIG.speed))
    assert np.hypot(*(target - pose[:2])) < 0.05


@pytest.mark.parametrize("slant_deg", [-30.0, 0.0, 15.0])
def test_it_stops_in_front_of_a_wall_that_its_front_beams_see(slant_deg: float) -> None:
    line = np.array([2.0, math.radians(slant_deg)])
    pose = np.array([0.0, 0.0, 0.0])
    actions = []
    for _ in range(150):
        action = steer(pose, np.array([5.0, 0.0]), wall_ranges(pose, line), ROBOT, CONFIG.speed)
        actions.append(action)
        pose = drive(pose, action)
        clearance = line[0] - pose[0] * math.cos(line[1]) - pose[1] * math.sin(line[1]) - ROBOT.radius
        assert clearance > 0.02
    # It drove up to it at full speed, slowed down, and stands still.
    assert actions[0].sum() == pytest.approx(2.0 * CONFIG.speed / ROBOT.max_wheel_speed)
    assert abs(actions[-1].sum()) < 0.01
    assert clearance < 0.15


@settings(deadline=None, max_examples=200)
@given(st.floats(-2.0, 2.0), st.floats(-20.0, 20.0))
def test_wheels_stay_within_their_speed_and_the_turn_is_kept(speed: float, turn_rate: float) -> None:
    left, right = wheel_speeds(speed, turn_rate, ROBOT)
    assert max(abs(left), abs(right)) <= 1.0 + 1e-12
    turned = (right - left) * ROBOT.max_wheel_speed / ROBOT.axle
    fastest = 2.0 * ROBOT.max_wheel_speed / ROBOT.axle
    assert turned == pytest.approx(float(np.clip(turn_rate, -fastest, fastest)), abs=1e-9)
    forward = 0.5 * (left + right) * ROBOT.max_wheel_speed
    assert abs(forward) <= abs(speed) + 1e-12
    assert forward * speed >= 0.0


def ground(*occupied: tuple[int, int]) -> GridView:
    """Free ground of 2 x 2 m about the origin, and some occupied cells given as (row, column)."""
    values = np.full((20, 20), 5, dtype=np.int16)
    for cell in occupied:
        values[cell] = -4
    return GridView(np.array([-1.0, -1.0]), 0.1, values)


@pytest.mark.parametrize("yaw", [0.0, -0.5 * math.pi])
def test_it_backs_off_over_ground_that_is_known_to_be_free(yaw: float) -> None:
    pose = np.array([0.05, 0.05, yaw])
    left, right = back_off(pose, ground(), ROBOT, CONFIG.speed)
    assert left == right < 0.0
    # What stands right behind it forbids it; the same ahead does not.
    behind = np.floor((pose[:2] - 0.2 * np.array([math.cos(yaw), math.sin(yaw)]) + 1.0) / 0.1).astype(int)
    ahead = np.floor((pose[:2] + 0.2 * np.array([math.cos(yaw), math.sin(yaw)]) + 1.0) / 0.1).astype(int)
    np.testing.assert_array_equal(back_off(pose, ground((behind[1], behind[0])), ROBOT, CONFIG.speed), [0.0, 0.0])
    assert (back_off(pose, ground((ahead[1], ahead[0])), ROBOT, CONFIG.speed) < 0.0).all()
