"""Normals, links and wall lines, against what plain numpy gives; local smoothing of a bent corridor."""

import numpy as np
import pytest
from support.corridors import corridor_log

from limslam_agent.config.graph import GraphConfig, WallLineConfig
from limslam_agent.slam.graph.key_poses import ERRORS, Trajectory, choose_keys
from limslam_agent.slam.graph.point_links import find_normals, links_across, point_cloud
from limslam_agent.slam.graph.wall_lines import lines_in

CONFIG = GraphConfig()


@pytest.fixture(scope="module")
def drive():
    log, truth = corridor_log(laps=1)
    keys = choose_keys(log, CONFIG.keys)
    return log, truth, keys


def test_normals_of_a_wall_point_to_the_sensor():
    x = np.linspace(0.0, 3.0, 61)
    places = np.column_stack((x, np.full(61, 1.0)))
    normals, good = find_normals(places, np.column_stack((x, np.zeros(61))), x, 0.0)
    assert good.all()
    assert np.allclose(normals, [0.0, -1.0], atol=1e-9)


def test_walls_of_a_window_are_found_with_their_points():
    generator = np.random.default_rng(2)
    along = np.sort(generator.uniform(0.0, 4.0, 60))
    sides = [np.column_stack((along, np.full(60, y))) + generator.normal(0.0, 0.01, (60, 2)) for y in (1.0, -1.0)]
    places = np.vstack(sides)
    normals = np.vstack((np.tile([0.0, -1.0], (60, 1)), np.tile([0.0, 1.0], (60, 1))))
    lines = lines_in(places, normals, np.ones(120, dtype=bool), np.array([[0, 120]]), WallLineConfig())
    assert len(lines.angles) == 2
    assert sorted(np.round(lines.centres[:, 1], 1)) == [-1.0, 1.0]
    assert np.bincount(lines.lines).tolist() == [60, 60]
    assert np.abs(np.cos(lines.angles)).max() < 0.02


def test_visits_are_linked_to_the_nearest_point_of_another_visit():
    log, truth = corridor_log(laps=2)
    keys = choose_keys(log, CONFIG.keys)
    cloud = point_cloud(keys, Trajectory(truth[keys.first_event], np.zeros(ERRORS)), 0.01)
    links = links_across(cloud, 0.3)
    assert len(links) > 0.3 * len(cloud.travel)
    point = links[len(links) // 2, 0]
    other = links[links[:, 0] == point][0, 1]
    fits = cloud.good & (np.abs(cloud.travel - cloud.travel[point]) > 13.5)
    fits &= cloud.normals @ cloud.normals[point] > 0.85
    apart = np.where(fits, np.hypot(*(cloud.places - cloud.places[point]).T), np.inf)
    assert apart[other] == apart.min() <= 0.3
