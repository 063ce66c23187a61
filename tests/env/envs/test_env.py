"""The Gymnasium environment: its checker, the contracts of its docstring, refusals, and
reproducibility.
"""

import copy
import hashlib
import inspect
import pickle
import re
import subprocess
import sys
import warnings
from pathlib import Path

import cv2
import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from support.episodes import EVERYTHING, bits, held_actions

import limslam_env
from limslam_env import (
    FloorPlanConfig,
    LimSlamEnv,
    LimSlamParallelEnv,
    NoiseConfig,
    Overlay,
    RewardConfig,
    RobotSpec,
    load_world,
)
from limslam_env.interface import beams_on_rim

ID = "LimSlam-Env1-v0"
IDS = {
    ID: {},
    "LimSlam-Env2-v0": {},
    "LimSlam-Env3-v0": {},
    "LimSlam-World-v0": {"world": "square"},
    "LimSlam-Random-v0": {},
}
AHEAD = np.array([1.0, 1.0], dtype=np.float32)


def table(section: str, of: type = LimSlamEnv) -> list[dict[str, str]]:
    """The rows of the table in one section of a class docstring."""
    documentation = inspect.getdoc(of)
    body = documentation.split(f"## {section}\n", 1)[1].split("\n## ", 1)[0]
    rows = [
        [cell.strip() for cell in row.strip("|").split("|")]
        for row in re.findall(r"^\|.*\|$", body, re.MULTILINE)
    ]
    head, ruler, *rest = rows
    assert set("".join(ruler)) == {"-"}
    return [dict(zip(head, row, strict=True)) for row in rest]


def follow(env, actions, seed: int) -> list[np.ndarray]:
    """Everything that an episode gives, one flat array a step."""
    rows = [env.reset(seed=seed)]
    rows += [(observation, info) for observation, _, _, _, info in map(env.step, actions)]
    return [
        np.concatenate(
            (
                observation["ranges"],
                observation["wheels"],
                info["pose"],
                [info["coverage"], info["time"]],
            )
        )
        for observation, info in rows
    ]


def random_actions(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (count, 2)).astype(np.float32)


def episode_digest(name: str, seed: int) -> str:
    """A name for everything that an episode gives; another process calls this, too."""
    env = gym.make(name, noise=EVERYTHING, **IDS[name])
    results = [env.reset(seed=seed), *(env.step(action) for action in held_actions(400))]
    return hashlib.sha256(b"".join(bits(result) for result in results)).hexdigest()


@pytest.fixture
def display(monkeypatch):
    """A display that nobody sees."""
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    yield pygame.display
    pygame.display.quit()


@pytest.mark.usefixtures("display")
@pytest.mark.parametrize("name", IDS)
def test_gymnasium_finds_nothing_to_warn_of(name):
    for arguments in ({"sensor_noise": 0.02}, {"noise": EVERYTHING, "render_mode": "rgb_array"}):
        env = gym.make(name, **IDS[name], **arguments)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # The windows of the human mode are opened, too.
            check_env(env.unwrapped)
        env.close()


def test_the_ids_are_registered_with_the_default_limit():
    for name in IDS:
        assert gym.spec(name).max_episode_steps == limslam_env.MAX_EPISODE_STEPS == 18_000
    registered = {name for name in gym.registry if name.startswith("LimSlam")}
    assert registered == set(IDS)


@pytest.mark.parametrize(
    ("name", "world"), [(ID, "env1"), ("LimSlam-Env2-v0", "env2"), ("LimSlam-Env3-v0", "env3")]
)
def test_an_id_is_its_world(name, world):
    env = gym.make(name)
    _, info = env.reset(seed=0)
    assert env.unwrapped.world == load_world(world)
    np.testing.assert_array_equal(info["pose"], load_world(world).starts[0])


def test_the_world_id_takes_a_name_a_path_or_a_world(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "mine"\nsize = [2, 2]\nwalls = [[0,0,2,0],[2,0,2,2],[2,2,0,2],[0,2,0,0]]',
        encoding="utf-8",
    )
    for source, name in (
        ("square", "square"),
        (str(path), "mine"),
        (path, "mine"),
        (load_world("env1"), "env1"),
    ):
        env = gym.make("LimSlam-World-v0", world=source).unwrapped
        env.reset(seed=0)
        assert env.world.name == name


