"""The occupancy grid, its frontiers and borders without a wall, and the ways over its free
ground.
"""

import math
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.config.presets import GridConfig
from limslam_agent.grid.frontier import frontier_cells, group_places
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.grid.planner import Clearance, routes, wall_distance
from limslam_agent.grid.unfinished import (
    Faces,
    border_faces,
    in_long_stretches,
    reachable_ground,
    unfinished_faces,
)
from limslam_env import RobotSpec, SensorSpec
from limslam_env.geometry import BoolArray, FloatArray

# One beam straight ahead from the middle of the body, so that what it crosses can be counted by
# hand.
ONE = RobotSpec(radius=0.05, beams=(SensorSpec(0.0, 0.0, 0.0, 0.05, 1.5),))
YES = np.array([True])
NO = np.array([False])
CONFIG = GridConfig(cell=0.1, seen_through=1, hit=4, limit=20)


def at_centre(column: int, row: int, heading: float = 0.0) -> FloatArray:
    """A pose in the middle of the cell with the given numbers, 0.1 m each."""
    return np.array([0.1 * column + 0.05, 0.1 * row + 0.05, heading])


def value(grid: OccupancyGrid, column: int, row: int) -> int:
    """What the grid says at a place of the world; 0 where it does not reach."""
    view = grid.view
    cell = view.cells(at_centre(column, row)[None, :2])[0]
    inside = (cell >= 0).all() and (cell < view.values.shape).all()
    return int(view.values[tuple(cell)]) if inside else 0


def known(grid: OccupancyGrid) -> dict[tuple[int, int], int]:
    """All cells that are not unknown, by their place in the world."""
    view = grid.view
    cells = np.argwhere(~view.unknown)
    places = np.floor(view.centres(cells) / view.cell).astype(int)
    return {
        (int(x), int(y)): int(view.values[row, column])
        for (x, y), (row, column) in zip(places, cells, strict=True)
    }


@pytest.mark.parametrize("reading", [float(np.float32(0.2)), 0.1])
def test_a_reading_at_the_minimum_marks_nothing(reading: float) -> None:
    with_it = OccupancyGrid(CONFIG)
    without = OccupancyGrid(CONFIG)
    beam = RobotSpec(radius=0.05, beams=(SensorSpec(0.3, 0.0, 0.0, 0.2, 1.5),))
    with_it.update(at_centre(0, 0), beam, np.array([reading]), YES)
    without.update(at_centre(0, 0), beam, np.array([reading]), NO)
    # Neither its way nor its end, not even where it begins: the body is all that is known.
    assert known(with_it) == known(without)
    assert value(with_it, 3, 0) == value(with_it, 5, 0) == 0
    # A little more is a reading like any other.
    with_it.update(at_centre(0, 0), beam, np.array([0.21]), YES)
    assert value(with_it, 5, 0) == -4


@pytest.mark.parametrize("far", [(20_100, 0), (0, -20_100)])
def test_a_map_without_bounds_is_refused(far: tuple[int, int]) -> None:
    grid = OccupancyGrid(CONFIG)
    grid.update(at_centre(0, 0), ONE, np.array([1.0]), YES)
    with pytest.raises(ValueError, match="the map has grown past 2000 m"):
        grid.update(at_centre(*far), ONE, np.array([1.0]), YES)


def test_cells_and_centres_are_inverse_and_tell_rows_from_columns() -> None:
    view = GridView(np.array([-1.0, 2.0]), 0.5, np.zeros((4, 6), dtype=np.int16))
    assert view.cells(np.array([[-1.0, 2.0], [0.6, 2.1], [-1.1, 3.9]])).tolist() == [
        [0, 0],
        [0, 3],
        [3, -1],
    ]
    cells = np.argwhere(view.unknown)
    assert len(cells) == 24
    np.testing.assert_array_equal(view.cells(view.centres(cells)), cells)
    np.testing.assert_allclose(view.centres(np.array([[3, 0]])), [[-0.75, 3.75]])


LOW = np.array([-1.0, 2.0])
CELL = 0.1
# A comfort this short makes no cell dear that is not too near a wall anyway.
NO_COMFORT = 1e-9


def grid_of(*rows: str) -> GridView:
    """A grid drawn with . for free, # for occupied and ? for unknown; the first row is row 0."""
    meaning = {".": 2, "#": -4, "?": 0}
    return GridView(
        LOW, CELL, np.array([[meaning[cell] for cell in row] for row in rows], dtype=np.int16)
    )


def drawn(mask: BoolArray) -> list[str]:
    return ["".join("x" if cell else "-" for cell in row) for row in mask]


def place(row: float, column: float) -> FloatArray:
    """The middle of a cell, m."""
    return LOW + CELL * np.array([column + 0.5, row + 0.5])


