"""A robot that is found where its covariance explains has closed a loop: the map moves with it."""

import numpy as np
import pytest
from support.walls import wall_along

from limslam_agent.config.exploration import GridConfig
from limslam_agent.grid.occupancy import GridView, OccupancyGrid
from limslam_agent.slam.consistent.map_state import MapState, lines_moved_with, poses_moved_with
from limslam_env.geometry import line as line_geometry
from limslam_env.geometry import se2
from limslam_env.geometry import segment as segment_geometry

MATCH = np.diag([0.05, 0.05, 0.03]) ** 2
POSE, DRIFT = np.array([2.5, 1.0, 0.4]), np.array([1.2, -0.8, 0.06])
NEAR = np.array([[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]], dtype=float)
AWAY = np.array([[8, 0, 8, 3], [8, 3, 12, 3], [12, 3, 12, 0]], dtype=float)


def walls_of(segments):
    """Lines (m, 2) about the middles of walls, these middles, and the walls with their extents."""
    middles, walls = 0.5 * (segments[:, :2] + segments[:, 2:]), []
    lines = np.column_stack((np.zeros(len(segments)), np.arctan2(*(segments[:, 2:] - segments[:, :2]).T[::-1])))
    lines[:, 1] -= 0.5 * np.pi
    for number, (segment, line, middle) in enumerate(zip(segments, lines, middles, strict=True)):
        walls.append(
            wall_along(
                number, (segment_geometry.sample(segment[None], 0.05)[0] - middle) @ line_geometry.direction(line)
            )
        )
    return lines, middles, walls


def drifted(stds, world=0.0):
    """A room that is known, another one that was seen after a drift, and the robot, which is back in the first room.

    The standard deviations (3,) of the drift are stated, and that of the direction of the whole world.
    """
    lines, middles, walls = walls_of(np.concatenate((NEAR, AWAY)))
    place = POSE + DRIFT
    by_drift = np.vstack((np.eye(3), lines_moved_with(tuple(place[:2]), lines, middles)))
    by_drift[3 : 3 + 2 * len(NEAR)] = 0.0
    wrong = middles.copy()
    wrong[len(NEAR) :] = se2.transform_points(DRIFT * [0, 0, 1], middles[len(NEAR) :] - POSE[:2]) + place[:2]
    lines[len(NEAR) :, 1] += DRIFT[2]
    by_world = np.vstack((poses_moved_with((0.0, 0.0), place[None]), lines_moved_with((0.0, 0.0), lines, wrong)))[:, 2]
    covariance = by_drift @ np.diag(np.square(stds)) @ by_drift.T + world**2 * np.outer(by_world, by_world)
    return MapState(place, lines, wrong, covariance + 1e-8 * np.eye(len(covariance)), walls)


def test_a_loop_moves_what_was_seen_since_the_robot_left():
    state, right = drifted([1.0, 1.0, 0.1]), walls_of(AWAY)
    after, motions = state.closed(POSE, MATCH, segment_geometry.sample(NEAR, 0.1)[0])
    np.testing.assert_allclose(after.pose, POSE, atol=0.02)
    np.testing.assert_allclose(after.lines[: len(NEAR)], state.lines[: len(NEAR)], atol=1e-3)
    away = slice(len(NEAR), None)
    np.testing.assert_allclose(after.lines[away, 1], right[0][:, 1], atol=0.01)
    feet = after.anchors[away] + after.lines[away, :1] * line_geometry.normal(after.lines[away])
    np.testing.assert_allclose(feet, right[1], atol=0.1)  # along the walls, too
    np.testing.assert_allclose(motions[away, 2], -DRIFT[2], atol=0.01)
    np.testing.assert_allclose(motions[: len(NEAR)], 0.0, atol=0.05)
    assert np.sqrt(after.covariance[0, 0]) < 0.06
    assert np.linalg.eigvalsh(after.covariance).min() > -1e-9


def test_a_loop_says_nothing_of_the_direction_of_the_world():
    state = drifted([1.0, 1.0, 0.1], world=0.2)
    after, _ = state.closed(POSE, MATCH, segment_geometry.sample(NEAR, 0.1)[0])
    assert np.sqrt(after.covariance[4, 4]) == pytest.approx(0.2, rel=0.01)
    assert np.sqrt(after.covariance[2, 2]) == pytest.approx(np.hypot(0.2, 0.03), rel=0.02)


def test_a_pose_that_the_covariance_does_not_explain_closes_no_loop():
    assert drifted([0.2, 0.2, 0.02]).closed(POSE, MATCH, segment_geometry.sample(NEAR, 0.1)[0]) is None
    assert drifted([1.0, 1.0, 0.1]).closed(POSE, MATCH, segment_geometry.sample(NEAR[:1], 0.1)[0][5:-5]) is None, (
        "one wall determines no pose"
    )


def test_cells_move_with_the_nearest_wall():
    values = np.zeros((20, 60), dtype=np.int16)
    values[5, 10], values[5, 50] = -3, 7
    grid = OccupancyGrid.of(GridView(np.zeros(2), 0.1, values), GridConfig())
    grid.bend(np.array([[1.0, 0.5], [5.0, 0.5]]), np.array([[0.0, 0.0, 0.0], [0.3, -0.2, 0.0]]))
    found = grid.view.values_at(np.array([[1.05, 0.55], [5.05, 0.55], [5.35, 0.35]]))
    np.testing.assert_array_equal(found, [-3, 0, 7])
