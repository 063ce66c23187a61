"""The paper's three environments have what the paper says of them. Env1's four-fold symmetry is in test_world.py."""

import math

import numpy as np
import pytest

from limslam_env.geometry import FloatArray
from limslam_env.geometry.segment import distances, inside_polygon, lengths, polygon_edges, sample
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.world import World

PAPER = {"env1": (7.0, 7.0), "env2": (9.0, 5.3), "env3": (7.0, 5.5)}
RADIUS = 0.10
NARROW = (0.60, 0.70)
CLEARLY_WIDER = 0.90
LOOP_CLEARANCE = 0.35
NARROWEST_PASSAGE = 0.60


@pytest.fixture(params=PAPER)
def world(request) -> World:
    return load_world(request.param)


def interior_regions(world: World, radius: float) -> list[int]:
    """Cells of each region that a disc of a radius (m) cannot leave the world from."""
    space = world.free_space(radius)
    sizes = np.bincount(space.labels.ravel())
    border = np.concatenate((space.labels[0], space.labels[-1], space.labels[:, 0], space.labels[:, -1]))
    sizes[[0, *np.unique(border)]] = 0
    return [int(size) for size in sizes if size]


def collinear_gaps(walls: FloatArray) -> set[tuple[float, float, float, float]]:
    """Openings (x1, y1, x2, y2) between neighbouring axis-parallel walls on one line, lower end first."""
    gaps = set()
    for axis in (0, 1):
        across = 1 - axis
        for at in np.unique(walls[walls[:, across] == walls[:, across + 2], across]):
            on_line = walls[(walls[:, across] == at) & (walls[:, across + 2] == at)][:, [axis, axis + 2]]
            pieces = np.sort(on_line, axis=1)[np.argsort(on_line.min(axis=1))]
            for end, start in zip(pieces[:-1, 1], pieces[1:, 0], strict=True):
                if start > end:
                    gaps.add((end, at, start, at) if axis == 0 else (at, end, at, start))
    return gaps


def turns(world: World) -> FloatArray:
    """Angles (rad, 0 to pi) between walls where exactly two of them meet end to end."""
    ends = np.vstack((world.walls[:, :2], world.walls[:, 2:]))
    away = np.vstack((world.walls[:, 2:], world.walls[:, :2])) - ends
    found = []
    for corner in np.unique(ends, axis=0):
        meeting = away[(ends == corner).all(axis=1)]
        if len(meeting) == 2:
            cosine = meeting[0] @ meeting[1] / np.prod(np.linalg.norm(meeting, axis=1))
            found.append(math.acos(np.clip(cosine, -1.0, 1.0)))
    return np.array(found)


def test_it_has_the_paper_s_size(world):
    assert world.size == PAPER[world.name]


def test_two_starts_are_far_apart_and_face_different_ways(world):
    first, second = world.starts
    assert np.hypot(*(first - second)[:2]) > 0.5 * max(world.size)
    assert math.cos(first[2] - second[2]) < 0.5


def test_every_place_can_be_reached(world):
    assert len(interior_regions(world, RADIUS)) == 1


def test_passages_are_wide_enough_to_pass_with_ease(world):
    # A larger disc still gets everywhere, so nothing hangs on a robot's last centimetre.
    assert len(interior_regions(world, 0.5 * NARROWEST_PASSAGE - 0.01)) == 1


def test_the_loop_is_a_closed_tour_with_clearance_round_something(world):
    tour, _ = sample(polygon_edges(world.loop), 0.01)
    assert distances(tour, world.edges).min() >= LOOP_CLEARANCE
    middles = 0.5 * (world.edges[:, :2] + world.edges[:, 2:])
    assert inside_polygon(middles, world.loop).sum() >= 4


def test_doors_are_open_and_lie_between_wall_ends_on_one_line(world):
    assert {tuple(door) for door in world.doors.tolist()} <= collinear_gaps(world.walls)
    for door in world.doors:
        points, _ = sample(door[None], 0.01)
        to_jambs = np.minimum(*(np.linalg.norm(points - end, axis=1) for end in (door[:2], door[2:])))
        np.testing.assert_allclose(distances(points, world.edges).min(axis=1), to_jambs, atol=1e-9)


def test_every_gap_between_env2_s_walls_is_a_door():
    world = load_world("env2")
    assert {tuple(door) for door in world.doors.tolist()} == collinear_gaps(world.walls)


def test_env2_has_perpendicular_walls_and_nothing_else():
    world = load_world("env2")
    spans = np.abs(world.walls[:, 2:] - world.walls[:, :2])
    assert (spans.min(axis=1) == 0.0).all()
    assert (spans > 0.0).any(axis=0).all(), "walls run both ways"
    assert not world.obstacles


def test_env2_has_lines_of_several_walls_with_gaps_between_them():
    doors = load_world("env2").doors
    _, gaps = np.unique(doors[doors[:, 1] == doors[:, 3], 1], return_counts=True)
    assert (gaps >= 2).sum() >= 2, "three pieces or more, on two lines at least"


def test_env2_has_one_narrow_door_and_it_comes_first():
    widths = lengths(load_world("env2").doors)
    assert NARROW[0] <= widths[0] <= NARROW[1]
    assert (widths[1:] >= CLEARLY_WIDER).all()


def test_env2_cannot_be_seen_from_one_place():
    # From each start most walls are further away than a beam reaches, or behind another wall.
    world = load_world("env2")
    for start in world.starts:
        assert (distances(start[None, :2], world.walls)[0] > 1.5).mean() > 0.5


def test_env3_has_square_and_slanted_corners():
    corners = turns(load_world("env3"))
    is_square = np.abs(corners - 0.5 * math.pi) < 1e-9
    assert is_square.sum() >= 3
    assert (~is_square).sum() >= 3


def test_env3_has_slanted_walls_of_different_slants():
    walls = load_world("env3").walls
    slants = np.arctan2(walls[:, 3] - walls[:, 1], walls[:, 2] - walls[:, 0]) % math.pi
    off_axis = np.abs((slants + 0.25 * math.pi) % (0.5 * math.pi) - 0.25 * math.pi)
    slanted = slants[off_axis > math.radians(10.0)]
    assert len(slanted) >= 3
    assert len(np.unique(slanted.round(2))) >= 3


def test_env3_has_rectangular_and_rounded_obstacles():
    world = load_world("env3")
    rounded = [polygon for polygon in world.obstacles if 6 <= len(polygon) <= 10]
    rectangles = [polygon for polygon in world.obstacles if len(polygon) == 4]
    assert len(rounded) >= 2
    assert len(rectangles) >= 2
    assert len(rounded) + len(rectangles) == len(world.obstacles)
    for polygon in rectangles:
        assert len(np.unique(polygon[:, 0])) == len(np.unique(polygon[:, 1])) == 2
    for polygon in rounded:
        # No edge is long, no corner is sharp: a blob in few strokes.
        edges = polygon_edges(polygon)
        directions = np.arctan2(edges[:, 3] - edges[:, 1], edges[:, 2] - edges[:, 0])
        bends = (np.diff(directions, append=directions[:1]) + math.pi) % (2.0 * math.pi) - math.pi
        assert np.abs(bends).max() < math.radians(90.0)
        assert lengths(edges).max() < 0.25 * lengths(edges).sum()


def test_env3_s_corridor_is_of_no_single_width():
    # Along the tour there is now more, now less room: the corridor has no shape of its own.
    world = load_world("env3")
    tour, _ = sample(polygon_edges(world.loop), 0.05)
    room = distances(tour, world.edges).min(axis=1)
    assert room.max() - room.min() > 0.15
