"""The Gymnasium environment: its checker, the contracts of its docstring, refusals, and reproducibility."""

import inspect
import re
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import limslam_env
from limslam_env.config import NoiseConfig, RewardConfig
from limslam_env.env import LimSlamEnv
from limslam_env.interface import RobotSpec, beams_on_rim
from limslam_env.world import WorldError, load_world

ID = "LimSlam-Env1-v0"
AHEAD = np.array([1.0, 1.0], dtype=np.float32)


def table(section: str) -> list[dict[str, str]]:
    """The rows of the table in one section of the class docstring."""
    documentation = inspect.getdoc(LimSlamEnv)
    body = documentation.split(f"## {section}\n", 1)[1].split("\n## ", 1)[0]
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in re.findall(r"^\|.*\|$", body, re.MULTILINE)]
    head, ruler, *rest = rows
    assert set("".join(ruler)) == {"-"}
    return [dict(zip(head, row, strict=True)) for row in rest]


def follow(env, actions, seed: int) -> list[np.ndarray]:
    """Everything that an episode gives, one flat array a step."""
    rows = [env.reset(seed=seed)]
    rows += [(observation, info) for observation, _, _, _, info in map(env.step, actions)]
    return [
        np.concatenate((observation["ranges"], observation["wheels"], info["pose"], [info["coverage"], info["time"]]))
        for observation, info in rows
    ]


def random_actions(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (count, 2)).astype(np.float32)


@pytest.mark.parametrize("arguments", [{"sensor_noise": 0.02}, {"sensor_noise": 0.02, "render_mode": "rgb_array"}])
def test_gymnasium_finds_nothing_to_warn_of(arguments):
    env = gym.make(ID, **arguments)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    env.close()


def test_the_ids_are_registered_with_the_default_limit():
    for name in (ID, "LimSlam-World-v0"):
        assert gym.spec(name).max_episode_steps == limslam_env.MAX_EPISODE_STEPS == 18_000


def test_world_id_takes_a_name_a_path_or_a_world(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('name = "mine"\nsize = [2, 2]\nwalls = [[0,0,2,0],[2,0,2,2],[2,2,0,2],[0,2,0,0]]', encoding="utf-8")
    for source, name in (("square", "square"), (str(path), "mine"), (path, "mine"), (load_world("env1"), "env1")):
        env = gym.make("LimSlam-World-v0", world=source).unwrapped
        env.reset(seed=0)
        assert env.world.name == name


def test_observations_are_what_the_contract_says():
    env = gym.make(ID, sensor_noise=0.04)
    observation, _ = env.reset(seed=0)
    for action in random_actions(50):
        assert list(observation) == ["ranges", "wheels"]
        assert observation["ranges"].shape == (6,)
        assert observation["wheels"].shape == (2,)
        assert observation["ranges"].dtype == observation["wheels"].dtype == np.float32
        assert env.observation_space.contains(observation)
        observation = env.step(action)[0]


def test_info_is_what_the_contract_says():
    env = gym.make(ID)
    _, info = env.reset(seed=0)
    np.testing.assert_array_equal(info["pose"], load_world("env1").starts[0])
    assert info["time"] == 0.0
    for step in range(1, 40):
        assert set(info) == {"pose", "time", "coverage", "collision", "wall_seen"}
        assert info["pose"].shape == (3,)
        assert info["pose"].dtype == np.float64
        assert type(info["time"]) is float
        assert type(info["coverage"]) is float
        assert 0.0 <= info["coverage"] <= 1.0
        assert type(info["collision"]) is bool
        assert info["wall_seen"].shape == (6,)
        assert np.issubdtype(info["wall_seen"].dtype, np.integer)
        assert (info["wall_seen"] >= -1).all()
        assert (info["wall_seen"] < 16).all()
        info = env.step(AHEAD)[4]
        assert info["time"] == pytest.approx(0.1 * step)


def test_every_array_is_fresh():
    env = gym.make(ID)
    results = [env.reset(seed=0), *((result[0], result[4]) for result in (env.step(AHEAD) for _ in range(3)))]
    arrays = [
        array for observation, info in results for array in (*observation.values(), info["pose"], info["wall_seen"])
    ]
    for number, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[:number])
    # What a caller does to an answer must not reach the next one.
    expected = follow(gym.make(ID), [AHEAD] * 5, seed=1)
    env.reset(seed=1)
    for row in expected[1:]:
        observation, _, _, _, info = env.step(AHEAD)
        np.testing.assert_array_equal(observation["ranges"], row[:6])
        np.testing.assert_array_equal(info["pose"], row[8:11])
        for array in (*observation.values(), info["pose"], info["wall_seen"]):
            array[:] = 0


