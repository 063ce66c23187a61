"""How policies steer: speeds, the collision guard, the way to a place, and the search of a lost
robot.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.beliefs import CLEAR, CONFIG, HALL, ROBOT, belief_of, drive, grid_of, place

from limslam_agent import Belief
from limslam_agent.belief import Guess
from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.controller import (
    CollisionGuard,
    steer,
)
from limslam_agent.policies.targets import next_target, search_cost
from limslam_agent.policies.way_to import WayTo, objection
from limslam_agent.status.status import Status
from limslam_env.geometry import FloatArray, no_rows, se2

angles = st.floats(-math.pi, math.pi)


def ahead_of(pose: FloatArray, bearing: float, distance: float = 1.0) -> FloatArray:
    """A point at a bearing (rad) as the robot sees it."""
    return se2.transform_points(
        pose, distance * np.array([[math.cos(bearing), math.sin(bearing)]])
    )[0]


def wall_ranges(pose: FloatArray, line: FloatArray) -> FloatArray:
    """Exact readings of all beams before one endless wall (r, theta)."""
    readings = []
    for beam in ROBOT.beams:
        x, y = se2.transform_points(pose, np.array([[beam.x, beam.y]]))[0]
        approach = math.cos(pose[2] + beam.angle - line[1])
        left = line[0] - x * math.cos(line[1]) - y * math.sin(line[1])
        hits = approach > 1e-9
        readings.append(
            min(max(left / approach, beam.min_range), beam.max_range) if hits else beam.max_range
        )
    return np.array(readings)


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
        clearance = (
            line[0] - pose[0] * math.cos(line[1]) - pose[1] * math.sin(line[1]) - ROBOT.radius
        )
        assert clearance > 0.02
    # It drove up to it at full speed, slowed down, and stands still.
    assert actions[0].sum() == pytest.approx(2.0 * CONFIG.speed / ROBOT.max_wheel_speed)
    assert abs(actions[-1].sum()) < 0.01
    assert clearance < 0.15


# A post seen by the beam at 45 degrees before the robot came nearer: 0.21 m from the centre, ahead
# and to the left.
POST = np.array([0.15, 0.15])
AHEAD = np.array([0.6, 0.6])


def reading_of(post: FloatArray, beam: int) -> FloatArray:
    """Readings at the origin with a post on one beam, at its distance."""
    ranges = CLEAR.copy()
    ranges[beam] = np.hypot(*post) - ROBOT.radius
    return ranges


def test_a_robot_is_slowed_down_if_it_turns_towards_a_post_and_not_if_it_turns_away() -> None:
    left = np.array([0.1, 0.9])
    right = np.array([0.9, 0.1])
    for side, beam, towards, away in ((1.0, 1, left, right), (-1.0, 4, right, left)):
        guard = CollisionGuard(ROBOT)
        bearing = side * 0.6
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
    guard = CollisionGuard(ROBOT)
    close = CLEAR.copy()
    close[1] = 0.05
    guard.add_readings(np.zeros(3), close)
    np.testing.assert_allclose(guard.limit_speed(np.zeros(3), AHEAD), 0.0, atol=1e-12)
    np.testing.assert_array_equal(guard.limit_speed(np.zeros(3), -AHEAD), -AHEAD)
    # Beside the robot it is not in the way, and a moment later it is forgotten: it may have been
    # noise.
    close[:2] = 0.05, 1.5
    for _ in range(3):
        guard.add_readings(np.zeros(3), close)
    np.testing.assert_array_equal(guard.limit_speed(np.zeros(3), AHEAD), AHEAD)


@settings(deadline=None, max_examples=50)
@given(st.floats(-1.2, 1.2), st.floats(0.16, 0.5), st.floats(-0.3, 0.3))
def test_a_post_that_was_seen_is_not_run_into(bearing: float, distance: float, turn: float) -> None:
    post = distance * np.array([math.cos(bearing), math.sin(bearing)])
    guard = CollisionGuard(ROBOT)
    pose = np.zeros(3)
    beam = 1 if bearing > 0.0 else 4
    robot_sees = CLEAR.copy()
    robot_sees[beam] = distance - ROBOT.radius
    # The reading is taken by a robot that looks so that the beam meets the post.
    guard.add_readings(np.array([0.0, 0.0, bearing - ROBOT.beam_angles[beam]]), robot_sees)
    for _ in range(30):
        pose = drive(pose, guard.limit_speed(pose, np.array([0.6 - turn, 0.6 + turn])))
        assert np.hypot(*(pose[:2] - post)) > ROBOT.radius


def belief_at(x, y, values=None):
    values = np.full((40, 40), 5, dtype=np.int16) if values is None else values
    grid = GridView(np.array([-2.0, -2.0]), 0.1, values)
    return Belief(np.array([x, y, 0.0]), 1e-6 * np.eye(3), np.full(6, 1.5), no_rows(4), grid)


def way_to(goal, words="its start"):
    return WayTo(np.array(goal), words, ROBOT, CONFIG)


def test_a_robot_that_is_walled_off_says_that_there_is_no_way():
    values = np.full((40, 40), 5, dtype=np.int16)
    values[:, 25] = -5
    policy = way_to([0.0, 0.0])
    np.testing.assert_array_equal(policy.act(belief_at(1.5, 0.0, values)), 0.0)
    assert policy.stop_reason == "the map shows no way to its start"


def test_a_way_is_planned_anew_in_another_frame():
    policy = way_to([1.5, 0.0])
    policy.act(belief_at(-1.0, 0.0))
    policy.act(replace(belief_at(0.0, 1.0), frame=2))
    np.testing.assert_allclose(policy.plan[[0, -1]], [[0.0, 1.0], [1.5, 0.0]], atol=0.1)
    policy.act(replace(belief_at(1.5, 0.0), frame=2))
    assert policy.stop_reason == "the robot is at its start"


def test_the_robot_comes_home_although_the_short_way_is_closed_before_it():
    wide = "#" + "." * 38 + "#"
    narrow = "#" + "." * 7 + "#" * 24 + "." * 7 + "#"
    rows = ["#" * 40, *[wide] * 7, *[narrow] * 14, *[wide] * 7, "#" * 40]
    closed = grid_of(*(f"{row[:9]}#{row[10:]}" for row in rows[:8]), *rows[8:])
    policy = way_to(place(4, 4)[:2])
    pose = place(4, 35)
    grid = grid_of(*rows)
    for _ in range(1500):
        pose = drive(pose, policy.act(belief_of(pose, grid)))
        grid = closed if pose[0] < 1.4 else grid
    assert policy.stop_reason == "the robot is at its start"


def test_a_robot_that_comes_no_nearer_gives_up():
    policy = way_to([1.5, 0.0], "the goal (1.5, 0.0)")
    for _ in range(200):
        policy.act(belief_at(-1.0, 0.0))
    assert policy.stop_reason == "something is in the way to the goal (1.5, 0.0)"


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        ((-1.5, 0.5), ""),
        ((0.55, 0.0), "there is a wall or an obstacle"),
        ((1.5, 0.0), "the map shows no way to it"),
        ((1.5, 1.95), "that ground is not mapped yet"),
        ((70.0, 0.0), "that ground is not mapped yet"),
    ],
)
def test_a_goal_that_cannot_be_reached_is_refused_with_the_reason(goal, words):
    values = np.full((40, 40), 5, dtype=np.int16)
    values[:, 25] = -5
    values[-1] = 0
    assert objection(np.array(goal), belief_at(-1.0, 0.0, values), ROBOT) == words


LOST = Status("lost", "for a test")
HERE = place(4, 20)  # in the middle of a hall that is open to both sides
ENDS = frontier_cells(HALL, 3)
# An earlier map that knows the ground beyond one end of the hall, or beyond both; its cell 0, 0 is
# 2 m to the left.
LEFT = grid_of(*["." * 40 + "?" * 41] * 9)
BOTH = grid_of(*["." * 81] * 9)
FRAME = np.array([2.0, 0.0, 0.0])


def lost(*guesses, heading=np.pi / 2):
    pose = np.array([*HERE[:2], heading])
    return replace(belief_of(pose, HALL), status=LOST, guesses=guesses)


def costs(belief):
    """The least costs of the left and the right end of the hall."""
    cost = search_cost(belief, ENDS)
    middle = HALL.values.shape[1] // 2
    assert not cost[~ENDS].any()
    return cost[:, :middle][ENDS[:, :middle]].min(), cost[:, middle:][ENDS[:, middle:]].min()


def test_only_a_lost_robot_searches():
    assert not search_cost(replace(lost(Guess(FRAME, 2.0, LEFT)), status=Status()), ENDS).any()


def test_a_robot_goes_where_its_only_likely_place_predicts_something():
    left, right = costs(lost(Guess(FRAME, 2.0, LEFT)))
    assert left < right - 1.0
    everywhere = np.zeros(HALL.values.shape, dtype=bool)
    target = next_target(lost(Guess(FRAME, 2.0, LEFT), heading=1.3), everywhere, ROBOT, CONFIG)
    assert target.goal[0] < HERE[0], "although the other end is a little more ahead"


def test_a_robot_goes_where_two_likely_places_predict_different_things():
    """Both places predict free ground to the left, and only one does so to the right."""
    wall = grid_of(*["." * 55 + "#" * 26] * 9)
    left, right = costs(lost(Guess(FRAME, 2.0, BOTH), Guess(FRAME, 2.0, wall)))
    assert right < left - 0.5


def test_a_robot_without_a_guess_goes_on_ahead():
    left, right = costs(lost(heading=0.0))
    assert right < left - 1.0
    assert costs(lost(heading=np.pi)) == pytest.approx((right, left), abs=0.1)
