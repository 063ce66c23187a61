"""The occupancy grid: beams clear, hits occupy, and growing keeps everything in its place."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.config.presets import GridConfig
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec, SensorSpec

# One beam straight ahead from the middle of the body, so that what it crosses can be counted by hand.
ONE = RobotSpec(radius=0.05, beams=(SensorSpec(0.0, 0.0, 0.0, 0.05, 1.5),))
SIX = RobotSpec()
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


def test_a_beam_clears_what_it_crosses_and_occupies_where_it_ends() -> None:
    grid = OccupancyGrid(CONFIG)
    grid.update(at_centre(0, 0), ONE, np.array([1.0]), YES)
    assert [value(grid, column, 0) for column in range(13)] == [1] * 10 + [-4, 0, 0]
    # Nothing to the sides of it, besides the body.
    assert all(value(grid, column, row) == 0 for column in range(2, 12) for row in (-1, 1))


@pytest.mark.parametrize("reading", [0.2, float(np.float32(0.2)), 0.1])
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


def test_the_view_ends_where_knowledge_ends() -> None:
    grid = OccupancyGrid(CONFIG)
    grid.update(at_centre(3, 5), ONE, np.array([1.0]), YES)
    assert grid.view.values.shape == (1, 11)
    np.testing.assert_allclose(grid.view.low, [0.3, 0.5])
    grid.update(at_centre(2, 8, 0.5 * math.pi), ONE, np.array([0.5]), YES)
    assert grid.view.values.shape == (9, 12)
    np.testing.assert_allclose(grid.view.low, [0.2, 0.5])
    # The outermost rows and columns all hold something.
    unknown = grid.view.unknown
    for edge in (unknown[0], unknown[-1], unknown[:, 0], unknown[:, -1]):
        assert not edge.all()


@pytest.mark.parametrize("far", [(20_100, 0), (0, -20_100), (-20_100, 20_100)])
def test_a_map_without_bounds_is_refused(far: tuple[int, int]) -> None:
    grid = OccupancyGrid(CONFIG)
    grid.update(at_centre(0, 0), ONE, np.array([1.0]), YES)
    with pytest.raises(ValueError, match="the map has grown past 2000 m"):
        grid.update(at_centre(*far), ONE, np.array([1.0]), YES)


def test_after_a_refusal_the_map_is_as_it_was() -> None:
    grid = OccupancyGrid(CONFIG)
    grid.update(at_centre(0, 0), ONE, np.array([1.0]), YES)
    before = known(grid)
    with pytest.raises(ValueError, match="the map has grown"):
        grid.update(at_centre(-30_000, 0), ONE, np.array([1.0]), YES)
    assert known(grid) == before


def test_a_cell_is_counted_once_a_step_however_many_samples_fall_into_it() -> None:
    grid = OccupancyGrid(CONFIG)
    fan = RobotSpec(radius=0.05, beams=tuple(SensorSpec(0.0, 0.0, a, 0.05, 1.5) for a in (-0.01, 0.0, 0.01)))
    grid.update(at_centre(0, 0), fan, np.full(3, 1.0), np.ones(3, dtype=bool))
    assert value(grid, 5, 0) == 1
    assert value(grid, 10, 0) == -4


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


poses = st.tuples(st.integers(-120, 120), st.integers(-120, 120), st.floats(-math.pi, math.pi))


@settings(deadline=None, max_examples=50)
@given(poses, poses, poses)
def test_growing_keeps_what_is_known_and_where(first: tuple, second: tuple, third: tuple) -> None:
    ranges = np.array([0.5, 0.6, 1.5, 1.1, 0.7, 0.5])
    expected: dict[tuple[int, int], int] = {}
    together = OccupancyGrid(CONFIG)
    for place in (first, second, third):
        pose = at_centre(*place)
        together.update(pose, SIX, ranges, np.ones(6, dtype=bool))
        alone = OccupancyGrid(CONFIG)
        alone.update(pose, SIX, ranges, np.ones(6, dtype=bool))
        for cell, amount in known(alone).items():
            total = expected.get(cell, 0) + amount
            expected[cell] = total or int(np.sign(amount))
    assert known(together) == expected


def test_a_view_is_read_only() -> None:
    grid = OccupancyGrid(CONFIG)
    grid.update(at_centre(0, 0), ONE, np.array([1.0]), YES)
    with pytest.raises(ValueError, match="read-only"):
        grid.view.values[0, 0] = 5


def test_cells_and_centres_are_inverse_and_tell_rows_from_columns() -> None:
    view = GridView(np.array([-1.0, 2.0]), 0.5, np.zeros((4, 6), dtype=np.int16))
    assert view.cells(np.array([[-1.0, 2.0], [0.6, 2.1], [-1.1, 3.9]])).tolist() == [[0, 0], [0, 3], [3, -1]]
    cells = np.argwhere(view.unknown)
    assert len(cells) == 24
    np.testing.assert_array_equal(view.cells(view.centres(cells)), cells)
    np.testing.assert_allclose(view.centres(np.array([[3, 0]])), [[-0.75, 3.75]])
