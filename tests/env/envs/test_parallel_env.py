"""Several robots in one building: PettingZoo's checkers, the contract, refusals, and bodies that
meet.
"""

import hashlib
import importlib
import math
import subprocess
import sys
import warnings
from pathlib import Path

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from support.episodes import EVERYTHING, bits, held_actions

import limslam_env
from limslam_env import LimSlamEnv, LimSlamParallelEnv, RewardConfig, RobotSpec, World, load_world
from limslam_env.interface import beams_on_rim

with warnings.catch_warnings():
    # The import brings PettingZoo's own example environments, which use what pygame calls outdated.
    warnings.simplefilter("ignore", DeprecationWarning)
    from pettingzoo.test import api_test, parallel_api_test
    from pettingzoo.test.state_test import state_test

IDS = {
    "limslam/Env1-v0": {},
    "limslam/Env2-v0": {},
    "limslam/Env3-v0": {},
    "limslam/World-v0": {"world": "square"},
    "limslam/Random-v0": {},
}
AHEAD = np.array([1.0, 1.0], dtype=np.float32)
STOP = np.zeros(2, dtype=np.float32)
FRONT = RobotSpec(beams=beams_on_rim((0.0, 90.0, -90.0), 0.10))
# What an observation of several parts cannot be.
DICT_WARNINGS = (
    "ignore:Observation is not a NumPy array:UserWarning",
    "ignore:Observation space for each agent probably should be:UserWarning",
)


def all_alike(env: LimSlamParallelEnv, action=AHEAD) -> dict:
    return dict.fromkeys(env.agents, action)


def named_actions(robots: int, count: int, seed: int = 0) -> list[dict]:
    return [
        {f"robot_{number}": action for number, action in enumerate(row)}
        for row in held_actions(count, robots, seed=seed)
    ]


def episode_digest(robots: int, seed: int, steps: int, world: str = "env3") -> str:
    """A name for everything that an episode gives; another process calls this, too."""
    env = LimSlamParallelEnv(world, num_robots=robots, noise=EVERYTHING)
    results = [
        env.reset(seed=seed),
        *(env.step(actions) for actions in named_actions(robots, steps)),
    ]
    return hashlib.sha256(b"".join(bits(result) for result in results)).hexdigest()


def hall() -> World:
    corners = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [0.0, 6.0]])
    return World("hall", (6.0, 6.0), np.hstack((corners, np.roll(corners, -1, axis=0))))


def gap(infos: dict, one: str = "robot_0", other: str = "robot_1") -> float:
    """Distance between the centres of two robots, m."""
    return float(np.hypot(*(infos[one]["pose"] - infos[other]["pose"])[:2]))


@pytest.mark.parametrize(("robots", "max_cycles"), [(2, 18_000), (8, 60)])
def test_pettingzoo_finds_nothing_to_warn_of(robots, max_cycles):
    env = LimSlamParallelEnv("env1", num_robots=robots, sensor_noise=0.02, max_cycles=max_cycles)
    parallel_api_test(env, num_cycles=300)


@pytest.mark.parametrize(
    "arguments",
    [
        {"noise": EVERYTHING},
        {"shared_reward": True},
        {"coverage_goal": 0.3},
        {"flat": True},
        {"flat": True, "imu": True},
    ],
)
def test_pettingzoo_finds_nothing_to_warn_of_whatever_the_arguments(arguments):
    parallel_api_test(LimSlamParallelEnv("random", num_robots=3, **arguments), num_cycles=200)


@pytest.mark.filterwarnings(*DICT_WARNINGS)
def test_the_same_holds_when_robots_act_one_after_the_other():
    api_test(limslam_env.aec_env("env1", num_robots=3, max_cycles=20), num_cycles=100)


@pytest.mark.parametrize("arguments", [{}, {"imu": True}, {"world": "random"}])
def test_pettingzoo_finds_nothing_to_warn_of_in_flat_observations_and_states(arguments):
    def make(kind):
        return kind(
            **{"world": "env1", "num_robots": 3, "flat": True, "max_cycles": 20, **arguments}
        )

    api_test(make(limslam_env.aec_env), num_cycles=100)
    state_test(make(limslam_env.aec_env), make(limslam_env.parallel_env))