def test_wall_seen_names_the_wall_that_the_range_ends_on():
    env = gym.make(ID).unwrapped
    robot, world = env.robot, env.world
    _, info = env.reset(seed=0, options={"start": (3.2, 1.9, 0.0)})
    hits = set()
    for _ in range(60):
        observation, _, _, _, info = env.step(np.array([0.6, 1.0]))
        x, y, theta = info["pose"]
        angles = theta + robot.beam_angles
        ends = [x, y] + (robot.radius + observation["ranges"])[:, None] * np.column_stack(
            (np.cos(angles), np.sin(angles))
        )
        for end, wall, reading in zip(ends, info["wall_seen"], observation["ranges"], strict=True):
            assert (wall == -1) == (reading == np.float32(1.5))
            if wall >= 0 and reading > 0.05:
                x1, y1, x2, y2 = world.edges[wall]
                off = abs((x2 - x1) * (end[1] - y1) - (y2 - y1) * (end[0] - x1)) / np.hypot(x2 - x1, y2 - y1)
                assert off < 1e-6
                hits.add(int(wall))
    assert len(hits) >= 3
    assert max(hits) >= 12, "an obstacle's edge is among them: they come after the walls"


def test_the_episode_is_truncated_at_the_limit_given_to_make():
    env = gym.make(ID, max_episode_steps=7)
    env.reset(seed=0)
    flags = [env.step(AHEAD)[2:4] for _ in range(7)]
    assert flags == [(False, False)] * 6 + [(False, True)]


def test_the_episode_terminates_at_the_coverage_goal():
    env = gym.make(ID, coverage_goal=0.05)
    _, info = env.reset(seed=0)
    terminated, steps = False, 0
    while not terminated:
        assert info["coverage"] < 0.05
        _, _, terminated, truncated, info = env.step(AHEAD)
        assert type(terminated) is bool
        assert not truncated
        steps += 1
    assert info["coverage"] >= 0.05
    assert 1 < steps < 500


def test_without_a_goal_nothing_terminates():
    # A small room that is wholly seen after one turn.
    robot = RobotSpec(beams=beams_on_rim(tuple(range(-180, 180, 5)), 0.10))
    flags, coverage = {}, {}
    for goal in (None, 1.0):
        env = LimSlamEnv("square", robot=robot, coverage_goal=goal)
        env.reset(seed=0, options={"world": small_room()})
        results = [env.step((-0.3, 0.3)) for _ in range(60)]
        flags[goal] = any(result[2] for result in results)
        coverage[goal] = results[-1][4]["coverage"]
    assert coverage == {None: 1.0, 1.0: 1.0}
    assert flags == {None: False, 1.0: True}


def small_room():
    corners = np.array([[0.0, 0.0], [0.8, 0.0], [0.8, 0.8], [0.0, 0.8]])
    walls = np.hstack((corners, np.roll(corners, -1, axis=0)))
    return type(load_world("env1"))("small", (0.8, 0.8), walls, starts=np.array([[0.4, 0.4, 0.0]]))


@pytest.mark.parametrize("goal", [0.0, -0.1, 1.1, float("nan")])
def test_a_goal_that_cannot_be_is_refused(goal):
    with pytest.raises(ValueError, match="coverage_goal"):
        LimSlamEnv("env1", coverage_goal=goal)


def test_the_reward_is_the_sum_of_its_pieces():
    rewards = RewardConfig(new_area=2.0, step=-0.5, collision=-10.0)
    env = LimSlamEnv("env1", rewards=rewards)
    _, info = env.reset(seed=0, options={"start": (1.0, 3.0, np.pi)})
    before, collisions = info["coverage"], set()
    for _ in range(60):
        _, reward, _, _, info = env.step(AHEAD)
        assert type(reward) is float
        new_area = (info["coverage"] - before) * 4500 * 0.01
        assert reward == pytest.approx(2.0 * new_area - 0.5 - 10.0 * info["collision"], abs=1e-9)
        before = info["coverage"]
        collisions.add(info["collision"])
    assert collisions == {True, False}


def test_reset_takes_a_start():
    env = gym.make(ID)
    _, info = env.reset(seed=0, options={"start": (5.0, 1.9, -2.0)})
    np.testing.assert_array_equal(info["pose"], [5.0, 1.9, -2.0])
    _, info = env.reset(seed=0)
    np.testing.assert_array_equal(info["pose"], load_world("env1").starts[0])


def test_reset_moves_to_another_world_and_stays_there():
    env = gym.make(ID)
    env.reset(seed=0, options={"world": "square"})
    assert env.unwrapped.world.name == "square"
    _, info = env.reset(seed=1)
    np.testing.assert_array_equal(info["pose"], load_world("square").starts[0])
    _, info = env.reset(options={"world": load_world("env1"), "start": (5.0, 1.9, 0.0)})
    np.testing.assert_array_equal(info["pose"], [5.0, 1.9, 0.0])


