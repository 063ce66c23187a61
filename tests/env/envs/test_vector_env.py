"""The batched environment: the same as the single one, autoreset, masks, refusals, the same bits
for any threads.
"""

import copy
import inspect
import pickle
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from scipy import stats
from support.episodes import EVERYTHING, held_actions

import limslam_env
from limslam_env import (
    FloorPlanConfig,
    LimSlamEnv,
    LimSlamVectorEnv,
    NoiseConfig,
    Overlay,
    RewardConfig,
    RobotSpec,
    SensorSpec,
    load_world,
)
from limslam_env.interface import beams_on_rim

QUIET = NoiseConfig(wheel_variance=0.0)
SMALL = FloorPlanConfig(width=4.0, height=4.0)


def assert_same(batch: tuple, env: int, single: tuple, atol: float = 1e-6) -> None:
    """One environment of a batch's step against the single one's."""
    observations, rewards, terminated, _, infos = batch
    observation, reward, is_over, _, info = single
    for key, value in observation.items():
        np.testing.assert_allclose(observations[key][env], value, atol=atol)
    for key, value in info.items():
        np.testing.assert_allclose(infos[key][env], value, atol=atol, err_msg=key)
    assert rewards[env] == pytest.approx(reward, abs=1e-12)
    assert terminated[env] == is_over


@pytest.mark.parametrize("world", ["env1", "env2", "env3", "square"])
def test_it_is_the_same_environment(world):
    envs = 4
    steps = 300
    batch = LimSlamVectorEnv(world, envs, noise=QUIET)
    singles = [LimSlamEnv(world, noise=QUIET) for _ in range(envs)]
    observations, infos = batch.reset(seed=0)
    contacts = 0
    for env, single in enumerate(singles):
        observation, info = single.reset(seed=1)
        start = {"start": infos["pose"][env]}
        if not len(load_world(world).starts):
            observation, info = single.reset(options=start)
        assert_same(
            (observations, [0.0] * envs, [False] * envs, None, infos),
            env,
            (observation, 0.0, False, None, info),
        )
    for actions in held_actions(steps, envs):
        result = batch.step(actions)
        for env, single in enumerate(singles):
            one = single.step(actions[env])
            contacts += one[-1]["collision"]
            assert_same(result, env, one)
    assert contacts > 20
    for env, single in enumerate(singles):
        grid = single.coverage_grid.coverable
        np.testing.assert_array_equal(batch.seen(env) & grid, single.seen & grid)


