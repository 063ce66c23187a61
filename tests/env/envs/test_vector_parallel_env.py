"""Many buildings with several robots in each: the same as the single parallel environment."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from support.episodes import held_actions

import limslam_env
from limslam_env import LimSlamParallelEnv, LimSlamParallelVectorEnv, NoiseConfig

QUIET = NoiseConfig(wheel_variance=0.0)


def assert_same(batch: tuple, env: int, single: tuple, atol: float) -> None:
    observations, rewards, terminated, _, infos = batch
    for name, observation in single[0].items():
        for key, value in observation.items():
            np.testing.assert_allclose(observations[name][key][env], value, atol=atol)
        for key, value in single[4][name].items():
            np.testing.assert_allclose(infos[name][key][env], value, atol=atol, err_msg=key)
        assert rewards[name][env] == pytest.approx(single[1][name], abs=1e-9)
        assert terminated[name][env] == single[2][name]


@pytest.mark.parametrize("robots", [1, 2, 3])
def test_it_is_the_same_environment(robots):
    singles = [LimSlamParallelEnv("square", num_robots=robots, noise=QUIET) for _ in range(2)]
    near = np.array([[3.0, 1.0, 0.0], [3.4, 1.1, 2.5], [2.6, 0.9, -1.0]])[:robots]
    poses = [near, near + np.array([0.4, -0.1, 0.1])]
    for start, single in zip(poses, singles, strict=True):
        single.reset(seed=0, options={"start": start})
    batch = LimSlamParallelVectorEnv("square", 2, num_robots=robots, noise=QUIET)
    batch.reset(seed=0, options={"start": np.array(poses)})
    contacts = meetings = 0
    rows = [held_actions(300, robots, seed=seed) for seed in range(2)]
    for step in range(300):
        actions = {
            name: np.array([rows[env][step, k] for env in range(2)])
            for k, name in enumerate(batch.agents)
        }
        result = batch.step(actions)
        for env, single in enumerate(singles):
            one = single.step({name: actions[name][env] for name in batch.agents})
            assert_same(result, env, one, atol=1e-5)
            contacts += sum(info["collision"] for info in one[4].values())
            meetings += sum((info["wall_seen"] == -2).any() for info in one[4].values())
    assert contacts > 20
    assert (meetings > 0) == (robots > 1)


def test_robots_that_meet_push_each_other_as_in_the_single_environment():
    start = np.array([[3.0, 0.5, 0.0], [3.6, 0.53, np.pi]])
    single = LimSlamParallelEnv("square", noise=QUIET)
    batch = LimSlamParallelVectorEnv("square", 3, noise=QUIET, num_threads=2)
    single.reset(seed=0, options={"start": start})
    batch.reset(seed=0, options={"start": start})
    touching = 0
    for _ in range(200):
        one = single.step({"robot_0": np.array([1.0, 0.98]), "robot_1": np.array([0.7, 0.7])})
        many = batch.step(
            {"robot_0": np.tile([1.0, 0.98], (3, 1)), "robot_1": np.full((3, 2), 0.7)}
        )
        touching += one[4]["robot_0"]["collision"]
        for name, info in one[4].items():
            np.testing.assert_allclose(
                many[4][name]["pose"], np.tile(info["pose"], (3, 1)), atol=1e-6
            )
            np.testing.assert_array_equal(many[4][name]["collision"], [info["collision"]] * 3)
    assert touching > 10


def test_it_is_made_by_name_and_has_spaces_for_each_robot():
    env = limslam_env.parallel_vector_env(
        world="square", num_robots=3, num_envs=4, sensor_noise=0.02
    )
    assert isinstance(env, limslam_env.LimSlamParallelVectorEnv)
    observations, infos = env.reset(seed=0)
    assert list(observations) == list(infos) == env.agents == ["robot_0", "robot_1", "robot_2"]
    for name in env.agents:
        assert env.observation_space(name) is env.observation_space(name)
        assert env.observation_space(name).contains(observations[name])
        assert infos[name]["pose"].shape == (4, 3)
        assert infos[name]["_pose"].all()
    gaps = np.hypot(*(infos["robot_0"]["pose"] - infos["robot_2"]["pose"])[:, :2].T)
    assert (gaps > 0.2).all()
    # Starts that are drawn differ from environment to environment.
    assert len(np.unique(infos["robot_2"]["pose"], axis=0)) == 4
    env.close()
    env.close()


def test_rewards_can_be_shared():
    actions = held_actions(60, 2)
    rewards = []
    for shared in (False, True):
        env = LimSlamParallelVectorEnv("env1", 2, noise=QUIET, shared_reward=shared)
        env.reset(seed=0)
        rows = [
            env.step({"robot_0": np.tile(row[0], (2, 1)), "robot_1": np.tile(row[1], (2, 1))})[1]
            for row in actions
        ]
        rewards.append(np.array([[row["robot_0"], row["robot_1"]] for row in rows]))
    own, shared = rewards
    np.testing.assert_allclose(shared, np.repeat(own.mean(axis=1, keepdims=True), 2, axis=1))
    assert (own[:, 0] != own[:, 1]).any()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_episodes_end_for_all_robots_at_once(mode):
    env = LimSlamParallelVectorEnv("env1", 2, max_cycles=3, autoreset_mode=mode, noise=QUIET)
    env.reset(seed=0)
    ahead = {name: np.full((2, 2), 0.5) for name in env.agents}
    results = [env.step(ahead) for _ in range(4)]
    for name in env.agents:
        assert [result[3][name].tolist() for result in results[:3]] == [
            [False] * 2,
            [False] * 2,
            [True] * 2,
        ]
        times = [result[4][name]["time"][0] for result in results]
        if mode is AutoresetMode.NEXT_STEP:
            np.testing.assert_allclose(times, [0.1, 0.2, 0.3, 0.0])
            assert (results[3][1][name] == 0.0).all()
        else:
            np.testing.assert_allclose(times, [0.1, 0.2, 0.0, 0.1])
            np.testing.assert_allclose(results[2][4][name]["final_info"]["time"], 0.3)
            assert results[2][4][name]["final_obs"][1]["wheels"].shape == (2,)


def test_bad_arguments_and_actions_are_refused():
    with pytest.raises(ValueError, match="robots must be a whole number from 1 to 8"):
        LimSlamParallelVectorEnv("env1", 2, num_robots=9)
    env = LimSlamParallelVectorEnv("env1", 2)
    with pytest.raises(gym.error.ResetNeeded):
        env.step({})
    env.reset(seed=0)
    with pytest.raises(ValueError, match="one action for each of robot_0, robot_1"):
        env.step({"robot_0": np.zeros((2, 2))})
    with pytest.raises(ValueError, match="actions of robot_1 must be 2 rows"):
        env.step({"robot_0": np.zeros((2, 2)), "robot_1": np.zeros(2)})
