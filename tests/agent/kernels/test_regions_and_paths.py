"""Frontiers, groups of cells and costs of steps: the compiled ones are the plain ones, on random grids."""

import numpy as np
import pytest
from scipy import ndimage

from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.paths import price_steps
from limslam_agent.kernels.regions import group_around
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


@pytest.mark.parametrize("corners", [True, False])
def test_groups(corners: bool) -> None:
    cells = random_values(1) > 0
    labels, count = ndimage.label(cells, structure=ALL_AROUND if corners else None)
    for label in range(1, count + 1):
        row, column = np.argwhere(labels == label)[0].tolist()
        np.testing.assert_array_equal(group_around(cells, row, column, corners), labels == label)


def test_costs_of_steps() -> None:
    open_cells = random_values(2) > 0
    rows, columns = open_cells.shape
    prices = np.random.default_rng(2).uniform(0.05, 1.0, open_cells.shape)
    found, leads_to = np.empty((rows, columns, 8)), np.empty((rows, columns, 8), dtype=np.int32)
    price_steps(open_cells, prices, found, leads_to)
    for row in range(rows):
        for column in range(columns):
            for slot in range(8):
                down, right, length = STEPS[slot] if slot < 4 else STEPS[7 - slot]
                to_row, to_column = (row + down, column + right) if slot < 4 else (row - down, column - right)
                is_inside = 0 <= to_row < rows and 0 <= to_column < columns
                # Both cells beside a diagonal step must be open, too.
                around = [(row, column), (to_row, to_column), (row, to_column), (to_row, column)]
                is_open = is_inside and all(open_cells[place] for place in around)
                price = 0.5 * length * (prices[row, column] + prices[to_row, to_column]) if is_open else np.inf
                assert found[row, column, slot] == price
                assert not is_inside or leads_to[row, column, slot] == to_row * columns + to_column
    assert 0 <= leads_to.min() <= leads_to.max() < open_cells.size
