"""Anything that can act is scored, by the same metrics as the agent that comes with the package."""

from dataclasses import replace

import numpy as np
import pytest
from gymnasium import spaces
from support.runs import run

from limslam_agent import (
    FrontierPolicy,
    LearnedPolicy,
    LimSlamAgent,
    LimSlamTeam,
    RandomPolicy,
    SlamObservation,
    WallFollower,
    evaluate,
    medians,
    preset,
)
from limslam_env import LimSlamEnv, NoiseConfig, NominalNoise, RobotSpec, World
from limslam_env.envs.wrappers import FlattenObservation, NormalizedObservation

ROBOT = RobotSpec()
TOLD = preset("paper", NominalNoise(0.02))
IN_ENV2 = ("--world", "env2", "--noise", 0.02, "--seed", 3)
FAST = replace(ROBOT, max_wheel_speed=0.4)
FLAT = spaces.Box(-1.0, 1.0, (8,))
DRIVE = {
    "path_m",
    "coverage_true",
    "time_to_50_s",
    "time_to_90_s",
    "time_to_95_s",
    "exploration_time_s",
    "collisions",
}
WALLS = [[0, 0, 3, 0], [3, 0, 3, 2], [3, 2, 0, 2], [0, 2, 0, 0]]
ROOM = World("room", (3.0, 2.0), WALLS, starts=[[1.0, 1.0, 0.0], [2.0, 1.0, 2.0]])


def straight(_):
    return 0.5, 0.5


def spin(_):
    return np.array([-0.2, 0.2])


class Model:
    """What Stable-Baselines3 calls a model, with a memory or without one."""

    def __init__(self, *, remembers):
        self.remembers = remembers
        self.calls = []

    def predict(self, observation, state=None, episode_start=None, deterministic=False):  # noqa: FBT002 (its interface)
        self.calls.append((observation, state, episode_start, deterministic))
        return np.array([0.5, 0.4], dtype=np.float32), (
            (state or 0) + 1 if self.remembers else None
        )


class Trained:
    """A model that was trained on the observations of a space. Without a space, on beliefs that it
    does not declare.
    """

    def __init__(self, space):
        if space is not None:
            self.observation_space = space

    def predict(self, observation, deterministic):
        assert deterministic
        return observation["pose"][:2], None


def test_the_agent_gets_the_metrics_of_a_run(tmp_path):
    expected = run(tmp_path / "run", *IN_ENV2, "--preset", "paper", "--max-time", 25).metrics
    (result,) = evaluate(
        LimSlamAgent(ROBOT, TOLD), "LimSlam-Env2-v0", [3], max_time=25.0, sensor_noise=0.02
    )
    assert result.pop("seed") == 3
    assert {"ate_m", "odometry_ate_m", "anees", "wall_f1", "doors_open", "coverage_correct"} <= set(
        result
    )
    assert {name: expected[name] for name in result} == result


def test_a_team_gets_the_metrics_of_a_run(tmp_path):
    expected = run(
        tmp_path / "run", *IN_ENV2, "--preset", "paper", "--max-time", 15, "--robots", 2
    ).metrics
    (result,) = evaluate(
        LimSlamTeam(ROBOT, TOLD), "limslam/Env2-v0", [3], max_time=15.0, sensor_noise=0.02
    )
    assert result.pop("seed") == 3
    assert {"ate_m", "wall_f1"} <= set(result)
    assert {name: expected[name] for name in result} == result


def test_a_function_gets_the_true_metrics_alone():
    results = evaluate(straight, "LimSlam-World-v0", (4, 5), max_time=30.0, world=ROOM)
    assert [result["seed"] for result in results] == [4, 5]
    for result in results:
        assert set(result) == DRIVE | {"seed", "stop_reason"}
        # From x = 1 at 0.15 m/s to the wall at 3 m, and on against it.
        assert result["path_m"] == pytest.approx(1.9, abs=0.01)
        assert result["collisions"] == 1
        assert result["exploration_time_s"] is None
        assert result["stop_reason"].startswith("time")
        assert 0.0 < result["coverage_true"] < 0.99


