"""Where an outline is open: x, y and width of each gap that lets a robot out."""

import numpy as np
import pytest

from limslam_env.worlds.openings import openings
from limslam_env.worlds.world import World, WorldError

RADIUS = 0.10
ROOM = [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]


def found(walls, turn: float = 0.0) -> list[tuple[float, float, float]]:
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    edges = (np.array(walls, dtype=float).reshape(-1, 2) @ rotation).reshape(-1, 4)
    gaps = openings(edges, (), RADIUS)
    middles = np.array([(gap.x, gap.y) for gap in gaps]).reshape(-1, 2) @ rotation.T
    return [(x, y, gap.width) for (x, y), gap in zip(middles.tolist(), gaps, strict=True)]


def near(*gap: float):
    return pytest.approx(gap, abs=0.06)


def test_a_closed_outline_and_one_that_is_open_for_smaller_robots_have_none():
    assert found(ROOM) == []
    assert found([[0, 0, 3, 0], [3.15, 0, 6, 0], *ROOM[1:]]) == []


@pytest.mark.parametrize("turn", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("width", [0.3, 0.9, 2.0])
def test_a_gap_is_found_with_its_width(width, turn):
    walls = [*ROOM[:2], [6, 4, 3 + width, 4], [3, 4, 0, 4], ROOM[3]]
    assert found(walls, turn) == [near(3 + width / 2, 4, width)]


def test_doors_inside_are_none_even_where_they_are_narrower():
    inner = [[3, 0, 3, 1.5], [3, 2.4, 3, 4]]
    for width in (0.6, 0.9, 1.2):
        left = [[0, 4, 0, 2 + width / 2], [0, 2 - width / 2, 0, 0]]
        assert found([*ROOM[:3], *left, *inner]) == [near(0, 2, width)]


def test_all_gaps_are_found_and_no_courtyard():
    two = [[0, 0, 0.8, 0], [1.2, 0, 6, 0], [6, 0, 6, 2.6], [6, 3.4, 6, 4], *ROOM[2:]]
    assert found(two) == [near(6, 3, 0.8), near(1, 0, 0.4)]
    # A building in the shape of a U, with a door of 0.8 m at the end of a yard 2 m wide.
    yard = [[10, 8, 6, 8], [6, 8, 6, 2], [6, 2, 5.4, 2], [4.6, 2, 4, 2], [4, 2, 4, 8], [4, 8, 0, 8]]
    assert found([[0, 0, 10, 0], [10, 0, 10, 8], *yard, [0, 8, 0, 0]]) == [near(5, 2, 0.8)]


def test_walls_of_thick_lines_have_one_gap():
    inner = [[0, 0, 2.55, 0], [3.45, 0, 6, 0], *ROOM[1:]]
    outer = [[-0.2, -0.2, 2.55, -0.2], [3.45, -0.2, 6.2, -0.2], [6.2, -0.2, 6.2, 4.2]]
    outer += [[6.2, 4.2, -0.2, 4.2], [-0.2, 4.2, -0.2, -0.2]]
    jambs = [[2.55, 0, 2.55, -0.2], [3.45, 0, 3.45, -0.2]]
    ((x, _, width),) = found([*inner, *outer, *jambs])
    assert (x, width) == near(3.0, 0.9)


def test_few_walls_enclose_nothing():
    assert found([[0, 0, 5, 0]]) == []
    assert found([[0, 0, 5, 0], [5, 0, 5, 5]]) == []


def test_a_check_says_where_a_robot_could_leave():
    walls = np.array([*ROOM[:2], [6, 4, 4, 4], [3, 4, 0, 4], ROOM[3]], dtype=float)
    words = r"the outline is open at \(3\.50, 4\.00\), 1\.00 m wide$"
    with pytest.raises(WorldError, match=f"no closed region has room .*; {words}"):
        World("hall", (6.0, 4.0), walls).check(RADIUS)
    with pytest.raises(WorldError, match=f"could leave the world; {words}"):
        World("hall", (6.0, 4.0), walls, starts=np.array([[1.0, 1.0, 0.0]])).check(RADIUS)
