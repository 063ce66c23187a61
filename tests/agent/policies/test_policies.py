"""Policies on beliefs drawn by hand: where they mean to go, and when and why they give up."""

import math
from dataclasses import replace

import numpy as np
import pytest

from limslam_agent.agent import LimSlamAgent
from limslam_agent.belief import Belief
from limslam_agent.config.presets import PolicyConfig, preset
from limslam_agent.grid.occupancy import GridView
from limslam_agent.policies.frontier_policy import FrontierPolicy
from limslam_agent.policies.policy import Policy
from limslam_agent.policies.simple_policies import Laps, RandomPolicy, WallFollower
from limslam_env.config import NoiseConfig
from limslam_env.envs.env import LimSlamEnv
from limslam_env.geometry import FloatArray
from limslam_env.interface import NominalNoise, RobotSpec
from limslam_env.worlds.world import World

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
HALL = grid_of("#" * 41, *["." * 41] * 7, "#" * 41)
CUT_OFF = grid_of("#" * 18, *["#" + "." * 10 + "#" + "." * 6] * 8, "#" * 18)


def actions_until_stopped(policy: Policy, belief: Belief, most: int = 3000) -> FloatArray:
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


def test_what_no_way_leads_to_is_looked_at_from_the_nearest_place_and_then_left() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    belief = belief_of(place(4, 4), CUT_OFF)
    actions = [policy.act(belief)]
    # Column 10 lies beside the wall, column 9 has room for the robot.
    assert policy.plan[-1, 0] == pytest.approx(place(4, 9)[0])
    assert actions[0].sum() > 0.5
    # It does not get on, and gives up; then there is nothing left to try.
    actions = actions_until_stopped(policy, belief)
    assert policy.stop_reason is not None
    assert policy.stop_reason.startswith("explored: 1 frontier is left that cannot be reached, near (1.8, 0.")
    assert len(actions) < 200
    np.testing.assert_array_equal(policy.act(belief), [0.0, 0.0])
    assert policy.goal is None
    assert len(policy.plan) == 0


def test_from_the_nearest_place_a_beam_is_pointed_at_it() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    belief = belief_of(place(4, 9, math.radians(30.0)), CUT_OFF)
    turned = policy.act(belief)
    assert turned.sum() == pytest.approx(0.0, abs=1e-12)
    assert turned[0] != turned[1]
    aim = policy.goal
    assert aim is not None
    bearing = math.atan2(*(aim - belief.pose[:2])[::-1])
    # A beam that points at it already tells all that it can.
    policy.act(belief_of(place(4, 9, bearing - ROBOT.beam_angles[1]), CUT_OFF))
    assert policy.goal is None


def test_a_robot_that_seems_walled_in_looks_round_before_it_believes_it() -> None:
    cut_off = grid_of("#" * 30, *["#...#" + "." * 25] * 5, "#" * 30)
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(3, 2), cut_off))
    spin = (actions[:96, 1] - actions[:96, 0]) * ROBOT.max_wheel_speed / ROBOT.axle
    np.testing.assert_allclose(spin, CONFIG.turn_rate)
    assert 3 * 2.0 * math.pi < spin.sum() * ROBOT.control_period < 3 * 2.0 * math.pi + 1.0
    assert policy.stop_reason == "explored: 1 frontier is left that cannot be reached, near (3.0, 0.4)"
    # What it sees meanwhile opens the way.
    policy = FrontierPolicy(ROBOT, CONFIG)
    for _ in range(10):
        policy.act(belief_of(place(3, 2), cut_off))
    for _ in range(40):
        policy.act(belief_of(place(3, 2), CORRIDOR))
    assert policy.goal is not None
    assert policy.goal[0] > 2.5


def test_specks_of_free_ground_behind_walls_are_no_frontier() -> None:
    specks = grid_of("#" * 18, *["#" + "." * 10 + "#" + "..????"] * 4, *["#" + "." * 10 + "#" * 7] * 4, "#" * 18)
    policy = FrontierPolicy(ROBOT, CONFIG)
    policy.act(belief_of(place(4, 4), specks))
    assert policy.stop_reason == "explored: no frontier is left"