def test_info_is_what_the_contract_says():
    env = gym.make(ID)
    _, info = env.reset(seed=0)
    np.testing.assert_array_equal(info["pose"], load_world("env1").starts[0])
    assert info["time"] == 0.0
    for step in range(1, 40):
        assert set(info) == {"pose", "time", "coverage", "collision", "cost", "wall_seen"}
        assert info["pose"].shape == (3,)
        assert info["pose"].dtype == np.float64
        assert type(info["time"]) is float
        assert type(info["coverage"]) is float
        assert 0.0 <= info["coverage"] <= 1.0
        assert type(info["collision"]) is bool
        assert type(info["cost"]) is float
        assert info["wall_seen"].shape == (6,)
        assert np.issubdtype(info["wall_seen"].dtype, np.integer)
        assert (info["wall_seen"] >= -1).all()
        assert (info["wall_seen"] < 16).all()
        info = env.step(AHEAD)[4]
        assert info["time"] == pytest.approx(0.1 * step)


def test_wall_seen_names_the_wall_that_the_range_ends_on():
    env = gym.make(ID).unwrapped
    robot = env.robot
    world = env.world
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
                off = abs((x2 - x1) * (end[1] - y1) - (y2 - y1) * (end[0] - x1)) / np.hypot(
                    x2 - x1, y2 - y1
                )
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
    terminated = False
    steps = 0
    while not terminated:
        assert info["coverage"] < 0.05
        _, _, terminated, truncated, info = env.step(AHEAD)
        assert type(terminated) is bool
        assert not truncated
        steps += 1
    assert info["coverage"] >= 0.05
    assert 1 < steps < 500


def test_reset_moves_to_another_world_for_one_episode():
    env = gym.make(ID)
    _, info = env.reset(seed=0, options={"world": "square"})
    assert env.unwrapped.world.name == "square"
    np.testing.assert_array_equal(info["pose"], load_world("square").starts[0])
    for _ in range(3):
        env.step(AHEAD)
    _, info = env.reset(seed=1)
    assert env.unwrapped.world.name == "env1"
    np.testing.assert_array_equal(info["pose"], load_world("env1").starts[0])
    _, info = env.reset(options={"world": load_world("square"), "start": (1.0, 3.0, 0.0)})
    np.testing.assert_array_equal(info["pose"], [1.0, 3.0, 0.0])
    # Naming the own world is no move.
    _, info = env.reset(options={"world": "env1"})
    np.testing.assert_array_equal(info["pose"], load_world("env1").starts[0])


def test_an_episode_elsewhere_leaves_no_trace():
    env, fresh = (LimSlamEnv("env1", noise=EVERYTHING) for _ in range(2))
    env.reset(seed=5, options={"world": "env3"})
    for action in held_actions(200):
        env.step(action)
    for one, other in zip(
        follow(env, held_actions(100), 7), follow(fresh, held_actions(100), 7), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_the_random_id_draws_another_plan_at_each_reset():
    env = gym.make("LimSlam-Random-v0").unwrapped
    plans = []
    for seed in (3, None, None):
        _, info = env.reset(seed=seed)
        assert env.world.free_space(env.robot.radius).region_of(info["pose"][:2]).any()
        plans.append(env.world)
    assert len({plan.digest for plan in plans}) == 3
    again = gym.make("LimSlam-Random-v0").unwrapped
    for seed, plan in zip((3, None, None), plans, strict=True):
        again.reset(seed=seed)
        assert again.world == plan


def test_there_is_no_floor_plan_before_the_first_reset():
    env = LimSlamEnv("random", render_mode="rgb_array")
    for ask in (
        lambda: env.world,
        lambda: env.seen,
        lambda: env.coverage_grid,
        lambda: env.step(AHEAD),
    ):
        with pytest.raises(gym.error.ResetNeeded):
            ask()


def test_plans_too_narrow_for_the_robot_are_refused_at_once():
    with pytest.raises(ValueError, match="too narrow for a robot"):
        LimSlamEnv(FloorPlanConfig(), robot=RobotSpec(radius=0.4))


@pytest.mark.parametrize(
    ("options", "error", "reason"),
    [
        ({"begin": (1, 1, 0)}, ValueError, "unknown reset option 'begin'"),
        ({"start": (1.0, 1.0)}, ValueError, "start"),
        ({"start": (3.5, 3.5, 0.0)}, ValueError, "inside an obstacle"),
        ({"start": (0.01, 3.0, 0.0)}, ValueError, "from a wall"),
        ({"start": (float("nan"), 3.0, 0.0)}, ValueError, "finite"),
        ({"start": (20.0, 20.0, 0.0)}, ValueError, "outside|closed"),
        ({"world": "nowhere"}, ValueError, "no world is called"),
    ],
)
def test_a_refused_reset_leaves_the_episode_as_it_was(options, error, reason):
    refused, plain = (LimSlamEnv("env1", noise=EVERYTHING) for _ in range(2))
    for env in (refused, plain):
        env.reset(seed=0)
        env.step(AHEAD)
    with pytest.raises(error, match=reason):
        refused.reset(options=options)
    for action in random_actions(10):
        assert bits(refused.step(action)) == bits(plain.step(action))


@pytest.mark.parametrize(
    "action",
    [
        *([np.nan, 0.0], [0.0, np.inf], [0.0], [[0.0, 0.0]], None, "go", [[0.0], [0.0, 1.0]]),
        *([10**6000, 0], ["x" * 10_000, 0]),
    ],
)
def test_an_action_that_is_not_two_finite_numbers_is_refused(action):
    env = LimSlamEnv("env1")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="two finite numbers") as caught:
        env.step(action)
    assert len(str(caught.value)) < 300
    # A refusal moves nothing.
    assert env.step(AHEAD)[4]["time"] == pytest.approx(0.1)