def test_it_is_the_same_in_corners_and_at_corners_of_obstacles():
    # Every heading into the rounded obstacles and the slanted corners of env3, at full speed.
    starts = np.array(
        [[*load_world("env3").starts[0, :2], angle] for angle in np.linspace(-np.pi, np.pi, 24)]
    )
    batch = LimSlamVectorEnv("env3", len(starts), noise=QUIET)
    batch.reset(seed=0, options={"start": starts})
    singles = [LimSlamEnv("env3", noise=QUIET) for _ in starts]
    for start, single in zip(starts, singles, strict=True):
        single.reset(seed=0, options={"start": start})
    sliding = np.zeros(len(starts), dtype=int)
    actions = np.tile(np.array([[1.0, 0.97], [0.97, 1.0]], dtype=np.float32), (len(starts) // 2, 1))
    for _ in range(250):
        infos = batch.step(actions)[-1]
        for env, single in enumerate(singles):
            info = single.step(actions[env])[-1]
            sliding[env] += info["collision"]
            off = infos["pose"][env] - info["pose"]
            assert np.hypot(*off[:2]) < 0.01
            assert abs(np.angle(np.exp(1j * off[2]))) < np.radians(1.0)
            assert infos["collision"][env] == info["collision"]
    assert (sliding > 100).sum() > 10


@pytest.mark.parametrize(
    "robot",
    [
        RobotSpec(radius=0.05, max_wheel_speed=2.0, beams=beams_on_rim((0.0, 100.0), 0.05)),
        RobotSpec(
            beams=(
                SensorSpec(0.02, 0.05, 0.4, period=3),
                SensorSpec(-0.03, 0.0, 2.0, max_range=0.7),
                SensorSpec(0.02, -0.05, -0.4, period=4, phase=3),
            )
        ),
        RobotSpec(beams=beams_on_rim(tuple(range(0, 360, 24)), 0.1, max_range=12.0)),
    ],
    ids=["fast", "beams inside", "far-seeing ring"],
)
def test_it_is_the_same_for_other_robots(robot):
    batch = LimSlamVectorEnv("env3", 2, noise=QUIET, robot=robot)
    singles = [LimSlamEnv("env3", noise=QUIET, robot=robot) for _ in range(2)]
    batch.reset(seed=0)
    for single in singles:
        single.reset(seed=0)
    for actions in held_actions(150, 2, seed=3):
        result = batch.step(actions)
        for env, single in enumerate(singles):
            assert_same(result, env, single.step(actions[env]))


def test_noise_has_the_same_distributions():
    noise = NoiseConfig(
        sensor_noise=0.02,
        range_noise_growth=0.01,
        dropout=0.1,
        wheel_variance=1e-3,
        slip_rate=5.0,
        slip_share=0.3,
    )
    ahead = np.array([0.4, 0.3], dtype=np.float32)
    count = 10_000
    batch = LimSlamVectorEnv("env1", count, noise=noise)
    batch.reset(seed=5)
    many, _, _, _, infos = batch.step(np.tile(ahead, (count, 1)))
    # One step from the same start again and again: all that differs is the noise.
    single = LimSlamEnv("env1", noise=noise)
    rows = []
    single.reset(seed=6)
    simulation = single._simulation
    start = load_world("env1").starts[:1]
    for _ in range(count):
        simulation._physics.place(start, single.robot.axle)
        simulation._scene.unreported[:] = 0.0
        observation, _, _, _, info = single.step(ahead)
        rows.append(np.concatenate((observation["ranges"], observation["wheels"], info["pose"])))
    table = np.array(rows)
    theirs = np.column_stack((many["ranges"], many["wheels"], infos["pose"]))
    for column in range(table.shape[1]):
        assert stats.ks_2samp(theirs[:, column], table[:, column], method="asymp").pvalue > 1e-3, (
            column
        )


def test_noise_of_beams_wheels_and_environments_is_independent():
    batch = LimSlamVectorEnv("env1", 4000, sensor_noise=0.02)
    batch.reset(seed=0)
    one, other = (batch.step(np.full((4000, 2), 0.1))[0] for _ in range(2))
    table = np.column_stack(
        (one["ranges"][:, [0, 5]], one["wheels"], other["ranges"][:, [0, 5]], other["wheels"])
    )
    table = np.column_stack((table, np.roll(table, 1, axis=0)))
    correlations = np.corrcoef(table[:, table.std(axis=0) > 0.0].T)
    assert np.abs(correlations - np.eye(len(correlations))).max() < 0.08


@pytest.mark.parametrize("world", ["env1", "random"])
def test_same_seed_same_bits_whatever_the_threads(world):
    digests = set()
    for threads in (1, 2, 3):
        plans = {"plans": 3} if world == "random" else {}
        batch = gym.make_vec(
            "LimSlam-World-v0",
            world=SMALL if plans else world,
            num_envs=1500,
            noise=EVERYTHING,
            num_threads=threads,
            max_episode_steps=12,
            **plans,
        )
        parts = [batch.reset(seed=9)[0]["ranges"].tobytes()]
        for actions in held_actions(30, 1500):
            observations, rewards, _, _, infos = batch.step(actions)
            parts += [value.tobytes() for value in (*observations.values(), rewards, infos["pose"])]
        batch.close()
        digests.add(b"".join(parts))
    assert len(digests) == 1


def test_noise_levels_share_starts_and_draws():
    batches = [LimSlamVectorEnv("square", 8, sensor_noise=noise) for noise in (0.01, 0.02)]
    (low, _), (high, _) = (batch.reset(seed=4) for batch in batches)
    ideal, _ = LimSlamVectorEnv("square", 8, sensor_noise=0.0).reset(seed=4)
    inner = (high["ranges"] < 1.4) & (high["ranges"] > 0.06) & (low["ranges"] < 1.4)
    np.testing.assert_allclose(
        (high["ranges"] - ideal["ranges"])[inner],
        2.0 * (low["ranges"] - ideal["ranges"])[inner],
        atol=1e-6,
    )


@pytest.mark.parametrize("name", ["Env1", "Env2", "Env3"])
def test_gymnasium_makes_it_by_default(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        batch = gym.make_vec(f"LimSlam-{name}-v0", num_envs=5, sensor_noise=0.02)
    assert isinstance(batch, limslam_env.LimSlamVectorEnv)
    assert batch.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    single = gym.make(f"LimSlam-{name}-v0")
    assert batch.single_observation_space == single.observation_space
    assert batch.single_action_space == single.action_space
    observations, infos = batch.reset(seed=0)
    assert batch.observation_space.contains(observations)
    for key in ("pose", "time", "coverage", "collision", "cost", "wall_seen"):
        assert infos[f"_{key}"].dtype == bool
        assert infos[f"_{key}"].all()
        assert infos[key].shape[0] == 5
    kept = {key: value.copy() for key, value in observations.items()}
    later, rewards, terminated, truncated, _ = batch.step(batch.action_space.sample())
    assert batch.observation_space.contains(later)
    assert rewards.shape == terminated.shape == truncated.shape == (5,)
    assert rewards.dtype == np.float64
    assert terminated.dtype == truncated.dtype == bool
    for key, value in kept.items():
        assert not np.shares_memory(observations[key], later[key])
        np.testing.assert_array_equal(observations[key], value)
    batch.close()
    batch.close()


def run(mode: AutoresetMode, batch_type=None, steps: int = 14) -> list[tuple]:
    arguments = {"sensor_noise": 0.0, "noise": QUIET}
    if batch_type is None:
        env = gym.make_vec(
            "LimSlam-Env1-v0", num_envs=2, max_episode_steps=5, autoreset_mode=mode, **arguments
        )
    else:
        env = gym.make_vec(
            "LimSlam-Env1-v0",
            num_envs=2,
            vectorization_mode="sync",
            max_episode_steps=5,
            vector_kwargs={"autoreset_mode": mode},
            **arguments,
        )
    env.reset(seed=0)
    return [env.step(actions) for actions in held_actions(steps, 2)]


def assert_same_info(ours: dict, theirs: dict) -> None:
    assert set(ours) == set(theirs)
    for key, value in theirs.items():
        if isinstance(value, dict):
            assert_same_info(ours[key], value)
        elif key == "final_obs":
            for mine, other in zip(ours[key], value, strict=True):
                assert (mine is None) == (other is None)
                for part in other or ():
                    np.testing.assert_allclose(mine[part], other[part], atol=1e-6)
        else:
            assert ours[key].dtype == value.dtype, key
            np.testing.assert_allclose(ours[key], value, atol=1e-6, err_msg=key)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_autoreset_is_gymnasium_s_own(mode):
    for ours, theirs in zip(run(mode), run(mode, "sync"), strict=True):
        for key, value in theirs[0].items():
            np.testing.assert_allclose(ours[0][key], value, atol=1e-6)
        for mine, other in zip(ours[1:4], theirs[1:4], strict=True):
            np.testing.assert_allclose(mine, other, atol=1e-9)
        assert_same_info(ours[4], theirs[4])


def test_without_autoreset_a_mask_resets():
    batch = LimSlamVectorEnv(
        "env1", 3, max_episode_steps=4, autoreset_mode=AutoresetMode.DISABLED, sensor_noise=0.02
    )
    batch.reset(seed=0)
    ahead = np.full((3, 2), 0.5)
    for _ in range(2):
        batch.step(ahead)
    _, infos = batch.reset(options={"reset_mask": np.array([False, True, False])})
    np.testing.assert_array_equal(infos["_pose"], [False, True, False])
    assert (infos["pose"][[0, 2]] == 0.0).all()
    for _ in range(2):
        _, _, _, truncated, infos = batch.step(ahead)
    np.testing.assert_array_equal(truncated, [True, False, True])
    np.testing.assert_allclose(infos["time"], [0.4, 0.2, 0.4])
    with pytest.raises(gym.error.ResetNeeded, match="environment 0 is over"):
        batch.step(ahead)
    batch.reset(options={"reset_mask": truncated})
    assert not batch.step(ahead)[3].any()


def test_the_goal_terminates():
    batch = LimSlamVectorEnv("env1", 2, coverage_goal=0.1, sensor_noise=0.02)
    batch.reset(seed=0)
    for actions in held_actions(400, 2):
        _, _, terminated, truncated, infos = batch.step(actions)
        np.testing.assert_array_equal(terminated, infos["coverage"] >= 0.1)
        assert not truncated.any()
        if terminated.any():
            return
    pytest.fail("nobody got there")


def test_rewards_are_of_the_settings():
    rewards = RewardConfig(new_area=2.0, step=-0.5, collision=-7.0)
    batch = LimSlamVectorEnv("env3", 4, rewards=rewards, noise=QUIET)
    batch.reset(seed=0)
    single = LimSlamEnv("env3")
    single.reset(seed=0)
    total = single.coverage_grid.total
    before = np.zeros(4)
    for actions in held_actions(200, 4):
        _, values, _, _, infos = batch.step(actions)
        new = np.rint((infos["coverage"] - before) * total) * 0.01
        before = infos["coverage"]
        if infos["time"][0] > 0.15:
            np.testing.assert_allclose(
                values, 2.0 * new - 0.5 - 7.0 * infos["collision"], atol=1e-9
            )


def test_wrappers_of_gymnasium_work():
    batch = gym.make_vec("LimSlam-Env1-v0", num_envs=2, max_episode_steps=5, sensor_noise=0.02)
    wrapped = gym.wrappers.vector.DictInfoToList(gym.wrappers.vector.RecordEpisodeStatistics(batch))
    wrapped.reset(seed=0)
    for _ in range(5):
        *_, infos = wrapped.step(wrapped.action_space.sample())
    assert infos[0]["episode"]["l"] == 5
    assert infos[1]["pose"].shape == (3,)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"num_envs": 0}, "num_envs must be a whole number"),
        ({"world": ["env1", "env2"]}, "2 worlds for 3"),
        ({"world": "nowhere"}, "no world is called"),
        ({"sensor_noise": [0.1, 0.2, 0.3]}, "sensor_noise must be a number"),
        ({"sensor_noise": -1.0}, "sensor_noise must be a number"),
        ({"coverage_goal": 2.0}, "coverage_goal must lie"),
        ({"max_episode_steps": 0}, "from 1 to 1000000000, not 0"),
        ({"num_threads": 0}, "num_threads must be"),
        ({"plans": 4}, "plans are for worlds that are drawn"),
        ({"world": "random", "plans": 0}, "plans must be a whole number from 1"),
        ({"world": ["random", "env1", "env1"]}, "floor plans are drawn for all"),
        ({"render_mode": "human"}, "render_mode of a batch must be rgb_array or None, not 'human'"),
        ({"autoreset_mode": "sometimes"}, "not a valid AutoresetMode"),
        ({"num_envs": True}, "num_envs must be a whole number from 1 to 4194304, not True"),
        (
            {"max_episode_steps": 2.5},
            "the steps of an episode must be a whole number from 1 to 1000000000, not 2.5",
        ),
        ({"world": SMALL, "plans": [3, -1]}, "plans must be up to 100000 seeds"),
        ({"noise": [QUIET, None, QUIET]}, "noise must be a NoiseConfig"),
    ],
)
def test_arguments_that_cannot_be_are_refused_in_one_line(arguments, reason):
    with pytest.raises(ValueError, match=reason) as error:
        LimSlamVectorEnv(**{"world": "env1", "num_envs": 3} | arguments)
    assert "\n" not in str(error.value)


