"""WallPolicy and its parts: which stretch it looks at, from where, how it sweeps, and that it always ends."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.beliefs import BLOCKED, CONFIG, ROBOT, belief_of

from limslam_agent import Belief
from limslam_agent.grid.occupancy import GridView
from limslam_agent.grid.unfinished import Faces
from limslam_agent.policies.controller import PATIENCE
from limslam_agent.policies.wall_look import sweep_along
from limslam_agent.policies.wall_policy import WallPolicy
from limslam_agent.policies.wall_views import View, next_view, open_border
from limslam_agent.runs.episode import run_episode
from limslam_agent.runs.run_config import RunConfig
from limslam_env import World
from limslam_env.geometry import FloatArray, se2

CELL = 0.1
# A room of 3 m by 2.4 m: its grid, and its walls.
COLUMNS, ROWS = 30, 24
_VALUES = np.full((ROWS + 2, COLUMNS + 2), -4, dtype=np.int16)
_VALUES[1:-1, 1:-1] = 2
ROOM = GridView(np.full(2, -CELL), CELL, _VALUES)
WALLS = np.array([[0.0, 0.0, 3.0, 0.0], [3.0, 0.0, 3.0, 2.4], [3.0, 2.4, 0.0, 2.4], [0.0, 2.4, 0.0, 0.0]])


def with_gap(side: int, start: float, length: float) -> FloatArray:
    """The walls of the room, with a gap in one of them."""
    wall = WALLS[side]
    along = (wall[2:] - wall[:2]) / np.hypot(*(wall[2:] - wall[:2]))
    low, high = wall[:2] + start * along, wall[:2] + (start + length) * along
    return np.vstack((np.delete(WALLS, side, axis=0), [*wall[:2], *low], [*high, *wall[2:]]))


def belief_at(pose: FloatArray, walls: FloatArray, ranges: FloatArray = ROBOT.max_ranges) -> Belief:
    return replace(belief_of(np.asarray(pose, dtype=float), ROOM, ranges), segments=walls)


def test_in_a_room_with_all_its_walls_there_is_nothing_to_look_at() -> None:
    assert not len(open_border(belief_at([1.5, 1.2, 0.0], WALLS), []))
    policy = WallPolicy(ROBOT, CONFIG)
    np.testing.assert_array_equal(policy.act(belief_at([1.5, 1.2, 0.0], WALLS)), [0.0, 0.0])
    assert policy.stop_reason == "explored: no frontier is left, and all walls were looked at"


@settings(deadline=None, max_examples=40)
@given(
    side=st.integers(0, 3),
    start=st.floats(0.3, 1.3),
    length=st.floats(0.35, 0.8),
    place=st.tuples(st.floats(0.3, 2.7), st.floats(0.3, 2.1)),
)
def test_a_missing_part_of_a_wall_is_looked_at_from_a_place_that_sees_it(side, start, length, place) -> None:
    walls = with_gap(side, start, length)
    belief = belief_at([*place, 0.0], walls)
    border = open_border(belief, [])
    view = next_view(belief, border, ROBOT)
    assert view is not None
    # A view may show a part of a stretch. What it shows is not looked at again.
    assert len(open_border(belief, [view.faces])) <= len(border) - len(view.faces)
    wall = WALLS[side]
    along = (wall[2:] - wall[:2]) / np.hypot(*(wall[2:] - wall[:2]))
    assert start < (view.middle - wall[:2]) @ along < start + length
    assert np.abs(np.hypot(*(view.path[0] - place))) < CELL
    np.testing.assert_allclose(view.path[-1], view.stand)
    # The robot can turn there, and a beam reaches the wall at a steep angle.
    assert (np.minimum(view.stand, [3.0, 2.4] - view.stand) >= ROBOT.radius).all()
    away = view.stand - view.middle
    assert np.hypot(*away) <= ROBOT.radius + 0.7 * ROBOT.reach
    assert abs(away @ along) <= 0.9 * np.hypot(*away)


def view_of(middle: FloatArray, count: int, stand: FloatArray) -> View:
    """A view of a stretch that lies along x, of ``count`` faces."""
    offset = CELL * (np.arange(count) - 0.5 * (count - 1))
    middles = np.column_stack((middle[0] + offset, np.full(count, middle[1])))
    faces = Faces(middles, np.tile([0.0, 1.0], (count, 1)))
    return View(faces, stand, stand[None], CELL)


@settings(deadline=None, max_examples=60)
@given(
    heading=st.floats(-math.pi, math.pi),
    count=st.integers(2, 8),
    away=st.floats(0.3, 0.9),
)
def test_a_sweep_lets_a_beam_pass_over_the_whole_stretch(heading, count, away) -> None:
    view = view_of(np.array([1.0, 0.0]), count, np.array([1.0, away]))
    sweep = sweep_along(view, np.array([1.0, away, heading]), ROBOT)
    first, width = view.bearings(view.stand)
    assert width == pytest.approx(2.0 * math.atan2(0.5 * CELL * count, away), rel=0.3)
    headings = np.linspace(sweep.start, sweep.end, 400)
    pointing = headings[:, None] + ROBOT.beam_angles
    inside = (se2.wrap_angle(pointing - first) >= 0.0) & (se2.wrap_angle(pointing - first) <= width)
    swept = [beam for beam in range(6) if inside[0, beam] == inside[-1, beam] == False and inside[:, beam].any()]  # noqa: E712
    assert swept
    assert math.radians(1.0) < sweep.step <= math.radians(5.0)
    assert sweep.left(sweep.start) == pytest.approx(abs(sweep.end - sweep.start), abs=1e-9)
    assert sweep.left(sweep.end) == pytest.approx(0.0, abs=1e-9)


def test_a_robot_that_cannot_move_gives_every_look_up_and_ends() -> None:
    policy = WallPolicy(ROBOT, CONFIG)
    belief = belief_at([2.5, 1.9, 0.0], with_gap(0, 0.6, 0.8), BLOCKED)
    steps = 0
    while policy.stop_reason is None and steps < 3000:
        policy.act(belief)
        steps += 1
    assert policy.stop_reason == "explored: no frontier is left, and some walls cannot be looked at"
    assert PATIENCE < steps < 1000
    np.testing.assert_array_equal(policy.act(belief), [0.0, 0.0])
    assert policy.goal is None
    assert len(policy.plan) == 0


def room_world() -> World:
    """A room of 2.6 m by 2 m with a short wall, and a block of which each side is 0.4 m long."""
    walls = [[0, 0, 2.6, 0], [2.6, 0, 2.6, 2], [2.6, 2, 0, 2], [0, 2, 0, 0], [1.9, 2, 1.9, 1.5]]
    block = np.array([[1.0, 0.7], [1.4, 0.7], [1.4, 1.1], [1.0, 1.1]])
    return World("room", (2.6, 2.0), np.array(walls, dtype=float), [block], starts=np.array([[0.4, 1.5, 0.0]]))


def run(until: str | None, **changes: object):
    return run_episode(RunConfig(room_world(), 0.02, "consistent", 100, 600.0, until=until, **changes))


def test_a_run_until_the_walls_are_whole_finds_more_walls_and_says_so() -> None:
    seen, walls = run("seen"), run("walls")
    assert seen.stop_reason.startswith("explored: ")
    assert "wall" not in seen.stop_reason
    assert walls.is_finished
    assert walls.stop_reason.startswith("explored: ")
    assert walls.stop_reason.endswith(", and all walls were looked at")
    assert not walls.contact.any()
    # The walls are looked at after everything was seen, and until then nothing is different.
    assert len(walls.time) > len(seen.time)
    np.testing.assert_array_equal(walls.true[: len(seen.time)], seen.true)
    lengths = [
        np.hypot(*(run.snapshot.segments[:, 2:] - run.snapshot.segments[:, :2]).T).sum() for run in (seen, walls)
    ]
    assert lengths[1] > lengths[0] + 0.2


def test_two_robots_look_at_the_walls_together() -> None:
    episode = run("walls", robots=2)
    assert episode.is_finished
    assert "all walls were looked at" in episode.stop_reason
