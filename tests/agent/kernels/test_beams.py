"""The model of a range beam: its derivatives, what a cone reads, and which beams pass a line."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from limslam_agent.kernels.beams import line_table, passes, predict_readings, read_share
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import direction, normal

places = st.floats(-5.0, 5.0)
angles = st.floats(-math.pi, math.pi)
# What is special about a line through the world's origin must not be special here.
near_zero = st.one_of(st.floats(-4.0, 4.0), st.sampled_from([0.0, 1e-12, -1e-12, 1e-6, -1e-3]))
poses = st.tuples(places, places, angles).map(np.array)
lines = st.tuples(near_zero, angles).map(np.array)
anchors = st.one_of(st.tuples(places, places).map(np.array), st.just(np.zeros(2)))
cones = st.sampled_from([0.0, 0.03, 0.2, 1.2])
BEAMS = np.array([[0.1, 0.0, 0.0], [0.07, 0.07, 0.8], [0.0, -0.1, -1.6], [-0.1, 0.02, 3.0]])


def predicted(pose: FloatArray, line: FloatArray, anchor: FloatArray, cone: float) -> FloatArray:
    """What each beam (4, 7) is predicted to read."""
    rows = np.empty((len(BEAMS), 7))
    readings = np.column_stack((BEAMS, np.zeros(4), np.full(4, cone), np.arange(4)))
    zeros = np.zeros(4, dtype=np.int64)
    table = line_table(line[None], anchor[None])
    predict_readings(pose[None], zeros, readings, table, zeros, rows)
    return rows


@settings(deadline=None, max_examples=200)
@given(poses, lines, anchors, cones)
def test_the_derivatives_equal_central_differences(
    pose: FloatArray, line: FloatArray, anchor: FloatArray, cone: float
) -> None:
    rows = predicted(pose, line, anchor, cone)
    # Within the angle of a difference, a ray that measures may turn into another kind of ray.
    middles = np.abs(np.cos(pose[2] + BEAMS[:, 2] - line[1]))
    is_smooth = np.abs(middles - math.cos(cone)) > 1e-3
    is_smooth &= middles > (0.201 if cone else 0.05)
    step = 3e-6
    for column, unit in enumerate(step * np.eye(5)):
        more, less = (
            predicted(pose + sign * unit[:3], line + sign * unit[3:], anchor, cone)[:, 0]
            for sign in (1.0, -1.0)
        )
        # What is left of differences grows as a beam turns along the line.
        flat = rows[is_smooth, 6] ** 2
        np.testing.assert_allclose(
            rows[is_smooth, 1 + column] * flat,
            ((more - less) / (2.0 * step))[is_smooth] * flat,
            rtol=0.0,
            atol=1e-6,
        )


@settings(deadline=None, max_examples=200)
@given(poses, lines, anchors)
def test_a_reading_as_predicted_ends_on_the_line(
    pose: FloatArray, line: FloatArray, anchor: FloatArray
) -> None:
    rows = predicted(pose, line, anchor, 0.0)
    clear = np.abs(rows[:, 6]) > 0.05
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    origins = pose[:2] + BEAMS[:, :2] @ np.array([[cos, sin], [-sin, cos]])
    headings = pose[2] + BEAMS[:, 2]
    ends = origins + rows[:, :1] * np.column_stack((np.cos(headings), np.sin(headings))) - anchor
    np.testing.assert_allclose(ends[clear] @ normal(line), line[0], rtol=0.0, atol=1e-11)
    along = -rows[:, 5] / rows[:, 4]
    np.testing.assert_allclose((ends @ direction(line))[clear], along[clear], atol=1e-9)


@pytest.mark.parametrize("slant", [0.0, 0.1, 0.5, -0.9])
def test_a_cone_reads_the_nearest_point_of_a_wall(slant: float) -> None:
    line = np.array([2.0, slant])
    cone = 0.2
    reached = predicted(np.zeros(3), line, np.zeros(2), cone)[0, 0]
    rays = np.linspace(-cone, cone, 4001)
    nearest = ((2.0 - 0.1 * math.cos(slant)) / np.cos(slant - rays)).min()
    assert reached == pytest.approx(nearest, abs=1e-6)
    middle = predicted(np.zeros(3), line, np.zeros(2), 0.0)[0, 0]
    assert read_share(math.cos(slant), cone) == pytest.approx(nearest / middle, abs=1e-6)


def test_a_beam_passes_a_wall_by_more_than_its_margin() -> None:
    assert passes(1.0, 0.5, 1.3, 0.1)
    assert not passes(1.0, 0.5, 1.1, 0.1)
    assert not passes(-1.0, 0.5, 1.3, 0.1)
    assert not passes(1.0, 0.1, 5.0, 0.1)