def test_who_cannot_stop_is_stopped_at_the_goal():
    (result,) = evaluate(
        spin, "LimSlam-World-v0", [0], max_time=60.0, world=ROOM, coverage_goal=0.5
    )
    assert result["stop_reason"] == "the coverage goal is reached"
    assert result["exploration_time_s"] == result["time_to_50_s"] > 0.0
    assert result["coverage_true"] >= 0.5


def test_who_stops_by_itself_is_not_stopped_by_what_is_true():
    class Patient:
        stop_reason = None

        def reset(self, start_pose, seed):
            np.testing.assert_array_equal(start_pose, ROOM.starts[0])
            self.steps = 0
            self.seed = seed

        def act(self, observation):
            assert set(observation) == {"ranges", "wheels"}
            self.steps += 1
            return spin(observation)

        @property
        def done(self):
            return self.steps > 400 + self.seed

    first, second = evaluate(Patient(), "LimSlam-World-v0", [0, 20], max_time=60.0, world=ROOM)
    assert (first["exploration_time_s"], second["exploration_time_s"]) == (40.0, 42.0)
    assert first["stop_reason"] == "the actor says that it is done"


def test_a_recurrent_model_gets_its_memory_back():
    model = Model(remembers=True)
    evaluate(model, "LimSlam-World-v0", [0, 1], max_time=1.0, world=ROOM)
    # Eleven observations an episode, and a new memory in each.
    assert [state for _, state, _, _ in model.calls] == [None, *range(1, 11)] * 2
    assert [start is None for _, _, start, _ in model.calls] == [True, *[False] * 10] * 2
    assert not any(start.any() for _, _, start, _ in model.calls if start is not None)
    assert all(deterministic for *_, deterministic in model.calls)


def test_a_model_answers_for_each_robot_of_a_team():
    model = Model(remembers=True)
    (result,) = evaluate(model, "limslam/World-v0", [0], max_time=2.0, world=ROOM, num_robots=3)
    assert set(result) == DRIVE | {"seed", "stop_reason"}
    assert len(model.calls) == 3 * 21


def test_a_wrapped_environment_shows_the_actor_what_it_was_made_for():
    def look(observation):
        assert set(observation) == {"pose", "covariance", "grid", "ranges"}
        return 0.2, 0.2

    (result,) = evaluate(
        look,
        "LimSlam-World-v0",
        [0],
        max_time=1.0,
        wrap=lambda env: SlamObservation(env, TOLD),
        world=ROOM,
    )
    assert result["path_m"] == pytest.approx(0.06)


@pytest.mark.parametrize(
    "wrap",
    [
        SlamObservation,
        lambda env: FlattenObservation(NormalizedObservation(SlamObservation(env))),
        lambda env: SlamObservation(env, preset("consistent", NominalNoise(0.03))),
    ],
)
def test_who_sees_beliefs_is_scored_by_their_estimate(wrap):
    class Blind(TurnFromWalls):
        def act(self, belief):
            return (0.4, 0.5) if len(belief.ranges) else None

    noise = NoiseConfig(sensor_noise=(0.0, np.float32(0.03)), wheel_variance=(2e-5, 2e-4))
    where = {"env_id": "LimSlam-Env2-v0", "seeds": [3], "max_time": 20.0, "noise": noise}
    (expected,) = evaluate(Blind(), **where)
    (result,) = evaluate(lambda _: (0.4, 0.5), wrap=wrap, **where)
    assert {"ate_m", "anees", "wall_f1", "coverage_correct"} <= set(result)
    assert set(result) == set(expected) == set(evaluate("frontier", **where)[0])
    if wrap is SlamObservation:
        assert result == expected