def test_a_flat_observation_holds_all_parts_in_order():
    plain, flat = (LimSlamParallelEnv("env1", imu=True, flat=each) for each in (False, True))
    expected, told = plain.reset(seed=0)[0], flat.reset(seed=0)[0]
    for _ in range(5):
        for name, parts in expected.items():
            np.testing.assert_array_equal(told[name], np.concatenate(list(parts.values())))
            assert flat.observation_space(name).contains(told[name])
        expected, told = plain.step(all_alike(plain))[0], flat.step(all_alike(flat))[0]


@pytest.mark.parametrize("is_flat", [False, True])
def test_the_state_is_what_is_true_of_all_robots(is_flat):
    corners = [[-1, 2, 3, 2], [3, 2, 3, 4], [3, 4, -1, 4], [-1, 4, -1, 2]]
    room = World("room", (4.0, 2.0), corners, starts=[[0.0, 3.0, 0.0], [2.0, 3.5, math.pi / 2]])
    env = LimSlamParallelEnv(room, sensor_noise=0.02, flat=is_flat)
    with pytest.raises(gym.error.ResetNeeded):
        env.state()
    env.reset(seed=0)
    observations, *_, infos = env.step(all_alike(env))
    state = env.state()
    assert env.state_space.contains(state)
    for row, name in zip(state[:-1].reshape(2, -1), env.possible_agents, strict=True):
        x, y, theta = infos[name]["pose"]
        np.testing.assert_allclose(row[:2], [(x + 1.0) / 4.0, (y - 2.0) / 2.0], atol=1e-6)
        np.testing.assert_allclose(row[2:4], [math.cos(theta), math.sin(theta)], atol=1e-6)
        seen = observations[name]
        seen = seen if is_flat else np.concatenate(list(seen.values()))
        np.testing.assert_array_equal(row[4:], seen)
        seen[:] = 0.0  # it is the caller's, and the state is not
    assert state[-1] == pytest.approx(infos["robot_0"]["coverage"], abs=1e-6)
    np.testing.assert_array_equal(env.state(), state)


@pytest.mark.parametrize("name", IDS)
def test_pettingzoo_makes_each_id(name):
    env = pettingzoo.make("parallel", name, **IDS[name], num_robots=3)
    observations, infos = env.reset(seed=0)
    assert list(observations) == list(infos) == env.agents == ["robot_0", "robot_1", "robot_2"]
    world = IDS[name].get("world", name.split("/")[1].split("-")[0].lower())
    assert env.world.name.startswith(world)
    turns = pettingzoo.make("aec", name, **IDS[name])
    turns.reset(seed=0)
    assert turns.agents == ["robot_0", "robot_1"]
    turns.step(AHEAD)
    assert turns.agent_selection == "robot_1"


def test_the_package_makes_environments_by_name():
    importlib.import_module("limslam_env.envs.parallel_env")
    env = limslam_env.parallel_env(world="square", num_robots=2)
    assert isinstance(env, limslam_env.LimSlamParallelEnv)
    assert env.world.name == "square"
    assert limslam_env.parallel_env().world.name == "env1"
    assert limslam_env.aec_env("square").possible_agents == ["robot_0", "robot_1"]
    with pytest.raises(AttributeError, match="parallel_universe"):
        _ = limslam_env.parallel_universe


def test_observations_and_info_are_what_the_contract_says():
    env = LimSlamParallelEnv("env1", num_robots=3, noise=EVERYTHING)
    observations, infos = env.reset(seed=0)
    for step, actions in enumerate(named_actions(3, 200)):
        assert list(observations) == list(infos) == env.possible_agents
        for name in env.agents:
            observation = observations[name]
            info = infos[name]
            assert list(observation) == ["ranges", "wheels"]
            assert env.observation_space(name).contains(observation)
            assert observation["ranges"].dtype == observation["wheels"].dtype == np.float32
            assert set(info) == {"pose", "time", "coverage", "collision", "cost", "wall_seen"}
            assert info["pose"].shape == (3,)
            assert info["pose"].dtype == np.float64
            assert info["time"] == pytest.approx(0.1 * step)
            assert type(info["time"]) is type(info["coverage"]) is float
            assert type(info["collision"]) is bool
            assert info["wall_seen"].shape == (6,)
            assert (info["wall_seen"] >= -2).all()
            assert info["coverage"] == infos["robot_0"]["coverage"]
        observations, rewards, terminations, truncations, infos = env.step(actions)
        assert list(rewards) == list(terminations) == list(truncations) == env.possible_agents
        assert {type(reward) for reward in rewards.values()} == {float}
        assert {type(flag) for flags in (terminations, truncations) for flag in flags.values()} == {
            bool
        }


