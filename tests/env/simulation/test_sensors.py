"""Beams against pymunk and against brute force, their noise, and what they see of other robots."""

import math

import numpy as np
import pytest
from support.data import SHIPPED_WORLDS

from limslam_env import NoiseConfig, RobotSpec, SensorSpec, World, load_world
from limslam_env.geometry import FloatArray, segment
from limslam_env.interface import beams_on_rim
from limslam_env.kernels.coverage import CellGrid
from limslam_env.kernels.observation import drive_and_observe, new_scene
from limslam_env.kernels.rays import NOTHING
from limslam_env.kernels.readings import noisy_reading
from limslam_env.simulation.sensors import CELL, beam_table, build_wall_index, cast, noise_table
from limslam_env.simulation.simulation import Readings, Simulation, Truth

REACH = 3.0
BOX = np.array(
    [[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 4.0], [4.0, 4.0, 0.0, 4.0], [0.0, 4.0, 0.0, 0.0]]
)
BOX_WORLD = World("box", (4.0, 4.0), BOX)
ROBOT = RobotSpec()
FRONT = RobotSpec(beams=beams_on_rim((0.0, 90.0, 180.0, -90.0), 0.10))
ONE_BEAM = RobotSpec(beams=beams_on_rim((0.0,), 0.10))
NO_WHEEL_NOISE = NoiseConfig(wheel_variance=0.0)


def unit(angles: FloatArray) -> FloatArray:
    return np.column_stack((np.cos(angles), np.sin(angles)))


def ring(corners: list[tuple[float, float]]) -> FloatArray:
    return segment.polygon_edges(np.array(corners))


def box_with(*walls: tuple[float, float, float, float]) -> World:
    return World("box", (4.0, 4.0), np.vstack((BOX, *(np.array([wall]) for wall in walls))))