def test_groups_have_a_place_each() -> None:
    grid = grid_of("#########", "#.......#", "??.???...")
    frontier = np.zeros(grid.values.shape, dtype=bool)
    frontier[1, 1:4] = frontier[2, 7:9] = True
    np.testing.assert_allclose(group_places(grid, frontier), [place(1, 2), place(2, 7.5)])
    assert group_places(grid, np.zeros_like(frontier)).shape == (0, 2)


def test_frontiers_are_groups_of_free_cells_beside_unknown_ones() -> None:
    grid = grid_of("#########", "#....???#", "#.......#", "#.#######")
    ends = ["---------", "----x----", "-----xxx-"]
    assert drawn(frontier_cells(grid, 1)) == [*ends, "-x-------"], "beyond the grid, all is unknown"
    assert drawn(frontier_cells(grid, 2)) == [*ends, "---------"]
    ignored = np.zeros(grid.values.shape, dtype=bool)
    ignored[2, 5] = True
    assert drawn(frontier_cells(grid, 2, ignored)) == ["-" * 9, "-" * 9, "------xx-", "-" * 9]


def plain_distances(grid: GridView) -> FloatArray:
    """Distance (m) of each cell's centre from the nearest edge of an occupied cell, straight on, by
    trying all.
    """
    occupied = np.argwhere(grid.occupied)
    distances = np.full(grid.values.shape, math.inf)
    for row, column in np.ndindex(*grid.values.shape):
        if len(occupied):
            distances[row, column] = (
                CELL * np.hypot(*(occupied - (row, column)).T).min() - 0.5 * CELL
            )
    return distances


def by_neighbours(cost: FloatArray, prices: FloatArray) -> FloatArray:
    """What each cell (rows, columns) costs by its cheapest neighbour."""
    rows, columns = cost.shape
    costs, around = (np.pad(each, 1, constant_values=np.inf) for each in (cost, prices))
    found = np.full(cost.shape, np.inf)
    for down, right in set(product((-1, 0, 1), repeat=2)) - {(0, 0)}:
        row = slice(1 + down, rows + 1 + down)
        column = slice(1 + right, columns + 1 + right)
        # A diagonal step needs both cells beside it; for a straight one these are its own ends.
        is_open = np.isfinite(around[row, 1:-1] + around[1:-1, column])
        reached = costs[row, column] + 0.5 * np.hypot(down, right) * (prices + around[row, column])
        found = np.where(is_open, np.minimum(found, reached), found)
    return found


def random_grid(seed: int, walls: float) -> tuple[GridView, tuple[int, int]]:
    generator = np.random.default_rng(seed)
    shape = tuple(generator.integers(4, 14, 2))
    values = generator.choice([2, -4, 0], shape, p=[0.9 - walls, walls, 0.1]).astype(np.int16)
    start = (int(generator.integers(shape[0])), int(generator.integers(shape[1])))
    values[start] = 3
    return GridView(LOW, CELL, values), start


# No distance between cells equals one of these radii, so rounding decides nothing.
@pytest.mark.parametrize(("radius", "walls"), [(0.0, 0.3), (0.07, 0.2), (0.12, 0.06), (0.19, 0.04)])
@settings(deadline=None, max_examples=40)
@given(st.integers(0, 100_000))
def test_no_neighbour_offers_a_cheaper_path(radius: float, walls: float, seed: int) -> None:
    grid, start = random_grid(seed, walls)
    cost = routes(grid, place(*start), Clearance(radius, NO_COMFORT)).cost
    # Of 22 m a metre within the radius, 20 are for the tightness, and two for all the comfort that
    # it lacks.
    prices = CELL * np.where(plain_distances(grid) < radius, 23.0, 1.0)
    least = by_neighbours(cost, np.where(grid.free, prices, np.inf))
    assert cost[start] == 0.0
    least[start] = 0.0
    np.testing.assert_allclose(cost, least, rtol=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 100_000))
def test_paths_lead_cell_by_cell_over_free_ground_and_cut_no_corners(seed: int) -> None:
    radius = 0.12
    grid, start = random_grid(seed, 0.06)
    ways = routes(grid, place(*start), Clearance(radius, 0.15))
    for cell in np.argwhere(np.isfinite(ways.cost)).tolist():
        path = ways.path_to((cell[0], cell[1]))
        assert path[0].tolist() == list(start)
        assert path[-1].tolist() == cell
        assert (
            (np.abs(np.diff(path, axis=0)).max(axis=1) == 1).all()
            if len(path) > 1
            else cell == list(start)
        )
        assert grid.free[path[:, 0], path[:, 1]].all()
        # The two cells that a diagonal step passes between are free as well.
        assert grid.free[path[1:, 0], path[:-1, 1]].all()
        assert grid.free[path[:-1, 0], path[1:, 1]].all()
        # Costs add up along the path, and only ever grow.
        assert (np.diff(ways.cost[path[:, 0], path[:, 1]]) > 0.0).all()


