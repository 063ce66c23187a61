"""The paper's three environments have what the paper says of them. Env1's four-fold symmetry is in test_world.py."""

import numpy as np
import pytest

from limslam_env import World, load_world
from limslam_env.geometry import FloatArray, segment

PAPER = {"env1": (7.0, 7.0), "env2": (9.0, 5.3), "env3": (7.0, 5.5)}
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


def test_it_has_the_paper_s_size(world):
    assert world.size == PAPER[world.name]


def test_passages_are_wide_enough_to_pass_with_ease(world):
    # A larger disc still gets everywhere, so nothing hangs on a robot's last centimetre.
    assert len(interior_regions(world, 0.5 * NARROWEST_PASSAGE - 0.01)) == 1


def test_the_loop_is_a_closed_tour_with_clearance_round_something(world):
    tour, _ = segment.sample(segment.polygon_edges(world.loop), 0.01)
    assert segment.distances(tour, world.edges).min() >= LOOP_CLEARANCE
    middles = 0.5 * (world.edges[:, :2] + world.edges[:, 2:])
    assert segment.inside_polygon(middles, world.loop).sum() >= 4


def test_doors_are_open_and_lie_between_wall_ends_on_one_line(world):
    assert {tuple(door) for door in world.doors.tolist()} <= collinear_gaps(world.walls)
    for door in world.doors:
        points, _ = segment.sample(door[None], 0.01)
        to_jambs = np.minimum(*(np.linalg.norm(points - end, axis=1) for end in (door[:2], door[2:])))
        np.testing.assert_allclose(segment.distances(points, world.edges).min(axis=1), to_jambs, atol=1e-9)


def test_env2_has_perpendicular_walls_and_nothing_else():
    world = load_world("env2")
    spans = np.abs(world.walls[:, 2:] - world.walls[:, :2])
    assert (spans.min(axis=1) == 0.0).all()
    assert (spans > 0.0).any(axis=0).all(), "walls run both ways"
    assert not world.obstacles


def test_env2_has_one_narrow_door_and_it_comes_first():
    widths = segment.lengths(load_world("env2").doors)
    assert NARROW[0] <= widths[0] <= NARROW[1]
    assert (widths[1:] >= CLEARLY_WIDER).all()