def test_actions_out_of_range_are_clipped():
    # Each number is finite: only the sum of the largest two is not.
    for wild, tame in (
        ([1.7e308, 1.7e308], [1.0, 1.0]),
        ([-1.1, 1.1], [-1.0, 1.0]),
        ([4.0, 0.2], [1.0, 0.2]),
    ):
        np.testing.assert_array_equal(
            follow(LimSlamEnv("env1"), [np.array(wild)] * 3, 3),
            follow(LimSlamEnv("env1"), [np.array(tame)] * 3, 3),
        )


def test_space_bounds_are_finite_and_those_of_the_robot():
    env = LimSlamEnv(
        "env1",
        robot=RobotSpec(
            beams=beams_on_rim((0.0, 90.0), 0.1, min_range=0.1, max_range=3.0), max_wheel_speed=0.5
        ),
    )
    ranges = env.observation_space["ranges"]
    wheels = env.observation_space["wheels"]
    np.testing.assert_allclose([ranges.low, ranges.high], [[0.1, 0.1], [3.0, 3.0]])
    np.testing.assert_allclose([wheels.low, wheels.high], [[-0.1, -0.1], [0.1, 0.1]])
    env.reset(seed=0)
    assert env.step(AHEAD)[0]["ranges"].shape == (2,)


def test_an_episode_is_the_same_in_another_process_to_the_last_bit():
    code = "import sys; sys.path.append('../..')\n"
    code += "import test_env; print(*(test_env.episode_digest(name, 6) for name in test_env.IDS))"
    command = [sys.executable, "-c", code]
    there = subprocess.run(
        command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True
    )
    here = [episode_digest(name, 6) for name in IDS]
    assert there.stdout.split() == here
    assert len({*here, *(episode_digest(name, 7) for name in IDS)}) == 2 * len(IDS)


@pytest.mark.parametrize(
    "clone",
    [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))],  # noqa: S301 (our own bytes)
    ids=["copy", "pickle"],
)
@pytest.mark.parametrize("name", [ID, "LimSlam-Random-v0"])
def test_an_episode_goes_on_in_a_copy_to_the_last_bit(clone, name):
    env = gym.make(name, noise=EVERYTHING, max_episode_steps=700)
    env.reset(seed=2)
    actions = held_actions(700, seed=2)
    for action in actions[:100]:
        env.step(action)
    copied = clone(env)
    results = []
    for number, action in enumerate(actions[100:600]):
        # A chain of copies: each must hold all that counts.
        copied = clone(copied) if number % 100 == 99 else copied
        results.append(env.step(action))
        assert bits(copied.step(action)) == bits(results[-1])
    assert any(info["collision"] for *_, info in results)
    assert all(info["cost"] == (1.0 if info["collision"] else 0.0) for *_, info in results)
    # The next episode without a seed follows from the same generator, and the limit of steps is the
    # same.
    for action in actions[600:]:
        assert env.step(action)[3] == copied.step(action)[3]
    assert bits(env.reset()) == bits(copied.reset())


def test_noise_given_as_ranges_is_another_in_each_episode():
    env = gym.make(
        ID,
        sensor_noise=(0.01, 0.04),
        noise=NoiseConfig(slip_rate=(0.0, 2.0), wheel_mismatch=(-0.1, 0.1)),
    )
    spreads = []
    for seed in range(12):
        env.reset(seed=seed, options={"start": (1.0, 3.0, 0.0)})
        # Standing in front of walls, the readings' spread is that of the noise.
        ranges = np.array([env.step([0.0, 0.0])[0]["ranges"] for _ in range(200)], dtype=float)
        spread = ranges.std(axis=0)
        np.testing.assert_allclose(spread[spread > 0.0], spread.max(), rtol=0.3)
        spreads.append(spread.max())
    assert 0.009 < min(spreads) < 0.018
    assert 0.032 < max(spreads) < 0.045


