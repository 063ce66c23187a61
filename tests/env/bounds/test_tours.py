"""Tours for a robot that knows the map: they can be driven, and driving them shows everything."""

import math

import numpy as np
import pytest

from limslam_env import FloorPlanConfig, LimSlamParallelEnv, RobotSpec, World, load_world
from limslam_env.bounds import tours
from limslam_env.bounds.roadmap import LEAST_GAP, Roadmap
from limslam_env.bounds.tours import Speeds, closed_tour, coverage_tour, poses_along, top_speeds
from limslam_env.geometry.segment import distances
from limslam_env.simulation.coverage import BeamSweep, coverage_grid
from limslam_env.worlds.generation.floor_plans import floor_plan
from limslam_env.worlds.world import WorldError

ROBOT = RobotSpec()
ROOM = [[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]]
# Two rooms and a door of 0.3 m, where the robot's disc of 0.2 m has 5 cm to spare on either side; a room without one.
ROOMS = World("rooms", (6.0, 3.0), [*ROOM, [2, 0, 2, 1.7], [2, 2.0, 2, 3], [4, 0, 6, 0], [6, 0, 6, 3], [6, 3, 4, 3]])
SCREEN = World("screen", (4.0, 3.0), [*ROOM, [2, 0, 2, 2]])
START = np.array([1.0, 1.0, 0.0])


def driven(world, start, way):
    """Poses of a drive along a tour at top speed, and the share that they cover."""
    poses = poses_along(start, way, ROBOT, top_speeds(ROBOT))
    grid = coverage_grid(world, ROBOT, start[None])
    new = BeamSweep(world, ROBOT, grid).mark(poses, np.zeros_like(grid.coverable))
    return poses, np.cumsum(new) / grid.total


def test_a_sweep_covers_what_the_environment_counts():
    env = LimSlamParallelEnv("env3", num_robots=1, coverage_goal=None)
    _, infos = env.reset(seed=7)
    actions = np.random.default_rng(7).uniform(-0.2, 1.0, (300, 2))
    truth = [infos["robot_0"], *(env.step({"robot_0": action})[4]["robot_0"] for action in actions)]
    seen = np.zeros_like(env.coverage_grid.coverable)
    poses = np.array([info["pose"] for info in truth])
    new = BeamSweep(env.world, ROBOT, env.coverage_grid).mark(poses, seen)
    np.testing.assert_array_equal(np.cumsum(new) / env.coverage_grid.total, [info["coverage"] for info in truth])
    np.testing.assert_array_equal(seen, env.seen)


def test_poses_of_a_drive_by_hand():
    # 0.09 m are three steps of 0.03 m; half a turn takes two steps of a quarter, and then 0.04 m two more.
    speeds = Speeds(0.3, 0.5 * math.pi / ROBOT.control_period)
    poses = poses_along(np.zeros(3), np.array([[0.09, 0.0], [0.05, 0.0]]), ROBOT, speeds)
    np.testing.assert_allclose(poses[:, 0], [0.0, 0.03, 0.06, 0.09, 0.09, 0.09, 0.06, 0.05], atol=1e-12)
    np.testing.assert_allclose(np.abs(poses[:, 2]), [0, 0, 0, 0, 0.5 * math.pi, math.pi, math.pi, math.pi])
    assert not poses[:, 1].any()


@pytest.mark.parametrize("name", ["env1", "env2", "env3", "plan"])
def test_driving_a_coverage_tour_shows_everything_and_touches_nothing(name):
    small = FloorPlanConfig(width=6.0, height=6.0)
    world = floor_plan(small, np.random.default_rng(5), ROBOT.radius) if name == "plan" else load_world(name)
    space = world.free_space(ROBOT.radius)
    place = space.centres(space.largest_closed_region())[40]
    start = world.starts[0] if len(world.starts) else np.array([*place, 0.3])
    way = coverage_tour(world, ROBOT, start, evaluations=200)
    poses, covered = driven(world, start, way)
    assert covered[-1] >= 0.99
    # The frontier explorer needs 158 s and more.
    assert len(poses) * ROBOT.control_period < 130.0
    away = distances(poses[:, :2], world.edges).min(axis=1)
    assert away.min() > ROBOT.radius + 0.3 * LEAST_GAP