def test_every_array_is_fresh():
    env = LimSlamParallelEnv("env1", num_robots=2)
    results = [env.reset(seed=0)]
    results += [(result[0], result[4]) for result in (env.step(all_alike(env)) for _ in range(3))]
    arrays = [
        array
        for observations, infos in results
        for name in env.agents
        for array in (*observations[name].values(), infos[name]["pose"], infos[name]["wall_seen"])
    ]
    for number, array in enumerate(arrays):
        assert not any(np.shares_memory(array, other) for other in arrays[:number])
    # What a caller does to an answer must not reach the next one.
    plain = LimSlamParallelEnv("env1", num_robots=2)
    plain.reset(seed=1)
    env.reset(seed=1)
    for _ in range(5):
        result = env.step(all_alike(env))
        assert bits(result) == bits(plain.step(all_alike(plain)))
        for name in env.agents:
            for array in (
                *result[0][name].values(),
                result[4][name]["pose"],
                result[4][name]["wall_seen"],
            ):
                array[:] = 0


def test_another_process_gives_the_same_bits_too():
    code = "import sys; sys.path.append('../..')\n"
    code += (
        "import test_parallel_env as t; print(t.episode_digest(3, 5, 1000), t.episode_digest(3, "
        "5, 100, 'random'))"
    )
    command = [sys.executable, "-c", code]
    there = subprocess.run(
        command, cwd=Path(__file__).parent, capture_output=True, text=True, check=True
    )
    assert there.stdout.split() == [episode_digest(3, 5, 1000), episode_digest(3, 5, 100, "random")]
    assert episode_digest(3, 6, 100, "random") != episode_digest(3, 5, 100, "random")


@pytest.mark.parametrize(
    "world", ["env1", "env2", hall(), "random"], ids=["env1", "env2", "no starts", "random"]
)
def test_the_first_robot_starts_where_it_would_alone(world):
    env = LimSlamParallelEnv(world, num_robots=5)
    single = LimSlamEnv(world)
    for seed in (4, None, 7):
        _, infos = env.reset(seed=seed)
        _, info = single.reset(seed=seed)
        np.testing.assert_array_equal(infos["robot_0"]["pose"], info["pose"])
        assert env.world == single.world


@pytest.mark.parametrize("world", ["env2", "random"])
def test_robots_start_apart_and_where_they_can_meet(world):
    env = LimSlamParallelEnv(world, num_robots=8)
    _, infos = env.reset(seed=1)
    names = env.agents
    space = env.world.free_space(env.robot.radius)
    for number, name in enumerate(names):
        assert all(gap(infos, name, other) > 2.0 * env.robot.radius for other in names[:number])
    assert len({space.label_of(infos[name]["pose"][:2]) for name in names}) == 1


def test_a_robot_that_stands_is_pushed_and_says_so():
    env = LimSlamParallelEnv("square", robot=FRONT)
    env.reset(seed=0, options={"start": [(2.0, 1.0, 0.0), (2.5, 1.0, 0.0)]})
    for _ in range(40):
        *_, infos = env.step({"robot_0": AHEAD, "robot_1": STOP})
        assert gap(infos) >= 2.0 * FRONT.radius - 1e-3
    assert infos["robot_1"]["pose"][0] > 2.51
    assert infos["robot_0"]["collision"]
    assert infos["robot_1"]["collision"]


def test_robots_see_each_other_s_bodies():
    env = LimSlamParallelEnv("square", robot=FRONT)
    observations, infos = env.reset(
        seed=0, options={"start": [(2.0, 1.0, 0.0), (3.0, 1.0, math.pi)]}
    )
    for _ in range(20):
        for name in env.agents:
            assert infos[name]["wall_seen"][0] == -2
            assert observations[name]["ranges"][0] == pytest.approx(
                gap(infos) - 2.0 * FRONT.radius, abs=1e-6
            )
        observations, *_, infos = env.step({"robot_0": AHEAD, "robot_1": STOP})
    # Robots that only look past each other see walls.
    _, infos = env.reset(seed=0, options={"start": [(2.0, 1.0, 0.0), (3.0, 1.5, 0.0)]})
    assert all((info["wall_seen"] != -2).all() for info in infos.values())