def test_what_is_said_to_be_an_actor_or_a_policy_is_not_guessed():
    class Renamed(TurnFromWalls):
        def act(self, observation):
            return np.zeros(2) if len(observation.segments) else np.full(2, 0.5)

    class Mislabelled:
        def act(self, belief):
            return 0.2, 0.2 if set(belief) == {"ranges", "wheels"} else None

    where = {"env_id": "LimSlam-World-v0", "seeds": [0], "max_time": 1.0, "world": ROOM}
    assert "ate_m" in evaluate(policy=Renamed(), **where)[0]
    assert "ate_m" not in evaluate(actor=Mislabelled(), **where)[0]
    assert "ate_m" in evaluate(policy=Ambiguous(), preset="paper", **where)[0]
    assert "ate_m" not in evaluate(actor=lambda belief: spin(belief["wheels"]), **where)[0]
    assert evaluate(policy="frontier", **where) == evaluate("frontier", **where)


@pytest.mark.parametrize(
    ("scored", "words"),
    [
        ({}, "evaluate scores one thing"),
        ({"policy": "frontier", "actor": spin}, "evaluate scores one thing"),
        ({"actor": "frontier"}, r"evaluate\(policy=...\), also by its name"),
        ({"policy": spin}, "is a policy, because policy= says so, but it has no act and no stop"),
        ({"policy": LimSlamAgent}, "LimSlamAgent is a class"),
        ({"actor": spin, "preset": "paper"}, "preset='paper' is for a policy"),
    ],
)
def test_what_is_neither_is_refused_in_one_line(scored, words):
    with pytest.raises(ValueError, match=words):
        evaluate(**scored, max_time=1.0)


class TurnFromWalls:
    """The policy of the README."""

    stop_reason = None
    plan = np.zeros((0, 2))
    steps = 0

    def act(self, belief):
        self.steps += 1
        is_near = belief.ranges[1:5].min() < 0.35
        return np.array([0.6, -0.5] if is_near else [0.7, 0.7])


class WithoutAttributes:
    def act(self, belief):
        return belief.pose[:2]


class Ambiguous(TurnFromWalls):
    def act(self, anything):
        return anything.pose[:2]

    def reset(self, start_pose, seed):
        pass


@pytest.mark.parametrize(
    ("actor", "env_id", "arguments", "words"),
    [
        (object(), "LimSlam-Env1-v0", {}, "object cannot act"),
        (LimSlamAgent, "LimSlam-Env1-v0", {}, "LimSlamAgent is a class"),
        (lambda _: {"robot_0": (0, 0)}, "limslam/Env1-v0", {}, "one action for each"),
        (spin, "limslam/Env9-v0", {}, "no environment 'limslam/Env9-v0'"),
        (spin, "CartPole-v1", {}, "is not a LimSLAM environment"),
        (
            spin,
            LimSlamEnv("env1"),
            {},
            "env_id is a name such as 'LimSlam-Env1-v0', not .*: evaluate makes",
        ),
        (
            LimSlamAgent(FAST),
            "LimSlam-Env1-v0",
            {},
            r"LimSlamAgent was made for another robot .*in max_wheel_speed\)",
        ),
        (
            Trained(FLAT),
            "LimSlam-Env1-v0",
            {},
            r"shape \(8,\)\).*\(ranges \(6,\), wheels \(2,\)\).*by wrap=",
        ),
        ("fronteer", "LimSlam-Env1-v0", {}, "no policy is called 'fronteer'; there are frontier, "),
        (
            "tour",
            "LimSlam-Env1-v0",
            {},
            "the policy 'tour' does not act on a belief: use limslam run --policy tour",
        ),
        (
            WithoutAttributes(),
            "LimSlam-Env1-v0",
            {},
            "is a policy.*no stop_reason and no plan.*write stop_reason = None",
        ),
        (Ambiguous(), "LimSlam-Env1-v0", {}, "policy or an actor: call the argument of act belief"),
        (TurnFromWalls(), "limslam/Env1-v0", {}, "a policy for one robot: pass LimSlamTeam"),
        (spin, "LimSlam-Env1-v0", {"seeds": 10**30}, "seeds must be a whole number from 1 to"),
        (spin, "LimSlam-Env1-v0", {"max_time": 1e300}, "max_time must be a number from 0.001"),
        (spin, "LimSlam-Env1-v0", {"seeds": "abc"}, "seeds must be a number of episodes, or"),
        (spin, "LimSlam-Env1-v0", {"preset": "paper"}, "preset='paper' is for a policy"),
        (spin, "LimSlam-Env1-v0", {"colour": 3}, "colour is an argument neither of evaluate nor"),
    ],
)
def test_what_cannot_act_is_refused_in_one_line(actor, env_id, arguments, words):
    with pytest.raises(ValueError, match=words) as refusal:
        evaluate(actor, env_id, **{"seeds": [0], "max_time": 1.0, **arguments})
    assert "\n" not in str(refusal.value)


