"""Beams against pymunk and against brute force, their noise, and the wheel encoders."""

import math
from dataclasses import replace

import numpy as np
import pymunk
import pytest

from limslam_env.config import NoiseConfig
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec, SensorSpec, beams_on_rim
from limslam_env.odometry import reported_travel
from limslam_env.sensors import WallIndex, beam_rays, build_wall_index, noisy_ranges
from limslam_env.simulation import Simulation
from limslam_env.world import World, load_world, shipped_worlds

REACH = 1.6
BOX = np.array([[0.0, 0.0, 4.0, 0.0], [4.0, 0.0, 4.0, 4.0], [4.0, 4.0, 0.0, 4.0], [0.0, 4.0, 0.0, 0.0]])
ROBOT = RobotSpec()
FRONT = RobotSpec(beams=beams_on_rim((0.0, 90.0, 180.0, -90.0), 0.10))
NO_DISCS = np.zeros((0, 2))


def unit(angles: FloatArray) -> FloatArray:
    return np.column_stack((np.cos(angles), np.sin(angles)))


def cast(index: WallIndex, origins: FloatArray, directions: FloatArray, lengths: FloatArray):
    return index.cast(origins, directions, lengths, np.zeros(len(origins), dtype=np.int64), NO_DISCS, 0.0)