def test_bad_actions_and_options_are_refused_and_change_nothing():
    batch = LimSlamVectorEnv("env1", 3, noise=QUIET)
    with pytest.raises(gym.error.ResetNeeded):
        batch.step(np.zeros((3, 2)))
    with pytest.raises(gym.error.ResetNeeded, match="first reset"):
        batch.reset(options={"reset_mask": np.array([True, False, False])})
    batch.reset(seed=0)
    for actions in (
        np.zeros((2, 2)),
        np.zeros(6),
        np.zeros((3, 3)),
        None,
        "ahead",
        [[0.0, 0.0], [0.0], [0.0, 0.0]],
    ):
        with pytest.raises(ValueError, match="3 rows of two numbers"):
            batch.step(actions)
    with pytest.raises(ValueError, match="those of environment 1 are"):
        batch.step(np.array([[0.0, 0.0], [np.nan, 0.0], [0.0, 0.0]]))
    for options, reason in (
        ({"place": 1}, "unknown reset option 'place'"),
        ([1], r"reset options are a dictionary, not \[1\]"),
        ({"reset_mask": np.zeros(3, dtype=bool)}, "reset_mask must be"),
        ({"reset_mask": np.ones(3)}, "reset_mask must be"),
        ({"start": (0.0, 1.0)}, "the start is"),
        ({"start": np.zeros((2, 3))}, "the start is"),
        ({"start": (1e3, 0.0, 0.0)}, "world 'env1'"),
    ):
        with pytest.raises(ValueError, match=reason):
            batch.reset(options=options)
    assert batch.step(np.zeros((3, 2)))[-1]["time"].tolist() == pytest.approx([0.1] * 3)
    with pytest.raises(ValueError):
        batch.reset(options={"start": (-5.0, 0.0, 0.0)})


