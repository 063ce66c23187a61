"""Scan buffers: points stay where they are in the world while the robot moves on, and are handed on in time."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.config import BufferConfig
from limslam_agent.scan_buffer import Scan, ScanBuffer
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import arc, compose, transform_points
from limslam_env.interface import RobotSpec, beams_on_rim

ROBOT = RobotSpec()  # beams at 90, 45, 15, -15, -45, -90 deg; left are 0 and 1, right are 4 and 5
ALL = np.ones(6, dtype=bool)
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
        origin = transform_points(pose, np.array([[spec.x, spec.y]]))[0]
        points.append(origin + RANGES[beam] * np.array([math.cos(heading), math.sin(heading)]))
    return np.array(points)


increments = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.4, 0.4)).map(lambda motion: arc(*motion))


@settings(deadline=None, max_examples=50)
@given(st.lists(increments, min_size=1, max_size=20))
def test_points_and_origins_stay_fixed_in_the_world_while_the_robot_moves(motions: list[FloatArray]) -> None:
    pose = np.array([1.0, -2.0, 2.5])
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(size=100, max_gap=100.0))
    buffer.add(RANGES, ALL, 0)
    start, seen = pose, ends_in_world(pose, [0, 1])
    for motion in motions:
        pose = compose(pose, motion)
        buffer.carry(motion)
    np.testing.assert_allclose(transform_points(pose, buffer.scan.points), seen, atol=1e-9)
    begun = transform_points(start, ROBOT.beam_origins[:2])
    np.testing.assert_allclose(transform_points(pose, buffer.scan.origins), begun, atol=1e-9)


def test_points_taken_on_the_way_draw_the_wall_that_the_robot_passes() -> None:
    # Ranges do not change along a straight wall, so the points of a beam lie behind one another.
    buffer = ScanBuffer(ROBOT, "right", BufferConfig(size=100))
    for step in range(10):
        buffer.carry(STRAIGHT)
        buffer.add(RANGES, only(5), step)
    points = buffer.scan.points
    np.testing.assert_allclose(points[:, 1], -0.6, atol=1e-12)
    np.testing.assert_allclose(points[:, 0], np.arange(-0.18, 0.001, 0.02), atol=1e-12)


def test_a_buffer_is_handed_on_when_it_reaches_its_size_and_begins_anew() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(size=6))
    handed_on: list[Scan | None] = []
    for step in range(6):
        buffer.carry(STRAIGHT)
        handed_on.append(buffer.add(RANGES, ALL, step))
    sizes = [0 if scan is None else len(scan) for scan in handed_on]
    assert sizes == [0, 0, 6, 0, 0, 6]
    assert len(buffer.scan) == 0
    # The second scan holds nothing of the first.
    assert handed_on[5] is not None
    assert handed_on[5].readings[:, 0].tolist() == [3, 3, 4, 4, 5, 5]


def test_a_wall_that_has_ended_is_handed_on_after_the_gap_and_not_before() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(max_gap=0.25))
    buffer.add(RANGES, only(0), 0)
    nothing = np.zeros(6, dtype=bool)
    given_up = []
    for step in range(1, 20):
        given_up.append(buffer.carry(STRAIGHT))
        buffer.add(RANGES, nothing, step)
    # 12 steps are 0.24 m, 13 are 0.26 m.
    assert [index for index, scan in enumerate(given_up) if scan is not None] == [12]
    scan = given_up[12]
    assert scan is not None
    np.testing.assert_allclose(scan.points, [[-0.26, 0.5]], atol=1e-12)
    assert len(buffer.scan) == 0


def test_each_measurement_starts_the_gap_anew_also_when_no_point_is_taken() -> None:
    # min_distance is so long that only the first point is taken; the beams still see the wall.
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(max_gap=0.25, min_distance=10.0, min_turn=10.0))
    buffer.add(RANGES, only(0), 0)
    assert all(buffer.carry(STRAIGHT) is None and buffer.add(RANGES, only(0), step) is None for step in range(1, 40))
    assert len(buffer.scan) == 1


def test_driving_back_and_forth_counts_as_distance_without_measurement() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(max_gap=0.25))
    buffer.add(RANGES, only(0), 0)
    results = [buffer.carry(STRAIGHT if step % 2 else -STRAIGHT) for step in range(13)]
    assert results[-1] is not None


def test_left_and_right_are_apart_and_front_beams_go_to_neither() -> None:
    left, right = (ScanBuffer(ROBOT, side, BufferConfig()) for side in ("left", "right"))
    for buffer in (left, right):
        buffer.add(RANGES, ALL, 3)
    assert left.scan.readings.tolist() == [[3, 0], [3, 1]]
    assert right.scan.readings.tolist() == [[3, 4], [3, 5]]
    assert (left.scan.points[:, 1] > 0.0).all()
    assert (right.scan.points[:, 1] < 0.0).all()


def test_a_miss_adds_no_point() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig())
    assert buffer.add(RANGES, only(2, 3, 4, 5), 0) is None
    assert len(buffer.scan) == 0
    buffer.add(RANGES, only(1, 4), 1)
    assert buffer.scan.readings.tolist() == [[1, 1]]


def test_standing_still_adds_nothing() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(size=4))
    buffer.add(RANGES, ALL, 0)
    for step in range(1, 50):
        assert buffer.carry(np.zeros(3)) is None
        assert buffer.add(RANGES, ALL, step) is None
    assert buffer.scan.readings[:, 0].tolist() == [0, 0]


def test_creeping_adds_a_point_once_it_adds_up_to_the_least_distance() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(min_distance=0.01))
    for step in range(9):
        buffer.carry(np.array([0.003, 0.0, 0.0]))
        buffer.add(RANGES, only(0), step)
    assert buffer.scan.readings[:, 0].tolist() == [0, 4, 8]


def test_turning_on_the_spot_adds_points_too() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(min_turn=math.radians(1.0)))
    for step in range(4):
        buffer.carry(np.array([0.0, 0.0, -math.radians(0.6)]))
        buffer.add(RANGES, only(0), step)
    assert buffer.scan.readings[:, 0].tolist() == [0, 2]


def test_the_readings_name_the_step_and_the_beam_of_each_point() -> None:
    buffer = ScanBuffer(ROBOT, "right", BufferConfig(size=100))
    for step, beam in ((7, 4), (8, 5), (12, 4)):
        buffer.carry(STRAIGHT)
        buffer.add(RANGES, only(beam), step)
    scan = buffer.scan
    assert scan.readings.tolist() == [[7, 4], [8, 5], [12, 4]]
    lengths = np.linalg.norm(scan.points - scan.origins, axis=1)
    np.testing.assert_allclose(lengths, RANGES[[4, 5, 4]], atol=1e-12)


def test_select_keeps_points_origins_and_readings_together() -> None:
    buffer = ScanBuffer(ROBOT, "left", BufferConfig(size=100))
    for step in range(3):
        buffer.carry(STRAIGHT)
        buffer.add(RANGES, ALL, step)
    chosen = buffer.scan.select(np.array([4, 1]))
    assert chosen.readings.tolist() == [[2, 0], [0, 1]]
    np.testing.assert_array_equal(chosen.points, buffer.scan.points[[4, 1]])
    np.testing.assert_array_equal(chosen.origins, buffer.scan.origins[[4, 1]])


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_side_without_beams_stays_empty(side: str) -> None:
    robot = RobotSpec(beams=beams_on_rim((0.0, 180.0), 0.1))
    buffer = ScanBuffer(robot, side, BufferConfig())
    assert buffer.add(np.array([0.5, 0.5]), np.ones(2, dtype=bool), 0) is None
    assert buffer.carry(np.array([1.0, 0.0, 0.0])) is None
    assert len(buffer.scan) == 0