def random_rays(edges: FloatArray, count: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Rays from inside and from a little outside of the walls, so that some leave the index's grid."""
    generator = np.random.default_rng(seed)
    corners = edges.reshape(-1, 2)
    origins = generator.uniform(corners.min(axis=0) - 1.0, corners.max(axis=0) + 1.0, (count, 2))
    return origins, unit(generator.uniform(-math.pi, math.pi, count)), generator.uniform(0.1, REACH, count)


def brute_force(edges: FloatArray, origins: FloatArray, directions: FloatArray, lengths: FloatArray):
    """Every ray against every wall, by Cramer's rule."""
    start, span = edges[None, :, :2] - origins[:, None], (edges[:, 2:] - edges[:, :2])[None]
    cross = directions[:, None, 0] * span[..., 1] - directions[:, None, 1] * span[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[..., 0] * span[..., 1] - start[..., 1] * span[..., 0]) / cross
        fraction = (start[..., 0] * directions[:, None, 1] - start[..., 1] * directions[:, None, 0]) / cross
    distance = np.where((distance >= 0.0) & (fraction >= 0.0) & (fraction <= 1.0), distance, np.inf)
    nearest = distance.argmin(axis=1)
    best = distance[np.arange(len(origins)), nearest]
    return np.minimum(best, lengths), np.where(best < lengths, nearest, -1)


@pytest.mark.parametrize("name", shipped_worlds())
def test_rays_agree_with_pymunk(name):
    edges = load_world(name).edges
    space = pymunk.Space()
    for x1, y1, x2, y2 in edges.tolist():
        space.add(pymunk.Segment(space.static_body, (x1, y1), (x2, y2), 0.0))
    origins, directions, lengths = random_rays(edges, 10_000, seed=1)
    found, hits = cast(build_wall_index(edges, REACH), origins, directions, lengths)
    ends = origins + lengths[:, None] * directions
    pairs = zip(origins.tolist(), ends.tolist(), strict=True)
    queries = [space.segment_query_first(origin, end, 0.0, pymunk.ShapeFilter()) for origin, end in pairs]
    alphas = np.array([query.alpha if query else 1.0 for query in queries])
    np.testing.assert_allclose(found, alphas * lengths, atol=1e-5)
    np.testing.assert_array_equal(hits == -1, [query is None for query in queries])
    assert 1000 < (hits >= 0).sum() < 9000, "both hits and misses are tried"


@pytest.mark.parametrize("name", [*shipped_worlds(), "random walls"])
def test_rays_agree_with_every_ray_against_every_wall(name):
    edges = np.random.default_rng(5).uniform(-3.0, 3.0, (60, 4)) if name == "random walls" else load_world(name).edges
    rays = random_rays(edges, 10_000, seed=2)
    found, hits = cast(build_wall_index(edges, REACH), *rays)
    distance, nearest = brute_force(edges, *rays)
    np.testing.assert_allclose(found, distance, atol=1e-9)
    np.testing.assert_array_equal(hits, nearest)


def test_no_ray_slips_through_a_joint_of_two_walls():
    centre = np.array([[1.3, 2.1]])
    corners = BOX[:, :2] - centre
    lengths = np.full(4, 9.0)
    directions = corners / np.linalg.norm(corners, axis=1)[:, None]
    found, hits = cast(build_wall_index(BOX, 9.0), np.tile(centre, (4, 1)), directions, lengths)
    np.testing.assert_allclose(found, np.linalg.norm(corners, axis=1), atol=1e-6)
    assert (hits >= 0).all()


def test_a_robot_is_seen_at_its_rim_and_not_by_its_own_beams():
    index = build_wall_index(BOX, FRONT.reach)
    poses = np.array([[1.0, 2.0, 0.0], [2.0, 2.0, math.pi / 2]])
    rays = beam_rays(poses, FRONT)
    lengths = rays.offsets + np.tile(FRONT.max_ranges, 2)
    found, hits = index.cast(rays.origins, rays.directions, lengths, rays.owners, poses[:, :2].copy(), FRONT.radius)
    ranges = (found - rays.offsets).reshape(2, 4)
    # Robot 0 looks along x at robot 1, which looks back with its left beam; centres 1 m apart.
    np.testing.assert_array_equal(hits.reshape(2, 4), [[-2, -1, 3, -1], [-1, -2, -1, -1]])
    np.testing.assert_allclose(ranges, [[0.8, 1.5, 0.9, 1.5], [1.5, 0.8, 1.5, 1.5]], atol=1e-12)


def test_a_disc_is_hit_where_geometry_says():
    # A ray that passes the centre at 0.06 m enters a disc of 0.10 m radius 0.08 m before the foot.
    origins, directions = np.array([[1.0, 1.0], [1.0, 1.0]]), unit(np.array([0.0, math.pi]))
    discs = np.array([[9.0, 9.0], [1.7, 1.06]])
    owners = np.zeros(2, dtype=np.int64)
    found, hits = build_wall_index(BOX, REACH).cast(origins, directions, np.full(2, 1.5), owners, discs, 0.1)
    np.testing.assert_allclose(found, [0.62, 1.0], atol=1e-12)
    np.testing.assert_array_equal(hits, [-2, 3])


def test_a_ray_sees_every_disc_but_that_of_its_owner():
    origins, directions = np.array([[1.0, 1.0], [1.0, 1.0]]), unit(np.zeros(2))
    discs = np.array([[1.5, 1.0], [2.0, 1.0]])
    found, hits = build_wall_index(BOX, REACH).cast(origins, directions, np.full(2, 1.5), np.arange(2), discs, 0.1)
    np.testing.assert_allclose(found, [0.9, 0.4], atol=1e-12)
    np.testing.assert_array_equal(hits, [-2, -2])


def test_a_wall_in_front_hides_a_robot():
    edges = np.vstack((BOX, [[2.0, 1.0, 2.0, 3.0]]))
    poses = np.array([[1.5, 2.0, 0.0], [2.5, 2.0, 0.0]])
    rays = beam_rays(poses, FRONT)
    lengths = rays.offsets + np.tile(FRONT.max_ranges, 2)
    index = build_wall_index(edges, FRONT.reach)
    _, hits = index.cast(rays.origins, rays.directions, lengths, rays.owners, poses[:, :2].copy(), 0.1)
    assert hits[0] == 4


@pytest.mark.parametrize("depth", [0.0, 1e-5, 5e-4, 1e-3])
def test_a_robot_pressed_to_a_wall_never_sees_through_it(depth):
    # The rim, where beams start, may lie a little behind the wall; the second wall is what would be seen then.
    edges = np.array([[-9.0, 0.0, 9.0, 0.0], [-9.0, -0.5, 9.0, -0.5]])
    index = build_wall_index(edges, ROBOT.reach)
    poses = np.array([[0.0, ROBOT.radius - depth, heading] for heading in np.linspace(-math.pi, math.pi, 721)])
    rays = beam_rays(poses, ROBOT)
    lengths = rays.offsets + np.tile(ROBOT.max_ranges, len(poses))
    found, hits = cast(index, rays.origins, rays.directions, lengths)
    assert (hits != 1).all()
    steep = rays.directions[:, 1] < -0.2
    assert (hits[steep] == 0).all()
    np.testing.assert_allclose((rays.origins + found[:, None] * rays.directions)[hits == 0, 1], 0.0, atol=1e-12)


def test_ideal_ranges_start_at_the_rim():
    world = World("box", (4.0, 4.0), BOX)
    _, truth = Simulation(world, FRONT).reset(np.random.SeedSequence(0), NoiseConfig(), np.array([1.0, 3.4, 0.0]))
    observations, _ = Simulation(world, FRONT).reset(
        np.random.SeedSequence(0), NoiseConfig(), np.array([1.0, 3.4, 0.0])
    )
    np.testing.assert_allclose(observations[0]["ranges"], [1.5, 0.5, 0.9, 1.5], atol=1e-6)
    np.testing.assert_array_equal(truth.wall_seen, [[-1, 2, 3, -1]])


def readings(std: float, ideal: float, count: int, seed: int = 0, hit: int = 0, **noise: float) -> FloatArray:
    """Many readings of the same scene by a robot of one beam."""
    robot = RobotSpec(beams=beams_on_rim((0.0,), 0.10))
    generator = np.random.default_rng(seed)
    config = NoiseConfig(sensor_noise=std, **noise)
    rows = [noisy_ranges(np.array([ideal]), np.array([hit]), robot, config, generator) for _ in range(count)]
    return np.array(rows)[:, 0]


@pytest.mark.parametrize("std", [0.02, 0.04])
def test_range_noise_has_the_asked_spread_and_no_bias(std):
    count = 20_000
    found = readings(std, 0.8, count)
    # Five standard errors of a mean and of a standard deviation.
    assert abs(found.mean() - 0.8) < 5.0 * std / math.sqrt(count)
    assert abs(found.std() / std - 1.0) < 5.0 / math.sqrt(2.0 * count)


def test_without_noise_a_reading_is_the_distance():
    np.testing.assert_array_equal(readings(0.0, 0.8, 10), 0.8)


def test_a_beam_that_hits_nothing_reads_its_maximum_exactly():
    np.testing.assert_array_equal(readings(0.04, 1.5, 500, hit=-1), 1.5)


def test_noise_levels_share_their_draws():
    low, high = readings(0.02, 0.8, 300), readings(0.04, 0.8, 300)
    np.testing.assert_allclose(2.0 * (low - 0.8), high - 0.8, atol=1e-12)


def test_dropout_does_not_change_the_other_draws():
    # "The same number of draws is made at every noise level": a run with dropout is paired with one without.
    without, dropped = readings(0.02, 0.8, 300), readings(0.02, 0.8, 300, dropout=0.3)
    kept = dropped != 1.5
    assert kept.any()
    np.testing.assert_array_equal(dropped[kept], without[kept])


def test_dropout_reads_the_maximum_at_the_asked_rate():
    count, chance = 20_000, 0.2
    share = (readings(0.0, 0.8, count, dropout=chance) == 1.5).mean()
    assert abs(share - chance) < 5.0 * math.sqrt(chance * (1.0 - chance) / count)
    assert set(readings(0.0, 0.8, 200, dropout=1.0)) == {1.5}


@pytest.mark.parametrize(("ideal", "bound"), [(0.06, 0.05), (1.49, 1.5), (-0.001, 0.05)])
def test_readings_are_clipped_to_what_the_beam_can_report(ideal, bound):
    found = readings(0.04, ideal, 500)
    assert found.min() >= 0.05
    assert found.max() <= 1.5
    assert (found == bound).any()


def test_a_beam_with_a_period_repeats_its_last_reading():
    beams = tuple(
        SensorSpec(0.10 * math.cos(angle), 0.10 * math.sin(angle), angle, period=period)
        for angle, period in ((-math.pi / 2, 1), (-math.pi / 2 + 0.1, 2), (-math.pi / 2 - 0.1, 5))
    )
    robot = RobotSpec(beams=beams)
    edges = np.vstack((BOX, [[1.2, 0.4, 1.6, 0.4], [2.0, 0.4, 2.4, 0.4]]))
    simulation = Simulation(World("box", (4.0, 4.0), edges), robot)
    noise, seeds = NoiseConfig(sensor_noise=0.02), np.random.SeedSequence(3)
    observations, truth = simulation.reset(seeds, noise, np.array([0.8, 1.0, 0.0]))
    ranges, seen = [observations[0]["ranges"]], [truth.wall_seen[0]]
    for _ in range(40):
        observations, truth = simulation.step(np.ones((1, 2)))
        ranges.append(observations[0]["ranges"])
        seen.append(truth.wall_seen[0])
    ranges, seen = np.array(ranges), np.array(seen)
    for beam, period in enumerate((1, 2, 5)):
        for step in range(1, 41):
            repeats = step % period != 0
            assert (ranges[step, beam] == ranges[step - 1, beam]) == repeats
            assert not repeats or seen[step, beam] == seen[step - 1, beam]
        assert len(set(seen[:, beam].tolist())) > 1, "the walls seen change on the way"


def reports(travel: FloatArray, noise: NoiseConfig, seed: int = 0, limit: float = 0.06) -> FloatArray:
    """What the encoders say to a list of wheel travels (n, 2)."""
    generator, remainder, rows = np.random.default_rng(seed), np.zeros(2), []
    for row in travel:
        reported, remainder = reported_travel(row, remainder, noise, limit, generator)
        rows.append(reported)
    return np.array(rows)


@pytest.mark.parametrize("travel", [0.002, 0.01, 0.03, -0.02])
def test_wheel_variance_is_proportional_to_travel(travel):
    count, per_metre = 20_000, 2e-5
    errors = reports(np.full((count, 2), travel), NoiseConfig(wheel_variance=per_metre), limit=1.0) - travel
    # The noise of one report must not be taken back by the next.
    variance = errors.var(axis=0) / (per_metre * abs(travel))
    np.testing.assert_allclose(variance, 1.0, atol=5.0 * math.sqrt(2.0 / count))
    assert np.abs(errors.mean(axis=0)).max() < 5.0 * math.sqrt(per_metre * abs(travel) / count)
    assert abs(np.corrcoef(errors.T)[0, 1]) < 5.0 / math.sqrt(count), "the wheels err apart"
    assert abs(np.corrcoef(errors[:-1, 0], errors[1:, 0])[0, 1]) < 5.0 / math.sqrt(count)


def test_standing_wheels_report_nothing():
    np.testing.assert_array_equal(reports(np.zeros((50, 2)), NoiseConfig(wheel_variance=1e-3)), 0.0)


@pytest.mark.parametrize("resolution", [0.001, 0.0037, 0.02])
def test_an_encoder_with_coarse_steps_loses_nothing_over_time(resolution):
    travel = np.random.default_rng(1).uniform(-0.03, 0.03, (2000, 2)) + 0.004
    found = reports(travel, NoiseConfig(wheel_variance=0.0, encoder_resolution=resolution))
    assert np.abs(np.cumsum(found - travel, axis=0)).max() <= resolution * (1.0 + 1e-9)
    ticks = found / resolution
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-6)


