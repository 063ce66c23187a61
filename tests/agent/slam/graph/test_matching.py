"""Matching of local maps: against a plain search, and matches that must be found."""

import numpy as np
import pytest

from limslam_agent.config.graph import LocalMapConfig
from limslam_agent.slam.graph import matching
from limslam_agent.slam.graph.local_maps import HIT, LocalMap, draw_grid, thinned
from limslam_agent.slam.graph.matching import NO_MATCH, Window, match, match_covariance, search_grid
from limslam_env.geometry import se2

MAPS = LocalMapConfig()


def corner(generator, count=60):
    """Points on two walls at a right angle, seen from the origin."""
    along = generator.uniform(-3.0, 3.0, count)
    aside = generator.uniform(-1.0, 2.0, count // 2)
    return np.vstack(
        (np.column_stack((along, np.full(count, 2.0))), np.column_stack((np.full(len(aside), 3.0), aside)))
    )


def chunk_of(places):
    origins = np.zeros_like(places)
    grid = draw_grid(places, origins, 4.5, MAPS)
    return LocalMap(0.0, thinned(places, MAPS.cell), grid, MAPS.cell)


def score_at(chunk, points, pose):
    """The mean of the cells at points, as shares of a hit; cells outside of the grid are unknown."""
    cells = np.floor((se2.transform_points(pose, points) - chunk.low) / chunk.cell).astype(int)
    inside = ((cells >= 0) & (cells < len(chunk.grid))).all(axis=1)
    return chunk.grid[tuple(cells[inside].T)].sum() / HIT / len(points)


@pytest.mark.parametrize("seed", range(3))
def test_the_best_pose_of_a_window_is_found(seed):
    generator = np.random.default_rng(seed)
    chunk = chunk_of(corner(generator))
    points = thinned(se2.transform_points(generator.normal(0.0, 0.3, 3), corner(generator, 30)), MAPS.cell)
    window, guess = Window(1.3, np.radians(20.0), np.radians(5.0)), generator.normal(0.0, 0.2, 3)
    found = match(search_grid(chunk.grid, MAPS.cell, window.shift), points, guess, window, -1.0)
    best = NO_MATCH
    for turn, x, y in np.ndindex(9, 27, 27):
        pose = guess + np.array([(x - 13) * 0.1, (y - 13) * 0.1, np.radians(5.0 * (turn - 4))])
        penalty = 0.05 * (((x - 13) ** 2 + (y - 13) ** 2) / 170.0 + (turn - 4) ** 2 / 17.0)
        best = max(best, score_at(chunk, points, pose) - penalty)
    assert found.score == pytest.approx(best, abs=1e-6)
    assert score_at(chunk, points, found.pose) >= best


def test_points_beyond_the_grid_are_found():
    generator = np.random.default_rng(5)
    chunk = chunk_of(corner(generator))
    points = chunk.points + np.array([9.0, -9.0])
    grid = search_grid(chunk.grid, MAPS.cell, 10.0)
    found = match(grid, points, np.zeros(3), Window(10.0, 0.2, 0.1), 0.5)
    assert found.pose[:2] == pytest.approx([-9.0, 9.0], abs=0.11)


def test_nothing_is_found_where_nothing_fits():
    generator = np.random.default_rng(8)
    chunk = chunk_of(corner(generator))
    points = generator.uniform(-3.0, 3.0, (80, 2))
    grid = search_grid(chunk.grid, MAPS.cell, 2.0)
    assert match(grid, points, np.zeros(3), Window(2.0, 0.3, 0.1), 0.9).score == NO_MATCH
    assert match(grid, points[:0], np.zeros(3), Window(2.0, 0.3, 0.1), 0.0).score == NO_MATCH


def corridor(*ends):
    """A corridor of 8 m with end walls at these x, seen from its axis."""
    along = np.linspace(-4.0, 4.0, 160)
    walls = [np.column_stack((along, np.full(160, y))) for y in (-1.0, 1.0)]
    return np.vstack((*walls, *[np.column_stack((np.full(40, x), np.linspace(-1.0, 1.0, 40))) for x in ends]))


@pytest.mark.parametrize(("ends", "std"), [((), (5.0, 20.0)), ((4.0,), (0.05, 0.3)), ((-4.0,), (0.05, 0.3))])
def test_a_match_is_known_along_a_corridor_only_by_what_stands_out_there(ends, std):
    places = corridor(*ends)
    origins = np.column_stack((0.9 * places[:, 0], np.zeros(len(places))))
    grid = draw_grid(places, origins, 4.5, MAPS)
    chunk = LocalMap(0.0, thinned(places, MAPS.cell), grid, MAPS.cell)
    search, guess = search_grid(chunk.grid, MAPS.cell, 4.0), np.array([0.0, 0.0, 0.3])
    points = se2.transform_points(se2.inverse(guess), chunk.points)
    turned = se2.transform_points(se2.inverse(guess), places), se2.transform_points(se2.inverse(guess), origins)
    back = search_grid(draw_grid(*turned, 4.5, MAPS), MAPS.cell, 4.0)
    _, covariance = match_covariance(search, points, guess, np.radians(3.0), (back, chunk.points))
    assert std[0] < np.sqrt(covariance[0, 0]) < std[1]
    assert np.sqrt(covariance[1, 1]) < 0.2


def test_too_few_points_to_tell_places_apart_are_not_matched():
    chunk = chunk_of(corner(np.random.default_rng(3)))
    grid, window = search_grid(chunk.grid, MAPS.cell, 0.6), Window(0.6, 0.2, 0.1)
    enough = chunk.points[: matching.LEAST_POINTS]
    assert match(grid, enough, np.zeros(3), window, 0.6).score > 0.9
    assert match(grid, enough[1:], np.zeros(3), window, 0.6).score == NO_MATCH
