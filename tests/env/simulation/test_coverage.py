"""Coverage: which cells count, and which have been seen."""

import math
from dataclasses import replace

import numpy as np
import pytest
from support.data import SHIPPED_WORLDS

from limslam_env import NoiseConfig, RobotSpec, World, load_world
from limslam_env.geometry import FloatArray
from limslam_env.interface import beams_on_rim
from limslam_env.kernels.coverage import CellGrid, mark_disc
from limslam_env.kernels.observation import drive_and_observe, new_scene
from limslam_env.simulation.coverage import CELL, coverage_grid
from limslam_env.simulation.sensors import beam_table, build_wall_index, noise_table
from limslam_env.simulation.simulation import Simulation

ROBOT = RobotSpec()
BOX = [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 2.0], [4.0, 2.0, 0.0, 2.0], [0.0, 2.0, 0.0, 0.0]]


def box_world(*walls: list[float]) -> World:
    return World("box", (4.0, 2.0), np.array([*BOX, *walls]), starts=np.array([[0.5, 1.0, 0.0]]))


def seen_from(world: World, poses: FloatArray) -> np.ndarray:
    """The cells that beams and body mark at each of the poses in turn, one robot alone in the
    world.
    """
    grid = coverage_grid(world, ROBOT, world.starts[:1])
    noise = noise_table(vars(NoiseConfig()), ROBOT)
    walls = build_wall_index(world.edges)
    table = beam_table(ROBOT)
    cells = CellGrid(np.zeros_like(grid.coverable), grid.coverable, grid.area)
    new = 0
    is_moved = True
    for pose in poses[:, None]:
        scene = new_scene(pose, np.zeros(3), ROBOT.radius, table, noise, walls, cells)
        drive_and_observe(is_moved, 0, np.zeros((1, len(ROBOT.beams) + 2, 2)), *scene)
        new += scene.new_cells[0]
    seen = cells.seen
    assert new == np.count_nonzero(seen & grid.coverable), "what counts as new is counted once"
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


def test_a_body_marks_the_cells_that_it_touches():
    generator = np.random.default_rng(1)
    rows, columns = np.mgrid[0:40, 0:40]
    for _ in range(200):
        x = generator.uniform(-0.5, 4.5)
        y = generator.uniform(-0.5, 4.5)
        radius = generator.uniform(0.03, 0.6)
        seen = np.zeros((40, 40), dtype=bool)
        grid = CellGrid(seen, seen.copy(), np.array([0.0, 0.0, CELL]))
        mark_disc(grid, x, y, radius)
        gap = np.hypot(
            x - np.clip(x, columns * CELL, (columns + 1) * CELL),
            y - np.clip(y, rows * CELL, (rows + 1) * CELL),
        )
        # A body may stand a millimetre in a wall, which must not show what lies behind.
        assert seen[gap < radius - 2e-3].all()
        assert not seen[gap >= radius].any()


def test_a_cell_behind_a_wall_is_not_marked():
    world = box_world([2.0, 0.0, 2.0, 1.4])
    seen = seen_from(world, turning_at(1.0, 0.55))
    assert not seen[:14, 20:].any()
    assert seen[5, 1:20].all(), "the row that the robot stands in, up to the wall"
    assert seen[:14, 19].all(), "the cells on this side of the wall"


def test_a_beam_marks_the_cells_that_it_crosses_and_no_others():
    world = box_world()
    seen = seen_from(world, np.array([[1.05, 1.05, 0.0]]))
    y = (np.nonzero(seen)[0] + 0.5) * CELL
    x = (np.nonzero(seen)[1] + 0.5) * CELL
    bearing = np.arctan2(y - 1.05, x - 1.05)
    distance = np.hypot(x - 1.05, y - 1.05)
    near_a_beam = np.zeros(len(x), dtype=bool)
    for beam in ROBOT.beams:
        off_axis = distance * np.abs(np.sin(bearing - beam.angle))
        near_a_beam |= (off_axis <= CELL * math.sqrt(0.5) + 1e-9) & (
            np.cos(bearing - beam.angle) > -1e-9
        )
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
    shares = [truth.coverage]
    area = truth.new_area[0]
    generator = np.random.default_rng(0)
    for step in range(2000):
        if step % 25 == 0:
            action = generator.uniform(-0.2, 1.0, 2).tolist()
        _, truth = simulation.step([action])
        shares.append(truth.coverage)
        area += truth.new_area[0]
        assert truth.new_area[0] >= 0.0
    assert shares[0] > 0.0
    assert (np.diff(shares) >= 0.0).all()
    assert shares[0] < shares[-1] <= 1.0
    assert area == pytest.approx(shares[-1] * total * CELL**2)


@pytest.mark.parametrize("name", SHIPPED_WORLDS)
def test_what_can_be_seen_in_a_drive_was_coverable(name):
    simulation = Simulation(load_world(name), ROBOT)
    simulation.reset(np.random.SeedSequence(1), NoiseConfig())
    generator = np.random.default_rng(1)
    for _ in range(80):
        action = generator.uniform(-0.3, 1.0, 2).tolist()
        for _ in range(25):
            simulation.step([action])
    assert not (simulation.seen & ~simulation.coverage_grid.coverable).any()


def test_only_beams_that_measured_in_a_step_count():
    slow = RobotSpec(
        beams=[replace(beam, period=10) for beam in beams_on_rim((90.0, 45.0), ROBOT.radius)]
    )
    simulation = Simulation(load_world("env1"), slow)
    _, truth = simulation.reset(np.random.SeedSequence(0), NoiseConfig())
    assert truth.coverage > 0.0
    # Turning on the spot, the body covers nothing new, and the beams look elsewhere at every step.
    areas = [simulation.step([(-0.5, 0.5)])[1].new_area[0] for _ in range(30)]
    assert [step for step, area in enumerate(areas, start=1) if area > 0.0] == [10, 20, 30]


def test_what_two_robots_see_at_once_counts_for_the_first_of_them():
    world = box_world()
    simulation = Simulation(world, ROBOT, 2)
    # The second stands behind the first and looks along the same walls.
    poses = np.array([[1.0, 1.0, 0.0], [0.7, 1.0, 0.0]])
    _, both = simulation.reset(np.random.SeedSequence(0), NoiseConfig(), poses)
    total = simulation.coverage_grid.total
    alone = [
        Simulation(world, ROBOT)
        .reset(np.random.SeedSequence(0), NoiseConfig(), pose)[1]
        .new_area[0]
        for pose in poses
    ]
    assert both.new_area[0] == pytest.approx(alone[0])
    assert 0.0 < both.new_area[1] < alone[1]
    assert sum(both.new_area) == pytest.approx(both.coverage * total * CELL**2)