def test_a_robot_alone_sees_and_does_what_the_single_environment_s_does():
    env = LimSlamParallelEnv("env1", num_robots=1, noise=EVERYTHING)
    single = LimSlamEnv("env1", noise=EVERYTHING)
    observations, infos = env.reset(seed=3)
    assert bits((observations["robot_0"], infos["robot_0"])) == bits(single.reset(seed=3))
    for actions in named_actions(1, 200):
        result = tuple(part["robot_0"] for part in env.step(actions))
        assert bits(result) == bits(single.step(actions["robot_0"]))


@pytest.mark.parametrize("shared", [False, True])
def test_rewards_are_the_sum_of_their_pieces(shared):
    pieces = RewardConfig(new_area=2.0, step=-0.5, collision=-10.0)
    env = LimSlamParallelEnv("env1", num_robots=3, rewards=pieces, shared_reward=shared)
    _, infos = env.reset(seed=0)
    before = infos["robot_0"]["coverage"]
    cells = env.coverage_grid.total
    seen_apart = False
    touched = set()
    for actions in named_actions(3, 400, seed=3):
        _, rewards, _, _, infos = env.step(actions)
        collisions = [infos[name]["collision"] for name in env.agents]
        new_area = 0.01 * cells * (infos["robot_0"]["coverage"] - before)
        before = infos["robot_0"]["coverage"]
        own = [rewards[name] for name in env.agents]
        # What one of them was the first to see is nobody else's.
        assert sum(own) == pytest.approx(
            2.0 * new_area - 3 * 0.5 - 10.0 * sum(collisions), abs=1e-9
        )
        if shared:
            assert len(set(own)) == 1
        else:
            areas = [0.5 * (r + 0.5 + 10.0 * c) for r, c in zip(own, collisions, strict=True)]
            assert min(areas) > -1e-9
            seen_apart |= len({round(area, 6) for area in areas}) > 1
            touched.update(collisions)
    assert shared or (seen_apart and touched == {True, False})


def test_all_terminate_when_they_have_seen_enough_together():
    env = LimSlamParallelEnv("env1", num_robots=3, coverage_goal=0.3)
    alone = LimSlamEnv("env1", coverage_goal=None)
    env.reset(seed=0)
    alone.reset(seed=0)
    own = 0.0
    together = []
    while env.agents:
        assert env.agents == env.possible_agents
        _, _, terminations, truncations, infos = env.step(all_alike(env, np.array([0.9, 1.0])))
        own = alone.step([0.9, 1.0])[4]["coverage"]
        together.append(infos["robot_0"]["coverage"])
        assert terminations == dict.fromkeys(env.possible_agents, together[-1] >= 0.3)
        assert truncations == dict.fromkeys(env.possible_agents, False)
    assert together[0] < 0.3 <= together[-1]
    assert own < 0.3


def test_all_are_truncated_after_max_cycles():
    env = LimSlamParallelEnv("env1", max_cycles=7)
    for _ in range(2):
        env.reset(seed=0)
        flags = [env.step(all_alike(env))[2:4] for _ in range(7)]
        for step, (terminations, truncations) in enumerate(flags, start=1):
            assert terminations == dict.fromkeys(env.possible_agents, False)
            assert truncations == dict.fromkeys(env.possible_agents, step == 7)
        assert env.agents == []


@pytest.mark.parametrize(
    "change",
    [{"robot_1": None}, {"robot_2": AHEAD}, {"robot_1": None, 1: AHEAD}],
    ids=["missing", "unknown", "a number for a name"],
)
def test_actions_must_be_those_of_the_robots_that_are_there(change):
    env = LimSlamParallelEnv("env1")
    plain = LimSlamParallelEnv("env1")
    for one in (env, plain):
        one.reset(seed=0)
    actions = {
        name: action for name, action in {**all_alike(env), **change}.items() if action is not None
    }
    with pytest.raises(ValueError, match="one action for each of robot_0, robot_1"):
        env.step(actions)
    with pytest.raises(ValueError, match="one action for each of robot_0, robot_1"):
        env.step(list(actions))
    # A refusal moves nothing.
    assert bits(env.step(all_alike(env))) == bits(plain.step(all_alike(plain)))


