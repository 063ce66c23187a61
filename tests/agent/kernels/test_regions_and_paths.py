"""Frontiers, groups of cells and paths: the compiled ones are the plain ones, on random grids."""

import numpy as np
import pytest
from scipy import ndimage

from limslam_agent.grid.frontier import frontier_cells
from limslam_agent.grid.occupancy import GridView
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


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("least", "pocket", "close_gaps"), [(1, 1, False), (3, 3, True), (12, 7, True)])
def test_frontiers(seed: int, least: int, pocket: int, close_gaps: bool) -> None:
    values = random_values(seed)
    grid, ignored = GridView(np.zeros(2), 0.1, values), np.random.default_rng(seed).random(values.shape) < 0.2
    for left_out in (None, ignored):
        expected = plain_frontier(values, left_out, least, pocket, close_gaps)
        found = frontier_cells(grid, least, left_out, close_gaps=close_gaps, pocket=pocket)
        np.testing.assert_array_equal(found, expected)
        assert expected.any()