@pytest.mark.parametrize(("row", "column"), [(-1, 2), (2, 5)])
def test_from_outside_of_the_grid_nothing_can_be_reached(row: int, column: int) -> None:
    ways = routes(grid_of(*["....."] * 5), place(row, column), Clearance(0.1, 0.1))
    assert ways.cost.shape == (5, 5)
    assert np.isinf(ways.cost).all()
    assert (ways.predecessors < 0).all()


def test_comfort_keeps_the_way_off_the_walls_where_there_is_room() -> None:
    # A corridor 9 cells wide: hugging its wall is as short, but dearer.
    grid = grid_of("#" * 30, *["." * 30] * 9, "#" * 30)
    near = routes(grid, place(2, 1), Clearance(0.12, NO_COMFORT)).path_to((2, 28))
    far = routes(grid, place(2, 1), Clearance(0.12, 0.3)).path_to((2, 28))
    assert set(near[:, 0].tolist()) == {2}
    assert far[len(far) // 2, 0] >= 4
    # A cell within the comfort costs up to three times its length, and never more.
    cost = routes(grid, place(2, 1), Clearance(0.12, 0.3)).cost[2, 2]
    assert 0.1 < cost <= 0.3


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 100_000))
def test_a_search_for_targets_finds_the_cheapest_at_its_cost(seed: int) -> None:
    grid, start = random_grid(seed, 0.15)
    everywhere = routes(grid, place(*start), Clearance(0.07, 0.1))
    targets = np.random.default_rng(seed).random(grid.values.shape) < 0.1
    found = routes(grid, place(*start), Clearance(0.07, 0.1), targets=targets)
    assert (
        np.where(targets, found.cost, np.inf).min()
        == np.where(targets, everywhere.cost, np.inf).min()
    )
    # What it reached at all, it reached at its least cost; when it found no target it went
    # everywhere.
    reached = np.isfinite(found.cost)
    np.testing.assert_array_equal(found.cost[reached], everywhere.cost[reached])
    if not np.isfinite(everywhere.cost[targets]).any():
        np.testing.assert_array_equal(reached, np.isfinite(everywhere.cost))


def test_a_near_target_is_found_without_going_everywhere() -> None:
    grid = grid_of(*["." * 60] * 60)
    targets = np.zeros(grid.values.shape, dtype=bool)
    targets[30, 34] = targets[0, 59] = True
    cost = routes(grid, place(30, 30), Clearance(0.1, 0.1), targets=targets).cost
    assert cost[30, 34] == pytest.approx(0.4)
    assert np.isfinite(cost).sum() < 400


def test_steps_far_from_walls_cost_three_times_as_much() -> None:
    grid = grid_of("#" * 100, *["." * 100] * 99)
    cost = routes(grid, place(60, 50), Clearance(0.1, 0.1, 2.5)).cost
    assert cost[60, 60] == pytest.approx(3.0 * 10 * CELL)
    assert routes(grid, place(60, 50), Clearance(0.1, 0.1)).cost[60, 60] == pytest.approx(10 * CELL)
    assert routes(grid, place(10, 50), Clearance(0.1, 0.1, 2.5)).cost[10, 60] == pytest.approx(
        10 * CELL
    )


def test_closed_cells_are_driven_round_though_they_are_free() -> None:
    grid = grid_of(*["." * 9] * 5)
    closed = np.zeros(grid.values.shape, dtype=bool)
    closed[:4, 4] = True
    ways = routes(grid, place(0, 0), Clearance(0.1, 0.1), closed=closed)
    assert ways.path_to((0, 8))[:, 0].max() == 4
    assert np.isinf(ways.cost[:4, 4]).all()
    closed[:, 4] = True
    assert np.isinf(routes(grid, place(0, 0), Clearance(0.1, 0.1), closed=closed).cost[:, 5:]).all()
    # Its own cell never is.
    assert (
        np.isfinite(routes(grid, place(0, 4), Clearance(0.1, 0.1), closed=closed).cost)
        .all(axis=0)[5:]
        .all()
    )


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 100_000))
def test_distances_from_walls_are_those_of_trying_all(seed: int) -> None:
    grid, _ = random_grid(seed, 0.1)
    np.testing.assert_allclose(wall_distance(grid), plain_distances(grid), atol=1e-6)