def test_what_has_been_seen_is_not_gone_to_again():
    grid = coverage_grid(SCREEN, ROBOT, START[None])
    seen = np.zeros_like(grid.coverable)
    assert len(coverage_tour(SCREEN, ROBOT, START, seen=~seen, evaluations=50)) == 0
    seen[:, : seen.shape[1] // 2] = True  # the half in which it stands
    way = coverage_tour(SCREEN, ROBOT, START, seen=seen, evaluations=50)
    assert way[:, 0].max() > 2.0
    new = BeamSweep(SCREEN, ROBOT, grid).mark(poses_along(START, way, ROBOT, top_speeds(ROBOT)), seen)
    assert new.sum() > 0
    assert np.count_nonzero(seen & grid.coverable) >= 0.99 * grid.total


def test_a_closed_tour_goes_round_the_worlds_loop():
    world = load_world("square")
    way = closed_tour(world, ROBOT, world.starts[0], laps=2)
    first = (int(np.argmin(np.hypot(*(world.loop - world.starts[0][:2]).T))) + 1) % len(world.loop)
    np.testing.assert_allclose(way[-8:], np.tile(np.roll(world.loop, -first, axis=0), (2, 1)))


def test_without_a_loop_a_closed_tour_shows_everything_and_leads_home():
    way = closed_tour(SCREEN, ROBOT, START, laps=2, evaluations=100)
    poses, covered = driven(SCREEN, START, way)
    assert covered[len(covered) // 2] >= 0.99
    np.testing.assert_allclose(poses[-1, :2], START[:2], atol=1e-9)
    np.testing.assert_array_equal(way[: len(way) // 2], way[len(way) // 2 :])


def test_a_loop_through_a_wall_is_refused():
    world = World("ring", (6.0, 3.0), ROOMS.walls, loop=[[1, 1], [5, 1], [5, 2]])
    with pytest.raises(WorldError, match="cannot drive along its loop"):
        closed_tour(world, ROBOT, START)


def test_where_there_is_no_room_there_is_no_tour():
    with pytest.raises(WorldError, match=r"no room to drive at \(2, 1\)"):
        coverage_tour(SCREEN, ROBOT, np.array([2.0, 1.0, 0.0]))


def test_a_building_that_would_take_hours_is_refused(monkeypatch):
    monkeypatch.setattr(tours, "MOST_CELLS", 1000)
    with pytest.raises(WorldError, match="'screen': 1200 cells are too many for a tour"):
        coverage_tour(SCREEN, ROBOT, START, evaluations=1)


def test_the_only_way_through_a_long_slanted_passage_is_found():
    # 3 m long and 0.3 m wide: no two places of the grid on its axis see each other.
    ahead, left = np.array([math.cos(0.2), math.sin(0.2)]), np.array([-math.sin(0.2), math.cos(0.2)])
    right_ends = np.array([[2.0, 1.0], [2.0, 1.0] + 3.0 * ahead])
    left_ends = right_ends + 0.3 * left
    (x1, x2), (x3, x4) = right_ends[:, 0], left_ends[:, 0]
    corners = [(0, 0), (x1, 0), *right_ends, (x2, 0), (8, 0), (8, 4), (x4, 4), *left_ends[::-1], (x3, 4), (0, 4)]
    world = World("passage", (8.0, 4.0), np.hstack((corners, np.roll(corners, -1, axis=0))))
    roads = Roadmap(world, ROBOT.radius, np.array([0.5, 3.5]))
    assert (roads.places[:, 0] > 5.5).sum() > 20
    assert np.isfinite(roads.lengths_from(0)).all()
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
    assert np.isfinite(roads.lengths_from(0)).all()
    assert roads.way(START[:2], np.array([3.0, 1.0])) is not None
    assert roads.way(START[:2], np.array([5.0, 1.0])) is None