@pytest.mark.parametrize(
    ("options", "error", "reason"),
    [
        ({"begin": (1, 1, 0)}, ValueError, "unknown reset option 'begin'"),
        ({"start": (1.0, 1.0)}, ValueError, "start"),
        ({"start": "corner"}, ValueError, None),
        ({"start": (3.5, 3.5, 0.0)}, WorldError, "inside an obstacle"),
        ({"start": (0.01, 3.0, 0.0)}, WorldError, "from a wall"),
        ({"start": (float("nan"), 3.0, 0.0)}, WorldError, "finite"),
        ({"start": (20.0, 20.0, 0.0)}, WorldError, "outside|closed"),
        ({"world": "nowhere"}, WorldError, "no world is called"),
    ],
)
def test_a_reset_option_that_cannot_be_is_refused(options, error, reason):
    env = LimSlamEnv("env1")
    with pytest.raises(error, match=reason):
        env.reset(seed=0, options=options)


def test_after_a_refused_reset_a_step_says_so_or_goes_on():
    env = LimSlamEnv("env1")
    env.reset(seed=0)
    with pytest.raises(WorldError):
        env.reset(options={"world": "square", "start": (3.5, 3.5, 0.0)})
    try:
        observation, *_ = env.step(AHEAD)
    except gym.error.ResetNeeded:
        return
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize(
    "action",
    [[np.nan, 0.0], [0.0, np.inf], [0.0], [0.0, 0.0, 0.0], [[0.0, 0.0]], 0.5, None, "go", [[0.0], [0.0, 1.0]]],
)
def test_an_action_that_is_not_two_finite_numbers_is_refused(action):
    env = LimSlamEnv("env1")
    env.reset(seed=0)
    with pytest.raises(ValueError):
        env.step(action)
    # A refusal moves nothing.
    assert env.step(AHEAD)[4]["time"] == pytest.approx(0.1)


def test_actions_out_of_range_are_clipped():
    wild, clipped = LimSlamEnv("env1"), LimSlamEnv("env1")
    actions = 4.0 * random_actions(60)
    assert (np.abs(actions) > 1.0).any()
    for one, other in zip(follow(wild, actions, 3), follow(clipped, np.clip(actions, -1.0, 1.0), 3), strict=True):
        np.testing.assert_array_equal(one, other)


def test_actions_may_be_plain_lists():
    lists, arrays = (
        follow(LimSlamEnv("env1"), actions, 3) for actions in ([[0.5, 1.0]] * 5, np.tile([0.5, 1.0], (5, 1)))
    )
    np.testing.assert_array_equal(lists, arrays)


def test_a_step_before_reset_is_refused():
    with pytest.raises(gym.error.ResetNeeded):
        LimSlamEnv("env1").step(AHEAD)


def test_close_may_be_called_twice_and_before_reset():
    env = LimSlamEnv("env1", render_mode="rgb_array")
    env.close()
    env.close()
    made = gym.make(ID)
    made.reset(seed=0)
    made.close()
    made.close()


def test_spaces_are_the_same_objects_at_each_call():
    env = LimSlamEnv("env1")
    spaces = env.action_space, env.observation_space
    env.reset(seed=0)
    env.step(AHEAD)
    assert env.action_space is spaces[0]
    assert env.observation_space is spaces[1]


def test_space_bounds_are_finite_and_those_of_the_robot():
    env = LimSlamEnv(
        "env1", robot=RobotSpec(beams=beams_on_rim((0.0, 90.0), 0.1, min_range=0.1, max_range=3.0), max_wheel_speed=0.5)
    )
    ranges, wheels = env.observation_space["ranges"], env.observation_space["wheels"]
    np.testing.assert_allclose([ranges.low, ranges.high], [[0.1, 0.1], [3.0, 3.0]])
    np.testing.assert_allclose([wheels.low, wheels.high], [[-0.1, -0.1], [0.1, 0.1]])
    env.reset(seed=0)
    assert env.step(AHEAD)[0]["ranges"].shape == (2,)


def test_a_seed_gives_the_same_episode_again():
    env = gym.make(ID, sensor_noise=0.04)
    first, second = (follow(env, random_actions(100), seed=8) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first, follow(gym.make(ID, sensor_noise=0.04), random_actions(100), seed=8))
    assert (np.array(first) != np.array(follow(env, random_actions(100), seed=9))).any()


