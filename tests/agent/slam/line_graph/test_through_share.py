"""The share of beams that go through drawn walls."""

import numpy as np
import pytest
from support.drives import ROBOT, ranges_at, room

from limslam_agent.slam.line_graph.through_share import Looks, compare_with_walls, through_share

WALLS = room(0.0, 0.0, 2.0, 2.0)
POSE = np.array([1.0, 0.8, 0.3])
SURE = np.diag([1e-6, 1e-6, 1e-6])
EVERY = np.ones(len(ROBOT.beams), dtype=bool)


def looks(segments, ranges=None, covariance=SURE, measured=EVERY):
    ranges = ranges_at(POSE, WALLS) if ranges is None else ranges
    return compare_with_walls(ROBOT, POSE, covariance, ranges, measured, segments, 0.02)


def test_a_right_map_is_not_contradicted():
    found = looks(WALLS)
    assert found.through == 0
    assert found.expected >= 4


def test_a_wall_too_near_is_gone_through():
    found = looks(np.array([[0.3, 1.3, 1.7, 1.3]]))
    assert found.through == found.expected > 0


def test_beams_that_see_nothing_count():
    found = looks(np.array([[0.3, 1.3, 1.7, 1.3]]), ROBOT.max_ranges)
    assert found.through == found.expected > 0


def test_an_unsure_pose_explains_a_miss():
    wall = np.array([[0.0, 1.75, 2.0, 1.75]])
    assert looks(wall).through > 0
    assert looks(wall, covariance=np.diag([0.01, 0.01, 1e-4])).through == 0


def test_ends_of_walls_do_not_count():
    # Beam 0 points to the left: it meets this wall 5 cm inside its end.
    heading = POSE[2] + ROBOT.beam_angles[0]
    x = POSE[0] + np.cos(heading) * 0.5 / np.sin(heading) + 0.05
    measured = np.arange(len(ROBOT.beams)) == 0
    assert looks(np.array([[0.0, 1.3, x, 1.3]]), measured=measured).expected == 0
    assert looks(np.array([[0.0, 1.3, x + 0.2, 1.3]]), measured=measured).expected == 1


def test_nothing_is_said_without_walls_or_readings():
    assert looks(np.zeros((0, 4))).expected == 0
    assert looks(WALLS, measured=~EVERY).expected == 0


def test_the_share_is_that_of_the_last_metres():
    steps = [Looks(2, 2)] * 20 + [Looks(2, 0)] * 40 + [Looks(2, 1)] * 10
    driven = 0.1 * np.arange(len(steps))
    assert through_share(steps, driven, window=1.0) == 0.0
    assert through_share(steps, driven, window=4.0) == pytest.approx(10 / 82)
    assert through_share(steps[:10], driven[:10]) == 0.0
