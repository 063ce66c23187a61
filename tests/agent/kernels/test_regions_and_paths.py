"""Frontiers, groups of cells and paths: the compiled ones are the plain ones, on random grids."""

import heapq
import math

import numpy as np
import pytest
from scipy import ndimage

from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.paths import search_paths
from limslam_agent.kernels.tables import STEPS
from limslam_env.geometry import BoolArray, FloatArray

ALL_AROUND = np.ones((3, 3), dtype=int)


def without_small(cells: BoolArray, least: int) -> BoolArray:
    labels, _ = ndimage.label(cells, structure=ALL_AROUND)
    keep = np.bincount(labels.ravel()) >= least
    keep[0] = False
    return np.asarray(keep[labels])


def plain_frontier(
    values: FloatArray, ignored: BoolArray | None, least: int, pocket: int, close_gaps: bool
) -> BoolArray:
    unknown, occupied = np.pad(values == 0, 1, constant_values=True), np.pad(values < 0, 2)
    if close_gaps:
        rows, columns = unknown.shape

        def side(down: int, right: int) -> BoolArray:
            return occupied[1 + down : 1 + down + rows, 1 + right : 1 + right + columns]

        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            unknown &= ~(side(down, right) & side(-down, -right))
    unknown = without_small(unknown, pocket)
    beside = unknown[:-2, 1:-1] | unknown[2:, 1:-1] | unknown[1:-1, :-2] | unknown[1:-1, 2:]
    found = (values > 0) & beside
    return without_small(found if ignored is None else found & ~ignored, least)


def random_values(seed: int) -> FloatArray:
    generator = np.random.default_rng(seed)
    smooth = ndimage.gaussian_filter(generator.normal(size=(40, 31)), 1.2)
    return np.where(smooth > 0.05, 3, np.where(smooth < -0.12, -2, 0)).astype(np.int16)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("least", "pocket", "close_gaps"), [(1, 1, False), (3, 3, True), (12, 7, True)])
def test_frontiers(seed: int, least: int, pocket: int, close_gaps: bool) -> None:
    values = random_values(seed)
    grid, ignored = GridView(np.zeros(2), 0.1, values), np.random.default_rng(seed).random(values.shape) < 0.2
    for left_out in (None, ignored):
        expected = plain_frontier(values, left_out, least, pocket, close_gaps)
        found = frontier_cells(grid, least, left_out, close_gaps=close_gaps, pocket=pocket)
        np.testing.assert_array_equal(found, expected)
        assert expected.any()


def searched(open_cells: BoolArray, prices: FloatArray, start: int) -> tuple[FloatArray, dict[int, int]]:
    """Costs (n,) of all cells, and the cell before each of them, by Dijkstra's algorithm with a queue of pairs."""
    rows, columns = open_cells.shape
    cost, before, queue = np.full(open_cells.size, np.inf), dict[int, int](), [(0.0, -start)]
    cost[start] = 0.0
    while queue:
        so_far, negative = heapq.heappop(queue)
        row, column = divmod(-negative, columns)
        if so_far > cost[-negative]:
            continue
        steps = [*STEPS, *((-down, -right, length) for down, right, length in reversed(STEPS))]
        for down, right, length in steps:
            to_row, to_column = row + down, column + right
            is_inside = 0 <= to_row < rows and 0 <= to_column < columns
            # Both cells beside a diagonal step must be open, too.
            if not is_inside or not all(
                open_cells[place] for place in [(to_row, to_column), (row, to_column), (to_row, column)]
            ):
                continue
            to, reached = (
                to_row * columns + to_column,
                so_far + 0.5 * length * (prices[row, column] + prices[to_row, to_column]),
            )
            if reached < cost[to]:
                cost[to], before[to] = reached, -negative
                heapq.heappush(queue, (reached, -to))
    return cost, before


@pytest.mark.parametrize("is_even", [True, False])
def test_paths(is_even: bool) -> None:
    draws = np.random.default_rng(2)
    open_cells = random_values(2) > -2
    prices = np.full(open_cells.shape, 0.1) if is_even else draws.uniform(0.05, 1.0, open_cells.shape)
    start, size = int(np.flatnonzero(open_cells)[40]), open_cells.size
    expected, before = searched(open_cells, prices, start)
    assert np.count_nonzero(np.isfinite(expected)) > 20
    wanted = draws.uniform(size=open_cells.shape) < 0.01
    extra = draws.uniform(0.0, 0.5, open_cells.shape)
    nothing, some = (np.zeros((0, 0), dtype=bool), np.zeros((0, 0))), (wanted, np.zeros((0, 0)))
    for aims, added in (nothing, some, (wanted, extra)):
        totals = expected + (added.ravel() if added.size else 0.0)
        far = float(np.min(totals[wanted.ravel()])) if aims.size else math.inf
        cost, found_before = np.full(size, np.inf), np.full(size, -1, dtype=np.int32)
        scratch = np.empty((2, size), dtype=np.int32)
        search_paths(open_cells, prices, aims, added, start, *scratch, cost, found_before)
        np.testing.assert_array_equal(cost, np.where(expected <= far, expected, np.inf))
        for cell in np.flatnonzero(np.isfinite(cost)).tolist():
            assert found_before[cell] == before.get(cell, -1)
