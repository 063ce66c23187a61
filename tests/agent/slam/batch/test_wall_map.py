"""The batch counts hits and passes of walls as the plain extents and the plain map do."""

import copy

import numpy as np
import pytest
from support.batch_stages import ROBOT, cached, estimator_after, observations, spec, state_from

from limslam_agent.slam.batch import wall_extent, wall_map
from limslam_agent.slam.batch.state import LENGTH, LINES, LOW, OVERFLOWS, States
from limslam_agent.slam.consistent.consistent import ConsistentEstimator
from limslam_agent.slam.consistent.wall_extent import WallExtent
from limslam_agent.slam.consistent.wall_map import WallMap
from limslam_agent.slam.core.front_end import FrontEnd
from limslam_env.geometry.line import direction

hit, pass_at, ends_of = (cached(each) for each in (wall_extent.hit, wall_extent.pass_at, wall_extent.ends_of))
add, grow, merge = (cached(each) for each in (wall_map.add, wall_map.grow, wall_map.merge))
clear_along_beams = cached(wall_map.clear_along_beams)


@pytest.fixture(scope="module")
def recorded() -> ConsistentEstimator:
    return estimator_after(200)


@pytest.fixture
def state(recorded: ConsistentEstimator) -> States:
    return state_from(recorded)


def assert_same_extent(state: States, index: int, plain: WallExtent) -> None:
    low, length = state.walls.table[index, LOW], state.walls.table[index, LENGTH]
    assert (low, length) == (plain._low, len(plain._hits))
    np.testing.assert_array_equal(state.walls.counted[index, :, :length], [plain._hits, plain._misses])
    reached = state.walls.reached[index, :, :length]
    np.testing.assert_allclose(reached, [plain._least, plain._most], rtol=0.0, atol=1e-12)


def assert_same_walls(state: States, plain: WallMap) -> None:
    assert state.filter.counts[OVERFLOWS] == 0
    for index, wall in enumerate(plain.walls):
        assert_same_extent(state, index, wall.extent)
        assert state.walls.table[index, 2:].tolist() == [wall.groups, wall.readings]
        np.testing.assert_allclose(state.walls.seen[index], wall.seen, rtol=0.0, atol=1e-12)
        assert state.walls.behind[index] == wall.behind


@pytest.mark.parametrize("seed", range(4))
def test_hits_and_passes_of_a_new_wall(state: States, seed: int) -> None:
    generator, plain = np.random.default_rng(seed), WallExtent()
    add(state.walls, 0)
    for along in generator.normal(0.0, 1.0, 40):
        hit(state.walls, state.filter.counts, 0, along)
        plain.hit(np.array([along]))
        place = generator.normal(0.0, 1.0)
        pass_at(state.walls, 0, place)
        plain.pass_at(place)
    assert_same_extent(state, 0, plain)
    assert ends_of(state.walls, 0) == plain.ends
    assert plain._misses.sum() > 10


def test_more_bins_than_there_is_room_for_are_counted_as_overflows(state: States) -> None:
    add(state.walls, 0)
    for along in (0.0, 100.0, -100.0):
        hit(state.walls, state.filter.counts, 0, along)
    assert state.filter.counts[OVERFLOWS] == 2
    assert state.walls.table[0, LENGTH] == 1


def test_walls_grow(state: States, recorded: ConsistentEstimator) -> None:
    plain, generator = copy.deepcopy(recorded._map), np.random.default_rng(1)
    for index in range(len(plain)):
        points = plain.ends(index)[0] + generator.normal(0.0, 0.2, (7, 2))
        side = index % 2
        plain.grow(index, points, side)
        grow(state.filter, state.walls, index, points, side)
    assert_same_walls(state, plain)


@pytest.mark.parametrize("factor", [1.0, -1.0])
def test_merged_walls(state: States, recorded: ConsistentEstimator, factor: float) -> None:
    plain, (older, younger) = copy.deepcopy(recorded._map), (0, 2)
    origin = plain._belief.anchors[older] + np.array([0.3, -0.2])
    shift = float(plain.along(older, origin))
    # The filter has merged the lines when the walls are merged, so one line is gone.
    state.filter.counts[LINES] -= 1
    merge(state.filter, state.walls, older, younger, factor, shift)
    plain.merge(older, younger, origin, factor * direction(plain._belief.anchored[older]))
    assert_same_walls(state, plain)


def test_beams_clear_walls(state: States, recorded: ConsistentEstimator) -> None:
    estimator, front = copy.deepcopy(recorded), FrontEnd(ROBOT)
    before = sum(wall.extent._misses.sum() for wall in estimator._map.walls)
    for number, seen in enumerate(observations()[200:230]):
        # Longer than they are, so that they pass through walls.
        ranges = np.asarray(seen["ranges"], dtype=float) + 0.1 * number
        front.accept({"ranges": ranges})
        estimator._clear_along_beams(0, front)
        clear_along_beams(state.filter, state.walls, ranges, front.measured, spec().settings[0], spec().beams)
    assert_same_walls(state, estimator._map)
    assert sum(wall.extent._misses.sum() for wall in estimator._map.walls) > before + 10
