"""What holds in any world, whatever robots do: bounds, walls, coverage, time and memory."""

import math
import resource

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from limslam_env import (
    FloorPlanConfig,
    LimSlamEnv,
    LimSlamParallelEnv,
    NoiseConfig,
    RobotSpec,
    SensorSpec,
    World,
)
from limslam_env.geometry import segment
from limslam_env.robots import ROBOTS
from limslam_env.worlds.free_space import cell_for, free_space
from limslam_env.worlds.generation.floor_plans import floor_plan

DEEPEST = 1e-3
STEPS = 60

coordinates = st.floats(-0.5, 5.5)
speeds = st.one_of(
    st.floats(-1.0, 1.0),
    st.floats(-1e6, 1e6),
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 1e-12, 5e-324, 1e30, -1e300]),
)


@st.composite
def polygons(draw):
    """A convex polygon, sometimes a sliver."""
    x = draw(st.floats(0.5, 4.5))
    y = draw(st.floats(0.5, 4.5))
    size = draw(st.floats(0.02, 1.0))
    corners = draw(st.integers(3, 7))
    flatness = draw(st.floats(0.05, 1.0))
    angles = 2.0 * math.pi * (np.arange(corners) + draw(st.floats(0.0, 1.0))) / corners
    return np.column_stack((x + size * np.cos(angles), y + flatness * size * np.sin(angles)))


@st.composite
def boxes(draw):
    """A box with walls and polygons in it, which may cross each other and leave pockets and sharp
    corners.
    """
    width = draw(st.floats(1.0, 5.0))
    height = draw(st.floats(1.0, 5.0))
    outer = np.array(
        [[0, 0, width, 0], [width, 0, width, height], [width, height, 0, height], [0, height, 0, 0]]
    )
    inner = [
        wall
        for wall in draw(st.lists(st.tuples(*[coordinates] * 4), max_size=6))
        if math.dist(wall[:2], wall[2:]) > 0.01
    ]
    return World(
        "box",
        (width, height),
        np.vstack((outer, *([wall] for wall in inner))),
        tuple(draw(st.lists(polygons(), max_size=3))),
    )


@st.composite
def plans(draw):
    low = draw(st.floats(4.0, 8.0))
    config = FloorPlanConfig(
        width=(low, low + 2.0),
        height=draw(st.floats(4.0, 8.0)),
        corridor=draw(st.floats(0.0, 1.0)),
        loops=draw(st.floats(0.0, 1.0)),
        slanted=draw(st.floats(0.0, 1.0)),
        obstacles=draw(st.floats(0.0, 4.0)),
    )
    return floor_plan(config, np.random.default_rng(draw(st.integers(0, 2**32))), 0.1)


@st.composite
def noises(draw):
    """Any noise, from none to nonsense."""
    share = st.floats(0.0, 1.0)
    return NoiseConfig(
        sensor_noise=draw(st.sampled_from([0.0, 0.04, 10.0])),
        range_noise_growth=draw(share),
        range_resolution=draw(st.sampled_from([0.0, 0.01, 0.7, 5.0])),
        dropout=draw(share),
        fold_back=draw(st.sampled_from([0.0, 3.0, 1e3])),
        cone=draw(st.floats(0.0, 0.5 * math.pi)),
        wheel_variance=draw(st.sampled_from([0.0, 2e-5, 10.0])),
        encoder_resolution=draw(st.sampled_from([0.0, 0.001, 0.5])),
        wheel_mismatch=draw(st.floats(-0.5, 0.5)),
        axle_mismatch=draw(st.floats(-0.5, 0.5)),
        slip_rate=draw(st.sampled_from([0.0, 2.0, 1e6])),
        slip_share=draw(share),
    )


@st.composite
def odd_robots(draw):
    """A robot with beams anywhere on and in its body."""
    radius = draw(st.floats(0.03, 0.25))
    place = st.floats(-0.7 * radius, 0.7 * radius)
    angle = st.floats(-10.0, 10.0)
    schedule = draw(st.sampled_from([(1, 0), (2, 0), (3, 2), (4, 1)]))
    beams = st.builds(
        SensorSpec,
        place,
        place,
        angle,
        min_range=st.sampled_from([0.0, 0.05]),
        max_range=st.floats(0.06, 4.0),
        period=st.just(schedule[0]),
        phase=st.just(schedule[1]),
    )
    return RobotSpec(
        radius=radius,
        axle=draw(st.floats(0.02, 0.5)),
        # Up to six times its own width in a step.
        max_wheel_speed=draw(st.sampled_from([0.05, 0.3, 3.0])),
        beams=tuple(draw(st.lists(beams, min_size=1, max_size=5))),
    )


def robots() -> st.SearchStrategy[RobotSpec]:
    return st.one_of(st.sampled_from([make() for make in ROBOTS.values()]), odd_robots())


