"""Policies on beliefs drawn by hand: where they mean to go, and when and why they give up."""

import math
from dataclasses import replace

import numpy as np
import pytest

from limslam_agent.config import PolicyConfig
from limslam_agent.occupancy import GridView
from limslam_agent.policies import Belief, FrontierPolicy, Laps
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

ROBOT = RobotSpec()
CONFIG = PolicyConfig()
CELL = 0.1
CLEAR = ROBOT.max_ranges
# The beams at 15 degrees see something right before the rim.
BLOCKED = np.where(np.abs(ROBOT.beam_angles) < math.radians(20.0), 0.05, CLEAR)


def grid_of(*rows: str) -> GridView:
    """A grid drawn with . for free, # for occupied and ? for unknown; the first row is row 0."""
    meaning = {".": 2, "#": -4, "?": 0}
    return GridView(np.zeros(2), CELL, np.array([[meaning[cell] for cell in row] for row in rows], dtype=np.int16))


def place(row: int, column: int, heading: float = 0.0) -> FloatArray:
    return np.array([CELL * (column + 0.5), CELL * (row + 0.5), heading])


def belief_of(pose: FloatArray, grid: GridView, ranges: FloatArray = CLEAR) -> Belief:
    return Belief(pose, np.zeros((3, 3)), ranges, np.zeros((0, 4)), grid)


# A corridor that goes on to the right, and a hall behind a wall that nothing leads to.
CORRIDOR = grid_of("#" * 30, *["#" + "." * 29] * 5, "#" * 30)
CLOSED = grid_of("#" * 12, *["#" + "." * 10 + "#"] * 8, "#" * 12)
CUT_OFF = grid_of("#" * 18, *["#" + "." * 10 + "#" + "." * 6] * 8, "#" * 18)


def actions_until_stopped(policy: FrontierPolicy | Laps, belief: Belief, most: int = 3000) -> FloatArray:
    """The actions (n, 2) of a robot that its wheels do not move, up to that after which it wants no more."""
    actions = []
    while policy.stop_reason is None and len(actions) < most:
        actions.append(np.array(policy.act(belief)))
    return np.array(actions)


def test_without_a_frontier_it_stops_at_once() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(4, 4), CLOSED))
    assert policy.stop_reason == "explored: no frontier is left"
    np.testing.assert_array_equal(actions, [[0.0, 0.0]])
    assert len(policy.plan) == 0


def test_what_cannot_be_reached_is_looked_for_all_round_twice() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(4, 4), CUT_OFF))
    assert policy.stop_reason == "explored: frontiers are left that cannot be reached (8 cells)"
    np.testing.assert_allclose(actions.sum(axis=1), 0.0, atol=1e-12)  # it never leaves its place
    turns = (actions[:, 1] - actions[:, 0]) * ROBOT.max_wheel_speed * ROBOT.control_period / ROBOT.axle
    assert (turns >= 0.0).all()
    # Two full circles, and not much more.
    assert 4.0 * math.pi <= turns.sum() <= 4.0 * math.pi + 2.0 * CONFIG.turn_rate * ROBOT.control_period
    # It tries in between.
    assert np.count_nonzero(turns == 0.0) == 3
    np.testing.assert_array_equal(policy.act(belief_of(place(4, 4), CUT_OFF)), [0.0, 0.0])


def test_what_it_sees_while_it_looks_round_opens_the_way() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    for _ in range(10):
        policy.act(belief_of(place(4, 4), CUT_OFF))
    # The wall was none: a door is there.
    opened = grid_of(
        "#" * 18, *["#" + "." * 10 + ("." if 1 <= row <= 6 else "#") + "." * 6 for row in range(8)], "#" * 18
    )
    for _ in range(60):
        policy.act(belief_of(place(4, 4), opened))
    assert policy.stop_reason is None
    assert len(policy.plan) > 2


@pytest.mark.parametrize("view_distance", [0.35, 0.6, 1.0])
def test_the_plan_ends_where_the_frontier_can_be_seen(view_distance: float) -> None:
    policy = FrontierPolicy(ROBOT, replace(CONFIG, view_distance=view_distance))
    action = policy.act(belief_of(place(3, 3), CORRIDOR))
    assert action.sum() > 0.5
    np.testing.assert_allclose(policy.plan[0], place(3, 3)[:2])
    # The frontier is the last column; straight on, the way ends as much before it, up to a cell.
    left = place(3, 29)[0] - policy.plan[-1, 0]
    assert view_distance - 1e-9 <= left <= view_distance + CELL + 1e-9


def test_a_frontier_nearer_than_the_view_is_looked_at_from_where_the_robot_is() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    action = policy.act(belief_of(place(3, 27, math.pi), CORRIDOR))
    assert len(policy.plan) == 1
    assert action.sum() == pytest.approx(0.0, abs=1e-12)
    assert abs(action[1] - action[0]) > 0.3


def test_a_frontier_in_whose_way_something_stands_is_tried_again_and_then_left() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(3, 3), CORRIDOR, BLOCKED))
    assert policy.stop_reason is not None
    assert policy.stop_reason.startswith("explored: frontiers are left that cannot be reached (5 cells)")
    # Patience, twice round, and patience after each.
    assert len(actions) > 3 * 40 + 2 * 31


SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])


@pytest.mark.parametrize("corner", range(4))
def test_laps_that_are_blocked_stop_and_name_the_corner(corner: int) -> None:
    before, ahead = SQUARE[corner - 1], SQUARE[corner]
    heading = math.atan2(*(ahead - before)[::-1])
    policy = Laps(ROBOT, CONFIG, SQUARE, 3)
    actions = actions_until_stopped(policy, belief_of(np.array([*before, heading]), CLOSED, BLOCKED))
    assert policy.stop_reason == f"stopped: something is in the way to corner {corner + 1} of the loop"
    assert 40 <= len(actions) <= 41
    np.testing.assert_allclose(actions, 0.0, atol=1e-9)


def test_laps_wait_for_what_goes_out_of_the_way() -> None:
    policy = Laps(ROBOT, CONFIG, SQUARE, 3)
    for _ in range(5):
        for _ in range(38):
            policy.act(belief_of(np.zeros(3), CLOSED, BLOCKED))
        policy.act(belief_of(np.zeros(3), CLOSED, CLEAR))
    assert policy.stop_reason is None


def test_laps_end_after_their_last_corner() -> None:
    policy = Laps(ROBOT, CONFIG, SQUARE, 2)
    for number in range(9):
        assert policy.stop_reason is None
        action = policy.act(belief_of(np.array([*SQUARE[number % 4], 0.0]), CLOSED))
    assert policy.stop_reason == "all laps driven"
    np.testing.assert_array_equal(action, [0.0, 0.0])