def test_a_step_before_reset_and_after_the_end_is_refused():
    env = LimSlamParallelEnv("env1", max_cycles=2)
    actions = dict.fromkeys(env.possible_agents, AHEAD)
    with pytest.raises(gym.error.ResetNeeded):
        env.step(actions)
    env.reset(seed=0)
    env.step(actions)
    env.step(actions)
    for wanted in (actions, {}):
        with pytest.raises(gym.error.ResetNeeded):
            env.step(wanted)
    env.reset()
    env.step(actions)


def test_reset_takes_starts_for_one_or_several():
    env = LimSlamParallelEnv("env1", num_robots=3)
    starts = [(5.0, 1.9, -2.0), (1.0, 3.5, 0.0), (6.0, 3.5, 1.0)]
    _, infos = env.reset(seed=0, options={"start": starts})
    np.testing.assert_allclose([infos[name]["pose"] for name in env.agents], starts, atol=1e-12)
    for some in (starts[:2], np.array(starts[:2])):
        _, infos = env.reset(seed=0, options={"start": some})
        np.testing.assert_allclose(
            [infos[name]["pose"] for name in env.agents[:2]], starts[:2], atol=1e-12
        )
        assert gap(infos, "robot_2", "robot_0") > 0.2
        assert gap(infos, "robot_2", "robot_1") > 0.2
    _, infos = env.reset(seed=0, options={"start": starts[0]})
    np.testing.assert_allclose(infos["robot_0"]["pose"], starts[0], atol=1e-12)
    _, infos = env.reset(seed=0)
    np.testing.assert_array_equal(infos["robot_0"]["pose"], load_world("env1").starts[0])


@pytest.mark.parametrize(
    ("start", "error", "reason"),
    [
        ([(5.0, 1.9, 0.0)] * 3, ValueError, "up to 2 rows"),
        ([], ValueError, "up to 2 rows"),
        ("corner", ValueError, "up to 2 rows"),
        ([(5.0, 1.9, 0.0), (5.1, 1.9, 0.0)], ValueError, "two robots are to start in one place"),
        ([(5.0, 1.9, 0.0), (3.5, 3.5, 0.0)], ValueError, "inside an obstacle"),
    ],
)
def test_starts_that_cannot_be_are_refused_and_leave_the_episode_as_it_was(start, error, reason):
    env = LimSlamParallelEnv("env1")
    plain = LimSlamParallelEnv("env1")
    for one in (env, plain):
        one.reset(seed=0)
    with pytest.raises(error, match=reason):
        env.reset(options={"start": start})
    assert bits(env.step(all_alike(env))) == bits(plain.step(all_alike(plain)))


def test_options_that_nobody_knows_are_ignored():
    # PettingZoo's checker insists on that.
    env = LimSlamParallelEnv("env1")
    assert bits(env.reset(seed=0, options={"colour": "red"})) == bits(env.reset(seed=0))


def test_more_robots_than_have_room_are_refused():
    side = 0.7
    walls = side * np.array([[0, 0, 1, 0], [1, 0, 1, 1], [1, 1, 0, 1], [0, 1, 0, 0]])
    env = LimSlamParallelEnv(World("closet", (side, side), walls), num_robots=8)
    with pytest.raises(ValueError, match="no room for 8 robots"):
        env.reset(seed=0)


@pytest.mark.parametrize("cycles", [0, -5])
def test_a_limit_of_cycles_that_cannot_be_is_refused(cycles):
    with pytest.raises(
        ValueError, match=f"max_cycles must be a whole number from 1 to 1000000000, not {cycles}"
    ):
        LimSlamParallelEnv("env1", max_cycles=cycles)


def test_the_human_mode_shows_a_window(monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    env = LimSlamParallelEnv("env1", render_mode="human")
    env.reset(seed=0)
    before = pygame.surfarray.array3d(pygame.display.get_surface())
    env.step(all_alike(env))
    assert (pygame.surfarray.array3d(pygame.display.get_surface()) != before).any()
    assert env.render() is None
    env.close()
    env.close()
    assert pygame.display.get_surface() is None