def random_rays(
    edges: FloatArray, count: int, seed: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rays from inside and from a little outside of the walls, so that some leave the index's
    grid.
    """
    generator = np.random.default_rng(seed)
    corners = edges.reshape(-1, 2)
    margin = 0.9 * CELL
    origins = generator.uniform(
        corners.min(axis=0) - margin, corners.max(axis=0) + margin, (count, 2)
    )
    return (
        origins,
        unit(generator.uniform(-math.pi, math.pi, count)),
        generator.uniform(0.1, REACH, count),
    )


def brute_force(
    edges: FloatArray, origins: FloatArray, directions: FloatArray, lengths: FloatArray
):
    """Every ray against every wall, by Cramer's rule."""
    start = edges[None, :, :2] - origins[:, None]
    span = (edges[:, 2:] - edges[:, :2])[None]
    cross = directions[:, None, 0] * span[..., 1] - directions[:, None, 1] * span[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[..., 0] * span[..., 1] - start[..., 1] * span[..., 0]) / cross
        fraction = (
            start[..., 0] * directions[:, None, 1] - start[..., 1] * directions[:, None, 0]
        ) / cross
    distance = np.where((distance >= 0.0) & (fraction >= 0.0) & (fraction <= 1.0), distance, np.inf)
    nearest = distance.argmin(axis=1)
    best = distance[np.arange(len(origins)), nearest]
    return np.minimum(best, lengths), np.where(best < lengths, nearest, -1)


def look(
    edges: FloatArray, pose: tuple[float, float, float], robot: RobotSpec, cone: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Walls hit (n_beams,) and ranges (n_beams,) of a robot that may stand where no robot could
    start.
    """
    noise = noise_table(vars(NoiseConfig(cone=cone)), robot)
    is_moved = True
    cells = np.zeros((1, 1), dtype=bool)
    grid = CellGrid(cells.copy(), cells, np.array([0.0, 0.0, 0.1]))
    walls = build_wall_index(edges)
    scene = new_scene(
        np.array([pose]), np.zeros(3), robot.radius, beam_table(robot), noise, walls, grid
    )
    drive_and_observe(is_moved, 0, np.zeros((1, len(robot.beams) + 2, 2)), *scene)
    return scene.hits[0], scene.ranges[0]


def sight(
    world: World,
    robot: RobotSpec,
    *poses: tuple[float, float, float],
    noise: NoiseConfig = NO_WHEEL_NOISE,
) -> tuple[Readings, Truth]:
    """The first observation of robots at the given poses."""
    return Simulation(world, robot, len(poses)).reset(
        np.random.SeedSequence(0), noise, np.array(poses)
    )


@pytest.mark.parametrize("name", [*SHIPPED_WORLDS, "random walls"])
def test_rays_agree_with_every_ray_against_every_wall(name):
    edges = (
        np.random.default_rng(5).uniform(-3.0, 3.0, (60, 4))
        if name == "random walls"
        else load_world(name).edges
    )
    rays = random_rays(edges, 10_000, seed=2)
    found, hits = cast(build_wall_index(edges), *rays)
    distance, nearest = brute_force(edges, *rays)
    np.testing.assert_allclose(found, distance, atol=1e-9)
    np.testing.assert_array_equal(hits, nearest)
    assert (hits == -1).any()
    assert (hits >= 0).any()


@pytest.mark.parametrize("shift", [0.0, 0.1, 1e-7])
def test_rays_and_walls_along_the_borders_of_the_index_miss_nothing(shift):
    # Walls on round numbers lie on the borders of the cells that the index sorts them by, or next
    # to them.
    edges = np.array(
        [
            [x, y, x + dx, y + dy]
            for x in range(5)
            for y in range(5)
            for dx, dy in ((0.4, 0.0), (0.0, 0.4))
        ]
    )
    edges += shift
    grid = np.arange(0.0, 4.5, 0.5) + shift
    origins = np.array([(x, y) for x in grid for y in grid for _ in range(8)])
    directions = np.tile(unit(np.arange(8) * math.pi / 4.0), (len(grid) ** 2, 1))
    lengths = np.full(len(origins), REACH)
    # Straight along a wall, or right through its end, either answer would do: a hair beside there
    # is only one.
    origins += 1e-5
    found, _ = cast(build_wall_index(edges), origins, directions, lengths)
    distance, _ = brute_force(edges, origins, directions, lengths)
    np.testing.assert_allclose(found, distance, atol=1e-9)


def test_a_ray_along_a_wall_ends_at_the_next_one():
    # A wall of no thickness is not seen edge on; the wall that it leads to is.
    for wall, origin in (((1.0, 2.0, 2.0, 2.0), (1.5, 2.0)), ((1.0, 2.0, 2.0, 2.0), (0.5, 2.0))):
        index = build_wall_index(np.vstack((BOX, [wall])))
        found, hits = cast(index, np.array([origin]), np.array([[1.0, 0.0]]), np.array([9.0]))
        assert found[0] == pytest.approx(4.0 - origin[0])
        assert hits[0] == 1


def test_a_robot_is_seen_at_its_rim_and_not_by_its_own_beams():
    # Robot 0 looks along x at robot 1, which looks back with its left beam; centres 1 m apart.
    readings, truth = sight(BOX_WORLD, FRONT, (1.0, 2.0, 0.0), (2.0, 2.0, math.pi / 2))
    np.testing.assert_array_equal(truth.wall_seen, [[-2, -1, 3, -1], [-1, -2, -1, -1]])
    np.testing.assert_allclose(
        readings.ranges, [[0.8, 1.5, 0.9, 1.5], [1.5, 0.8, 1.5, 1.5]], atol=1e-6
    )


def test_robots_see_each_other_where_geometry_says():
    generator = np.random.default_rng(2)
    simulation = Simulation(BOX_WORLD, ROBOT, 3)
    seen = 0
    for _ in range(60):
        poses = np.column_stack(
            (generator.uniform(0.5, 3.5, (3, 2)), generator.uniform(-math.pi, math.pi, 3))
        )
        if min(np.hypot(*(poses[a, :2] - poses[b, :2])) for a, b in ((0, 1), (0, 2), (1, 2))) < 0.3:
            continue
        readings, truth = simulation.reset(np.random.SeedSequence(0), NO_WHEEL_NOISE, poses)
        for one, beam in zip(*np.nonzero(truth.wall_seen == -2), strict=True):
            x, y, theta = poses[one]
            angle = theta + ROBOT.beam_angles[beam]
            end = np.array([x, y]) + (ROBOT.radius + readings.ranges[one, beam]) * np.array(
                [math.cos(angle), math.sin(angle)]
            )
            gaps = np.delete(np.hypot(*(poses[:, :2] - end).T), one)
            assert gaps.min() == pytest.approx(ROBOT.radius, abs=1e-6)
            seen += 1
    assert seen > 20


def test_a_robot_in_front_hides_a_wall_and_counts_for_no_wall():
    readings, truth = sight(box_with((2.5, 1.0, 2.5, 3.0)), FRONT, (1.5, 2.0, 0.0), (2.0, 2.0, 0.0))
    assert truth.wall_seen[0, 0] == -2
    assert readings.ranges[0, 0] == pytest.approx(0.3, abs=1e-6)
    assert truth.wall_seen[1, 0] == 4


@pytest.mark.parametrize("depth", [0.0, 1e-3])
def test_a_robot_pressed_to_a_wall_never_sees_through_it(depth):
    # The rim, where beams start, may lie a little behind the wall; the second wall is what would be
    # seen then.
    edges = np.array([[-9.0, 0.0, 9.0, 0.0], [-9.0, -0.5, 9.0, -0.5]])
    robot = RobotSpec(
        beams=tuple(SensorSpec(b.x, b.y, b.angle, min_range=0.0) for b in ROBOT.beams)
    )
    for heading in np.linspace(-math.pi, math.pi, 721):
        hits, ranges = look(edges, (0.0, robot.radius - depth, heading), robot)
        angles = heading + robot.beam_angles
        assert (hits != 1).all()
        steep = np.sin(angles) < -0.2
        assert (hits[steep] == 0).all()
        # Beams point straight out: from the centre to the wall, less the radius.
        expected = (robot.radius - depth) / -np.sin(angles[steep]) - robot.radius
        np.testing.assert_allclose(ranges[steep], np.clip(expected, 0.0, 1.5), atol=1e-6)


def test_a_beam_that_starts_at_the_middle_measures_from_there():
    robot = RobotSpec(
        beams=(
            SensorSpec(0.0, 0.0, 0.0),
            SensorSpec(-0.05, 0.0, math.pi),
            SensorSpec(0.0, 0.05, 0.0),
        )
    )
    readings, _ = sight(BOX_WORLD, robot, (1.0, 3.4, math.pi))
    np.testing.assert_allclose(readings.ranges, [[1.0, 1.5, 1.0]], atol=1e-6)


def readings_of(
    ideal: float, count: int, seed: int = 0, hit: int = 0, **noise: float
) -> FloatArray:
    """Many readings of the same thing."""
    table = noise_table(vars(NoiseConfig(**noise)), FRONT)
    generator = np.random.default_rng(seed)
    drawn = zip(generator.standard_normal(count), generator.random(count), strict=True)
    return np.array(
        [
            noisy_reading(ideal, hit, beam_table(FRONT), 0, table, normal, uniform)
            for normal, uniform in drawn
        ]
    )


def test_the_simulation_makes_the_asked_noise_apart_for_each_beam():
    simulation = Simulation(BOX_WORLD, FRONT)
    std = 0.03
    count = 4000
    simulation.reset(
        np.random.SeedSequence(1), NoiseConfig(sensor_noise=std), np.array([1.0, 1.0, 0.0])
    )
    ranges = np.array(
        [simulation.step([(0.0, 0.0)])[0].ranges[0] for _ in range(count)], dtype=float
    )
    errors = ranges[:, 2:] - 0.9
    assert (np.abs(errors.mean(axis=0)) < 5.0 * std / math.sqrt(count)).all()
    np.testing.assert_allclose(errors.std(axis=0), std, rtol=5.0 / math.sqrt(2.0 * count))
    assert abs(np.corrcoef(errors.T)[0, 1]) < 5.0 / math.sqrt(count), "beams err apart"
    assert abs(np.corrcoef(errors[:-1, 0], errors[1:, 0])[0, 1]) < 5.0 / math.sqrt(count), (
        "and step by step"
    )


def test_a_beam_that_hits_nothing_reads_its_maximum_exactly():
    noise = {
        "sensor_noise": 0.04,
        "range_noise_growth": 0.02,
        "range_resolution": 0.07,
        "fold_back": 3.0,
    }
    np.testing.assert_array_equal(readings_of(1.5, 500, hit=NOTHING, **noise), 1.5)


def ranges_of_a_drive(robots: int = 1, **noise: float) -> FloatArray:
    simulation = Simulation(load_world("env1"), ROBOT, robots)
    first, _ = simulation.reset(np.random.SeedSequence(2), NoiseConfig(wheel_variance=0.0, **noise))
    drive = [simulation.step([(0.6, 1.0)] * robots)[0] for _ in range(150)]
    return np.array([readings.ranges for readings in (first, *drive)], dtype=float)


def test_dropout_does_not_change_the_other_draws():
    # A step takes the same numbers whatever the noise is: a run with dropout is paired with one
    # without.
    without = ranges_of_a_drive(sensor_noise=0.02)
    dropped = ranges_of_a_drive(sensor_noise=0.02, dropout=0.3)
    kept = dropped != 1.5
    assert kept.any()
    np.testing.assert_array_equal(dropped[kept], without[kept])
    assert (without[~kept] < 1.5).any()


def test_dropout_reads_the_maximum_at_the_asked_rate():
    count = 20_000
    chance = 0.2
    share = (readings_of(0.8, count, dropout=chance) == 1.5).mean()
    assert abs(share - chance) < 5.0 * math.sqrt(chance * (1.0 - chance) / count)
    assert set(readings_of(0.8, 200, dropout=1.0)) == {1.5}


@pytest.mark.parametrize(("ideal", "bound"), [(0.06, 0.05), (1.49, 1.5), (-0.001, 0.05)])
def test_readings_are_clipped_to_what_the_beam_can_report(ideal, bound):
    found = readings_of(ideal, 500, sensor_noise=0.04)
    assert found.min() >= 0.05
    assert found.max() <= 1.5
    assert (found == bound).any()


@pytest.mark.parametrize("ideal", [0.2, 1.3])
def test_a_sharp_sensor_s_noise_grows_with_the_squared_range(ideal):
    count = 20_000
    growth = 0.02
    found = readings_of(ideal, count, range_noise_growth=growth)
    assert found.std() == pytest.approx(growth * ideal**2, rel=5.0 / math.sqrt(2.0 * count))
    # What it has at any range comes on top, as independent errors add up.
    both = readings_of(ideal, count, sensor_noise=0.01, range_noise_growth=growth)
    assert both.std() == pytest.approx(
        math.hypot(0.01, growth * ideal**2), rel=5.0 / math.sqrt(2.0 * count)
    )


@pytest.mark.parametrize("resolution", [0.01, 0.025])
def test_readings_come_in_steps_of_the_resolution(resolution):
    found = readings_of(0.8, 500, sensor_noise=0.05, range_resolution=resolution)
    np.testing.assert_allclose(found / resolution, np.round(found / resolution), atol=1e-9)
    # Rounding is to the nearest step: half a step at most.
    exact = readings_of(0.8, 500, sensor_noise=0.05)
    assert np.abs(found - exact).max() <= 0.5 * resolution + 1e-12
    assert len(set(found)) > 3


def test_a_robot_that_drives_up_to_a_wall_reads_less_and_then_more():
    simulation = Simulation(BOX_WORLD, ONE_BEAM)
    simulation.reset(
        np.random.SeedSequence(0), NoiseConfig(fold_back=4.0), np.array([3.7, 2.0, 0.0])
    )
    steps = [simulation.step([(0.1, 0.1)]) for _ in range(80)]
    gaps = np.array([3.9 - truth.poses[0, 0] for _, truth in steps])
    ranges = np.array([readings.ranges[0, 0] for readings, _ in steps], dtype=float)
    np.testing.assert_allclose(
        ranges, np.where(gaps < 0.05, 0.05 + 4.0 * (0.05 - gaps), gaps), atol=1e-6
    )
    assert ranges[-1] > ranges.min() + 0.15
    assert steps[-1][1].contact[0]


def post(bearing: float, distance: float, width: float) -> list[tuple[float, float, float, float]]:
    """A square post seen at a bearing (rad) and distance (m) of its near side from (1, 2)."""
    half = 0.5 * width
    corners = np.array(
        [(distance, -half), (distance + width, -half), (distance + width, half), (distance, half)]
    )
    cos = math.cos(bearing)
    sin = math.sin(bearing)
    return [
        tuple(edge)
        for edge in ring((corners @ np.array([[cos, sin], [-sin, cos]]) + (1.0, 2.0)).tolist())
    ]


@pytest.mark.parametrize("bearing", np.linspace(-0.12, 0.12, 5))
def test_a_beam_with_a_cone_reads_a_post_beside_its_middle(bearing):
    cone = 0.1
    width = 0.06
    world = box_with(*post(bearing, 0.8, width))
    ray, _ = sight(world, ONE_BEAM, (1.0, 2.0, 0.0))
    wide, truth = sight(world, ONE_BEAM, (1.0, 2.0, 0.0), noise=NoiseConfig(cone=cone))
    half = math.atan(0.5 * width / 0.8)
    assert (ray.ranges[0, 0] < 1.0) == (abs(bearing) < half)
    if abs(bearing) > cone + half:
        assert wide.ranges[0, 0] == 1.5
        assert truth.wall_seen[0, 0] == -1
    elif abs(bearing) < cone:
        assert wide.ranges[0, 0] == pytest.approx(0.7, abs=0.01)
        assert truth.wall_seen[0, 0] >= 4, "the post is what was seen"


def test_a_cone_reads_the_nearest_thing_within():
    # The wall to the right comes nearer from ahead to the right: the cone's edge meets it first.
    slanted = box_with((2.0, 2.0, 1.4, 0.5))
    for cone in (0.05, 0.2, 0.4):
        readings, _ = sight(slanted, ONE_BEAM, (1.0, 2.0, -0.6), noise=NoiseConfig(cone=cone))
        directions = unit(-0.6 + np.linspace(-cone, cone, 5001))
        # All rays of a cone go out from one point of the rim; what they measure starts there.
        rim = np.array([1.0, 2.0]) + 0.1 * unit(np.array([-0.6]))
        rays = np.tile(rim, (5001, 1)), directions, np.full(5001, 3.0)
        expected = brute_force(slanted.edges, *rays)[0].min()
        assert readings.ranges[0, 0] == pytest.approx(expected, rel=0.01)


def test_a_cone_covers_no_more_than_its_ray():
    seen = []
    for cone in (0.0, 0.3):
        simulation = Simulation(load_world("env1"), ROBOT)
        simulation.reset(np.random.SeedSequence(0), NoiseConfig(cone=cone))
        for _ in range(60):
            simulation.step([(1.0, 0.9)])
        seen.append(simulation.seen)
    np.testing.assert_array_equal(*seen)


@pytest.mark.parametrize("depth", [0.0, 5e-4])
def test_a_cone_does_not_look_through_a_wall_that_the_robot_touches(depth):
    edges = np.array([[-9.0, 0.0, 9.0, 0.0], [-9.0, -0.5, 9.0, -0.5]])
    for heading in np.linspace(-2.8, -0.3, 251):
        hits, _ = look(edges, (0.0, ONE_BEAM.radius - depth, heading), ONE_BEAM, cone=0.3)
        assert hits[0] == 0


def test_a_beam_measures_at_the_reset_and_then_once_a_period_in_its_phase():
    schedule = ((1, 0), (2, 0), (5, 0), (5, 1), (5, 4))
    angles = -0.5 * math.pi + 0.1 * np.arange(-2.0, 3.0)
    beams = tuple(
        SensorSpec(
            0.10 * math.cos(angle), 0.10 * math.sin(angle), angle, period=period, phase=phase
        )
        for angle, (period, phase) in zip(angles.tolist(), schedule, strict=True)
    )
    robot = RobotSpec(beams=beams)
    simulation = Simulation(box_with((1.2, 0.4, 1.6, 0.4), (2.0, 0.4, 2.4, 0.4)), robot)
    noise = NoiseConfig(sensor_noise=0.02)
    seeds = np.random.SeedSequence(3)
    results = [simulation.reset(seeds, noise, np.array([0.8, 1.0, 0.0]))]
    results += [simulation.step([(1.0, 1.0)]) for _ in range(40)]
    ranges = np.array([readings.ranges[0] for readings, _ in results])
    seen = np.array([truth.wall_seen[0] for _, truth in results])
    assert robot.measures(0).all()
    for beam, (period, phase) in enumerate(schedule):
        for step in range(1, 41):
            repeats = step % period != phase
            assert robot.measures(step)[beam] != repeats
            assert (ranges[step, beam] == ranges[step - 1, beam]) == repeats
            assert not repeats or seen[step, beam] == seen[step - 1, beam]
        assert len(set(seen[:, beam].tolist())) > 1, "the walls seen change on the way"