def test_a_wall_that_was_none_opens_the_way() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    for _ in range(10):
        policy.act(belief_of(place(4, 4), CUT_OFF))
    opened = grid_of(
        "#" * 18, *["#" + "." * 10 + ("." if 1 <= row <= 6 else "#") + "." * 6 for row in range(8)], "#" * 18
    )
    for _ in range(60):
        policy.act(belief_of(place(4, 4), opened))
    assert policy.stop_reason is None
    assert policy.goal is not None
    assert policy.goal[0] == pytest.approx(place(0, 17)[0])


@pytest.mark.parametrize("view_distance", [0.35, 0.6, 1.0])
def test_the_plan_ends_where_the_frontier_can_be_seen(view_distance: float) -> None:
    policy = FrontierPolicy(ROBOT, replace(CONFIG, view_distance=view_distance, small_frontier=0))
    action = policy.act(belief_of(place(3, 3), CORRIDOR))
    assert action.sum() > 0.5
    np.testing.assert_allclose(policy.plan[0], place(3, 3)[:2])
    # The frontier is the last column; straight on, the way ends as much before it, up to a cell.
    left = place(3, 29)[0] - policy.plan[-1, 0]
    assert view_distance - 1e-9 <= left <= view_distance + CELL + 1e-9


def test_a_small_frontier_is_looked_at_from_farther_off_but_not_through_walls() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    policy.act(belief_of(place(3, 3), CORRIDOR))
    left = place(3, 29)[0] - policy.plan[-1, 0]
    assert left == pytest.approx(CONFIG.far_view_distance)
    # A wall with a door in its lower half hides it until the robot stands in the door.
    values = CORRIDOR.values.copy()
    values[3:, 24] = -4
    policy = FrontierPolicy(ROBOT, CONFIG)
    policy.act(belief_of(place(5, 3), GridView(CORRIDOR.low, CELL, values)))
    assert policy.goal is not None
    assert policy.goal[0] - policy.plan[-1, 0] < 0.75


def test_a_frontier_nearer_than_the_view_is_looked_at_from_where_the_robot_is() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    action = policy.act(belief_of(place(3, 27, math.radians(135.0)), CORRIDOR))
    assert len(policy.plan) == 1
    assert action.sum() == pytest.approx(0.0, abs=1e-12)
    assert abs(action[1] - action[0]) > 0.3


def pointing_at_the_frontier(ranges: FloatArray) -> Belief:
    """Near the right end of a hall; beam 2, 15 degrees to the left, points at the frontier cell straight ahead."""
    return belief_of(place(4, 38, -ROBOT.beam_angles[2]), HALL, ranges)


def test_where_a_beam_finds_a_wall_in_the_frontiers_place_there_is_nothing_more_to_see() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    # The middle of the unknown lies 0.3 m ahead, 0.2 m from the rim.
    belief = pointing_at_the_frontier(np.where(np.arange(6) == 2, 0.2, CLEAR))
    policy.act(belief)
    assert policy.goal is None
    policy.act(belief)
    assert policy.goal is not None
    assert np.hypot(*(policy.goal - place(4, 40)[:2])) > 1.5 * CELL


def test_where_a_look_shows_nothing_it_goes_nearer() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    policy.act(pointing_at_the_frontier(CLEAR))
    assert policy.goal is not None
    action = policy.act(belief_of(place(4, 38), HALL))
    assert len(policy.plan) == 3
    np.testing.assert_allclose(policy.plan[-1], policy.goal)
    assert action.sum() > 0.3


