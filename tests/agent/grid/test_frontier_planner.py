"""Frontiers worked out by hand, and Dijkstra against a plain one written down here."""

import heapq
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.grid.frontier import frontier_cells, group_places
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.planner import routes, wall_distance
from limslam_env.geometry import BoolArray, FloatArray

LOW = np.array([-1.0, 2.0])
CELL = 0.1
# A comfort this short makes no cell dear that is not too near a wall anyway.
NO_COMFORT = 1e-9


def grid_of(*rows: str) -> GridView:
    """A grid drawn with . for free, # for occupied and ? for unknown; the first row is row 0."""
    meaning = {".": 2, "#": -4, "?": 0}
    return GridView(LOW, CELL, np.array([[meaning[cell] for cell in row] for row in rows], dtype=np.int16))


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


# A plain Dijkstra, cell by cell.


def plain_distances(grid: GridView) -> FloatArray:
    """Distance (m) of each cell's centre from the nearest edge of an occupied cell, straight on, by trying all."""
    occupied = np.argwhere(grid.occupied)
    distances = np.full(grid.values.shape, math.inf)
    for row, column in np.ndindex(*grid.values.shape):
        if len(occupied):
            distances[row, column] = CELL * np.hypot(*(occupied - (row, column)).T).min() - 0.5 * CELL
    return distances


def plain_dijkstra(grid: GridView, start: tuple[int, int], radius: float) -> FloatArray:
    """Costs (m) over free cells; a cell within the radius of an occupied one costs 22 m more a metre.

    Of these, 20 are for the tightness, and two for all the comfort that it lacks.
    """
    distances = plain_distances(grid)
    rows, columns = grid.values.shape

    def passable(row: int, column: int) -> bool:
        return (row, column) == start or bool(grid.free[row, column])

    def toll(row: int, column: int) -> float:
        return 23.0 if distances[row, column] < radius else 1.0

    cost = np.full(grid.values.shape, math.inf)
    queue = [(0.0, start)]
    while queue:
        so_far, cell = heapq.heappop(queue)
        if so_far >= cost[cell]:
            continue
        cost[cell] = so_far
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                row, column = cell[0] + down, cell[1] + right
                inside = (down or right) and 0 <= row < rows and 0 <= column < columns
                # A diagonal step needs both cells beside it; for a straight one these are the step's own ends.
                if inside and passable(row, column) and passable(cell[0], column) and passable(row, cell[1]):
                    step = CELL * math.hypot(down, right) * 0.5 * (toll(*cell) + toll(row, column))
                    heapq.heappush(queue, (so_far + step, (row, column)))
    return cost


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
def test_costs_equal_a_plain_dijkstras(radius: float, walls: float, seed: int) -> None:
    grid, start = random_grid(seed, walls)
    ways = routes(grid, place(*start), radius, NO_COMFORT)
    np.testing.assert_allclose(ways.cost, plain_dijkstra(grid, start, radius), rtol=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 100_000))
def test_paths_lead_cell_by_cell_over_free_ground_and_cut_no_corners(seed: int) -> None:
    radius = 0.12
    grid, start = random_grid(seed, 0.06)
    ways = routes(grid, place(*start), radius, 0.15)
    for cell in np.argwhere(np.isfinite(ways.cost)).tolist():
        path = ways.path_to((cell[0], cell[1]))
        assert path[0].tolist() == list(start)
        assert path[-1].tolist() == cell
        assert (np.abs(np.diff(path, axis=0)).max(axis=1) == 1).all() if len(path) > 1 else cell == list(start)
        assert grid.free[path[:, 0], path[:, 1]].all()
        # The two cells that a diagonal step passes between are free as well.
        assert grid.free[path[1:, 0], path[:-1, 1]].all()
        assert grid.free[path[:-1, 0], path[1:, 1]].all()
        # Costs add up along the path, and only ever grow.
        assert (np.diff(ways.cost[path[:, 0], path[:, 1]]) > 0.0).all()


def test_each_metre_too_near_a_wall_costs_twenty_more_at_least() -> None:
    # A corridor of one cell, 0.05 m to the wall on both sides.
    grid = grid_of("#" * 12, "." * 12, "#" * 12)
    assert routes(grid, place(1, 0), 0.0, NO_COMFORT).cost[1, 10] == pytest.approx(1.0)
    assert routes(grid, place(1, 0), 0.12, NO_COMFORT).cost[1, 10] == pytest.approx(1.0 + 2.0 + 20.0)
    # Comfort is two at most, and clipped: half of it is missing, and all of it within the radius.
    assert routes(grid, place(1, 0), 0.0, 0.1).cost[1, 10] == pytest.approx(1.0 + 1.0)
    assert routes(grid, place(1, 0), 0.12, 0.05).cost[1, 10] == pytest.approx(1.0 + 2.0 + 20.0)


