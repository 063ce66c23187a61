"""Lines (r, theta): there and back all round the circle and near r = 0; Jacobians; points on
lines.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from limslam_env.geometry import FloatArray, line, se2

SPOTS = np.array([-2.0, 0.0, 3.0])
CIRCLE = np.linspace(-math.pi, math.pi, 73)
POSES = [
    np.array(pose)
    for pose in ((0.0, 0.0, 0.0), (1.0, -2.0, 0.7), (-3.0, 0.5, math.pi), (0.2, 0.1, -3.1))
]


def lines() -> SearchStrategy[FloatArray]:
    near_the_origin = st.sampled_from([0.0, 1e-14, 1e-9, 1e-4])
    return st.tuples(
        st.one_of(st.floats(0.0, 20.0), near_the_origin), st.floats(-math.pi, math.pi)
    ).map(np.array)


def poses() -> SearchStrategy[FloatArray]:
    place = st.floats(-20.0, 20.0)
    return st.tuples(place, place, st.floats(-math.pi, math.pi)).map(np.array)


def points() -> SearchStrategy[FloatArray]:
    return st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)).map(np.array)


def assert_same_line(first: FloatArray, second: FloatArray, tolerance: float = 1e-11) -> None:
    """Near the origin (r, theta) and (-r, theta + pi) are neighbours: only nearest forms may be
    subtracted.
    """
    np.testing.assert_allclose(line.nearest_form(first, second) - second, 0.0, atol=tolerance)


def assert_normalised(given_line: FloatArray) -> None:
    assert given_line[0] >= 0.0
    assert -math.pi < given_line[1] <= math.pi


def central_difference(function, at: FloatArray, step: float = 1e-5) -> FloatArray:
    middle = function(at)
    columns = [
        line.nearest_form(function(at + offset), middle)
        - line.nearest_form(function(at - offset), middle)
        for offset in step * np.eye(len(at))
    ]
    return np.array(columns).T / (2.0 * step)


@given(st.floats(-20.0, 20.0), st.floats(-10.0, 10.0))
@settings(deadline=None)
def test_normalise_names_the_same_points(r, theta):
    raw = np.array([r, theta])
    normalised = line.normalise(raw)
    assert_normalised(normalised)
    np.testing.assert_allclose(line.distance(normalised, line.at(raw, SPOTS)), 0.0, atol=1e-12)


@pytest.mark.parametrize("pose", POSES)
@pytest.mark.parametrize("r", [0.0, 1e-9, 0.5])
def test_there_and_back_all_round_the_circle(pose, r):
    for theta in CIRCLE:
        world = np.array([r, theta])
        seen = line.to_frame(world, pose)
        assert_normalised(seen)
        assert_same_line(line.from_frame(seen, pose), world)
        assert_same_line(line.to_frame(line.from_frame(world, pose), pose), world)


@given(lines(), poses())
# Here rounding takes the angle one bit beyond pi.
@example(np.array([0.0, 4.1e-16]), np.array([0.0, -1.0, 0.0]))
@settings(deadline=None, max_examples=200)
def test_a_line_seen_from_a_pose_holds_the_points_seen_from_there(world, pose):
    seen = line.to_frame(world, pose)
    points_seen = se2.transform_points(se2.inverse(pose), line.at(world, SPOTS))
    np.testing.assert_allclose(line.distance(seen, points_seen), 0.0, atol=1e-11)
    back = line.from_frame(seen, pose)
    assert_normalised(back)
    np.testing.assert_allclose(line.distance(back, line.at(world, SPOTS)), 0.0, atol=1e-11)


@pytest.mark.parametrize("r", [0.0, 1e-13, -1e-13])
def test_a_line_through_the_pose_itself_is_seen_at_zero(r):
    # The place where the sign of r, and with it theta, may turn over.
    for theta in CIRCLE:
        pose = np.array([1.5, -0.5, 0.3])
        world = np.array([pose[0] * math.cos(theta) + pose[1] * math.sin(theta) + r, theta])
        seen = line.to_frame(world, pose)
        assert abs(seen[0]) < 1e-12
        assert_same_line(line.from_frame(seen, pose), line.normalise(world))


@pytest.mark.parametrize(
    ("change", "jacobians"),
    [(line.to_frame, line.to_frame_jacobians), (line.from_frame, line.from_frame_jacobians)],
)
def test_frame_jacobians_match_central_differences(change, jacobians):
    signs = set()

    @given(lines(), poses())
    @settings(deadline=None, max_examples=200)
    def check(given_line, pose):
        # At r = 0 the normalised line has no derivative.
        assume(change(given_line, pose)[0] > 1e-2)
        by_pose, by_line = jacobians(given_line, pose)
        signs.add(by_line[0, 0])
        numeric_by_pose = central_difference(lambda moved: change(given_line, moved), pose)
        numeric_by_line = central_difference(lambda moved: change(moved, pose), given_line)
        np.testing.assert_allclose(by_pose, numeric_by_pose, atol=5e-8)
        np.testing.assert_allclose(by_line, numeric_by_line, atol=5e-8)

    check()
    assert signs == {-1.0, 1.0}, "both branches must have been seen"


@given(lines(), lines())
@settings(deadline=None)
def test_nearest_form_is_the_same_line_within_a_quarter_turn(given_line, reference):
    near = line.nearest_form(given_line, reference)
    assert abs(near[1] - reference[1]) <= 0.5 * math.pi + 1e-12
    np.testing.assert_allclose(line.distance(near, line.at(given_line, SPOTS)), 0.0, atol=1e-11)


@given(points(), points())
@settings(deadline=None)
def test_through_holds_both_points_whichever_comes_first(start, end):
    assume(np.hypot(*(end - start)) > 1e-3)
    found = line.through(start, end)
    assert_normalised(found)
    np.testing.assert_allclose(line.distance(found, np.array([start, end])), 0.0, atol=1e-9)
    assert_same_line(line.through(end, start), found, tolerance=1e-9)


def test_through_one_point_twice_is_refused():
    with pytest.raises(ValueError, match="two different points"):
        line.through(np.array([1.0, 2.0]), np.array([1.0, 2.0]))


@given(lines(), st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=6))
@settings(deadline=None)
def test_at_is_the_inverse_of_along_and_lies_on_the_line(given_line, positions):
    spots = line.at(given_line, np.array(positions))
    np.testing.assert_allclose(line.along(given_line, spots), positions, atol=1e-12)
    np.testing.assert_allclose(line.distance(given_line, spots), 0.0, atol=1e-12)


@given(lines(), points())
@settings(deadline=None)
def test_distance_and_along_are_the_point_in_the_frame_of_the_line(given_line, point):
    away = line.distance(given_line, point[None])[0]
    position = line.along(given_line, point[None])
    rebuilt = line.at(given_line, position)[0] + away * line.normal(given_line)
    np.testing.assert_allclose(rebuilt, point, atol=1e-11)
    assert line.normal(given_line) @ line.direction(given_line) == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize(
    ("turn", "angle"), [(0.3, 0.3), (-0.3, -0.3), (math.pi - 0.1, -0.1), (7.0, 7.0 - 2.0 * math.pi)]
)
def test_half_a_turn_leaves_a_line_as_it_is(turn: float, angle: float) -> None:
    assert line.angle_between(turn) == pytest.approx(angle)
    np.testing.assert_allclose(line.angle_between(np.array([turn, turn + math.pi])), angle)
