"""A kidnapped robot is placed among the walls that it was matched with, and is as uncertain as they are."""

import numpy as np
from support.walls import wall_along

from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.map_state import MapState, lines_moved_with
from limslam_env.geometry import line as line_geometry
from limslam_env.geometry import segment as segment_geometry

ROOM = np.array([[0, 0, 4, 0], [4, 0, 4, 3], [4, 3, 0, 3], [0, 3, 0, 0]], dtype=float)
LINES = np.array([[0.0, 0.5 * np.pi], [4.0, 0.0], [3.0, 0.5 * np.pi], [0.0, 0.0]])
POSE, MATCH = np.array([2.5, 1.0, 0.4]), np.diag([0.05, 0.05, 0.03]) ** 2
WORLD = np.diag([0.8, 0.6, 0.0]) ** 2  # covariance of the whole room in the world


def room_in_an_uncertain_world(count):
    """A filter, and its map of the first walls of a room."""
    ekf, walls = CloneEKF(np.array([9.0, 9.0, 0.0]), np.diag([0.01] * 3)), []
    for number, (segment, line) in enumerate(zip(ROOM[:count], LINES, strict=False)):
        points, _ = segment_geometry.sample(segment[None], 0.05)
        middle = points.mean(axis=0)
        ekf.add_known_line(line, 1e-8 * np.eye(2), middle)
        walls.append(wall_along(number, (points - middle) @ line_geometry.direction(line)))
    by_world = lines_moved_with((0.0, 0.0), ekf.anchored, ekf.anchors)
    ekf.P[3:, 3:] += by_world @ WORLD @ by_world.T
    return ekf, MapState(ekf.pose, ekf.anchored, ekf.anchors, ekf.marginal(), walls)


def ends(count):
    return segment_geometry.sample(ROOM[:count], 0.1)[0] + 0.02


def test_a_placed_robot_moves_with_the_walls_that_it_was_matched_with():
    ekf, state = room_in_an_uncertain_world(4)
    by_lines = state.by_walls(POSE, ends(4))
    with_all = by_lines @ lines_moved_with((2.5, 1.0), state.lines, state.anchors)
    np.testing.assert_allclose(with_all, np.eye(3), atol=1e-12)
    ekf.relocate(POSE, MATCH, by_lines=by_lines)
    np.testing.assert_array_equal(ekf.pose, POSE)
    np.testing.assert_allclose(ekf.joint_pose_covariance, WORLD + MATCH, atol=1e-5)
    # A later correction moves the right wall by 0.5 m. The robot follows, and is known as well as its match then.
    gain = ekf.P[:, 5] / (ekf.P[5, 5] + 1e-8)
    ekf.x[:] += 0.5 * gain
    ekf.P[:] -= np.outer(gain, ekf.P[5])
    np.testing.assert_allclose(ekf.pose, POSE + np.array([0.5, 0.0, 0.0]), atol=1e-3)
    np.testing.assert_allclose(
        np.sqrt(np.diag(ekf.joint_pose_covariance)), [0.05, np.hypot(0.6, 0.05), 0.03], atol=1e-3
    )