def test_a_frontier_in_whose_way_something_stands_is_tried_three_times_and_then_left() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(3, 3), CORRIDOR, BLOCKED))
    assert policy.stop_reason == "explored: 1 frontier is left that cannot be reached, near (3.0, 0.4)"
    # Patience, and a little way back, three times.
    backwards = actions.sum(axis=1) < -0.1
    assert np.count_nonzero(backwards) == 3 * CONFIG.back_steps
    assert 3 * CONFIG.patience < len(actions) < 4 * (CONFIG.patience + CONFIG.back_steps)


def test_what_was_set_aside_waits_until_there_is_nothing_else() -> None:
    # Open to the left and, farther off, to the right.
    grid = grid_of("#" * 40, *["." * 40] * 5, "#" * 40)
    policy = FrontierPolicy(ROBOT, CONFIG)
    goals = []
    for _ in range(CONFIG.patience + 20):
        policy.act(belief_of(place(3, 12, math.pi), grid, BLOCKED))
        goals.append(math.nan if policy.goal is None else float(policy.goal[0]))
    assert goals[0] < 0.2
    assert goals[-1] > 3.8


def test_a_robot_that_does_not_get_on_gives_up_though_its_wheels_turn() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions = actions_until_stopped(policy, belief_of(place(3, 3), CORRIDOR))
    assert policy.stop_reason is not None
    assert "cannot be reached" in policy.stop_reason
    assert len(actions) < 1500


def test_it_does_not_back_into_what_it_does_not_know() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    # Its back to the wall.
    actions = actions_until_stopped(policy, belief_of(place(3, 1), CORRIDOR, BLOCKED))
    assert (actions.sum(axis=1) > -1e-9).all()


def test_a_far_cheaper_frontier_changes_its_mind_and_a_slightly_cheaper_one_does_not() -> None:
    grid = grid_of("#" * 40, *["." * 40] * 5, "#" * 40)
    policy = FrontierPolicy(ROBOT, CONFIG)
    policy.act(belief_of(place(3, 15), grid))
    assert policy.goal is not None
    assert policy.goal[0] < 0.2
    for column, side in ((22, "left"), (36, "right")):
        for _ in range(CONFIG.replan_period):
            policy.act(belief_of(place(3, column), grid))
        assert (policy.goal[0] < 0.2) == (side == "left")


def test_a_gap_that_beams_left_in_a_wall_is_no_frontier() -> None:
    holes = grid_of(
        "#" * 12, *["#" + "." * 10 + "#"] * 3, "#" + "." * 10 + "?", *["#" + "." * 10 + "#"] * 4, "##?" + "#" * 9
    )
    policy = FrontierPolicy(ROBOT, CONFIG)
    policy.act(belief_of(place(4, 4), holes))
    assert policy.stop_reason == "explored: no frontier is left"


def test_the_reason_names_the_places_and_no_more_than_three() -> None:
    # Halls of 16 cells at both ends, each open to one side, with walls between.
    row = "." * 4 + "#" + "." * 10 + "#" + "." * 4
    two = grid_of("#" * 20, *[row] * 8, "#" * 20)
    policy = FrontierPolicy(ROBOT, CONFIG)
    actions_until_stopped(policy, belief_of(place(4, 9), two))
    assert policy.stop_reason is not None
    assert policy.stop_reason.startswith("explored: 2 frontiers are left that cannot be reached, near (0.1, 0.")
    assert ") and (2.0, 0." in policy.stop_reason


def shared(pose: FloatArray, other_poses: list[list[float]], other_goals: list[list[float]]) -> Belief:
    others = np.array(other_poses).reshape(-1, 3), np.array(other_goals).reshape(-1, 2)
    return Belief(pose, np.zeros((3, 3)), CLEAR, np.zeros((0, 4)), HALL, *others)


def test_robots_part() -> None:
    pose = place(4, 18)
    alone, together = FrontierPolicy(ROBOT, CONFIG), FrontierPolicy(ROBOT, CONFIG)
    alone.act(shared(pose, [], []))
    assert alone.goal is not None
    assert alone.goal[0] < 0.2
    # The other one goes there, so the way to the other end is worth its length.
    together.act(shared(pose, [[1.2, 0.45, math.pi]], [[0.05, 0.45]]))
    assert together.goal is not None
    assert together.goal[0] > 3.9


