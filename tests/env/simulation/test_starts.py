"""The simulation: runs of one seed with other noise are alike but for the noise, and robots start
where they may.
"""

import math

import numpy as np

from limslam_env import LimSlamParallelEnv, NoiseConfig, RobotSpec, World, load_world
from limslam_env.geometry import FloatArray, segment

ROBOT = RobotSpec()
BOX = np.array(
    [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 4.0], [4.0, 4.0, 0.0, 4.0], [0.0, 4.0, 0.0, 0.0]]
)
# All noise of readings: what moves the robot otherwise (slips, the axle) is not among it.
ALL_NOISE = NoiseConfig.sharp(
    sensor_noise=0.04,
    dropout=0.05,
    cone=0.0,
    wheel_variance=1e-4,
    encoder_resolution=0.001,
    wheel_mismatch=0.01,
)


def box_world(*starts: tuple[float, float, float], extra: FloatArray | None = None) -> World:
    walls = BOX if extra is None else np.vstack((BOX, extra))
    return World("box", (4.0, 4.0), walls, starts=np.array(starts).reshape(-1, 3))


def start_poses(
    world: World, robots: int, seed: int = 0, start: FloatArray | None = None
) -> FloatArray:
    env = LimSlamParallelEnv(world, num_robots=robots)
    _, infos = env.reset(seed=seed, options={} if start is None else {"start": start})
    return np.array([infos[name]["pose"] for name in env.agents])


def assert_apart(poses: FloatArray, world: World) -> None:
    for number, pose in enumerate(poses[:, :2]):
        for other in poses[:number, :2]:
            assert np.hypot(*(pose - other)) > 2.0 * ROBOT.radius
    assert segment.distances(poses[:, :2], world.edges).min() >= ROBOT.radius


def test_noise_levels_with_one_seed_share_the_truth():
    envs = [
        LimSlamParallelEnv("env1", num_robots=1, noise=n)
        for n in (NoiseConfig(wheel_variance=0.0), ALL_NOISE)
    ]
    told = [env.reset(seed=3)[0]["robot_0"] for env in envs]
    for action in np.repeat(np.random.default_rng(1).uniform(-0.5, 1.0, (20, 2)), 10, axis=0):
        steps = [env.step({"robot_0": action}) for env in envs]
        told += [step[0]["robot_0"] for step in steps]
        quiet, loud = (step[4]["robot_0"] for step in steps)
        for name in ("pose", "coverage", "wall_seen", "collision"):
            np.testing.assert_array_equal(quiet[name], loud[name])
    for name in ("ranges", "wheels"):
        assert any(
            (quiet[name] != loud[name]).any()
            for quiet, loud in zip(told[::2], told[1::2], strict=True)
        )


def test_drawn_starts_depend_on_the_seed_and_cover_the_room_and_all_headings():
    poses = np.vstack([start_poses(box_world(), 1, seed) for seed in range(60)])
    assert len(np.unique(poses, axis=0)) == 60
    assert (np.ptp(poses[:, :2], axis=0) > 3.0).all()
    assert np.ptp(poses[:, 2]) > 5.0
    assert (np.abs(poses[:, 2]) <= math.pi).all()


def test_drawn_starts_lie_in_the_largest_region():
    # A wall leaves 1 m of 4 m on its right.
    world = box_world(extra=np.array([[3.0, 0.0, 3.0, 4.0]]))
    poses = np.vstack([start_poses(world, 1, seed) for seed in range(25)])
    assert (poses[:, 0] < 3.0).all()


def test_no_robot_starts_behind_a_slit_that_is_hardly_wider_than_its_body():
    # The slit of 0.235 m connects the cavity on the right with the rest, so that both are one
    # region.
    world = box_world(extra=np.array([[3.0, 0.0, 3.0, 1.88], [3.0, 2.115, 3.0, 4.0]]))
    space = world.free_space(ROBOT.radius)
    assert (space.centres(space.largest_closed_region())[:, 0] > 3.5).any()
    for robots, start in ((1, None), (3, np.array([1.0, 1.0, 0.0]))):
        poses = np.vstack([start_poses(world, robots, seed, start) for seed in range(25)])
        assert (poses[:, 0] < 3.05).all()


def test_extra_robots_start_where_the_first_can_get_to():
    world = box_world((3.5, 2.0, 0.0), extra=np.array([[3.0, 0.0, 3.0, 4.0]]))
    poses = start_poses(world, 3)
    assert (poses[:, 0] > 3.0).all()
    assert_apart(poses, world)


def test_two_starts_at_one_place_are_not_both_used():
    # A world's starts may differ in heading only.
    world = box_world((1.0, 1.0, 0.0), (1.05, 1.0, math.pi), (3.0, 3.0, 0.0))
    for robots in (2, 3):
        poses = start_poses(world, robots)
        np.testing.assert_array_equal(poses[0], [1.0, 1.0, 0.0])
        assert_apart(poses, world)


def test_a_given_start_is_taken_and_the_others_keep_away_from_it():
    world = load_world("env1")
    poses = start_poses(world, 2, start=np.array([1.25, 2.0, 1.0]))
    np.testing.assert_array_equal(poses[0], [1.25, 2.0, 1.0])
    assert_apart(poses, world)
