"""SE(2): group laws, the exact arc against integration, and every Jacobian against central
differences.
"""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from limslam_env.geometry import FloatArray, se2

ORIGIN = np.zeros(3)
BEYOND_PI = math.nextafter(math.pi, 4.0)
# Half the turn is what the series of sinc (1e-6) and of its derivative (1e-4) switch on.
SWITCHES = [side * turn for turn in (0.0, 1.9e-6, 2.1e-6, 1.99e-4, 2.01e-4) for side in (-1.0, 1.0)]


def poses() -> SearchStrategy[FloatArray]:
    place = st.floats(-50.0, 50.0)
    return st.tuples(place, place, st.floats(-10.0, 10.0)).map(np.array)


def assert_same(first: FloatArray, second: FloatArray) -> None:
    np.testing.assert_allclose(first[:2], second[:2], atol=1e-11)
    assert abs(math.remainder(first[2] - second[2], 2.0 * math.pi)) < 1e-12


def central_difference(function, at: FloatArray, step: float = 1e-5) -> FloatArray:
    columns = []
    for offset in step * np.eye(len(at)):
        change = function(at + offset) - function(at - offset)
        columns.append([change[0], change[1], math.remainder(change[2], 2.0 * math.pi)])
    return np.array(columns).T / (2.0 * step)


@given(poses())
@settings(deadline=None)
def test_inverse_undoes_from_both_sides(pose):
    assert_same(se2.compose(pose, se2.inverse(pose)), ORIGIN)
    assert_same(se2.compose(se2.inverse(pose), pose), ORIGIN)


@given(poses(), poses())
@settings(deadline=None)
def test_between_leads_from_start_to_end(start, end):
    assert_same(se2.compose(start, se2.between(start, end)), end)


def test_compose_on_a_case_worked_by_hand():
    # Standing at (1, 2) and looking along y, two metres ahead and one to the left are (0, 4).
    assert_same(
        se2.compose(np.array([1.0, 2.0, math.pi / 2]), np.array([2.0, 1.0, math.pi])),
        np.array([0, 4, -math.pi / 2]),
    )


def test_group_operations_work_row_by_row_on_stacks():
    rows = np.random.default_rng(0).uniform(-3.0, 3.0, (2, 5, 3))
    for operation in (se2.compose, se2.between):
        single = [operation(first, second) for first, second in zip(rows[0], rows[1], strict=True)]
        np.testing.assert_allclose(operation(rows[0], rows[1]), single, atol=1e-15)
        one_to_many = [operation(rows[0, 0], second) for second in rows[1]]
        np.testing.assert_allclose(operation(rows[0, 0], rows[1]), one_to_many, atol=1e-15)
    np.testing.assert_allclose(
        se2.inverse(rows[0]), [se2.inverse(row) for row in rows[0]], atol=1e-15
    )


@given(st.floats(-1e3, 1e3))
@example(BEYOND_PI)
@example(-BEYOND_PI)
@example(math.nextafter(-math.pi, 0.0))
@example(-1e-300)
@settings(deadline=None)
def test_wrap_angle_lies_in_the_half_open_circle_and_keeps_the_direction(angle):
    wrapped = float(se2.wrap_angle(angle))
    assert -math.pi < wrapped <= math.pi
    assert abs(math.remainder(wrapped - angle, 2.0 * math.pi)) < 1e-12


def test_wrap_angle_of_an_array_is_that_of_its_numbers():
    angles = np.array([[math.pi, -math.pi, 7.0], [-7.0, 0.0, BEYOND_PI]])
    wrapped = se2.wrap_angle(angles)
    assert wrapped.shape == angles.shape
    assert ((wrapped > -math.pi) & (wrapped <= math.pi)).all()
    np.testing.assert_array_equal(
        wrapped.ravel(), [se2.wrap_angle(float(angle)) for angle in angles.ravel()]
    )


@given(poses(), poses())
@settings(deadline=None)
def test_compose_jacobians_match_central_differences(first, second):
    by_first, by_second = se2.compose_jacobians(first, second)
    np.testing.assert_allclose(
        by_first, central_difference(lambda pose: se2.compose(pose, second), first), atol=2e-8
    )
    np.testing.assert_allclose(
        by_second, central_difference(lambda pose: se2.compose(first, pose), second), atol=2e-8
    )


@given(
    st.floats(-2.0, 2.0),
    st.one_of(st.floats(-6.0, 6.0), st.sampled_from(SWITCHES), st.floats(-3e-4, 3e-4)),
)
@settings(deadline=None, max_examples=200)
def test_arc_jacobian_matches_central_differences(distance, turn):
    numeric = central_difference(lambda motion: se2.arc(*motion), np.array([distance, turn]))
    np.testing.assert_allclose(se2.arc_jacobian(distance, turn), numeric, atol=1e-9)


def test_dead_reckoning_composes_the_arcs_of_its_rows():
    wheels = np.float32([[0.1, 0.2], [0.3, 0.3], [-0.2, 0.4], [0.5, -0.5]])
    start = np.array([1.0, -2.0, 3.0])
    pose = start
    expected = []
    for travel in wheels:
        pose = se2.compose(pose, se2.arc(*se2.wheels_to_arc(travel, 0.16)))
        expected.append(pose)
    np.testing.assert_allclose(se2.driven(wheels, 0.16, start), expected, atol=1e-12)


@given(st.floats(-2.0, 2.0), st.one_of(st.floats(-12.0, 12.0), st.sampled_from(SWITCHES)))
@settings(deadline=None, max_examples=200)
def test_arc_is_the_integral_of_the_unicycle(distance, turn):
    # dx/ds = d cos(turn s), dy/ds = d sin(turn s) over s in [0, 1], by Gauss and Legendre.
    nodes, weights = np.polynomial.legendre.leggauss(40)
    headings = turn * 0.5 * (nodes + 1.0)
    x, y = (0.5 * distance * float(weights @ rate(headings)) for rate in (np.cos, np.sin))
    np.testing.assert_allclose(se2.arc(distance, turn), [x, y, turn], atol=1e-12)


@given(
    poses(),
    st.lists(st.tuples(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0)), min_size=1, max_size=5),
)
@settings(deadline=None)
def test_points_go_there_and_back(pose, rows):
    points = np.array(rows)
    there = se2.transform_points(pose, points)
    np.testing.assert_allclose(se2.transform_points(se2.inverse(pose), there), points, atol=1e-11)
    # A point is the place of a pose: both must agree on where it goes.
    np.testing.assert_allclose(
        there, [se2.compose(pose, np.array([x, y, 0.0]))[:2] for x, y in points], atol=1e-11
    )


def test_wheels_to_arc_turns_left_when_the_right_wheel_is_faster():
    assert se2.wheels_to_arc(np.array([0.02, 0.03]), 0.16) == pytest.approx((0.025, 0.0625))
    assert se2.wheels_to_arc(np.array([0.02, 0.02]), 0.16) == pytest.approx((0.02, 0.0))
