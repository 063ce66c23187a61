"""The simulation: runs of one seed with other noise are alike but for the noise, and robots start where they may."""

import math

import numpy as np
import pytest

from limslam_env import NoiseConfig, RobotSpec, World, load_world
from limslam_env.geometry import FloatArray, segment
from limslam_env.simulation.physics import Physics
from limslam_env.simulation.simulation import Simulation

ROBOT = RobotSpec()
BOX = np.array([[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 4.0], [4.0, 4.0, 0.0, 4.0], [0.0, 4.0, 0.0, 0.0]])
# All noise of readings: what moves the robot otherwise (slips, the axle) is not among it.
ALL_NOISE = NoiseConfig.sharp(
    sensor_noise=0.04, dropout=0.05, cone=0.0, wheel_variance=1e-4, encoder_resolution=0.001, wheel_mismatch=0.01
)


def box_world(*starts: tuple[float, float, float], extra: FloatArray | None = None) -> World:
    walls = BOX if extra is None else np.vstack((BOX, extra))
    return World("box", (4.0, 4.0), walls, starts=np.array(starts).reshape(-1, 3))


def start_poses(world: World, robots: int, seed: int = 0, start: FloatArray | None = None) -> FloatArray:
    simulation = Simulation(world, ROBOT, robots)
    return simulation.reset(np.random.SeedSequence(seed), NoiseConfig(), start)[1].poses


def assert_apart(poses: FloatArray, world: World) -> None:
    for number, pose in enumerate(poses[:, :2]):
        for other in poses[:number, :2]:
            assert np.hypot(*(pose - other)) > 2.0 * ROBOT.radius
    assert segment.distances(poses[:, :2], world.edges).min() >= ROBOT.radius


def record(noise: NoiseConfig, seed: int, steps: int, robots: int = 1) -> dict[str, np.ndarray]:
    """Everything that a run gives, as arrays."""
    simulation = Simulation(load_world("env1"), ROBOT, robots)
    results = [simulation.reset(np.random.SeedSequence(seed), noise)]
    generator = np.random.default_rng(1)
    for step in range(steps):
        if step % 10 == 0:
            actions = generator.uniform(-0.5, 1.0, (robots, 2)).tolist()
        results.append(simulation.step(actions))
    return {
        "ranges": np.array([readings.ranges for readings, _ in results]),
        "wheels": np.array([readings.wheels for readings, _ in results]),
        "poses": np.array([truth.poses for _, truth in results]),
        "coverage": np.array([truth.coverage for _, truth in results]),
        "wall_seen": np.array([truth.wall_seen for _, truth in results]),
        "contact": np.array([truth.contact for _, truth in results]),
        "time": np.array([truth.time for _, truth in results]),
    }


def test_noise_levels_with_one_seed_share_the_truth():
    quiet, loud = record(NoiseConfig(wheel_variance=0.0), 3, 200), record(ALL_NOISE, 3, 200)
    for name in ("poses", "coverage", "wall_seen", "contact"):
        np.testing.assert_array_equal(quiet[name], loud[name])
    assert (quiet["ranges"] != loud["ranges"]).any()
    assert (quiet["wheels"] != loud["wheels"]).any()


def test_drawn_starts_depend_on_the_seed_and_cover_the_room_and_all_headings():
    poses = np.vstack([start_poses(box_world(), 1, seed) for seed in range(60)])
    assert len(np.unique(poses, axis=0)) == 60
    assert (np.ptp(poses[:, :2], axis=0) > 3.0).all()
    assert np.ptp(poses[:, 2]) > 5.0
    assert (np.abs(poses[:, 2]) <= math.pi).all()


def test_each_robot_needs_an_action():
    simulation = Simulation(load_world("env3"), ROBOT, 2)
    simulation.reset(np.random.SeedSequence(0), NoiseConfig())
    with pytest.raises(ValueError, match="for each of 2 robots, not 1"):
        simulation.step([(1.0, 1.0)])


def test_drawn_starts_lie_in_the_largest_region():
    # A wall leaves 1 m of 4 m on its right.
    world = box_world(extra=np.array([[3.0, 0.0, 3.0, 4.0]]))
    poses = np.vstack([start_poses(world, 1, seed) for seed in range(25)])
    assert (poses[:, 0] < 3.0).all()


def test_no_robot_starts_behind_a_slit_that_is_hardly_wider_than_its_body():
    # The slit of 0.235 m connects the cavity on the right with the rest, so that both are one region.
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


@pytest.mark.parametrize(("robots", "speed"), [(1, 0.3), (3, 2.0)], ids=["usual", "fast"])
def test_the_compiled_step_moves_robots_as_the_physics_does(robots, speed):
    robot, world = RobotSpec(max_wheel_speed=speed), load_world("env3")
    simulation, physics = Simulation(world, robot, robots), Physics(world.edges, robot.radius, robots)
    physics.place(simulation.reset(np.random.SeedSequence(1), NoiseConfig())[1].poses, robot.axle)
    generator, touches = np.random.default_rng(2), 0
    for step in range(600):
        if step % 20 == 0:
            actions = generator.uniform(-0.2, 1.0, (robots, 2))
        truth = simulation.step(actions.tolist())[1]
        travel = actions * (speed * robot.control_period)
        assert truth.contact == physics.step(travel.tolist(), robot.control_period)
        np.testing.assert_array_equal(truth.poses, physics.poses)
        touches += sum(truth.contact)
    assert 0 < touches < 600 * robots