def test_sensor_noise_overrides_that_of_noise_and_nothing_else():
    env = LimSlamEnv(
        "env1", sensor_noise=0.04, noise=NoiseConfig(sensor_noise=0.02, wheel_variance=1e-4)
    )
    assert (env.noise.sensor_noise, env.noise.wheel_variance) == (0.04, 1e-4)
    assert LimSlamEnv("env1", noise=NoiseConfig(sensor_noise=0.02)).noise.sensor_noise == 0.02
    assert LimSlamEnv("env1", sensor_noise=(0.0, 0.04)).noise.sensor_noise == (0.0, 0.04)


@pytest.mark.parametrize("mode", ["ansi", "rgb_array_list"])
@pytest.mark.parametrize("make", [LimSlamEnv, LimSlamParallelEnv])
def test_an_unknown_render_mode_is_refused(make, mode):
    with pytest.raises(ValueError, match="render_mode must be one of rgb_array, human or None"):
        make("env1", render_mode=mode)


@pytest.mark.usefixtures("display")
def test_a_window_that_its_user_has_closed_stops_nothing():
    env = LimSlamEnv("env1", render_mode="human")
    env.reset(seed=0)
    env.window.close()
    for _ in range(30):
        env.step(AHEAD)
    assert env.window.closed
    env.close()


def test_an_overlay_is_drawn_over_later_pictures():
    env = LimSlamEnv("env1", render_mode="rgb_array")
    env.reset(seed=0)
    plain = env.render()
    assert tuple(env.overlay) == ()
    belief = Overlay(pose=np.array([5.0, 6.0, 0.3]), segments=np.array([[0.5, 6.5, 3.0, 6.5]]))
    env.overlay = belief
    assert tuple(env.overlay) == (belief,)
    with_belief = env.render()
    assert (with_belief != plain).any()
    env.overlay = [belief]
    np.testing.assert_array_equal(env.render(), with_belief)
    env.overlay = ()
    np.testing.assert_array_equal(env.render(), plain)


def test_gymnasium_records_a_video(tmp_path):
    pytest.importorskip("moviepy")
    env = gym.wrappers.RecordVideo(
        gym.make(ID, render_mode="rgb_array"),
        str(tmp_path / "video"),
        episode_trigger=lambda _: True,
    )
    env.reset(seed=0)
    for _ in range(12):
        env.step(AHEAD)
    picture = env.render()
    env.close()
    (path,) = (tmp_path / "video").glob("*.mp4")
    video = cv2.VideoCapture(str(path))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(env.metadata["render_fps"])
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 13
    is_read, frame = video.read()
    video.release()
    assert is_read
    assert frame.shape == picture.shape


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
        np.testing.assert_allclose(
            space.low, np.broadcast_to(meaning[rows[key]["Min"]], space.shape), rtol=1e-6
        )
        np.testing.assert_allclose(
            space.high, np.broadcast_to(meaning[rows[key]["Max"]], space.shape), rtol=1e-6
        )
        assert space.dtype == np.float32


def test_the_table_of_rewards_agrees_with_the_defaults():
    assert {row["Term"]: row["Default"] for row in table("Rewards", LimSlamEnv)} == {
        name: f"{value:g}" for name, value in vars(RewardConfig()).items()
    }


def test_the_pieces_of_info_are_those_of_the_docstring():
    listed = [row["Key"] for row in table("Info", LimSlamEnv)]
    assert listed == list(LimSlamEnv("env1").reset(seed=0)[1])


@pytest.mark.parametrize("make", [LimSlamEnv, LimSlamParallelEnv])
def test_the_table_of_arguments_agrees_with_the_signature(make):
    parameters = list(inspect.signature(make).parameters.values())
    rows = {row["Argument"]: row["Default"].strip("`") for row in table("Arguments", make)}
    assert list(rows) == [parameter.name for parameter in parameters]
    env = make("env1")
    # None stands for these.
    made = {"RobotSpec()": env.robot, "NoiseConfig()": env.noise, "RewardConfig()": env.task.reward}
    assert made == {
        "RobotSpec()": RobotSpec(),
        "NoiseConfig()": NoiseConfig(),
        "RewardConfig()": RewardConfig(),
    }
    for parameter in parameters:
        told = rows[parameter.name]
        if parameter.name == "world":
            assert (told, parameter.default) == ("the id's world", inspect.Parameter.empty)
        elif told in made:
            assert parameter.default is None
        else:
            assert str(parameter.default) == told