def test_episodes_without_a_new_seed_differ_but_follow_from_the_first():
    runs = []
    for _ in range(2):
        env = LimSlamEnv("env1", sensor_noise=0.04)
        runs.append([env.reset(seed=1)[0]["ranges"], env.reset()[0]["ranges"], env.reset()[0]["ranges"]])
    np.testing.assert_array_equal(*runs)
    assert (runs[0][1] != runs[0][2]).any()


def test_the_world_must_be_named():
    with pytest.raises(TypeError, match="world"):
        LimSlamEnv(sensor_noise=0.02)


def test_sensor_noise_overrides_that_of_noise_and_nothing_else():
    env = LimSlamEnv("env1", sensor_noise=0.04, noise=NoiseConfig(sensor_noise=0.02, wheel_variance=1e-4))
    assert (env.noise.sensor_noise, env.noise.wheel_variance) == (0.04, 1e-4)
    assert LimSlamEnv("env1", noise=NoiseConfig(sensor_noise=0.02)).noise.sensor_noise == 0.02
    assert LimSlamEnv("env1", sensor_noise=(0.0, 0.04)).noise.sensor_noise == (0.0, 0.04)


@pytest.mark.parametrize("noise", [-0.01, float("nan"), float("inf"), (0.04, 0.02), (-0.1, 0.1)])
def test_a_noise_that_cannot_be_is_refused(noise):
    with pytest.raises(ValueError, match="sensor_noise"):
        LimSlamEnv("env1", sensor_noise=noise)


def test_an_unknown_render_mode_is_refused():
    with pytest.raises(ValueError, match="render_mode"):
        LimSlamEnv("env1", render_mode="human")


def test_the_table_of_actions_agrees_with_the_space():
    space = LimSlamEnv("env1").action_space
    assert f"`{space!r}`" in inspect.getdoc(LimSlamEnv)
    rows = table("Action Space")
    assert [int(row["Num"]) for row in rows] == list(range(space.shape[0]))
    assert [row["Action"].split()[0] for row in rows] == ["left", "right"]
    np.testing.assert_array_equal([float(row["Min"]) for row in rows], space.low)
    np.testing.assert_array_equal([float(row["Max"]) for row in rows], space.high)


def test_the_first_action_is_the_left_wheel():
    env = LimSlamEnv("env1", noise=NoiseConfig(wheel_variance=0.0))
    env.reset(seed=0)
    observation, _, _, _, info = env.step([0.0, 1.0])
    np.testing.assert_allclose(observation["wheels"], [0.0, 0.03])
    assert info["pose"][2] > 0.0, "the right wheel alone turns to the left"


def test_the_table_of_observations_agrees_with_the_space():
    env = LimSlamEnv("env1")
    rows = {row["Key"]: row for row in table("Observation Space")}
    assert set(rows) == set(env.observation_space.keys())
    robot = env.robot
    meaning = {
        "(n_beams,)": (len(robot.beams),),
        "(2,)": (2,),
        "the beams' min_range": robot.min_ranges,
        "the beams' max_range": robot.max_ranges,
        "max_wheel_travel": robot.max_wheel_travel,
        "-max_wheel_travel": -robot.max_wheel_travel,
    }
    for key, space in env.observation_space.items():
        assert meaning[rows[key]["Shape"]] == space.shape
        np.testing.assert_allclose(space.low, np.broadcast_to(meaning[rows[key]["Min"]], space.shape), rtol=1e-6)
        np.testing.assert_allclose(space.high, np.broadcast_to(meaning[rows[key]["Max"]], space.shape), rtol=1e-6)
        assert space.dtype == np.float32


def test_the_numbers_in_the_docstring_are_those_of_the_code():
    text = " ".join(inspect.getdoc(LimSlamEnv).split())
    robot, rewards = RobotSpec(), RewardConfig()
    degrees = [f"{round(np.degrees(angle)):+d}" for angle in robot.beam_angles]
    assert f"{', '.join(degrees[:-1])} and {degrees[-1]} degrees" in text
    assert f"from {robot.beams[0].min_range} to {robot.beams[0].max_range} m" in text
    assert f"`max_wheel_travel` is {robot.max_wheel_travel:g} m" in text
    assert f"{rewards.new_area:g}, {rewards.step:g} and {rewards.collision:g}" in text
    assert f"{limslam_env.MAX_EPISODE_STEPS} steps" in text


def test_the_table_of_arguments_agrees_with_the_signature():
    parameters = list(inspect.signature(LimSlamEnv).parameters.values())
    rows = {row["Argument"]: row["Default"].strip("`") for row in table("Arguments")}
    assert list(rows) == [parameter.name for parameter in parameters]
    for parameter in parameters:
        if rows[parameter.name] in ("None", "0.99"):
            assert str(parameter.default) == rows[parameter.name]
