"""Random floor plans: closed, all of one piece, as the settings say, and the same everywhere."""

import math
from dataclasses import replace

import numpy as np
import pytest

from limslam_env import FloorPlanConfig, World
from limslam_env.geometry import FloatArray, segment
from limslam_env.worlds.generation.floor_plans import SPARE, floor_plan
from limslam_env.worlds.generation.room_layout import (
    Measures,
    layout,
)

RADIUS = 0.10
DEFAULT = FloorPlanConfig()
TINY = FloorPlanConfig(width=3.0, height=3.0)
FULL = FloorPlanConfig(loops=1.0, slanted=1.0, obstacles=20.0, corridor=1.0)
# Every setting at its ends, and the settings that press hardest on one another. (config, radius,
# seeds)
EXTREMES = {
    "default": (DEFAULT, RADIUS, 60),
    "a tree": (FloorPlanConfig(loops=0.0, slanted=0.0, obstacles=0.0, corridor=0.0), RADIUS, 20),
    "everything": (FULL, RADIUS, 20),
    "tiny": (TINY, RADIUS, 20),
    "tiny and full": (replace(FULL, width=3.0, height=3.0), RADIUS, 20),
    "tiny robot": (FULL, 0.035, 20),
    "large robot": (FULL, 0.20, 20),
    "narrowest doors": (replace(FULL, door_width=0.3, corridor_width=0.3), RADIUS, 20),
    "smallest rooms": (
        replace(FULL, width=4.0, height=4.0, min_room=0.7, door_width=0.4),
        RADIUS,
        20,
    ),
    "long": (replace(FULL, width=12.0, height=3.0), RADIUS, 20),
    "large things": (
        replace(FULL, obstacle_size=(0.2, 6.0), min_room=4.0, width=12.0, height=12.0),
        RADIUS,
        20,
    ),
    "huge": (FloorPlanConfig(width=40.0, height=40.0), RADIUS, 1),
}


def plan(seed: int, config: FloorPlanConfig = DEFAULT, radius: float = RADIUS) -> World:
    return floor_plan(config, np.random.default_rng(seed), radius)


def region_sizes(world: World, radius: float) -> FloatArray:
    """Cells of each region that a disc cannot leave the world from, largest first."""
    labels = world.free_space(radius).labels
    sizes = np.bincount(labels.ravel())
    border = np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1]))
    sizes[[0, *np.unique(border)]] = 0
    return np.sort(sizes[sizes > 0])[::-1]


def room_count(world: World, radius: float) -> int:
    """How many regions there are when all doors are walled up."""
    return len(region_sizes(replace(world, walls=np.vstack((world.walls, world.doors))), radius))


def is_slanted(segments: FloatArray) -> np.ndarray:
    return (np.abs(segments[:, 2:] - segments[:, :2]) > 0.0).all(axis=1)


def apart(first: FloatArray, second: FloatArray) -> float:
    """Least distance (m) of two sets of segments that do not cross."""
    ends = (
        segment.distances(first.reshape(-1, 2), second).min(),
        segment.distances(second.reshape(-1, 2), first).min(),
    )
    return float(min(ends))


@pytest.mark.parametrize("name", EXTREMES)
def test_the_building_is_closed_and_a_robot_gets_everywhere(name):
    config, radius, seeds = EXTREMES[name]
    for seed in range(seeds):
        world = plan(seed, config, radius)
        world.check(radius)
        sizes = region_sizes(world, radius)
        assert sizes[0] / sizes.sum() > 0.999, seed


