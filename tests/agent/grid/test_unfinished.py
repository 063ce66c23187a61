"""Unfinished borders on grids drawn by hand: which faces have no wall of the map, and in which stretches."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.unfinished import (
    Faces,
    border_faces,
    in_long_stretches,
    reachable_ground,
    unfinished_faces,
)
from limslam_env.geometry import FloatArray

CELL = 0.1


def room(columns: int, rows: int) -> GridView:
    """Free cells from the origin to a corner, m, and occupied cells around them."""
    values = np.full((rows + 2, columns + 2), -4, dtype=np.int16)
    values[1:-1, 1:-1] = 2
    return GridView(np.full(2, -CELL), CELL, values)


def walls_of(columns: int, rows: int) -> FloatArray:
    """The walls of such a room, along the outer sides of its free cells."""
    x, y = CELL * columns, CELL * rows
    return np.array([[0, 0, x, 0], [x, 0, x, y], [x, y, 0, y], [0, y, 0, 0]], dtype=float)


def unfinished(grid: GridView, walls: FloatArray, least: float = 0.15) -> Faces:
    faces = border_faces(grid, reachable_ground(grid, np.full(2, 0.05)))
    faces = faces.select(unfinished_faces(faces, walls, CELL))
    return faces.select(in_long_stretches(faces, least, CELL))


def test_the_faces_of_a_room_lie_on_its_border_and_look_inside() -> None:
    faces = border_faces(room(12, 8), room(12, 8).free)
    assert len(faces) == 2 * (12 + 8)
    x, y = faces.middles.T
    assert ((np.isclose(x, 0.0) | np.isclose(x, 1.2)) | (np.isclose(y, 0.0) | np.isclose(y, 0.8))).all()
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
    cut, others = walls[side], np.delete(walls, side, axis=0)
    along = (cut[2:] - cut[:2]) / 3.0
    low, high = cut[:2] + start * along, cut[:2] + (start + length) * along
    found = unfinished(room(columns, rows), np.vstack((others, [*cut[:2], *low], [*high, *cut[2:]])))
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
    values[1, 1:5], values[1, 7:11] = 2, 2
    ground = reachable_ground(GridView(np.full(2, -CELL), CELL, values), np.array(place))
    assert ground[1, 1:5].all() == (place[0] < 0.5)
    assert ground[1, 7:11].all() == (place[0] > 0.5)
    assert ground.sum() == 4