def test_medians_by_hand():
    rows = [
        {
            "seed": 0,
            "path_m": 1.0,
            "exploration_time_s": 10.0,
            "time_to_95_s": None,
            "anees": None,
            "stop_reason": "a",
        },
        {
            "seed": 1,
            "path_m": 5.0,
            "exploration_time_s": None,
            "time_to_95_s": None,
            "anees": 2.0,
            "stop_reason": "b",
        },
        {
            "seed": 2,
            "path_m": 2.0,
            "exploration_time_s": 30.0,
            "time_to_95_s": 5.0,
            "anees": 4.0,
            "stop_reason": "c",
        },
    ]
    assert medians(rows) == {
        "path_m": 2.0,
        "exploration_time_s": 30.0,
        "time_to_95_s": None,
        "anees": 3.0,
    }
    assert medians([]) == {}


def test_a_policy_is_scored_as_the_policy_of_an_agent():
    config = preset("consistent", NominalNoise(0.02))
    arguments = {"max_time": 3.0, "world": ROOM, "sensor_noise": 0.02}
    policy = TurnFromWalls()
    first, second = evaluate(policy, "LimSlam-World-v0", [3, 3], **arguments)
    expected = evaluate(
        LimSlamAgent(ROBOT, config, TurnFromWalls()), "LimSlam-World-v0", [3], **arguments
    )
    assert [first] == [second] == expected
    assert "ate_m" in first
    assert policy.steps == 0, "each episode begins with a copy"


@pytest.mark.parametrize(
    "policy", [FrontierPolicy(), WallFollower(), RandomPolicy(), LearnedPolicy()]
)
def test_the_policies_of_the_package_need_no_arguments(policy):
    (result,) = evaluate(policy, "LimSlam-Env2-v0", [0], max_time=6.0, sensor_noise=0.02)
    assert result["path_m"] > 0.0
    assert "ate_m" in result


def test_the_agent_of_a_policy_is_told_the_nominal_noise_of_the_environment():
    noise = NoiseConfig(sensor_noise=(0.0, np.float64(0.03)), wheel_variance=(2e-5, 2e-4))
    told = LimSlamEnv(ROOM, noise=noise).nominal_noise
    where = {"env_id": "LimSlam-Env2-v0", "seeds": [3], "max_time": 4.0, "noise": noise}
    assert evaluate("frontier", **where) == evaluate(
        LimSlamAgent(ROBOT, preset("graph", told)), **where
    )


@pytest.mark.parametrize("name", ["frontier_fast", "learned"])
def test_a_name_stands_for_the_policy_of_a_run(name, tmp_path):
    options = ("--preset", "consistent", "--max-time", 5, "--policy", name)
    expected = run(tmp_path / "run", *IN_ENV2, *options).metrics
    (result,) = evaluate(name, "LimSlam-Env2-v0", [3], max_time=5.0, sensor_noise=0.02)
    assert result.pop("seed") == 3
    assert {each: expected[each] for each in result} == result
