"""Policies that explore: to frontiers, along walls until they are whole, at random, and of one's
own.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.beliefs import (
    BLOCKED,
    CLEAR,
    CLOSED,
    CONFIG,
    CORRIDOR,
    CUT_OFF,
    HALL,
    ROBOT,
    actions_until_stopped,
    belief_of,
    drive,
    explored,
    grid_of,
    place,
)

from limslam_agent import Belief, FrontierPolicy, Laps, LimSlamAgent, RandomPolicy, WallFollower
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.unfinished import Faces
from limslam_agent.policies.controller import PATIENCE
from limslam_agent.policies.frontier_policy import least_reach
from limslam_agent.policies.wall_policy import WallPolicy, sweep_along
from limslam_agent.policies.wall_views import View, next_view, open_border
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.results import score
from limslam_agent.runs.run_config import RunConfig
from limslam_env import World
from limslam_env.geometry import FloatArray, se2
from limslam_env.robots import e_puck


def test_without_a_frontier_it_stops_at_once() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(4, 4), CLOSED))
    assert policy.stop_reason == "explored: no frontier is left"
    np.testing.assert_array_equal(actions, [[0.0, 0.0]])
    assert len(policy.plan) == 0


def test_in_front_of_a_corner_it_turns_round_before_it_ends() -> None:
    # The group of frontier cells is smaller than a frontier.
    corner = grid_of("####", "#..#", "#..?", "####")
    policy = FrontierPolicy(ROBOT, CONFIG)
    pose = place(1, 1)
    turned = 0.0
    while policy.stop_reason is None:
        after = drive(pose, policy.act(belief_of(pose, corner)))
        turned += float(se2.wrap_angle(after[2] - pose[2]))
        pose = after
    assert turned == pytest.approx(2.0 * math.pi, abs=0.5)


def test_in_another_frame_it_plans_anew() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions_until_stopped(policy, belief_of(place(4, 4), CLOSED))
    assert policy.stop_reason is not None
    lost = replace(belief_of(place(3, 4), CORRIDOR), frame=1)
    policy.act(lost)
    assert policy.stop_reason is None
    assert policy.goal is not None
    goal = policy.goal
    flipped = replace(CORRIDOR, values=CORRIDOR.values[:, ::-1].copy())
    mirrored = replace(lost, grid=flipped)
    policy.act(mirrored)
    np.testing.assert_array_equal(policy.goal, goal)
    policy.act(replace(mirrored, frame=2))
    assert abs(policy.goal[0] - goal[0]) > 0.5


@pytest.mark.parametrize("kind", [FrontierPolicy, WallPolicy])
def test_in_a_map_that_was_moved_it_knows_what_it_has_given_up(kind) -> None:
    policy = kind(ROBOT, CONFIG)
    belief = belief_of(place(3, 3), CORRIDOR, BLOCKED)
    first = len(actions_until_stopped(policy, belief))
    moved = replace(belief, frame=1)
    other = replace(belief, frame=2, map_number=1)
    policy.act(moved)
    again = len(actions_until_stopped(policy, moved))
    assert policy.stop_reason is not None
    assert again < first / 10, "the frontier that was not reached is not tried again"
    policy.act(other)
    assert len(actions_until_stopped(policy, other)) > first / 2, (
        "in another map, nothing is known of it"
    )


def test_a_frontier_that_no_way_leads_to_is_named() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions_until_stopped(policy, belief_of(place(4, 4), CUT_OFF))
    assert (
        policy.stop_reason == "explored: 1 frontier is left that cannot be reached, near (1.8, 0.5)"
    )


def test_free_cells_behind_a_wall_without_room_for_the_robot_are_no_frontier_that_is_left() -> None:
    behind = grid_of(
        "#" * 14, *["#" + "." * 10 + "#??"] * 3, *["#" + "." * 10 + "#.."] * 3, "#" * 14
    )
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions_until_stopped(policy, belief_of(place(4, 4), behind))
    assert policy.stop_reason == "explored: no frontier is left"


def test_a_frontier_in_whose_way_something_stands_is_left() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(3, 3), CORRIDOR, BLOCKED))
    assert (
        policy.stop_reason == "explored: 1 frontier is left that cannot be reached, near (3.0, 0.4)"
    )
    assert 3 * PATIENCE < len(actions) < 4 * PATIENCE


def test_frontiers_that_come_and_go_do_not_keep_it_for_ever() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    pose = place(4, 20)
    for _ in range(600):
        # Each open end of a hall looks like a wall as soon as the robot comes near.
        values = HALL.values.copy()
        values[1:8, 0] = -4 if pose[0] < 1.2 else 2
        values[1:8, 40] = -4 if pose[0] > 2.9 else 2
        pose = drive(pose, policy.act(belief_of(pose, replace(HALL, values=values))))
    assert policy.stop_reason == "explored: no frontier is left"


@pytest.mark.parametrize("seed", range(3))
def test_goals_that_change_at_random_do_not_keep_it_for_ever(seed: int) -> None:
    generator = np.random.default_rng(seed)
    policy = FrontierPolicy(ROBOT, CONFIG)
    pose = place(4, 20)
    steps = 0
    while policy.stop_reason is None and steps < 6000:
        steps += 1
        if steps % 40 == 1:
            values = HALL.values.copy()
            values[1:8, generator.choice([0, 40])] = -4
        pose = drive(pose, policy.act(belief_of(pose, replace(HALL, values=values))))
    assert policy.stop_reason is not None


@pytest.mark.parametrize("width", [0.40, 0.60])
def test_narrow_corridors_are_explored_to_their_end(width: float) -> None:
    corners = [(0.0, 0.0), (4.0, 0.0), (4.0, width), (0.0, width)]
    walls = np.array(
        [(*start, *end) for start, end in zip(corners, corners[1:] + corners[:1], strict=True)]
    )
    world = World("corridor", (4.0, width), walls, starts=np.array([[0.3, 0.5 * width, 0.0]]))
    policy = FrontierPolicy(ROBOT, CONFIG)
    coverage, contacts = explored(world, policy, 120.0, 103)
    assert coverage > 0.95
    assert contacts == 0
    assert policy.stop_reason is not None
    assert policy.stop_reason.startswith("explored: ")


def test_the_end_of_a_robot_that_cannot_see_frontiers_is_no_exploration():
    walls = [[0, 0, 0.6, 0], [0.6, 0, 0.6, 0.6], [0.6, 0.6, 0, 0.6], [0, 0.6, 0, 0]]
    box = World("box", (0.6, 0.6), np.array(walls), starts=np.array([[0.3, 0.3, 0.0]]))
    robot = e_puck()
    assert robot.reach < least_reach(robot, 0.1) < e_puck(max_range=0.15).reach
    config = RunConfig(box, 0.0, robot=robot, max_time=400.0, until="seen")
    assert [warning.split(":")[0] for warning in config.warnings] == [
        "the beams reach 0.095 m, where frontier exploration needs at least 0.175 m"
    ]
    episode = run_episode(config)
    assert episode.is_finished
    assert episode.stop_reason.startswith("stopped: nothing new was seen along the wall for 90 s")
    assert episode.stop_reason.endswith("needs at least 0.175 m: not explored")
    assert score(episode)["exploration_time_s"] is None


CELL = 0.1
# A room of 3 m by 2.4 m: its grid, and its walls.
COLUMNS = 30
ROWS = 24
_VALUES = np.full((ROWS + 2, COLUMNS + 2), -4, dtype=np.int16)
_VALUES[1:-1, 1:-1] = 2
ROOM = GridView(np.full(2, -CELL), CELL, _VALUES)
WALLS = np.array(
    [[0.0, 0.0, 3.0, 0.0], [3.0, 0.0, 3.0, 2.4], [3.0, 2.4, 0.0, 2.4], [0.0, 2.4, 0.0, 0.0]]
)


def with_gap(side: int, start: float, length: float) -> FloatArray:
    """The walls of the room, with a gap in one of them."""
    wall = WALLS[side]
    along = (wall[2:] - wall[:2]) / np.hypot(*(wall[2:] - wall[:2]))
    low = wall[:2] + start * along
    high = wall[:2] + (start + length) * along
    return np.vstack((np.delete(WALLS, side, axis=0), [*wall[:2], *low], [*high, *wall[2:]]))


def belief_at(pose: FloatArray, walls: FloatArray, ranges: FloatArray = ROBOT.max_ranges) -> Belief:
    return replace(belief_of(np.asarray(pose, dtype=float), ROOM, ranges), segments=walls)


def test_in_a_room_with_all_its_walls_there_is_nothing_to_look_at() -> None:
    assert not len(open_border(belief_at([1.5, 1.2, 0.0], WALLS), []))
    policy = WallPolicy(ROBOT, CONFIG)
    np.testing.assert_array_equal(policy.act(belief_at([1.5, 1.2, 0.0], WALLS)), [0.0, 0.0])
    assert policy.stop_reason == "explored: no frontier is left, and all walls were looked at"


@settings(deadline=None, max_examples=40)
@given(
    side=st.integers(0, 3),
    start=st.floats(0.3, 1.3),
    length=st.floats(0.35, 0.8),
    place=st.tuples(st.floats(0.3, 2.7), st.floats(0.3, 2.1)),
)
def test_a_missing_part_of_a_wall_is_looked_at_from_a_place_that_sees_it(
    side, start, length, place
) -> None:
    walls = with_gap(side, start, length)
    belief = belief_at([*place, 0.0], walls)
    border = open_border(belief, [])
    view = next_view(belief, border, ROBOT)
    assert view is not None
    # A view may show a part of a stretch. What it shows is not looked at again.
    assert len(open_border(belief, [view.faces])) <= len(border) - len(view.faces)
    wall = WALLS[side]
    along = (wall[2:] - wall[:2]) / np.hypot(*(wall[2:] - wall[:2]))
    assert start < (view.middle - wall[:2]) @ along < start + length
    assert np.abs(np.hypot(*(view.path[0] - place))) < CELL
    np.testing.assert_allclose(view.path[-1], view.stand)
    # The robot can turn there, and a beam reaches the wall at a steep angle.
    assert (np.minimum(view.stand, [3.0, 2.4] - view.stand) >= ROBOT.radius).all()
    away = view.stand - view.middle
    assert np.hypot(*away) <= ROBOT.radius + 0.7 * ROBOT.reach
    assert abs(away @ along) <= 0.9 * np.hypot(*away)


def view_of(middle: FloatArray, count: int, stand: FloatArray) -> View:
    """A view of a stretch that lies along x, of ``count`` faces."""
    offset = CELL * (np.arange(count) - 0.5 * (count - 1))
    middles = np.column_stack((middle[0] + offset, np.full(count, middle[1])))
    faces = Faces(middles, np.tile([0.0, 1.0], (count, 1)))
    return View(faces, stand, stand[None], CELL)


@settings(deadline=None, max_examples=60)
@given(
    heading=st.floats(-math.pi, math.pi),
    count=st.integers(2, 8),
    away=st.floats(0.3, 0.9),
)
def test_a_sweep_lets_a_beam_pass_over_the_whole_stretch(heading, count, away) -> None:
    view = view_of(np.array([1.0, 0.0]), count, np.array([1.0, away]))
    sweep = sweep_along(view, np.array([1.0, away, heading]), ROBOT)
    first, width = view.bearings(view.stand)
    assert width == pytest.approx(2.0 * math.atan2(0.5 * CELL * count, away), rel=0.3)
    headings = np.linspace(sweep.start, sweep.end, 400)
    pointing = headings[:, None] + ROBOT.beam_angles
    inside = (se2.wrap_angle(pointing - first) >= 0.0) & (se2.wrap_angle(pointing - first) <= width)
    swept = [
        beam
        for beam in range(6)
        if not inside[0, beam] and not inside[-1, beam] and inside[:, beam].any()
    ]
    assert swept
    assert math.radians(1.0) < sweep.step <= math.radians(5.0)
    assert sweep.left(sweep.start) == pytest.approx(abs(sweep.end - sweep.start), abs=1e-9)
    assert sweep.left(sweep.end) == pytest.approx(0.0, abs=1e-9)


def test_a_robot_that_cannot_move_gives_every_look_up_and_ends() -> None:
    policy = WallPolicy(ROBOT, CONFIG)
    belief = belief_at([2.5, 1.9, 0.0], with_gap(0, 0.6, 0.8), BLOCKED)
    steps = 0
    while policy.stop_reason is None and steps < 3000:
        policy.act(belief)
        steps += 1
    assert policy.stop_reason == "explored: no frontier is left, and some walls cannot be looked at"
    assert PATIENCE < steps < 1000
    np.testing.assert_array_equal(policy.act(belief), [0.0, 0.0])
    assert policy.goal is None
    assert len(policy.plan) == 0


def room_world() -> World:
    """A room of 2.6 m by 2 m with a short wall, and a block of which each side is 0.4 m long."""
    walls = [[0, 0, 2.6, 0], [2.6, 0, 2.6, 2], [2.6, 2, 0, 2], [0, 2, 0, 0], [1.9, 2, 1.9, 1.5]]
    block = np.array([[1.0, 0.7], [1.4, 0.7], [1.4, 1.1], [1.0, 1.1]])
    return World(
        "room",
        (2.6, 2.0),
        np.array(walls, dtype=float),
        [block],
        starts=np.array([[0.4, 1.5, 0.0]]),
    )


def run(until: str | None, **changes: object):
    return run_episode(
        RunConfig(room_world(), 0.02, "consistent", 100, 600.0, until=until, **changes)
    )


def test_a_run_until_the_walls_are_whole_finds_more_walls_and_says_so() -> None:
    seen = run("seen")
    walls = run("walls")
    assert seen.stop_reason.startswith("explored: ")
    assert "wall" not in seen.stop_reason
    assert walls.is_finished
    assert walls.stop_reason.startswith("explored: ")
    assert walls.stop_reason.endswith(", and all walls were looked at")
    assert not walls.contact.any()
    # The walls are looked at after everything was seen, and until then nothing is different.
    assert len(walls.time) > len(seen.time)
    np.testing.assert_array_equal(walls.true[: len(seen.time)], seen.true)
    lengths = [
        np.hypot(*(run.snapshot.segments[:, 2:] - run.snapshot.segments[:, :2]).T).sum()
        for run in (seen, walls)
    ]
    assert lengths[1] > lengths[0] + 0.2


def test_two_robots_divide_the_walls() -> None:
    teams = []
    config = RunConfig(room_world(), 0.02, "consistent", 100, 600.0, until="walls", robots=2)
    episode = run_episode(config, lambda team, *_: teams.append(team))
    assert episode.is_finished
    assert "all walls were looked at" in episode.stop_reason
    first, second = ([faces.middles for faces in policy.looks] for policy in teams[-1].policies)
    assert first
    assert second
    away = np.concatenate(first)[:, None] - np.concatenate(second)
    assert np.hypot(*away.T).min() > 0.1


def test_what_was_looked_at_is_not_looked_at_again_after_news_of_teammates() -> None:
    policy = WallPolicy(ROBOT, CONFIG)
    pose = place(20, 15)
    walls = with_gap(0, 0.6, 0.8)
    while policy.stop_reason is None:
        pose = drive(pose, policy.act(belief_at(pose, walls)))
    assert policy.looks
    policy.restart()
    policy.act(belief_at(pose, walls))
    assert policy.stop_reason is not None


SQUARE = np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]])


@pytest.mark.parametrize("corner", range(2))
def test_laps_that_are_blocked_stop_and_name_the_corner(corner: int) -> None:
    before = SQUARE[corner - 1]
    ahead = SQUARE[corner]
    heading = math.atan2(*(ahead - before)[::-1])
    policy = Laps(ROBOT, SQUARE, 3)
    actions = actions_until_stopped(
        policy, belief_of(np.array([*before, heading]), CLOSED, BLOCKED)
    )
    assert (
        policy.stop_reason == f"stopped: something is in the way to corner {corner + 1} of the loop"
    )
    assert PATIENCE < len(actions) < PATIENCE + 3
    np.testing.assert_allclose(actions, 0.0, atol=1e-9)


def test_laps_go_on_in_another_frame_in_which_the_corner_is_farther_away() -> None:
    policy = Laps(ROBOT, SQUARE, 1)
    pose = np.array([1.9, 0.1, 0.5 * math.pi])
    policy.act(belief_of(pose, CLOSED))
    pose = np.array([0.1, -1.0, 0.0])
    for _ in range(400):
        pose = drive(pose, policy.act(replace(belief_of(pose, CLOSED), frame=1)))
    assert policy.stop_reason is None or policy.stop_reason == "all laps driven"


@pytest.mark.parametrize(
    ("policy", "least"), [(WallFollower(ROBOT, CONFIG), 0.6), (RandomPolicy(ROBOT, CONFIG, 3), 0.4)]
)
def test_a_policy_without_a_planner_gets_about(policy, least) -> None:
    coverage, contacts = explored("env1", policy, 180.0)
    assert coverage > least
    assert contacts <= 1


def test_a_wall_follower_stops_when_there_is_nothing_new() -> None:
    policy = WallFollower(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(4, 4), CLOSED))
    assert policy.stop_reason == "stopped: nothing new was seen along the wall for 90 s"
    assert len(actions) == 902
    np.testing.assert_array_equal(policy.act(belief_of(place(4, 4), CLOSED)), [0.0, 0.0])


def seeing(**distances: float) -> Belief:
    """Beams from left to right are called a to f."""
    ranges = CLEAR.copy()
    for name, distance in distances.items():
        ranges["abcdef".index(name)] = distance
    return belief_of(place(4, 4), CLOSED, ranges)


def test_a_wall_follower_keeps_its_distance() -> None:
    def turn(**distances: float) -> float:
        left, right = WallFollower(ROBOT, CONFIG).act(seeing(**distances))
        return float(left - right)

    assert turn(f=0.25) == pytest.approx(0.0, abs=1e-9)
    assert turn(f=0.15) < -0.05
    assert turn(f=0.40) > 0.05
    # Something ahead: away from the wall, where it stands.
    assert turn(f=0.25, c=0.1, d=0.1) < -0.3


def test_a_random_walk_is_its_seeds() -> None:
    belief = belief_of(place(4, 4), CLOSED, BLOCKED)

    def walk(seed: int | np.random.Generator) -> FloatArray:
        policy = RandomPolicy(ROBOT, CONFIG, seed)
        return np.array([policy.act(belief) for _ in range(50)])

    np.testing.assert_array_equal(walk(1), walk(np.random.default_rng(1)))
    assert any((walk(1) != walk(seed)).any() for seed in (2, 3, 4))


SEEN = {"ranges": ROBOT.max_ranges.astype(np.float32), "wheels": np.zeros(2, dtype=np.float32)}


class Mine:
    """A policy that gives what it is told to give."""

    def __init__(self, action=(0.0, 0.0), plan=(), stop_reason=None):
        self.action = action
        self.plan = plan
        self.stop_reason = stop_reason

    def act(self, _belief):
        return self.action


def snapshot_after_a_step(policy):
    agent = LimSlamAgent(ROBOT, policy=policy)
    agent.reset(np.zeros(3))
    agent.act(SEEN)
    return agent.snapshot()


@pytest.mark.parametrize("plan", [(), np.zeros((0, 2)), np.zeros(0)])
def test_an_empty_plan_may_be_written_in_any_way(plan):
    assert snapshot_after_a_step(Mine(plan=plan)).plan.shape == (0, 2)


def test_a_plan_may_be_a_list_and_a_snapshot_keeps_a_copy():
    policy = Mine(plan=[[0.0, 1.0], [2.0, 3.0]])
    snapshot = snapshot_after_a_step(policy)
    policy.plan[0][0] = 9.0
    assert snapshot.plan.tolist() == [[0.0, 1.0], [2.0, 3.0]]


ACTION = "act must return two finite numbers"
PLAN = "plan must be an array (k, 2)"
REASON = "stop_reason must be None or a text"


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        *(({"action": each}, ACTION) for each in (None, (1.0,), (np.nan, 0.0), "ahead")),
        *(({"plan": each}, PLAN) for each in (None, np.zeros((2, 3)), [[np.nan, 0.0]])),
        *(({"stop_reason": each}, REASON) for each in (True, 0, b"enough")),
    ],
)
def test_an_answer_that_is_none_is_refused_in_one_line(answer, words):
    with pytest.raises(ValueError, match=f"^Mine: {re.escape(words)}") as refusal:
        snapshot_after_a_step(Mine(**answer))
    assert "\n" not in str(refusal.value)
