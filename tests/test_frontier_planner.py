"""Frontiers worked out by hand, and Dijkstra against a plain one written down here."""

import heapq
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.frontier import frontier_cells
from limslam_agent.occupancy import GridView
from limslam_agent.planner import routes
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


def place(row: int, column: int) -> FloatArray:
    """The middle of a cell, m."""
    return LOW + CELL * np.array([column + 0.5, row + 0.5])


def test_frontiers_are_free_cells_beside_unknown_ones() -> None:
    grid = grid_of(
        "#######",
        "#....??",
        "#..#...",
        "?..#..?",
        "#######",
    )
    # Above, below, left and right count; (2, 4) meets the unknown at a corner only.
    assert drawn(frontier_cells(grid, 1)) == [
        "-------",
        "----x--",
        "-----xx",
        "-x---x-",
        "-------",
    ]


def test_a_group_touches_at_corners_and_small_groups_are_left_out() -> None:
    grid = grid_of(
        "#######",
        "#....??",
        "#..#...",
        "?..#..?",
        "#######",
    )
    # (1, 4), (2, 5), (2, 6), (3, 5) hang together by corners; (3, 1) is alone.
    alone = ["-------", "----x--", "-----xx", "-----x-", "-------"]
    assert drawn(frontier_cells(grid, 2)) == alone
    assert drawn(frontier_cells(grid, 4)) == alone
    assert not frontier_cells(grid, 5).any()


def test_a_closed_room_has_no_frontier() -> None:
    grid = grid_of("?????", "?###?", "?#.#?", "?###?", "?????")
    assert not frontier_cells(grid, 1).any()


def test_occupied_and_unknown_cells_are_no_frontier() -> None:
    assert not frontier_cells(grid_of("?#?", "#?#"), 1).any()


def test_what_lies_past_the_grids_edge_is_unknown() -> None:
    # The grid grows only when something falls outside of it: free space can reach its last row exactly.
    assert drawn(frontier_cells(grid_of("#####", "#...#", "#...#"), 3)) == ["-----", "-----", "-xxx-"]
    assert drawn(frontier_cells(grid_of("#...#", "#...#", "#####"), 3)) == ["-xxx-", "-----", "-----"]
    assert drawn(frontier_cells(grid_of("..#", "..#", "..#"), 3)) == ["xx-", "x--", "xx-"]


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
    """Costs (m) over cells that keep the radius; near the start too close ones count threefold."""
    distances = plain_distances(grid)
    rows, columns = grid.values.shape

    def passable(row: int, column: int) -> bool:
        if (row, column) == start:
            return True
        under = math.hypot(row - start[0], column - start[1]) <= radius / CELL
        return bool(grid.free[row, column] and (under or distances[row, column] >= radius))

    def toll(row: int, column: int) -> float:
        return 3.0 if distances[row, column] < radius else 1.0

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
                if (down or right) and 0 <= row < rows and 0 <= column < columns and passable(row, column):
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
def test_paths_lead_cell_by_cell_over_free_ground_and_keep_the_radius(seed: int) -> None:
    radius = 0.12
    grid, start = random_grid(seed, 0.06)
    distances = plain_distances(grid)
    ways = routes(grid, place(*start), radius, 0.15)
    for cell in np.argwhere(np.isfinite(ways.cost)).tolist():
        path = ways.path_to((cell[0], cell[1]))
        assert path[0].tolist() == list(start)
        assert path[-1].tolist() == cell
        assert (np.abs(np.diff(path, axis=0)).max(axis=1) == 1).all() if len(path) > 1 else cell == list(start)
        away = np.hypot(*(path - start).T) > radius / CELL
        assert grid.free[path[:, 0], path[:, 1]].all()
        assert (distances[path[away, 0], path[away, 1]] >= radius).all()
        # Costs add up along the path, and only ever grow.
        assert (np.diff(ways.cost[path[:, 0], path[:, 1]]) > 0.0).all()


def test_in_the_open_the_cost_is_the_length_of_the_way() -> None:
    grid = grid_of(*["." * 9] * 5)
    ways = routes(grid, place(0, 0), 0.15, 0.15)
    assert ways.cost[0, 8] == pytest.approx(0.8)
    assert ways.cost[4, 4] == pytest.approx(0.4 * math.sqrt(2.0))
    assert ways.cost[2, 8] == pytest.approx(0.6 + 0.2 * math.sqrt(2.0))
    assert ways.path_to((0, 3)).tolist() == [[0, 0], [0, 1], [0, 2], [0, 3]]
    assert ways.path_to((0, 0)).tolist() == [[0, 0]]


def test_what_cannot_be_reached_costs_infinity() -> None:
    grid = grid_of(
        "...#..",
        "...#..",
        "...#??",
        "...#..",
    )
    cost = routes(grid, place(1, 0), 0.0, NO_COMFORT).cost
    assert np.isfinite(cost[:, :3]).all()
    assert np.isinf(cost[:, 3:]).all()


def test_unknown_ground_is_not_driven_over() -> None:
    cost = routes(grid_of("..?..", "..?.."), place(0, 0), 0.0, NO_COMFORT).cost
    assert np.isinf(cost[:, 2:]).all()


def test_a_door_narrower_than_the_robot_is_closed_and_a_wider_one_open() -> None:
    # An opening of 3 cells leaves 0.15 m from the middle to the posts, one of 5 leaves 0.25 m.
    for opening, passes in ((3, False), (5, True)):
        side = (9 - opening) // 2
        wall = "#" * side + "." * opening + "#" * (9 - side - opening)
        grid = grid_of(*["." * 9] * 5, wall, *["." * 9] * 5)
        assert np.isfinite(routes(grid, place(1, 4), 0.18, NO_COMFORT).cost[9, 4]) == passes


@pytest.mark.parametrize("row", [1, 2])
def test_a_robot_that_stands_too_near_a_wall_still_gets_out(row: int) -> None:
    # The belief has drifted into the zone that is kept around the wall; all of it must not be a trap.
    grid = grid_of("#########", *["." * 9] * 8)
    ways = routes(grid, place(row, 4), 0.22, 0.15)
    path = ways.path_to((7, 4))
    assert np.isfinite(ways.cost[7, 4])
    assert path[0].tolist() == [row, 4]
    # But it cannot run along the wall for long: a cell as near the wall and far from the robot stays shut.
    assert np.isinf(ways.cost[1, 8])


def test_a_robot_whose_own_cell_seems_occupied_still_gets_out() -> None:
    grid = grid_of(".....", ".....", "..#..", ".....", ".....")
    ways = routes(grid, place(2, 2), 0.15, 0.1)
    assert np.isfinite(ways.cost[0, 0])
    assert ways.path_to((0, 0))[0].tolist() == [2, 2]


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


def test_comfort_gives_way_where_there_is_none() -> None:
    # A passage in which no cell has all its comfort: dear, but open.
    grid = grid_of("#" * 12, *["." * 12] * 3, "#" * 12)
    cost = routes(grid, place(2, 0), 0.1, 0.5).cost[2, 11]
    assert 1.1 < cost <= 3.3