@pytest.mark.parametrize("name", EXTREMES)
def test_doors_are_truly_open_and_of_the_asked_width(name):
    config, radius, seeds = EXTREMES[name]
    narrowest, widest = np.broadcast_to(config.door_width, 2)
    for seed in range(min(seeds, 20)):
        world = plan(seed, config, radius)
        assert (
            (segment.lengths(world.doors) >= narrowest - 1e-9)
            & (segment.lengths(world.doors) <= widest + 1e-9)
        ).all()
        assert not is_slanted(world.doors).any()
        for door in world.doors:
            points, _ = segment.sample(door[None], 0.02)
            to_jambs = np.linalg.norm(points[:, None] - door.reshape(2, 2), axis=-1).min(axis=1)
            nearest = segment.distances(points, world.edges).min(axis=1)
            # Nothing but the jambs is near, and both are there: the ends of two walls on the door's
            # line.
            np.testing.assert_allclose(nearest, np.minimum(to_jambs, nearest.max()), atol=1e-9)
            assert nearest[0] < 1e-9
            assert nearest[-1] < 1e-9


@pytest.mark.parametrize("seed", range(6))
def test_without_loops_the_doors_are_a_tree(seed):
    world = plan(seed, FloorPlanConfig(loops=0.0))
    assert len(world.doors) == room_count(world, RADIUS) - 1 > 0


def measures(corridor: float) -> Measures:
    return Measures(1800, (1000, 1400), corridor, 450, 0.0, 0.0, (300, 1000))


def test_corridors_are_there_as_often_as_asked():
    def share(corridor: float) -> float:
        plans = (
            layout((9000, 8000), measures(corridor), np.random.default_rng(seed))[0]
            for seed in range(100)
        )
        return sum(any(room.is_corridor for room in rooms) for rooms in plans) / 100

    assert share(0.0) == 0.0
    assert share(1.0) == 1.0
    assert 0.35 < share(0.5) < 0.65


def test_without_slants_walls_are_parallel_to_the_axes():
    for seed in range(40):
        assert not is_slanted(plan(seed, FloorPlanConfig(slanted=0.0)).walls).any()


def test_without_obstacles_there_are_none():
    assert not any(plan(seed, FloorPlanConfig(obstacles=0.0)).obstacles for seed in range(40))


def test_obstacles_are_as_many_as_asked_where_there_is_space():
    config = FloorPlanConfig(
        width=20.0, height=20.0, min_room=9.0, corridor=0.0, slanted=0.0, obstacles=1.5
    )
    counts = [len(plan(seed, config).obstacles) for seed in range(30)]
    assert np.mean(counts) == pytest.approx(1.5 * 400.0 / 10.0, rel=0.05)


def test_obstacles_are_convex_of_three_to_eight_corners_and_of_the_asked_size():
    low = 0.4
    high = 0.8
    polygons = [
        polygon
        for seed in range(30)
        for polygon in plan(
            seed, FloorPlanConfig(obstacles=4.0, obstacle_size=(low, high))
        ).obstacles
    ]
    assert {len(polygon) for polygon in polygons} == set(range(3, 9))
    for polygon in polygons:
        spans = np.roll(polygon, -1, axis=0) - polygon
        turns = (
            spans[:, 0] * np.roll(spans, -1, axis=0)[:, 1]
            - spans[:, 1] * np.roll(spans, -1, axis=0)[:, 0]
        )
        assert (turns > 0.0).all(), "convex, counter-clockwise"
        across = np.linalg.norm(polygon[:, None] - polygon[None], axis=-1).max()
        assert 0.6 * low <= across <= high


@pytest.mark.parametrize(("radius", "size"), [(0.035, (0.2, 4.0)), (0.2, (0.2, 1.0))])
def test_obstacles_keep_their_distance_from_all_but_one_wall(radius, size):
    clearance = 2.0 * radius + SPARE - 1e-9
    at_walls = 0
    for seed in range(10):
        world = plan(
            seed, replace(FULL, width=7.0, height=6.0, min_room=6.0, obstacle_size=size), radius
        )
        for number, polygon in enumerate(world.obstacles):
            edges = segment.polygon_edges(polygon)
            to_walls = np.array([apart(edges, wall[None]) for wall in world.walls])
            at_walls += (to_walls < 1e-9).sum()
            assert (to_walls < 1e-9).sum() <= 1
            assert (to_walls[to_walls > 1e-9] >= clearance).all()
            for other in world.obstacles[:number]:
                assert apart(edges, segment.polygon_edges(other)) >= clearance
                assert not segment.inside_polygon(other.mean(axis=0)[None], polygon)[0]
                assert not segment.inside_polygon(polygon.mean(axis=0)[None], other)[0]
    assert at_walls > 0


