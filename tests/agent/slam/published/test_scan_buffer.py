"""Scan buffers: points stay where they are in the world while the robot moves on, and are handed on in time."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.config.published import BufferConfig
from limslam_agent.slam.published.scan_buffer import Scan, ScanBuffer
from limslam_env import RobotSpec
from limslam_env.geometry import BoolArray, FloatArray, se2

ROBOT = RobotSpec()  # beams at 90, 45, 15, -15, -45, -90 deg; left are 0 and 1, right are 4 and 5
ALL = np.ones(6, dtype=bool)
NOTHING = np.zeros(6, dtype=bool)
RANGES = np.array([0.4, 0.6, 1.0, 1.1, 0.7, 0.5])
STRAIGHT = np.array([0.02, 0.0, 0.0])


def only(*beams: int) -> BoolArray:
    return np.isin(np.arange(6), beams)


def ends_in_world(pose: FloatArray, beams: list[int]) -> FloatArray:
    """Where the beams end, worked out beam by beam."""
    points = []
    for beam in beams:
        spec = ROBOT.beams[beam]
        heading = pose[2] + spec.angle
        origin = se2.transform_points(pose, np.array([[spec.x, spec.y]]))[0]
        points.append(origin + RANGES[beam] * np.array([math.cos(heading), math.sin(heading)]))
    return np.array(points)


increments = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.4, 0.4)).map(lambda motion: se2.arc(*motion))


@settings(deadline=None, max_examples=50)
@given(st.lists(increments, min_size=1, max_size=20))
def test_points_and_origins_stay_fixed_in_the_world_while_the_robot_moves(motions: list[FloatArray]) -> None:
    pose = np.array([1.0, -2.0, 2.5])
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(size=100, max_gap=100.0))
    buffer.add(RANGES, ALL, ALL, 0)
    start, seen = pose, ends_in_world(pose, [0, 1])
    for motion in motions:
        pose = se2.compose(pose, motion)
        buffer.move(motion)
    np.testing.assert_allclose(se2.transform_points(pose, buffer.scan.points), seen, atol=1e-9)
    begun = se2.transform_points(start, ROBOT.beam_origins[:2])
    np.testing.assert_allclose(se2.transform_points(pose, buffer.scan.origins), begun, atol=1e-9)


def test_a_buffer_is_handed_on_when_it_reaches_its_size_and_begins_anew() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(size=6))
    handed_on: list[list[Scan]] = []
    for step in range(6):
        buffer.move(STRAIGHT)
        handed_on.append(buffer.add(RANGES, ALL, ALL, step))
    assert [[len(scan) for scan in scans] for scans in handed_on] == [[], [], [6], [], [], [6]]
    assert len(buffer.scan) == 0
    # The second scan holds nothing of the first.
    assert handed_on[5][0].readings[:, 0].tolist() == [3, 3, 4, 4, 5, 5]


def test_a_wall_that_has_ended_is_handed_on_after_the_gap_and_not_before() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(max_gap=0.25))
    buffer.add(RANGES, ALL, only(0), 0)
    given_up = []
    for step in range(1, 20):
        buffer.move(STRAIGHT)
        given_up.append(buffer.add(RANGES, ALL, NOTHING, step))
    # 12 steps are 0.24 m, 13 are 0.26 m.
    assert [index for index, scans in enumerate(given_up) if scans] == [12]
    (scan,) = given_up[12]
    np.testing.assert_allclose(scan.points, [[-0.26, 0.5]], atol=1e-12)
    assert len(buffer.scan) == 0
