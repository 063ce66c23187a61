"""What a beam should measure: there and back, and its derivatives against central differences, all round."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from support.readings import Readings, expected_ranges, hit_points

from limslam_env import RobotSpec
from limslam_env.geometry import FloatArray
from limslam_env.geometry import line as line_geometry

ROBOT = RobotSpec()  # beams on the rim, 0.1 m from the middle, at 90, 45, 15, -15, -45, -90 deg
places = st.floats(-5.0, 5.0)
angles = st.floats(-math.pi, math.pi)
# What is special about a line through the world's origin must not be special here.
near_zero = st.one_of(st.floats(-4.0, 4.0), st.sampled_from([0.0, 1e-12, -1e-12, 1e-6, -1e-3]))
poses = st.tuples(places, places, angles).map(np.array)
anchors = st.one_of(st.tuples(places, places).map(np.array), st.just(np.zeros(2)))
lines = st.tuples(near_zero, angles).map(np.array)


def readings_of(beams: list[int], ranges: FloatArray) -> Readings:
    """Readings by some of the robot's beams, each from a pose of its own."""
    numbers = np.arange(len(beams))
    sources = np.column_stack((numbers, beams))
    return Readings(numbers, ROBOT.beam_origins[beams], ROBOT.beam_angles[beams], ranges, sources)


def one_pose(pose: FloatArray) -> tuple[FloatArray, Readings]:
    """All six beams at one pose."""
    return np.tile(pose, (6, 1)), readings_of(list(range(6)), np.zeros(6))


def assert_close(found: FloatArray, wanted: FloatArray, cosines: FloatArray) -> None:
    """Equal but for what is left of central differences, which grows as a beam turns along the line."""
    np.testing.assert_allclose(found * cosines**2, wanted * cosines**2, rtol=0.0, atol=1e-6)


@settings(deadline=None, max_examples=200)
@given(poses, lines, anchors)
def test_the_derivatives_equal_central_differences(pose: FloatArray, line: FloatArray, anchor: FloatArray) -> None:
    stacked, readings = one_pose(pose)
    expected = expected_ranges(stacked, readings, line, anchor)
    clear = np.abs(expected.cosines) > 0.05
    step = 1e-5

    def ranges(moved: FloatArray, turned: FloatArray) -> FloatArray:
        return expected_ranges(moved, readings, turned, anchor).ranges

    for number, unit in enumerate(step * np.eye(3)):
        by_one = (ranges(stacked + unit, line) - ranges(stacked - unit, line)) / (2.0 * step)
        assert_close(expected.by_pose[clear, number], by_one[clear], expected.cosines[clear])
    for number, unit in enumerate(step * np.eye(2)):
        by_one = (ranges(stacked, line + unit) - ranges(stacked, line - unit)) / (2.0 * step)
        assert_close(expected.by_line[clear, number], by_one[clear], expected.cosines[clear])


@settings(deadline=None, max_examples=200)
@given(poses, lines, anchors)
def test_a_reading_as_expected_ends_on_the_line(pose: FloatArray, line: FloatArray, anchor: FloatArray) -> None:
    stacked, readings = one_pose(pose)
    expected = expected_ranges(stacked, readings, line, anchor)
    clear = np.nonzero(np.abs(expected.cosines) > 0.05)[0]
    points = hit_points(stacked[clear], readings._replace(ranges=expected.ranges).select(clear))
    np.testing.assert_allclose(line_geometry.distance(line, points - anchor), 0.0, atol=1e-11)