def test_coordinates_are_whole_millimetres_within_the_size():
    for seed in range(20):
        world = plan(seed, FULL)
        numbers = np.concatenate((world.edges.ravel(), world.doors.ravel(), world.size))
        np.testing.assert_array_equal(numbers, np.round(numbers, 3))
        corners = world.edges.reshape(-1, 2)
        np.testing.assert_array_equal(corners.min(axis=0), 0.0)
        np.testing.assert_array_equal(corners.max(axis=0), world.size)
        assert len(world.starts) == len(world.loop) == 0


def test_sizes_are_drawn_from_their_ranges():
    sizes = np.array(
        [plan(seed, FloorPlanConfig(width=(4.0, 5.0), height=[7, 9])).size for seed in range(60)]
    )
    assert (sizes.min(axis=0) >= [4.0, 7.0]).all()
    assert (sizes.max(axis=0) <= [5.0, 9.0]).all()
    assert (np.ptp(sizes, axis=0) > [0.8, 1.6]).all()


def test_a_plan_of_old_is_still_the_same():
    # Runs are compared by seed: whoever changes this changes everybody's benchmark.
    world = plan(0)
    assert world.size == (9.403, 8.548)
    np.testing.assert_array_equal(
        world.walls[:2], [[0.0, 0.0, 8.644, 0.0], [8.644, 0.0, 9.403, 0.7]]
    )
    np.testing.assert_array_equal(
        world.doors[:2], [[6.239, 7.024, 6.239, 7.893], [2.159, 2.81, 2.989, 2.81]]
    )
    np.testing.assert_array_equal(
        world.obstacles[0][:3], [[0.971, 1.314], [0.858, 1.305], [0.775, 1.228]]
    )
    assert world.name == "random-bcefe473"


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"width": 0.0}, "width must be a length"),
        ({"height": (8.0, 6.0)}, "height must be a length"),
        ({"height": (1.0, 9.0)}, "height .* is less than min_room"),
        ({"min_room": 1.2}, "min_room must be 1.3 m or more, not 1.2"),
        ({"corridor": 1.5}, "corridor must be a number from 0 to 1"),
        ({"door_width": (0.0, 1.0)}, "door_width must be a length"),
        ({"door_width": (0.6, 2.0)}, "min_room must be 2.3 m or more"),
        ({"loops": -0.1}, "loops must be a number from 0 to 1"),
        ({"obstacles": -1.0}, r"obstacles per 10 m\^2 must be a number from 0 to 20"),
        ({"obstacle_size": (0.1, 0.5)}, r"obstacle_size must be 0.2 m or more"),
    ],
)
def test_settings_that_cannot_be_are_refused_in_one_line(settings, reason):
    with pytest.raises(ValueError, match=f"^{reason}[^\n]*$"):
        FloorPlanConfig(**settings)


@pytest.mark.parametrize(
    ("settings", "radius", "reason"),
    [
        ({}, 0.3, "door_width 0.6 m is too narrow for a robot of 0.3 m radius, which needs 0.7 m"),
        (
            {"door_width": 1.0, "corridor_width": (0.5, 2.0)},
            0.25,
            "corridor_width 0.5 m is too narrow",
        ),
        ({}, math.nan, "a robot's radius must be a positive length"),
    ],
)
def test_a_robot_that_does_not_fit_is_refused_with_the_reason(settings, radius, reason):
    with pytest.raises(ValueError, match=f"^{reason}[^\n]*$"):
        plan(0, FloorPlanConfig(**settings), radius)