@pytest.mark.parametrize(("row", "column"), [(-1, 2), (2, 5)])
def test_from_outside_of_the_grid_nothing_can_be_reached(row: int, column: int) -> None:
    ways = routes(grid_of(*["....."] * 5), place(row, column), 0.1, 0.1)
    assert ways.cost.shape == (5, 5)
    assert np.isinf(ways.cost).all()
    assert (ways.predecessors < 0).all()


def test_comfort_keeps_the_way_off_the_walls_where_there_is_room() -> None:
    # A corridor 9 cells wide: hugging its wall is as short, but dearer.
    grid = grid_of("#" * 30, *["." * 30] * 9, "#" * 30)
    near = routes(grid, place(2, 1), 0.12, NO_COMFORT).path_to((2, 28))
    far = routes(grid, place(2, 1), 0.12, 0.3).path_to((2, 28))
    assert set(near[:, 0].tolist()) == {2}
    assert far[len(far) // 2, 0] >= 4
    # A cell within the comfort costs up to three times its length, and never more.
    cost = routes(grid, place(2, 1), 0.12, 0.3).cost[2, 2]
    assert 0.1 < cost <= 0.3


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 100_000))
def test_a_search_for_targets_finds_the_cheapest_at_its_cost(seed: int) -> None:
    grid, start = random_grid(seed, 0.15)
    everywhere = routes(grid, place(*start), 0.07, 0.1)
    targets = np.random.default_rng(seed).random(grid.values.shape) < 0.1
    found = routes(grid, place(*start), 0.07, 0.1, targets=targets)
    assert np.where(targets, found.cost, np.inf).min() == np.where(targets, everywhere.cost, np.inf).min()
    # What it reached at all, it reached at its least cost; when it found no target it went everywhere.
    reached = np.isfinite(found.cost)
    np.testing.assert_array_equal(found.cost[reached], everywhere.cost[reached])
    if not np.isfinite(everywhere.cost[targets]).any():
        np.testing.assert_array_equal(reached, np.isfinite(everywhere.cost))


def test_a_near_target_is_found_without_going_everywhere() -> None:
    grid = grid_of(*["." * 60] * 60)
    targets = np.zeros(grid.values.shape, dtype=bool)
    targets[30, 34] = targets[0, 59] = True
    cost = routes(grid, place(30, 30), 0.1, 0.1, targets=targets).cost
    assert cost[30, 34] == pytest.approx(0.4)
    assert np.isfinite(cost).sum() < 400


def test_steps_far_from_walls_cost_three_times_as_much() -> None:
    grid = grid_of("#" * 100, *["." * 100] * 99)
    cost = routes(grid, place(60, 50), 0.1, 0.1, coast=2.5).cost
    assert cost[60, 60] == pytest.approx(3.0 * 10 * CELL)
    assert routes(grid, place(60, 50), 0.1, 0.1).cost[60, 60] == pytest.approx(10 * CELL)
    assert routes(grid, place(10, 50), 0.1, 0.1, coast=2.5).cost[10, 60] == pytest.approx(10 * CELL)


def test_closed_cells_are_driven_round_though_they_are_free() -> None:
    grid = grid_of(*["." * 9] * 5)
    closed = np.zeros(grid.values.shape, dtype=bool)
    closed[:4, 4] = True
    ways = routes(grid, place(0, 0), 0.1, 0.1, closed=closed)
    assert ways.path_to((0, 8))[:, 0].max() == 4
    assert np.isinf(ways.cost[:4, 4]).all()
    closed[:, 4] = True
    assert np.isinf(routes(grid, place(0, 0), 0.1, 0.1, closed=closed).cost[:, 5:]).all()
    # Its own cell never is.
    assert np.isfinite(routes(grid, place(0, 4), 0.1, 0.1, closed=closed).cost).all(axis=0)[5:].all()


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 100_000))
def test_distances_from_walls_are_those_of_trying_all(seed: int) -> None:
    grid, _ = random_grid(seed, 0.1)
    np.testing.assert_allclose(wall_distance(grid), plain_distances(grid), atol=1e-6)
