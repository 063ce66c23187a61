"""The occupancy grid: beams clear, hits occupy, and growing keeps everything in its place."""

import numpy as np
import pytest

from limslam_agent.config.presets import GridConfig
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_env import RobotSpec, SensorSpec
from limslam_env.geometry import FloatArray

# One beam straight ahead from the middle of the body, so that what it crosses can be counted by hand.
ONE = RobotSpec(radius=0.05, beams=(SensorSpec(0.0, 0.0, 0.0, 0.05, 1.5),))
YES, NO = np.array([True]), np.array([False])
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
        (int(x), int(y)): int(view.values[row, column]) for (x, y), (row, column) in zip(places, cells, strict=True)
    }


@pytest.mark.parametrize("reading", [float(np.float32(0.2)), 0.1])
def test_a_reading_at_the_minimum_marks_nothing(reading: float) -> None:
    with_it, without = OccupancyGrid(CONFIG), OccupancyGrid(CONFIG)
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


def test_values_stay_within_the_limit_and_can_always_be_outvoted() -> None:
    grid = OccupancyGrid(CONFIG)
    for _ in range(60):
        grid.update(at_centre(0, 0), ONE, np.array([1.0]), YES)
    assert value(grid, 10, 0) == -20
    assert value(grid, 5, 0) == 20
    # The wall was none, or has gone: 20 beams through it outweigh whatever was there before.
    for _ in range(20):
        grid.update(at_centre(0, 0), ONE, np.array([1.5]), YES)
    assert value(grid, 10, 0) == 1
    view = grid.view
    assert view.free[tuple(view.cells(at_centre(10, 0)[None, :2])[0])], "one more beam through it than into it"


def test_cells_and_centres_are_inverse_and_tell_rows_from_columns() -> None:
    view = GridView(np.array([-1.0, 2.0]), 0.5, np.zeros((4, 6), dtype=np.int16))
    assert view.cells(np.array([[-1.0, 2.0], [0.6, 2.1], [-1.1, 3.9]])).tolist() == [[0, 0], [0, 3], [3, -1]]
    cells = np.argwhere(view.unknown)
    assert len(cells) == 24
    np.testing.assert_array_equal(view.cells(view.centres(cells)), cells)
    np.testing.assert_allclose(view.centres(np.array([[3, 0]])), [[-0.75, 3.75]])