def test_another_robot_is_driven_round() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG, index=0)
    # All but the left end is known, and somebody stands in between.
    closed = GridView(HALL.low, CELL, np.column_stack((HALL.values, np.full((9, 1), -4, dtype=np.int16))))
    other = np.array([[*place(4, 10)[:2], 0.0]])
    policy.act(Belief(place(4, 20, math.pi), np.zeros((3, 3)), CLEAR, np.zeros((0, 4)), closed, other))
    assert policy.goal is not None
    assert policy.goal[0] < 0.2
    assert np.hypot(*(policy.plan - other[0, :2]).T).min() >= 2.0 * ROBOT.radius


def test_where_another_robot_stands_in_the_only_way_it_goes_on_meaning_to_go_there() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG)
    other = np.array([[*place(3, 12)[:2], 0.0]])
    policy.act(Belief(place(3, 3), np.zeros((3, 3)), CLEAR, np.zeros((0, 4)), CORRIDOR, other))
    assert policy.goal is not None
    assert policy.goal[0] == pytest.approx(place(3, 29)[0])


@pytest.mark.parametrize(("index", "waits"), [(0, False), (1, True)])
def test_of_two_that_meet_the_second_waits_but_not_for_ever(index: int, waits: bool) -> None:
    policy = FrontierPolicy(ROBOT, CONFIG, index)
    other = np.array([[*place(3, 15)[:2], math.pi]])
    belief = Belief(place(3, 11), np.zeros((3, 3)), CLEAR, np.zeros((0, 4)), CORRIDOR, other)
    moves = [abs(policy.act(belief)).max() > 0.01 for _ in range(CONFIG.patience + 2)]
    assert moves[0] != waits
    assert moves[CONFIG.patience - 1] != waits
    assert moves[-1]


def test_it_does_not_wait_for_one_behind_it() -> None:
    policy = FrontierPolicy(ROBOT, CONFIG, 1)
    other = np.array([[*place(3, 7)[:2], math.pi]])
    action = policy.act(Belief(place(3, 11), np.zeros((3, 3)), CLEAR, np.zeros((0, 4)), CORRIDOR, other))
    assert action.sum() > 0.5


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


def explored(world: World | str, policy: Policy, max_time: float, seed: int = 100) -> tuple[float, int]:
    """True coverage and contacts begun of an agent with a policy, 2 cm noise."""
    noise = NoiseConfig(sensor_noise=0.02)
    env = LimSlamEnv(world, robot=ROBOT, noise=noise, coverage_goal=None)
    agent = LimSlamAgent(ROBOT, preset("paper", NominalNoise(0.02)), policy)
    observation, info = env.reset(seed=seed)
    agent.reset(info["pose"])
    contacts = [False]
    while info["time"] < max_time and policy.stop_reason is None:
        observation, _, _, _, info = env.step(agent.act(observation))
        contacts.append(info["collision"])
    return float(info["coverage"]), int(np.count_nonzero(np.diff(contacts, prepend=False)[1:] & contacts[1:]))


@pytest.mark.parametrize("seed", [100, 102, 103, 104])
@pytest.mark.parametrize("width", [0.40, 0.45, 0.60])
def test_narrow_corridors_are_explored_to_their_end(width: float, seed: int) -> None:
    corners = [(0.0, 0.0), (4.0, 0.0), (4.0, width), (0.0, width)]
    walls = np.array([(*start, *end) for start, end in zip(corners, corners[1:] + corners[:1], strict=True)])
    world = World("corridor", (4.0, width), walls, starts=np.array([[0.3, 0.5 * width, 0.0]]))
    policy = FrontierPolicy(ROBOT, CONFIG)
    coverage, contacts = explored(world, policy, 120.0, seed)
    assert coverage > 0.95
    assert contacts == 0
    assert policy.stop_reason is not None
    assert policy.stop_reason.startswith("explored: ")


