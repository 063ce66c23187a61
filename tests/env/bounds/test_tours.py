"""Tours for a driver that knows the map: they can be driven."""

import math

import numpy as np
import pytest

from limslam_env import RobotSpec, World, load_world
from limslam_env.bounds import Roadmap, Speeds, loop_tour, poses_along

ROBOT = RobotSpec()
ROOM = [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]]
# Two rooms and a door of 0.3 m, where the robot's disc of 0.2 m has 5 cm to spare on either side; a
# room without one.
ROOMS = World(
    "rooms",
    (6.0, 3.0),
    [*ROOM, [2, 0, 2, 1.7], [2, 2.0, 2, 3], [4, 0, 6, 0], [6, 0, 6, 3], [6, 3, 4, 3]],
)
SCREEN = World("screen", (4.0, 3.0), [*ROOM, [2, 0, 2, 2]])
START = np.array([1.0, 1.0, 0.0])


def test_poses_of_a_drive_by_hand():
    # 0.09 m are three steps of 0.03 m; half a turn takes two steps of a quarter, and then 0.04 m
    # two more.
    speeds = Speeds(0.3, 0.5 * math.pi / ROBOT.control_period)
    poses = poses_along(np.zeros(3), np.array([[0.09, 0.0], [0.05, 0.0]]), ROBOT, speeds)
    np.testing.assert_allclose(
        poses[:, 0], [0.0, 0.03, 0.06, 0.09, 0.09, 0.09, 0.06, 0.05], atol=1e-12
    )
    np.testing.assert_allclose(
        np.abs(poses[:, 2]), [0, 0, 0, 0, 0.5 * math.pi, math.pi, math.pi, math.pi]
    )
    assert not poses[:, 1].any()


def test_a_tour_goes_round_the_worlds_loop():
    world = load_world("square")
    way = loop_tour(world, ROBOT, world.starts[0], laps=2)
    first = (int(np.argmin(np.hypot(*(world.loop - world.starts[0][:2]).T))) + 1) % len(world.loop)
    np.testing.assert_allclose(way[-8:], np.tile(np.roll(world.loop, -first, axis=0), (2, 1)))


def test_a_loop_through_a_wall_is_refused():
    world = World("ring", (6.0, 3.0), ROOMS.walls, loop=[[1, 1], [5, 1], [5, 2]])
    with pytest.raises(ValueError, match="cannot drive along its loop"):
        loop_tour(world, ROBOT, START)


def test_where_there_is_no_room_there_is_no_tour():
    with pytest.raises(ValueError, match=r"no room to drive at \(2, 1\)"):
        Roadmap(SCREEN, ROBOT.radius, np.array([2.0, 1.0]))


def test_the_only_way_through_a_long_slanted_passage_is_found():
    # 3 m long and 0.3 m wide: no two places of the grid on its axis see each other.
    ahead = np.array([math.cos(0.2), math.sin(0.2)])
    left = np.array([-math.sin(0.2), math.cos(0.2)])
    right_ends = np.array([[2.0, 1.0], [2.0, 1.0] + 3.0 * ahead])
    left_ends = right_ends + 0.3 * left
    (x1, x2), (x3, x4) = right_ends[:, 0], left_ends[:, 0]
    corners = [
        (0, 0),
        (x1, 0),
        *right_ends,
        (x2, 0),
        (8, 0),
        (8, 4),
        (x4, 4),
        *left_ends[::-1],
        (x3, 4),
        (0, 4),
    ]
    world = World("passage", (8.0, 4.0), np.hstack((corners, np.roll(corners, -1, axis=0))))
    roads = Roadmap(world, ROBOT.radius, np.array([0.5, 3.5]))
    assert (roads.places[:, 0] > 5.5).sum() > 20
    assert all(roads.way(roads.places[0], place) is not None for place in roads.places)
    way = np.vstack(([[0.5, 3.5]], roads.way(np.array([0.5, 3.5]), np.array([7.5, 0.5]))))
    assert roads.is_free(way[:-1], way[1:]).all()


def test_ways_go_round_what_stands_there():
    roads = Roadmap(SCREEN, ROBOT.radius, START[:2])
    way = np.vstack((START[:2], roads.way(START[:2], np.array([3.0, 1.0]))))
    # Over the end of the screen at (2, 2): the body keeps 0.13 m off it.
    shortest = 2.0 * math.hypot(1.0, 1.13)
    assert shortest < np.hypot(*np.diff(way, axis=0).T).sum() < 1.15 * shortest
    assert roads.is_free(way[:-1], way[1:]).all()
    assert not roads.is_free(START[:2], np.array([3.0, 1.0]))[0]


def test_ways_find_narrow_doors_and_no_closed_rooms():
    roads = Roadmap(ROOMS, ROBOT.radius, START[:2])
    assert (roads.places[:, 0] > 2.5).any()
    assert (roads.places[:, 0] < 4.0).all()
    assert all(roads.way(roads.places[0], place) is not None for place in roads.places)
    assert roads.way(START[:2], np.array([3.0, 1.0])) is not None
    assert roads.way(START[:2], np.array([5.0, 1.0])) is None