def room(columns: int, rows: int) -> GridView:
    """Free cells from the origin to a corner, m, and occupied cells around them."""
    values = np.full((rows + 2, columns + 2), -4, dtype=np.int16)
    values[1:-1, 1:-1] = 2
    return GridView(np.full(2, -CELL), CELL, values)


def walls_of(columns: int, rows: int) -> FloatArray:
    """The walls of such a room, along the outer sides of its free cells."""
    x = CELL * columns
    y = CELL * rows
    return np.array([[0, 0, x, 0], [x, 0, x, y], [x, y, 0, y], [0, y, 0, 0]], dtype=float)


def unfinished(grid: GridView, walls: FloatArray, least: float = 0.15) -> Faces:
    faces = border_faces(grid, reachable_ground(grid, np.full(2, 0.05)))
    faces = faces.select(unfinished_faces(faces, walls, CELL))
    return faces.select(in_long_stretches(faces, least, CELL))


def test_the_faces_of_a_room_lie_on_its_border_and_look_inside() -> None:
    faces = border_faces(room(12, 8), room(12, 8).free)
    assert len(faces) == 2 * (12 + 8)
    x, y = faces.middles.T
    assert (
        (np.isclose(x, 0.0) | np.isclose(x, 1.2)) | (np.isclose(y, 0.0) | np.isclose(y, 0.8))
    ).all()
    assert (np.sum(faces.normals * (np.array([0.6, 0.4]) - faces.middles), axis=1) > 0.0).all()
    np.testing.assert_allclose(np.hypot(*faces.normals.T), 1.0)


@settings(deadline=None, max_examples=50)
@given(
    columns=st.integers(3, 40),
    rows=st.integers(3, 40),
    error=st.tuples(st.floats(-0.09, 0.09), st.floats(-0.09, 0.09)),
)
def test_a_room_with_all_its_walls_has_no_unfinished_stretch(columns, rows, error) -> None:
    walls = walls_of(columns, rows) + np.tile(error, 2)
    assert not len(unfinished(room(columns, rows), walls))


@settings(deadline=None, max_examples=50)
@given(
    side=st.integers(0, 3),
    start=st.floats(0.1, 2.0),
    length=st.floats(0.35, 0.9),
    error=st.floats(-0.05, 0.05),
)
def test_a_missing_part_of_a_wall_is_found(side, start, length, error) -> None:
    columns = rows = 30
    walls = walls_of(columns, rows) + error
    cut = walls[side]
    others = np.delete(walls, side, axis=0)
    along = (cut[2:] - cut[:2]) / 3.0
    low = cut[:2] + start * along
    high = cut[:2] + (start + length) * along
    found = unfinished(
        room(columns, rows), np.vstack((others, [*cut[:2], *low], [*high, *cut[2:]]))
    )
    assert len(found) * CELL >= length - 0.25
    places = (found.middles - cut[:2]) @ along
    assert (places > start - 1e-9).all()
    assert (places < start + length + 1e-9).all()
    assert np.abs((found.middles - cut[:2]) @ (along[1], -along[0])).max() < 0.06


def test_a_stretch_shorter_than_asked_is_left_out() -> None:
    walls = walls_of(20, 20)
    walls = np.vstack((walls[1:], [[0.0, 0.0, 0.83, 0.0], [1.17, 0.0, 2.0, 0.0]]))
    grid = room(20, 20)
    assert len(unfinished(grid, walls, 0.15)) == 2
    assert not len(unfinished(grid, walls, 0.25))
    faces = Faces(
        np.array([[x, 0.0] for x in (0.05, 0.15, 0.35, 0.45)]), np.tile([0.0, 1.0], (4, 1))
    )
    assert in_long_stretches(faces, 0.2, CELL).all()
    assert not in_long_stretches(faces, 0.25, CELL).any(), (
        "a face that is missing separates two stretches"
    )


def test_an_obstacle_without_walls_is_unfinished_all_around() -> None:
    grid = room(20, 20)
    values = grid.values.copy()
    values[9:13, 9:13] = -4
    found = unfinished(GridView(grid.low, CELL, values), walls_of(20, 20))
    assert len(found) == 16
    assert (np.sum(found.normals * (found.middles - 1.0), axis=1) > 0.0).all()


@pytest.mark.parametrize("place", [(0.05, 0.05), (0.95, 0.05)])
def test_only_the_ground_that_the_robot_can_reach_counts(place) -> None:
    values = np.full((3, 12), -4, dtype=np.int16)
    values[1, 1:5] = 2
    values[1, 7:11] = 2
    ground = reachable_ground(GridView(np.full(2, -CELL), CELL, values), np.array(place))
    assert ground[1, 1:5].all() == (place[0] < 0.5)
    assert ground[1, 7:11].all() == (place[0] > 0.5)
    assert ground.sum() == 4