def test_a_wall_follower_goes_round() -> None:
    coverage, contacts = explored("env1", WallFollower(ROBOT, CONFIG), 180.0)
    assert coverage > 0.6
    assert contacts == 0


def test_a_wall_follower_stops_when_there_is_nothing_new() -> None:
    policy = WallFollower(ROBOT, CONFIG, patience=20.0)
    actions = actions_until_stopped(policy, belief_of(place(4, 4), CLOSED))
    assert policy.stop_reason == "stopped: nothing new was seen along the wall for 20 s"
    assert len(actions) == 202
    np.testing.assert_array_equal(policy.act(belief_of(place(4, 4), CLOSED)), [0.0, 0.0])


def seeing(**distances: float) -> Belief:
    """Beams from left to right are called a to f."""
    ranges = CLEAR.copy()
    for name, distance in distances.items():
        ranges["abcdef".index(name)] = distance
    return belief_of(place(4, 4), CLOSED, ranges)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_wall_follower_keeps_its_distance(side: str) -> None:
    beside, sign = ("a", 1.0) if side == "left" else ("f", -1.0)

    def turn(**distances: float) -> float:
        left, right = WallFollower(ROBOT, CONFIG, side, distance=0.25).act(seeing(**distances))
        return sign * float(right - left)

    assert turn(**{beside: 0.25}) == pytest.approx(0.0, abs=1e-9)
    assert turn(**{beside: 0.15}) < -0.05
    assert turn(**{beside: 0.40}) > 0.05
    # Something ahead: away from the wall, where it stands.
    assert turn(**{beside: 0.25, "c": 0.1, "d": 0.1}) < -0.3


def test_a_wall_follower_turns_round_the_end_of_its_wall_and_goes_straight_on_when_there_is_no_other() -> None:
    policy = WallFollower(ROBOT, CONFIG, "right")
    np.testing.assert_allclose(np.ptp(policy.act(seeing())), 0.0, atol=1e-12)
    policy.act(seeing(f=0.25))
    after = np.array([policy.act(seeing()) for _ in range(200)])
    assert after[0, 0] > after[0, 1] > 0.0
    turned = float((after[:, 0] - after[:, 1]).sum()) * ROBOT.max_wheel_speed * ROBOT.control_period / ROBOT.axle
    assert math.radians(260.0) < turned < math.radians(290.0)
    np.testing.assert_allclose(np.ptp(after[-1]), 0.0, atol=1e-12)


def test_a_wall_is_on_one_of_two_sides() -> None:
    with pytest.raises(ValueError, match="the left or the right side, not 'up'"):
        WallFollower(ROBOT, CONFIG, "up")


def test_a_random_walk_gets_about() -> None:
    coverage, contacts = explored("env1", RandomPolicy(ROBOT, CONFIG, 3), 200.0)
    assert coverage > 0.4
    assert contacts <= 1


def test_a_random_walk_is_its_seeds() -> None:
    belief = belief_of(place(4, 4), CLOSED, BLOCKED)

    def walk(seed: int | np.random.Generator) -> FloatArray:
        policy = RandomPolicy(ROBOT, CONFIG, seed)
        return np.array([policy.act(belief) for _ in range(50)])

    np.testing.assert_array_equal(walk(1), walk(np.random.default_rng(1)))
    assert any((walk(1) != walk(seed)).any() for seed in (2, 3, 4))


def test_a_random_walk_stops_when_there_is_nothing_new() -> None:
    policy = RandomPolicy(ROBOT, CONFIG, 0, patience=10.0)
    actions = actions_until_stopped(policy, belief_of(place(4, 4), CLOSED, BLOCKED))
    assert policy.stop_reason == "stopped: nothing new was seen by chance for 10 s"
    assert len(actions) == 102
    # In front of something it only turns.
    np.testing.assert_allclose(actions.sum(axis=1), 0.0, atol=1e-9)
