"""Normals, links and wall lines, against what plain numpy gives; local smoothing of a bent corridor."""

import numpy as np
import pytest
from support.corridors import corridor_log, loop_errors

from limslam_agent.config.graph import GraphConfig, WallLineConfig
from limslam_agent.slam.graph import point_links
from limslam_agent.slam.graph.key_poses import ERRORS, Trajectory, choose_keys, event_poses, odometry_trajectory
from limslam_agent.slam.graph.local_smoothing import chained, smooth_locally
from limslam_agent.slam.graph.point_links import PointCloud, find_normals, links_across, links_along, point_cloud
from limslam_agent.slam.graph.wall_lines import lines_in

CONFIG = GraphConfig()


@pytest.fixture(scope="module")
def drive():
    log, truth = corridor_log(laps=1)
    keys = choose_keys(log, CONFIG.keys)
    return log, truth, keys


@pytest.fixture(scope="module")
def true_cloud(drive):
    log, truth, keys = drive
    exact = Trajectory(truth[keys.first_event], np.zeros(ERRORS))
    return point_cloud(keys, exact, log.range_std)


def test_normals_of_a_wall_point_to_the_sensor():
    x = np.linspace(0.0, 3.0, 61)
    places = np.column_stack((x, np.full(61, 1.0)))
    normals, good = find_normals(places, np.column_stack((x, np.zeros(61))), x, 0.0)
    assert good.all()
    assert np.allclose(normals, [0.0, -1.0], atol=1e-9)


def test_scattered_points_and_grazed_walls_have_no_trusted_normal():
    generator = np.random.default_rng(0)
    places = generator.uniform(0.0, 1.0, (100, 2))
    assert find_normals(places, np.full((100, 2), 5.0), np.zeros(100), 0.0)[1].mean() < 0.2
    x = np.linspace(0.0, 3.0, 61)
    wall = np.column_stack((x, np.zeros(61)))
    assert not find_normals(wall, np.column_stack((x - 10.0, np.full(61, 0.5))), x, 0.0)[1].any()


def test_links_are_the_nearest_points_of_their_band(true_cloud):
    links = links_along(true_cloud)
    gap = np.abs(true_cloud.travel[links[:, 0]] - true_cloud.travel[links[:, 1]])
    assert gap.min() >= point_links._BANDS[0]
    assert gap.max() <= point_links._BANDS[-1]
    cosine = np.sum(true_cloud.normals[links[:, 0]] * true_cloud.normals[links[:, 1]], axis=1)
    assert cosine.min() > point_links._MIN_COSINE
    row = len(links) // 2
    point = links[row, 0]
    apart = np.column_stack((true_cloud.places, 0.035 * true_cloud.travel[:, None])) - np.append(
        true_cloud.places[point], 0.035 * true_cloud.travel[point]
    )
    reach = np.abs(true_cloud.travel - true_cloud.travel[point])
    lower = max(border for border in (0.4, 1.2, 3.0) if border <= gap[row])
    upper = min(border for border in (1.2, 3.0, 10.01) if border > gap[row])
    fits = true_cloud.good & (reach >= lower) & (reach < upper) & (true_cloud.key != true_cloud.key[point])
    fits &= true_cloud.normals @ true_cloud.normals[point] > point_links._MIN_COSINE
    offset = true_cloud.places[point] - true_cloud.places
    fits &= np.abs(np.sum(offset * true_cloud.normals, axis=1)) < point_links._MAX_OFFSET * point_links._RADIUS
    distances = np.where(fits, np.linalg.norm(apart, axis=1), np.inf)
    assert distances[links[row, 1]] == pytest.approx(distances.min())


def test_visits_are_linked_across_and_only_they():
    log, truth = corridor_log(laps=2)
    keys = choose_keys(log, CONFIG.keys)
    cloud = point_cloud(keys, Trajectory(truth[keys.first_event], np.zeros(ERRORS)), 0.01)
    links = links_across(cloud, 0.3)
    gap = np.abs(cloud.travel[links[:, 0]] - cloud.travel[links[:, 1]])
    assert len(links) > 0.3 * len(cloud.travel)
    assert gap.min() > point_links._CROSS_TRAVEL
    assert np.hypot(*(cloud.places[links[:, 0]] - cloud.places[links[:, 1]]).T).max() <= 0.3


def test_walls_of_a_window_are_found_with_their_points():
    generator = np.random.default_rng(2)
    along = np.sort(generator.uniform(0.0, 4.0, 60))
    sides = [np.column_stack((along, np.full(60, y))) + generator.normal(0.0, 0.01, (60, 2)) for y in (1.0, -1.0)]
    places = np.vstack(sides)
    normals = np.vstack((np.tile([0.0, -1.0], (60, 1)), np.tile([0.0, 1.0], (60, 1))))
    lines = lines_in(places, normals, np.ones(120, dtype=bool), np.array([[0, 120]]), WallLineConfig(), 0.12)
    assert len(lines.angles) == 2
    assert sorted(np.round(lines.centres[:, 1], 1)) == [-1.0, 1.0]
    assert np.bincount(lines.lines).tolist() == [60, 60]
    assert np.abs(np.cos(lines.angles)).max() < 0.02


def test_a_gap_ends_a_wall():
    along = np.concatenate((np.linspace(0.0, 2.0, 30), np.linspace(4.5, 6.5, 30)))
    places = np.column_stack((along, np.zeros(60)))
    normals = np.tile([0.0, 1.0], (60, 1))
    lines = lines_in(places, normals, np.ones(60, dtype=bool), np.array([[0, 60]]), WallLineConfig(), 0.12)
    assert np.bincount(lines.lines).tolist() == [30, 30]


def test_a_chained_step_turns_all_that_comes_later(drive):
    _, _, keys = drive
    before = odometry_trajectory(keys, np.zeros(3))
    by_pose = np.zeros((len(keys), 3))
    by_pose[50:, 2] = 0.3
    by_pose[50:, :2] = 0.3 * (before.poses[50:, :2] - before.poses[49, :2]) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    after = chained(before, np.append(by_pose.ravel(), np.zeros(ERRORS)))
    lengths = [np.hypot(*np.diff(each.poses[:, :2], axis=0).T) for each in (before, after)]
    assert np.allclose(after.poses[:50], before.poses[:50])
    assert np.allclose(lengths[0][50:], lengths[1][50:], rtol=1e-6)
    assert np.hypot(*(after.poses[-1] - before.poses[-1])[:2]) > 0.5


def test_local_smoothing_makes_the_way_straight(drive):
    log, truth, keys = drive
    raw = odometry_trajectory(keys, truth[0])
    smooth = smooth_locally(keys, raw, CONFIG, log.range_std)
    errors = [loop_errors(event_poses(keys, each), truth, 100).mean() for each in (raw, smooth)]
    assert errors[1] < 0.4 * errors[0]


def test_a_cloud_is_the_same_wherever_the_frame_is(drive, true_cloud):
    log, truth, keys = drive
    cos, sin = np.cos(2.5), np.sin(2.5)
    turned = truth[keys.first_event] @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    cloud = point_cloud(keys, Trajectory(turned + np.array([0.0, 0.0, 2.5]), np.zeros(ERRORS)), log.range_std)
    assert isinstance(cloud, PointCloud)
    assert np.allclose(cloud.normals_in_key, true_cloud.normals_in_key, atol=1e-6)
    assert np.array_equal(cloud.good, true_cloud.good)
