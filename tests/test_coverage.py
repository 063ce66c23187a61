"""Coverage: which cells count, and which have been seen."""

import math

import numpy as np
import pytest

from limslam_env.config import NoiseConfig
from limslam_env.coverage import CELL, coverage_grid, mark_seen
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec
from limslam_env.sensors import beam_rays, build_wall_index
from limslam_env.simulation import Simulation
from limslam_env.world import World, load_world

ROBOT = RobotSpec()
BOX = [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 2.0], [4.0, 2.0, 0.0, 2.0], [0.0, 2.0, 0.0, 0.0]]


def box_world(*walls: list[float]) -> World:
    return World("box", (4.0, 2.0), np.array([*BOX, *walls]), starts=np.array([[0.5, 1.0, 0.0]]))


def seen_from(world: World, poses: FloatArray) -> np.ndarray:
    """The cells that beams and body mark at each of the poses in turn, one robot alone in the world."""
    grid = coverage_grid(world, ROBOT, world.starts[:1])
    index = build_wall_index(world.edges, ROBOT.reach)
    seen = np.zeros_like(grid.coverable)
    for pose in poses[:, None]:
        rays = beam_rays(pose, ROBOT)
        lengths = rays.offsets + ROBOT.max_ranges
        found, _ = index.cast(rays.origins, rays.directions, lengths, rays.owners, pose[:, :2].copy(), ROBOT.radius)
        mark_seen(seen, grid, pose, rays, found, ROBOT.radius)
    return seen


def turning_at(x: float, y: float) -> FloatArray:
    return np.array([[x, y, heading] for heading in np.linspace(-math.pi, math.pi, 721)])


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("env1", 25, 45), ("square", 20, 50)],
)
def test_all_but_the_block_counts(name, low, high):
    world = load_world(name)
    grid = coverage_grid(world, ROBOT, world.starts[:1])
    expected = np.ones((70, 70), dtype=bool)
    # Nothing can look into the block; every other place can be seen from somewhere.
    expected[low:high, low:high] = False
    np.testing.assert_array_equal(grid.coverable, expected)
    assert grid.total == {"env1": 4500, "square": 4000}[name]


def test_a_closed_off_room_does_not_count():
    world = box_world([2.0, 0.0, 2.0, 2.0])
    grid = coverage_grid(world, ROBOT, world.starts)
    expected = np.zeros((20, 40), dtype=bool)
    expected[:, :20] = True
    np.testing.assert_array_equal(grid.coverable, expected)


def test_a_room_behind_a_gap_too_narrow_for_the_robot_counts_as_far_as_beams_reach():
    world = box_world([2.0, 0.0, 2.0, 0.925], [2.0, 1.075, 2.0, 2.0])
    coverable = coverage_grid(world, ROBOT, world.starts).coverable
    assert coverable[:, :20].all()
    assert coverable[9:11, 20:32].all(), "seen through the gap"
    assert not coverable[:, 37:].any(), "further than a beam reaches from the gap"
    assert not coverable[[0, 1, -2, -1], 20].any(), "beside the gap, behind the wall"


def test_count_counts_coverable_cells_only():
    world = load_world("env1")
    grid = coverage_grid(world, ROBOT, world.starts[:1])
    assert grid.count(np.ones_like(grid.coverable)) == 4500
    assert grid.count(~grid.coverable) == 0
    assert grid.count(np.zeros_like(grid.coverable)) == 0


def test_a_cell_behind_a_wall_is_not_marked():
    world = box_world([2.0, 0.0, 2.0, 1.4])
    seen = seen_from(world, turning_at(1.0, 0.55))
    assert not seen[:14, 20:].any()
    assert seen[5, 1:20].all(), "the row that the robot stands in, up to the wall"
    assert seen[:14, 19].all(), "the cells on this side of the wall"


@pytest.mark.parametrize("gap", [0.0, 1e-6])
def test_a_robot_against_a_wall_marks_nothing_behind_it(gap):
    world = box_world([2.0, 0.0, 2.0, 1.4])
    for x, behind in ((2.0 - ROBOT.radius - gap, np.s_[:14, 20:]), (2.0 + ROBOT.radius + gap, np.s_[:14, :20])):
        assert not seen_from(world, turning_at(x, 0.55))[behind].any()


def test_a_beam_marks_the_cells_that_it_crosses_and_no_others():
    world = box_world()
    seen = seen_from(world, np.array([[1.05, 1.05, 0.0]]))
    y, x = (np.nonzero(seen)[0] + 0.5) * CELL, (np.nonzero(seen)[1] + 0.5) * CELL
    bearing, distance = np.arctan2(y - 1.05, x - 1.05), np.hypot(x - 1.05, y - 1.05)
    near_a_beam = np.zeros(len(x), dtype=bool)
    for beam in ROBOT.beams:
        off_axis = distance * np.abs(np.sin(bearing - beam.angle))
        near_a_beam |= (off_axis <= CELL * math.sqrt(0.5) + 1e-9) & (np.cos(bearing - beam.angle) > -1e-9)
    assert (near_a_beam | (distance < ROBOT.radius + CELL)).all()
    assert seen[10:20, 10].all(), "the beam to the left reaches the wall 0.95 m away"
    assert seen[0:10, 10].all()
    assert seen[10, 9], "the body reaches back to where no beam points"
    assert not seen[10, 13:].any(), "no beam points straight ahead"


def test_coverage_grows_from_above_zero_and_never_beyond_one():
    world = load_world("env1")
    simulation = Simulation(world, ROBOT)
    _, truth = simulation.reset(np.random.SeedSequence(0), NoiseConfig(sensor_noise=0.04))
    total = simulation.coverage_grid.total
    shares, area = [truth.coverage], truth.new_area
    generator = np.random.default_rng(0)
    for step in range(2000):
        if step % 25 == 0:
            action = generator.uniform(-0.2, 1.0, (1, 2))
        _, truth = simulation.step(action)
        shares.append(truth.coverage)
        area += truth.new_area
        assert truth.new_area >= 0.0
    assert shares[0] > 0.0
    assert (np.diff(shares) >= 0.0).all()
    assert shares[0] < shares[-1] <= 1.0
    assert area == pytest.approx(shares[-1] * total * CELL**2)


def test_noise_does_not_change_what_counts_as_seen():
    shares = []
    for noise in (NoiseConfig(), NoiseConfig(sensor_noise=0.04, dropout=1.0, wheel_variance=1e-3)):
        simulation = Simulation(load_world("env1"), ROBOT)
        simulation.reset(np.random.SeedSequence(0), noise)
        shares.append([simulation.step(np.array([[0.9, 1.0]]))[1].coverage for _ in range(100)])
    assert shares[0] == shares[1]


def test_what_can_be_seen_in_a_drive_was_coverable():
    simulation = Simulation(load_world("env1"), ROBOT)
    simulation.reset(np.random.SeedSequence(1), NoiseConfig())
    generator = np.random.default_rng(1)
    for _ in range(80):
        action = generator.uniform(-0.3, 1.0, (1, 2))
        for _ in range(25):
            simulation.step(action)
    assert not (simulation._seen & ~simulation.coverage_grid.coverable).any()
