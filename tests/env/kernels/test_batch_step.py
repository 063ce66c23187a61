"""Kernels of the batch: random numbers, tiles and contact; the arrays that they work on."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from limslam_env import NoiseConfig, RobotSpec, load_world
from limslam_env.batch.batch import noise_settings
from limslam_env.batch.worlds import from_tiles, to_tiles
from limslam_env.compilation import compiled
from limslam_env.kernels.batch_rays import cast_fan, find_unseen
from limslam_env.kernels.coverage import (
    CellGrid,
    TileGrid,
    mark_disc,
    mark_ray,
    walk_disc,
    walk_ray,
)
from limslam_env.kernels.random_numbers import derive_keys, draw_rows, mixed, normal
from limslam_env.kernels.rays import Ray, meeting
from limslam_env.simulation.sensors import build_wall_index, walls_around
from limslam_env.simulation.sensors import cast as cast_rays

CELL = 0.1
AREA = np.array([-0.3, 0.2, CELL])


@compiled
def normals(key: np.uint64, numbers: np.ndarray) -> None:
    for place in range(len(numbers)):
        numbers[place] = normal(mixed(key + np.uint64(place + 1) * np.uint64(0x9E3779B97F4A7C15)))


@compiled
def marked(seen, x, y, dx, dy, reach, radius):
    grid = CellGrid(seen, np.ones_like(seen), AREA)
    return mark_ray(grid, Ray(x, y, dx, dy, reach)) + mark_disc(grid, x, y, radius)


@compiled
def taken(left, tile_columns, tile_rows, x, y, dx, dy, reach, radius):
    grid = TileGrid(left, 0, tile_columns, tile_rows, AREA[0], AREA[1], CELL)
    return walk_ray(grid, Ray(x, y, dx, dy, reach)) + walk_disc(grid, x, y, radius)


@compiled
def cast(aims, edges, rays):
    starts = np.array([0, len(edges)])
    numbers = np.arange(len(edges)).astype(np.uint16)
    cast_fan(0, 0, aims, edges, starts, numbers, rays)


@compiled
def met(aims, edges, rays):
    for lane in range(rays.shape[1]):
        for edge in range(len(edges)):
            x = edges[edge, 0]
            y = edges[edge, 1]
            distance, is_met = meeting(
                x - aims[0, lane],
                y - aims[1, lane],
                edges[edge, 2] - x,
                edges[edge, 3] - y,
                aims[2, lane],
                aims[3, lane],
            )
            if is_met and distance < rays[0, lane]:
                rays[0, lane] = distance
                rays[1, lane] = edge


@compiled
def found(left, tile_columns, tile_rows, aims, rays):
    grid = TileGrid(left, 0, tile_columns, tile_rows, AREA[0], AREA[1], CELL)
    return find_unseen(grid, aims, rays)


def padded(tiles: np.ndarray) -> np.ndarray:
    """Tiles as the batch holds them: with words behind them that may be looked at."""
    memory = np.zeros(tiles.size + 3 * tiles.shape[1] + 3, dtype=np.uint64)
    memory[: tiles.size] = tiles.ravel()
    return memory[: tiles.size].reshape(1, -1)


def test_normal_numbers_are_normal():
    numbers = np.empty(1_000_000)
    normals(np.uint64(7), numbers)
    assert stats.kstest(numbers, "norm").pvalue > 0.001
    # The tail is made in another way than the rest, and so are the edges of layers.
    for limit in (2.5, 3.4426, 4.0):
        expected = 2.0 * stats.norm.sf(limit) * len(numbers)
        assert abs((np.abs(numbers) > limit).sum() - expected) < 5.0 * np.sqrt(expected)


def test_uniform_numbers_are_uniform_and_of_their_key():
    keys = derive_keys(np.arange(100, dtype=np.uint64), np.ones(100, dtype=np.int64), 1)
    numbers = np.empty((100, 100))
    again = np.empty((1, 100))
    bounds = np.zeros(100), np.ones(100), np.arange(100)
    draw_rows(keys, *bounds, numbers)
    draw_rows(keys[41:42], *bounds, again)
    np.testing.assert_array_equal(numbers[41], again[0])
    assert len(np.unique(numbers)) == numbers.size
    assert stats.kstest(numbers.ravel(), "uniform").pvalue > 0.001
    assert abs(np.corrcoef(numbers[:50].ravel(), numbers[50:].ravel())[0, 1]) < 0.05


@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_tiles_hold_every_cell(rows, columns, seed):
    cells = np.random.default_rng(seed).random((rows, columns)) < 0.5
    np.testing.assert_array_equal(from_tiles(to_tiles(cells), cells.shape), cells)


@pytest.mark.parametrize(("share", "reach"), [(0.02, 6.0), (1.0, 1.6)])
def test_what_is_taken_is_what_the_single_environment_marks(share, reach):
    generator = np.random.default_rng(3)
    shape = (75, 61)
    extent = np.array([61.0, 75.0]) * CELL
    for _ in range(300):
        coverable = generator.random(shape) < share
        seen = ~coverable
        tiles = to_tiles(coverable)
        x, y = AREA[:2] + generator.uniform(0.0, 1.0, 2) * extent
        angle = generator.uniform(-np.pi, np.pi)
        length = generator.uniform(0.0, reach)
        # Rays stay within the walls, which the grid holds; some run along an axis.
        angle = generator.choice([angle, 0.0, np.pi / 2])
        dx = np.cos(angle)
        dy = np.sin(angle)
        left = padded(tiles)
        new = taken(left, tiles.shape[1], tiles.shape[0], x, y, dx, dy, length, 0.1)
        assert new == marked(seen, x, y, dx, dy, length, 0.1)
        np.testing.assert_array_equal(from_tiles(left.reshape(tiles.shape), shape), ~seen)


@pytest.mark.parametrize("count", [1, 4, 5])
def test_rays_side_by_side_meet_the_walls_that_single_rays_meet(count):
    generator = np.random.default_rng(1)
    lanes = 8
    for _ in range(300):
        edges = np.round(generator.uniform(0.0, 2.0, (count, 4)), 1)
        edges = edges[(edges[:, :2] != edges[:, 2:]).any(axis=1)]
        if not len(edges):
            continue
        # Rays to the ends of walls, and past them by as much as counts as a hit, or a little more;
        # some along a wall.
        origins = generator.uniform(0.0, 2.0, (lanes, 2))
        ends = edges.reshape(-1, 2)
        origins[0] = edges[0, :2]
        aside = generator.choice(
            [0.0, 1e-16, 9e-10, 1.1e-9, 5e-9, 2e-8, 0.3], lanes
        ) * generator.choice([-1.0, 1.0], lanes)
        ways = ends[generator.integers(0, len(ends), lanes)] - origins
        angles = np.arctan2(ways[:, 1], ways[:, 0]) + aside
        angles[1] = 0.0
        aims = np.stack((*origins.T, np.cos(angles), np.sin(angles)))
        rays = np.zeros((4, lanes))
        single = np.zeros((2, lanes))
        rays[0] = single[0] = 1.6
        rays[1] = single[1] = -1.0
        cast(aims, edges, rays)
        met(aims, edges, single)
        np.testing.assert_array_equal(rays[:2], single)


@pytest.mark.parametrize("share", [0.002, 0.02])
def test_a_look_finds_unseen_cells_wherever_a_ray_takes_one(share):
    generator = np.random.default_rng(4)
    shape = (75, 61)
    lanes = 8
    for _ in range(200):
        tiles = to_tiles(generator.random(shape) < share)
        aims = np.zeros((4, lanes))
        rays = np.zeros((4, lanes))
        # From anywhere and from corners of cells, along an axis or not.
        places = generator.uniform(20.0, 40.0, (2, lanes))
        places[:, ::2] = np.round(places[:, ::2])
        angles = generator.uniform(-np.pi, np.pi, lanes)
        angles[::3] = generator.choice([0.0, np.pi / 2, np.pi], len(angles[::3]))
        aims[:2], aims[2:] = AREA[:2, None] + CELL * places, (np.cos(angles), np.sin(angles))
        rays[0] = np.round(generator.uniform(0.0, 1.6, lanes), 1)
        bits = found(padded(tiles), tiles.shape[1], tiles.shape[0], aims, rays)
        for lane in range(lanes):
            new = taken(
                padded(tiles), tiles.shape[1], tiles.shape[0], *aims[:, lane], rays[0, lane], 0.0
            )
            assert new == 0 or int(bits) >> lane & 1


def test_walls_around_a_cell_are_all_that_a_beam_can_meet_from_it():
    world = load_world("env3")
    reach = RobotSpec().reach
    index = build_wall_index(world.edges)
    starts, numbers = walls_around(index, reach)
    generator = np.random.default_rng(0)
    origins = generator.uniform(0.0, world.size, (2000, 2))
    angles = generator.uniform(-np.pi, np.pi, 2000)
    _, hits = cast_rays(
        index, origins, np.column_stack((np.cos(angles), np.sin(angles))), np.full(2000, reach)
    )
    column, row = ((origins - (index.low_x, index.low_y)) / index.side).astype(int).T
    cells = row * index.columns + column
    for cell, hit in zip(cells, hits, strict=True):
        assert hit < 0 or hit in numbers[starts[cell] : starts[cell + 1]]


def test_ranges_of_noise_are_drawn_from_evenly_and_for_each():
    keys = derive_keys(np.arange(2000, dtype=np.uint64), np.zeros(2000, dtype=np.int64), 1)
    noise = NoiseConfig(sensor_noise=(0.01, 0.03), wheel_mismatch=(-0.1, 0.1))
    table = np.empty((2000, 14))
    draw_rows(keys, *noise_settings(noise, RobotSpec()), table)
    assert stats.kstest(table[:, 0], stats.uniform(0.01, 0.02).cdf).pvalue > 0.001
    np.testing.assert_allclose(table[:, 6] + table[:, 7], 2.0)
    assert abs(np.corrcoef(table[:, 0], table[:, 6])[0, 1]) < 0.1