def test_a_copy_goes_on_alike():
    batch = LimSlamVectorEnv("env1", 1100, sensor_noise=0.02, num_threads=2)
    batch.reset(seed=0)
    batch.step(np.full((1100, 2), 0.4))
    copies = pickle.loads(pickle.dumps(batch)), copy.deepcopy(batch)  # noqa: S301 (our own)
    one, *others = (env.step(np.full((1100, 2), 0.4)) for env in (batch, *copies))
    for other in others:
        np.testing.assert_array_equal(one[0]["ranges"], other[0]["ranges"])
        np.testing.assert_array_equal(one[-1]["pose"], other[-1]["pose"])


def assert_bits(one, other):
    """Whether all that a reset or step gives is the same, to the last bit."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert list(one) == list(other)
        one = tuple(one.values())
        other = tuple(other.values())
    if isinstance(one, tuple):
        for mine, their in zip(one, other, strict=True):
            assert_bits(mine, their)
    else:
        np.testing.assert_array_equal(one, other)


REFUSED_RESETS = {
    "plans made beforehand": {"world": SMALL, "plans": 6},
    "plans of their own": {"world": SMALL},
    "one world": {"world": "env1", "noise": EVERYTHING},
    "worlds of their own": {"world": ["env1", "env2", "env3", "env2"], "sensor_noise": 0.02},
}


@pytest.mark.parametrize("kind", REFUSED_RESETS)
def test_a_refused_reset_changes_nothing(kind):
    batch, twin = (
        LimSlamVectorEnv(num_envs=4, max_episode_steps=15, **REFUSED_RESETS[kind]) for _ in range(2)
    )
    first = batch.reset(seed=0)
    actions = held_actions(60, 4)
    assert_bits(first, twin.reset(seed=0))
    # All starts but the last can be used.
    starts = first[1]["pose"].copy()
    starts[3] = 1e3, 0.0, 0.0
    masked = {"reset_mask": np.array([True, False, False, True])}
    for number, row in enumerate(actions):
        if number in {5, 40}:
            for options in (
                {"start": (1e3, 0.0, 0.0)},
                {"start": starts},
                {"start": starts} | masked,
            ):
                with pytest.raises(ValueError):
                    batch.reset(seed=5, options=options)
        assert_bits(batch.step(row), twin.step(row))
    for options in (None, masked, {"start": first[1]["pose"]} if kind == "one world" else None):
        assert_bits(batch.reset(options=options), twin.reset(options=options))
        assert_bits(batch.step(actions[0]), twin.step(actions[0]))
    assert batch.np_random_seed == twin.np_random_seed
    assert batch.np_random.random() == twin.np_random.random()


def test_the_documentation_names_every_argument():
    documentation = inspect.getdoc(LimSlamVectorEnv)
    for name in list(inspect.signature(LimSlamVectorEnv).parameters)[:-1]:
        assert f"| {name} " in documentation


def test_a_seed_of_its_own_decides_all_of_an_environment():
    def drive(count, seeds):
        envs = LimSlamVectorEnv("random", count, noise=EVERYTHING)
        seen = [envs.reset(seed=seeds)[0]["ranges"]]
        seen += [envs.step(np.full((count, 2), 0.5))[0]["ranges"] for _ in range(20)]
        seen.append(envs.reset()[0]["ranges"])
        return np.stack(seen, axis=1)

    many = drive(4, [5, 9, 5, 7])
    np.testing.assert_array_equal(many[0], many[2])
    assert not np.array_equal(many[0], many[1])
    np.testing.assert_array_equal(drive(1, [9])[0], many[1])
    np.testing.assert_array_equal(drive(2, np.array([7, 5])), many[[3, 0]])


def test_a_seed_may_be_left_out_and_those_left_out_go_on_from_the_one_before():
    def ranges(seeds):
        envs = LimSlamVectorEnv("env1", 3, sensor_noise=0.02)
        envs.reset(seed=4)
        return envs.reset(seed=seeds)[0]["ranges"]

    one, other = ranges([1, None, None]), ranges([2, None, None])
    np.testing.assert_array_equal(one[1:], other[1:])
    assert not np.array_equal(one[0], other[0])
    assert not np.array_equal(one[1], one[2])


def test_several_robots_take_a_seed_for_each_environment():
    envs = limslam_env.parallel_vector_env(num_robots=2, num_envs=2, sensor_noise=0.02)
    seen = envs.reset(seed=[3, 3])[0]
    np.testing.assert_array_equal(seen["robot_1"]["ranges"][0], seen["robot_1"]["ranges"][1])


@pytest.mark.parametrize("seed", [[1, 2], [1, 2, 3.5], [1, 2, -3], [1, True, 2], "abc", 2.5])
def test_seeds_that_cannot_be_are_refused_and_leave_the_episode_as_it_was(seed):
    envs = LimSlamVectorEnv("env1", 3, sensor_noise=0.02)
    plain = LimSlamVectorEnv("env1", 3, sensor_noise=0.02)
    for each in (envs, plain):
        each.reset(seed=0)
    with pytest.raises(ValueError, match=r"a seed is a whole number, 0 or more, or a list of 3"):
        envs.reset(seed=seed)
    actions = np.full((3, 2), 0.5)
    np.testing.assert_array_equal(envs.step(actions)[0]["ranges"], plain.step(actions)[0]["ranges"])


def test_a_picture_shows_what_each_agent_believes():
    envs = LimSlamVectorEnv("env1", 2, render_mode="rgb_array")
    envs.reset(seed=0)
    before = envs.render()
    envs.overlays = [Overlay(), Overlay(pose=np.array([3.5, 3.5, 0.0]))]
    after = envs.render()
    np.testing.assert_array_equal(before[0], after[0])
    assert not np.array_equal(before[1], after[1])