def is_finite(value) -> bool:
    return bool(np.isfinite(np.asarray(value, dtype=float)).all())


def check_episode(env: LimSlamParallelEnv, seed: int, actions: list[tuple[float, float]]) -> None:
    """Drive for a while, each robot by actions of its own, and look at everything that is given."""
    observations, infos = env.reset(seed=seed)
    edges = env.world.edges
    radius = env.robot.radius
    names = list(env.agents)
    corners = edges.reshape(-1, 2)
    low = corners.min(axis=0)
    high = corners.max(axis=0)
    # A little thinner than the robot: wherever the robot gets, the grid has a way too.
    cell = cell_for(edges, radius)
    space = free_space(edges, radius - 0.75 * cell - DEEPEST, cell, env.world.obstacles)
    labels = [space.label_of(infos[name]["pose"][:2]) for name in names]
    coverage = 0.0
    rewards = {}
    for step in range(STEPS + 1):
        poses = np.array([infos[name]["pose"] for name in names])
        assert is_finite(poses)
        assert is_finite(list(rewards.values()))
        assert all(env.observation_space(name).contains(observations[name]) for name in names)
        assert (np.abs(poses[:, 2]) <= math.pi).all()
        # Never outside, and never in a wall.
        assert (poses[:, :2] > low).all()
        assert (poses[:, :2] < high).all()
        assert segment.distances(poses[:, :2], edges).min() >= radius - DEEPEST
        for polygon in env.world.obstacles:
            assert not segment.inside_polygon(poses[:, :2], polygon).any()
        for number, pose in enumerate(poses):
            others = np.hypot(*(poses[:number, :2] - pose[:2]).T)
            assert (others >= 2.0 * radius - DEEPEST).all()
            assert space.label_of(pose[:2]) == labels[number] > 0, "no way leads through walls"
        info = infos[names[0]]
        assert coverage <= info["coverage"] <= 1.0
        assert info["time"] == pytest.approx(step * env.robot.control_period)
        coverage = info["coverage"]
        if not env.agents:
            return
        chosen = {
            name: actions[(step // 6 + 5 * number) % len(actions)]
            for number, name in enumerate(names)
        }
        observations, rewards, _, _, infos = env.step(chosen)


def made(
    world: World, robot: RobotSpec, noise: NoiseConfig, count: int, seed: int
) -> LimSlamParallelEnv:
    """An environment in a world that may turn out to be too small."""
    try:
        env = LimSlamParallelEnv(world, num_robots=count, robot=robot, noise=noise)
        env.reset(seed=seed)
    except ValueError:
        assume(condition=False)
    return env


action_lists = st.lists(st.tuples(speeds, speeds), min_size=1, max_size=12)
seeds = st.integers(0, 2**31)
random_runs = settings(
    deadline=None,
    max_examples=40,
    suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow],
)


@given(boxes(), robots(), noises(), st.integers(1, 4), seeds, action_lists)
@random_runs
def test_any_box_any_robot_any_noise(world, robot, noise, count, seed, actions):
    check_episode(made(world, robot, noise, count, seed), seed, actions)


@given(plans(), noises(), st.integers(1, 4), seeds, action_lists)
@random_runs
def test_any_floor_plan(world, noise, count, seed, actions):
    check_episode(made(world, RobotSpec(), noise, count, seed), seed, actions)


@given(
    boxes(),
    st.integers(1, 4),
    seeds,
    st.lists(st.tuples(st.sampled_from([1.0, 0.5, -1.0]), st.just(1.0)), min_size=1),
)
@random_runs
def test_robots_that_keep_pushing(world, count, seed, actions):
    check_episode(made(world, RobotSpec(), NoiseConfig(), count, seed), seed, actions)


def drive_and_reset(steps: int, env: LimSlamEnv, *, seed: int, longest: int = 500) -> int:
    """Drive at random with a new episode after ``longest`` steps, or at the goal; the number of
    episodes.
    """
    generator = np.random.default_rng(seed)
    env.reset(seed=seed)
    episodes = 1
    since = 0
    for step in range(steps):
        if step % 20 == 0:
            action = generator.uniform(-0.3, 1.0, 2)
        _, _, terminated, _, _ = env.step(action)
        since += 1
        if terminated or since == longest:
            env.reset()
            episodes = episodes + 1
            since = 0
    return episodes


@pytest.mark.slow
@pytest.mark.parametrize(("world", "steps"), [("env1", 1_000_000), ("random", 200_000)])
def test_memory_stays_constant_over_a_million_steps(world, steps):
    env = LimSlamEnv(world, noise=NoiseConfig.sharp())
    drive_and_reset(20_000, env, seed=0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert drive_and_reset(steps, env, seed=1) > steps / 501
    # In kilobytes: the highest mark is not to rise by more than 12 MB, and pymunk's own memory
    # counts, too.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 12_000
