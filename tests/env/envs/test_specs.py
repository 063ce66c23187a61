"""What Gymnasium remembers of an environment makes it again, also when it was JSON in between, as
in Minari's files.
"""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from gymnasium.envs.registration import EnvSpec

import limslam_env
from limslam_agent import SlamObservation, preset
from limslam_agent.config.presets import ABLATIONS, PRESETS, ablated
from limslam_env import (
    FloorPlanConfig,
    LimSlamEnv,
    NoiseConfig,
    NominalNoise,
    RewardConfig,
    RobotSpec,
    World,
)
from limslam_env.envs.wrappers import (
    DiscreteAction,
    FlattenObservation,
    FrameStackObservation,
    NormalizedObservation,
    PrivilegedLocalMap,
    VelocityAction,
)
from limslam_env.robots import ring

WALLS = [[0, 0, 3, 0], [3, 0, 3, 2], [3, 2, 0, 2], [0, 2, 0, 0]]
BOX = ([2.0, 0.5], [2.3, 0.5], [2.3, 0.9])
ROOM = World("room", (3.0, 2.0), WALLS, (BOX,), starts=[[1, 1, 0]], notes=("read from a file",))
NOISE = NoiseConfig(sensor_noise=(np.float32(0.01), np.float64(0.03)), dropout=(0, 0.1))


def again(spec):
    return EnvSpec.from_json(spec.to_json())


def drive(env, steps=6):
    """What is observed and paid in a short drive."""
    env.action_space.seed(0)
    seen = [env.reset(seed=3)[0]]
    for _ in range(steps):
        observation, reward, *_ = env.step(env.action_space.sample())
        seen += [observation, reward]
    return repr(seen)


@pytest.mark.parametrize(
    "arguments",
    [
        {"noise": NOISE},
        {"sensor_noise": np.float32(0.02), "imu": True},
        {"sensor_noise": (0.0, np.float64(0.04))},
        {"robot": ring(12, max_range=2.0), "noise": NoiseConfig.sharp()},
        {"rewards": RewardConfig(step=np.float32(-0.5)), "coverage_goal": np.float64(0.5)},
        {"world": ROOM},
        {"world": FloorPlanConfig(width=(6.0, 7.0), obstacles=0)},
        {"world": "random:17", "coverage_goal": None},
        {"world": Path(limslam_env.__file__).parent / "worlds" / "env2.toml"},
    ],
    ids=" ".join,
)
def test_an_environment_is_made_again_from_its_spec(arguments):
    single = gym.make("LimSlam-Env1-v0", max_episode_steps=50, **arguments)
    expected = drive(single)
    assert drive(gym.make(again(single.spec))) == expected
    assert drive(gym.make(single.spec)) == expected
    if "imu" in arguments:
        return
    batch = gym.make_vec("LimSlam-Env1-v0", num_envs=2, autoreset_mode="SameStep", **arguments)
    expected = drive(batch)
    for spec in (again(batch.spec), batch.spec):
        other = gym.make_vec(spec)
        assert other.metadata == batch.metadata
        assert drive(other) == expected


def test_the_worlds_and_the_plans_of_a_batch_are_remembered():
    many = gym.make_vec("LimSlam-World-v0", num_envs=3, world=[ROOM, "env1", ROOM])
    assert drive(gym.make_vec(again(many.spec))) == drive(many)
    drawn = gym.make_vec("LimSlam-Random-v0", num_envs=2, plans=range(3, 5))
    assert drive(gym.make_vec(again(drawn.spec))) == drive(drawn)


@pytest.mark.parametrize(
    "wrap",
    [
        NormalizedObservation,
        VelocityAction,
        DiscreteAction,
        lambda env: DiscreteAction(env, np.array([(1, 1), (0.5, -0.5)])),
        lambda env: PrivilegedLocalMap(env, 10),
        lambda env: FrameStackObservation(FlattenObservation(NormalizedObservation(env)), 3),
        SlamObservation,
        lambda env: SlamObservation(env, preset("paper", NominalNoise(np.float32(0.03))), 20),
        lambda env: NormalizedObservation(SlamObservation(env), reach=np.float32(5.0)),
    ],
)
def test_a_wrapped_environment_is_made_again_from_its_spec(wrap):
    env = wrap(gym.make("LimSlam-Env2-v0", noise=NOISE))
    expected = drive(env)
    for spec in (again(env.spec), env.spec):
        other = gym.make(spec)
        assert str(other) == str(env)
        assert drive(other) == expected


@pytest.mark.parametrize(
    "config",
    [*map(preset, PRESETS), *(ablated(preset("paper"), name) for name in ABLATIONS)],
    ids=[*PRESETS, *ABLATIONS],
)
def test_the_settings_of_the_agent_are_remembered(config):
    env = gym.make(again(SlamObservation(gym.make("LimSlam-Env1-v0"), config).spec))
    assert env.get_wrapper_attr("mapper").config == config


def test_tables_stand_for_settings_everywhere():
    tables = {
        "noise": {"sensor_noise": [0.0, 0.03]},
        "robot": {"radius": 0.08, "beams": [{"x": 0.08, "y": 0.0, "angle": 0.0}]},
        "rewards": {"step": -1},
    }
    world = {"name": "room", "size": (3.0, 2.0), "walls": np.array(WALLS), "starts": [[1, 1, 0]]}
    env = LimSlamEnv(world, **tables)
    assert env.noise == NoiseConfig(sensor_noise=(0.0, 0.03))
    assert env.robot.beams[0].side == "none"
    assert env.robot == RobotSpec.from_json(env.robot.to_json())
    assert env.world.size == (3.0, 2.0)
    two = limslam_env.parallel_env(world, num_robots=2, **tables)
    assert two.reset(seed=0)[0]["robot_1"]["ranges"].shape == (1,)
    env.reset(seed=0, options={"world": {"width": 7.0}})
    assert env.world.size[0] == 7.0


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_a_world_that_is_missing_is_named(make):
    with pytest.raises(ValueError, match=r"^a world is needed: world= takes a name \('env1'"):
        make("LimSlam-World-v0")
    with pytest.raises(ValueError, match=r"world has no setting 'wide'; there are width"):
        make("LimSlam-World-v0", world={"wide": 7.0})
    with pytest.raises(ValueError, match=r"the key 'name' is missing"):
        make("LimSlam-World-v0", world={"walls": WALLS})


@pytest.mark.parametrize("kind", ["parallel", "aec"])
def test_a_world_of_several_robots_that_is_missing_is_named(kind):
    with pytest.raises(ValueError, match=r"^a world is needed"):
        pettingzoo.make(kind, "limslam/World-v0")
    pettingzoo.make(kind, "limslam/World-v0", world="env2")


@pytest.mark.parametrize(("period", "fps"), [(0.1, 10), (0.03, 33), (0.04, 25), (5.0, 1)])
def test_pictures_are_shown_at_the_speed_of_the_robot(period, fps):
    robot = RobotSpec(control_period=period)
    for env in (
        LimSlamEnv("env1", robot=robot),
        gym.make_vec("LimSlam-Env1-v0", robot=robot),
        limslam_env.parallel_env(robot=robot),
        limslam_env.aec_env(robot=robot),
    ):
        assert env.metadata["render_fps"] == fps
