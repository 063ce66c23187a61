"""FrontierPolicy on beliefs drawn by hand: which goal it chooses, and when and why it stops."""

from dataclasses import replace

import numpy as np
import pytest
from support.beliefs import (
    BLOCKED,
    CLOSED,
    CONFIG,
    CORRIDOR,
    CUT_OFF,
    ROBOT,
    actions_until_stopped,
    belief_of,
    explored,
    grid_of,
    place,
)

from limslam_agent import FrontierPolicy
from limslam_agent.policies.controller import PATIENCE
from limslam_agent.policies.frontier_policy import least_reach
from limslam_agent.policies.wall_policy import WallPolicy
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_env import World
from limslam_env.robots import e_puck


def test_without_a_frontier_it_stops_at_once() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(4, 4), CLOSED))
    assert policy.stop_reason == "explored: no frontier is left"
    np.testing.assert_array_equal(actions, [[0.0, 0.0]])
    assert len(policy.plan) == 0


def test_in_another_frame_it_plans_anew() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions_until_stopped(policy, belief_of(place(4, 4), CLOSED))
    assert policy.stop_reason is not None
    lost = replace(belief_of(place(3, 4), CORRIDOR), frame=1)
    policy.act(lost)
    assert policy.stop_reason is None
    assert policy.goal is not None
    goal, flipped = policy.goal, replace(CORRIDOR, values=CORRIDOR.values[:, ::-1].copy())
    mirrored = replace(lost, grid=flipped)
    policy.act(mirrored)
    np.testing.assert_array_equal(policy.goal, goal)
    policy.act(replace(mirrored, frame=2))
    assert abs(policy.goal[0] - goal[0]) > 0.5


@pytest.mark.parametrize("kind", [FrontierPolicy, WallPolicy])
def test_in_a_map_that_was_moved_it_knows_what_it_has_given_up(kind) -> None:
    policy, belief = kind(ROBOT, CONFIG), belief_of(place(3, 3), CORRIDOR, BLOCKED)
    first = len(actions_until_stopped(policy, belief))
    moved, other = replace(belief, frame=1), replace(belief, frame=2, map_number=1)
    policy.act(moved)
    again = len(actions_until_stopped(policy, moved))
    assert policy.stop_reason is not None
    assert again < first / 10, "the frontier that was not reached is not tried again"
    policy.act(other)
    assert len(actions_until_stopped(policy, other)) > first / 2, "in another map, nothing is known of it"


def test_a_frontier_that_no_way_leads_to_is_named() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions_until_stopped(policy, belief_of(place(4, 4), CUT_OFF))
    assert policy.stop_reason == "explored: 1 frontier is left that cannot be reached, near (1.8, 0.5)"


def test_free_cells_behind_a_wall_without_room_for_the_robot_are_no_frontier_that_is_left() -> None:
    behind = grid_of("#" * 14, *["#" + "." * 10 + "#??"] * 3, *["#" + "." * 10 + "#.."] * 3, "#" * 14)
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions_until_stopped(policy, belief_of(place(4, 4), behind))
    assert policy.stop_reason == "explored: no frontier is left"


def test_a_frontier_in_whose_way_something_stands_is_left() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(3, 3), CORRIDOR, BLOCKED))
    assert policy.stop_reason == "explored: 1 frontier is left that cannot be reached, near (3.0, 0.4)"
    assert PATIENCE < len(actions) < 2 * PATIENCE


def test_the_reason_names_the_places_and_no_more_than_three() -> None:
    # Halls of 16 cells at both ends, each open to one side, with walls between.
    row = "." * 4 + "#" + "." * 10 + "#" + "." * 4
    two = grid_of("#" * 20, *[row] * 8, "#" * 20)
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions_until_stopped(policy, belief_of(place(4, 9), two))
    assert policy.stop_reason is not None
    assert policy.stop_reason.startswith("explored: 2 frontiers are left that cannot be reached, near (0.1, 0.")
    assert ") and (2.0, 0." in policy.stop_reason


@pytest.mark.parametrize("width", [0.40, 0.60])
def test_narrow_corridors_are_explored_to_their_end(width: float) -> None:
    corners = [(0.0, 0.0), (4.0, 0.0), (4.0, width), (0.0, width)]
    walls = np.array([(*start, *end) for start, end in zip(corners, corners[1:] + corners[:1], strict=True)])
    world = World("corridor", (4.0, width), walls, starts=np.array([[0.3, 0.5 * width, 0.0]]))
    policy = FrontierPolicy(ROBOT, CONFIG)
    coverage, contacts = explored(world, policy, 120.0, 103)
    assert coverage > 0.95
    assert contacts == 0
    assert policy.stop_reason is not None
    assert policy.stop_reason.startswith("explored: ")


def test_a_robot_that_cannot_see_frontiers_follows_walls_and_does_not_call_the_world_explored():
    robot = e_puck()
    assert robot.reach < least_reach(robot, 0.1) < e_puck(max_range=0.15).reach
    episode = run_episode(RunConfig("env1", policy="frontier", robot=robot, max_time=60.0))
    assert episode.time[-1] == pytest.approx(60.0), "it went on after its first look"
    # As shipped, it had seen 0.1 % when it called the world explored.
    assert episode.coverage[-1] > 0.02
    assert not episode.contact.any()


def test_the_end_of_a_robot_that_cannot_see_frontiers_is_no_exploration():
    walls = [[0, 0, 0.6, 0], [0.6, 0, 0.6, 0.6], [0.6, 0.6, 0, 0.6], [0, 0.6, 0, 0]]
    box = World("box", (0.6, 0.6), np.array(walls), starts=np.array([[0.3, 0.3, 0.0]]))
    config = RunConfig(box, robot=e_puck(), max_time=400.0)
    assert [warning.split(":")[0] for warning in config.warnings] == [
        "the beams reach 0.095 m, where frontier exploration needs at least 0.175 m"
    ]
    episode = run_episode(config)
    assert episode.is_finished
    assert episode.stop_reason.startswith("stopped: nothing new was seen along the wall for 90 s")
    assert episode.stop_reason.endswith("needs at least 0.175 m: not explored")
    assert score(episode)["exploration_time_s"] is None