def test_unequal_wheels_report_too_much_and_too_little():
    found = reports(np.full((5, 2), 0.02), NoiseConfig(wheel_variance=0.0, wheel_mismatch=0.05))
    np.testing.assert_allclose(found, np.tile([0.021, 0.019], (5, 1)), atol=1e-12)


def test_a_report_is_clipped_to_the_limit():
    found = reports(np.array([[0.1, -0.1], [0.01, 0.06]]), NoiseConfig(wheel_variance=0.0), limit=0.06)
    np.testing.assert_allclose(found, [[0.06, -0.06], [0.01, 0.06]], atol=1e-12)


def test_even_wild_wheel_noise_stays_within_the_limit():
    found = reports(np.full((500, 2), 0.03), NoiseConfig(wheel_variance=1.0))
    assert np.abs(found).max() == 0.06


def test_the_encoders_draw_alike_whatever_the_noise():
    after = []
    for noise in (NoiseConfig(wheel_variance=0.0), NoiseConfig(wheel_variance=1e-3, encoder_resolution=0.01)):
        generator = np.random.default_rng(4)
        reported_travel(np.zeros(2), np.zeros(2), noise, 0.06, generator)
        after.append(generator.random())
    assert after[0] == after[1]


def test_in_contact_the_encoders_go_on_reporting_the_wheels():
    simulation = Simulation(World("box", (4.0, 4.0), BOX), replace(ROBOT))
    simulation.reset(np.random.SeedSequence(0), NoiseConfig(wheel_variance=0.0), np.array([3.85, 2.0, 0.0]))
    for _ in range(10):
        observations, truth = simulation.step(np.ones((1, 2)))
    assert truth.contact[0]
    np.testing.assert_allclose(observations[0]["wheels"], 0.03, atol=1e-7)
    assert truth.poses[0, 0] == pytest.approx(3.9, abs=1e-3)
