"""The batch's occupancy grid is the plain one: the same cells, and the same values in them."""

import numpy as np
import pytest
from support.batch_stages import ROBOT, cached, config_of, spec

from limslam_agent.grid.occupancy import OccupancyGrid
from limslam_agent.slam.batch import grid as batch_grid
from limslam_env.geometry import BoolArray, FloatArray

update = cached(batch_grid.update)
CELLS = 160


def check(poses: list[FloatArray], ranges: list[FloatArray], usable: list[BoolArray], cells: int = CELLS) -> None:
    """Update both grids by the same readings, and compare all cells of the plain one after each of them."""
    plain, config, settings = OccupancyGrid(config_of().grid), config_of().grid, spec().settings[0]
    values, stamps = np.zeros((cells, cells), dtype=np.int16), np.zeros((cells, cells), dtype=np.int32)
    window = np.floor(poses[0][1::-1] / config.cell).astype(np.int64) - cells // 2
    for stamp, (pose, reading, new) in enumerate(zip(poses, ranges, usable, strict=True)):
        plain.update(pose, ROBOT, reading, new)
        update(pose, values, window, reading, new, settings, spec().beams, stamps, stamp + 1)
        view = plain.view
        row, column = np.round(view.low[::-1] / config.cell).astype(int)
        rows, columns = row + np.arange(view.values.shape[0]), column + np.arange(view.values.shape[1])
        np.testing.assert_array_equal(values[np.ix_(rows % cells, columns % cells)], view.values)
        assert np.count_nonzero(values) == np.count_nonzero(view.values)
    assert (values > 0).any()
    assert (values < 0).any()


@pytest.mark.parametrize("seed", range(3))
def test_random_readings(seed: int) -> None:
    generator, number = np.random.default_rng(seed), len(ROBOT.beams)
    poses = [np.array([*generator.normal(0.0, 1.0, 2), generator.uniform(-4.0, 4.0)]) for _ in range(30)]
    spread = ROBOT.max_ranges * 1.2
    ranges = [np.clip(generator.random(number) * spread, ROBOT.min_ranges, ROBOT.max_ranges) for _ in poses]
    check(poses, ranges, [generator.random(number) < 0.8 for _ in poses])
