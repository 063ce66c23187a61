"""The line EKF: equal to filterpy's dense filter, honest where the model is linear, and sound after many steps."""

import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.stats import chi2

from limslam_agent.slam.core.ekf import LineEKF
from limslam_env.geometry import FloatArray
from limslam_env.geometry.line import from_frame, nearest_form, to_frame
from limslam_env.geometry.se2 import compose, wrap_angle

MOTION = np.diag([2e-6, 5e-7, 4e-5])
SEEN = np.array([[1e-4, 3e-5], [3e-5, 2e-4]])
LINES = np.array([(2.0, 0.3), (1.5, 1.9), (3.0, -2.8), (0.8, -1.2)])
coordinates = st.floats(-4.0, 4.0)
angles = st.floats(-math.pi, math.pi)


def spread(size: int, seed: int, scale: float = 1e-3) -> FloatArray:
    """Some covariance (size, size) with correlations between all numbers."""
    root = np.random.default_rng(seed).normal(size=(size, size + 2))
    return scale * (root @ root.T) / size


def filter_with(lines: FloatArray, pose: FloatArray, covariance: FloatArray) -> LineEKF:
    """A filter with given lines and a given covariance of everything."""
    ekf = LineEKF(pose, covariance[:3, :3])
    for line in lines:
        ekf.augment(to_frame(line, ekf.pose), SEEN)
    ekf.x = np.concatenate((pose, lines.ravel()))
    ekf.P = np.array(covariance)
    return ekf


def random_lines(count: int, generator: np.random.Generator) -> FloatArray:
    return np.column_stack((generator.uniform(0.3, 5.0, count), generator.uniform(-math.pi, math.pi, count)))


# The dense filter: the textbook's Jacobians, written out here once more and at full size.


def dense_predict(dense: ExtendedKalmanFilter, increment: FloatArray, covariance: FloatArray) -> None:
    x, y, theta = dense.x[:3]
    cos, sin = math.cos(theta), math.sin(theta)
    size = len(dense.x)
    dense.F = np.eye(size)
    dense.F[0, 2] = -sin * increment[0] - cos * increment[1]
    dense.F[1, 2] = cos * increment[0] - sin * increment[1]
    turned = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    dense.Q = np.zeros((size, size))
    dense.Q[:3, :3] = turned @ covariance @ turned.T
    moved = [x + cos * increment[0] - sin * increment[1], y + sin * increment[0] + cos * increment[1]]
    state = np.concatenate((moved, [wrap_angle(theta + increment[2])], dense.x[3:]))
    dense.predict()
    dense.x = state


def dense_observe(dense: ExtendedKalmanFilter, z: FloatArray, covariance: FloatArray, index: int) -> None:
    first = 3 + 2 * index

    def unsigned(state: FloatArray) -> float:
        r, theta = state[first : first + 2]
        return float(r - state[0] * math.cos(theta) - state[1] * math.sin(theta))

    def predicted(state: FloatArray) -> FloatArray:
        behind = unsigned(state) < 0.0
        return np.array([abs(unsigned(state)), state[first + 1] - state[2] + (math.pi if behind else 0.0)])

    def jacobian(state: FloatArray) -> FloatArray:
        sign = -1.0 if unsigned(state) < 0.0 else 1.0
        cos, sin = math.cos(state[first + 1]), math.sin(state[first + 1])
        full = np.zeros((2, len(state)))
        full[:, :3] = [[-sign * cos, -sign * sin, 0.0], [0.0, 0.0, -1.0]]
        full[:, first : first + 2] = [[sign, sign * (state[0] * sin - state[1] * cos)], [0.0, 1.0]]
        return full

    def residual(one: FloatArray, other: FloatArray) -> FloatArray:
        return np.array([one[0] - other[0], wrap_angle(one[1] - other[1])])

    dense.update(z, jacobian, predicted, covariance, residual=residual)
    dense.x = np.array(dense.x)
    dense.x[2] = wrap_angle(dense.x[2])
    for row in range(3, len(dense.x), 2):
        if dense.x[row] < 0.0:
            flip = np.eye(len(dense.x))
            flip[row, row] = -1.0
            dense.x[row], dense.x[row + 1] = -dense.x[row], dense.x[row + 1] + math.pi
            dense.P = flip @ dense.P @ flip
        dense.x[row + 1] = wrap_angle(dense.x[row + 1])


def dense_augment(dense: ExtendedKalmanFilter, z: FloatArray, covariance: FloatArray) -> ExtendedKalmanFilter:
    size = len(dense.x)
    theta = z[1] + dense.x[2]
    r = z[0] + dense.x[0] * math.cos(theta) + dense.x[1] * math.sin(theta)
    sign = -1.0 if r < 0.0 else 1.0
    by_angle = sign * (dense.x[1] * math.cos(theta) - dense.x[0] * math.sin(theta))
    by_pose = [[sign * math.cos(theta), sign * math.sin(theta), by_angle], [0.0, 0.0, 1.0]]
    by_state = np.vstack((np.eye(size), np.hstack((by_pose, np.zeros((2, size - 3))))))
    by_z = np.vstack((np.zeros((size, 2)), [[sign, by_angle], [0.0, 1.0]]))
    grown = ExtendedKalmanFilter(dim_x=size + 2, dim_z=2)
    line = np.array([abs(r), wrap_angle(theta + (math.pi if r < 0.0 else 0.0))])
    grown.x = np.concatenate((dense.x, line))
    grown.P = by_state @ dense.P @ by_state.T + by_z @ covariance @ by_z.T
    return grown


def assert_equal_filters(ekf: LineEKF, dense: ExtendedKalmanFilter) -> None:
    np.testing.assert_allclose(ekf.x, dense.x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(ekf.P, dense.P, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_hundred_random_steps_equal_filterpys_dense_filter(seed: int) -> None:
    generator = np.random.default_rng(seed)
    ekf = LineEKF(np.array([0.5, -0.3, 2.8]), spread(3, seed, 1e-4))
    dense = ExtendedKalmanFilter(dim_x=3, dim_z=2)
    dense.x, dense.P = ekf.pose, ekf.joint_pose_covariance
    for line in random_lines(20, generator):
        seen = to_frame(line, ekf.pose) + generator.multivariate_normal(np.zeros(2), SEEN)
        ekf.augment(seen, SEEN)
        dense = dense_augment(dense, seen, SEEN)
        assert_equal_filters(ekf, dense)
    for _ in range(100):
        increment = np.array([generator.uniform(-0.1, 0.1), generator.normal(0.0, 0.01), generator.uniform(-0.3, 0.3)])
        ekf.predict(increment, MOTION)
        dense_predict(dense, increment, MOTION)
        assert_equal_filters(ekf, dense)
        index = int(generator.integers(20))
        predicted = to_frame(ekf.lines[index], ekf.pose)
        seen = nearest_form(predicted + generator.multivariate_normal(np.zeros(2), SEEN), predicted)
        ekf.observe_line(seen, SEEN, index)
        dense_observe(dense, seen, SEEN, index)
        assert_equal_filters(ekf, dense)


@settings(deadline=None, max_examples=200)
@given(coordinates, coordinates, angles, st.floats(0.0, 5.0), angles)
def test_the_jacobian_of_an_observation_equals_central_differences(
    x: float, y: float, yaw: float, r: float, theta: float
) -> None:
    # On the line itself the observed form jumps, and there is no derivative.
    assume(abs(r - x * math.cos(theta) - y * math.sin(theta)) > 1e-3)
    ekf = filter_with(np.array([[1.0, 0.0], [r, theta]]), np.array([x, y, yaw]), np.eye(7))
    step = 1e-6
    reference = ekf._observed(ekf.x, ekf.columns_of(1))
    differences = np.zeros((2, 7))
    for column, unit in enumerate(np.eye(7)):
        shifted = (ekf.x + sign * step * unit for sign in (1.0, -1.0))
        above, below = (nearest_form(ekf._observed(x, ekf.columns_of(1)), reference) for x in shifted)
        differences[:, column] = (above - below) / (2.0 * step)
    columns = ekf.columns_of(1)
    np.testing.assert_allclose(ekf._line_jacobian(ekf.x, columns), differences[:, columns], atol=1e-6)
    # The Jacobian's other columns are zero, as update takes them to be.
    np.testing.assert_allclose(np.delete(differences, ekf.columns_of(1), axis=1), 0.0, atol=1e-9)


@settings(deadline=None, max_examples=100)
@given(coordinates, coordinates, angles, st.floats(-0.3, 0.3), st.floats(-0.05, 0.05), st.floats(-1.0, 1.0))
def test_the_jacobian_of_the_motion_equals_central_differences(
    x: float, y: float, yaw: float, forward: float, sideways: float, turn: float
) -> None:
    pose, increment = np.array([x, y, yaw]), np.array([forward, sideways, turn])
    ekf = LineEKF(pose, np.zeros((3, 3)))
    covariance = np.diag([1e-4, 2e-4, 3e-4])
    ekf.predict(increment, covariance)
    step, reference = 1e-6, compose(pose, increment)

    def differences(of_pose: bool) -> FloatArray:
        columns = []
        for unit in step * np.eye(3):
            above = compose(pose + unit, increment) if of_pose else compose(pose, increment + unit)
            below = compose(pose - unit, increment) if of_pose else compose(pose, increment - unit)
            turned = wrap_angle(above[2] - reference[2]) - wrap_angle(below[2] - reference[2])
            columns.append(np.append(above[:2] - below[:2], turned) / (2.0 * step))
        return np.column_stack(columns)

    by_increment = differences(of_pose=False)
    np.testing.assert_allclose(ekf.F, differences(of_pose=True), atol=1e-6)
    np.testing.assert_allclose(ekf.joint_pose_covariance, by_increment @ covariance @ by_increment.T, atol=1e-9)


@settings(deadline=None, max_examples=100)
@given(coordinates, coordinates, angles, st.floats(0.01, 5.0), angles, st.integers(0, 1000))
def test_the_covariance_of_a_new_line_follows_from_pose_and_observation(
    x: float, y: float, yaw: float, r: float, theta: float, seed: int
) -> None:
    pose, seen, step = np.array([x, y, yaw]), np.array([r, theta]), 1e-6
    ekf = filter_with(LINES[:1], pose, spread(5, seed))
    before = ekf.P.copy()
    new = from_frame(seen, pose)
    assume(new[0] > 1e-3)
    columns = []
    for unit in step * np.eye(5):
        above = nearest_form(from_frame(seen + unit[3:], pose + unit[:3]), new)
        below = nearest_form(from_frame(seen - unit[3:], pose - unit[:3]), new)
        columns.append((above - below) / (2.0 * step))
    jacobian = np.column_stack(columns)
    assert ekf.augment(seen, SEEN) == 1
    np.testing.assert_allclose(ekf.lines[1], new, atol=1e-12)
    np.testing.assert_allclose(ekf.P[:5, :5], before, atol=1e-15)
    both = block_diag(before[:3, :3], SEEN)
    np.testing.assert_allclose(ekf.line_covariance(1), jacobian @ both @ jacobian.T, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(ekf.P[5:, :5], jacobian[:, :3] @ before[:3], rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(ekf.P, ekf.P.T, atol=1e-15)


def test_the_covariance_of_a_new_line_is_what_pose_and_observation_scatter() -> None:
    generator = np.random.default_rng(8)
    pose, seen, covariance = np.array([3.0, -2.0, 2.0]), np.array([0.7, 1.4]), spread(3, 4, 1e-6)
    ekf = LineEKF(pose, covariance)
    ekf.augment(seen, 0.01 * SEEN)
    poses = generator.multivariate_normal(pose, covariance, 20_000)
    observations = generator.multivariate_normal(seen, 0.01 * SEEN, 20_000)
    lines = np.array([from_frame(one, other) for one, other in zip(observations, poses, strict=True)])
    drawn = np.hstack((poses, nearest_form(lines, ekf.lines[0])))
    scale = np.sqrt(np.diag(ekf.P))
    np.testing.assert_allclose(np.cov(drawn.T) / np.outer(scale, scale), ekf.P / np.outer(scale, scale), atol=0.04)


@settings(deadline=None, max_examples=50)
@given(coordinates, coordinates, angles, st.floats(0.05, 4.0), angles, st.integers(0, 1000))
def test_seeing_a_new_line_again_from_the_same_place_does_not_move_the_pose(
    x: float, y: float, yaw: float, r: float, theta: float, seed: int
) -> None:
    # A line that is known only from here says nothing about here, wherever the second look puts it.
    ekf = LineEKF(np.array([x, y, yaw]), spread(3, seed))
    first = np.array([r, theta])
    assume(from_frame(first, ekf.pose)[0] > 0.05)
    index = ekf.augment(first, SEEN)
    pose, covariance, trace = ekf.pose, ekf.joint_pose_covariance, np.trace(ekf.line_covariance(index))
    ekf.observe_line(first + np.array([0.01, -0.02]), SEEN, index)
    np.testing.assert_allclose(ekf.pose[:2], pose[:2], atol=1e-11)
    assert wrap_angle(float(ekf.pose[2] - pose[2])) == pytest.approx(0.0, abs=1e-11)
    np.testing.assert_allclose(ekf.joint_pose_covariance, covariance, atol=1e-12)
    # The line itself moves half way: both looks are equally sure.
    np.testing.assert_allclose(
        nearest_form(to_frame(ekf.lines[index], ekf.pose), first), first + np.array([0.005, -0.01]), atol=1e-3
    )
    assert np.trace(ekf.line_covariance(index)) < trace


def test_errors_stay_inside_their_chi_square_band_where_the_model_is_nearly_linear() -> None:
    # Noise so small that curvature does not count; what is left is the algebra, and NEES tells if it is right.
    runs, steps, small = 200, 20, 1e-4
    generator = np.random.default_rng(21)
    start = np.array([0.4, -0.2, 1.0])
    first, motion, seen = (small**2 * np.diag(d) for d in ([1.0, 2.0, 0.5], [1.0, 0.2, 0.7], [1.0, 2.0]))
    pose_nees, state_nees, innovations = np.zeros(runs), np.zeros(runs), np.zeros(runs)
    for run in range(runs):
        truth = generator.multivariate_normal(start, first)
        ekf = LineEKF(start, first)
        for step in range(steps):
            increment = np.array([0.1, 0.0, 0.2 * math.sin(step)])
            truth = compose(truth, increment)
            ekf.predict(increment + generator.multivariate_normal(np.zeros(3), motion), motion)
            for index, line in enumerate(LINES):
                observed = to_frame(line, truth) + generator.multivariate_normal(np.zeros(2), seen)
                if step == 0:
                    ekf.augment(observed, seen)
                    continue
                difference, covariance = ekf.innovation(observed, seen, index)
                innovations[run] += difference @ np.linalg.solve(covariance, difference)
                ekf.observe_line(observed, seen, index)
        error = np.concatenate((ekf.pose - truth, (nearest_form(ekf.lines, LINES) - LINES).ravel()))
        error[2] = wrap_angle(float(error[2]))
        pose_nees[run] = error[:3] @ np.linalg.solve(ekf.joint_pose_covariance, error[:3])
        state_nees[run] = error @ np.linalg.solve(ekf.P, error)
    for values, freedom in ((pose_nees, 3), (state_nees, 11), (innovations, 2 * len(LINES) * (steps - 1))):
        low, high = chi2.ppf([0.025, 0.975], freedom * runs) / runs
        assert low < values.mean() < high


def test_the_covariance_stays_symmetric_and_positive_over_many_steps() -> None:
    generator = np.random.default_rng(3)
    lines = random_lines(20, generator)
    truth = np.array([0.3, 0.1, 0.0])
    ekf = LineEKF(truth, 1e-6 * np.eye(3))
    for line in lines:
        ekf.augment(to_frame(line, truth), SEEN)
    asymmetry = 0.0
    for step in range(20_000):
        # Round and round, so that the robot stays among its walls.
        increment = np.array([0.03, 0.0, 0.05])
        truth = compose(truth, increment)
        ekf.predict(increment + generator.normal(size=3) * np.sqrt(np.diag(MOTION)), MOTION)
        index = int(generator.integers(20))
        observed = to_frame(lines[index], truth) + generator.multivariate_normal(np.zeros(2), SEEN)
        ekf.observe_line(observed, SEEN, index)
        if step % 500 == 499:
            asymmetry = max(asymmetry, float(np.abs(ekf.P - ekf.P.T).max() / np.abs(ekf.P).max()))
            assert np.linalg.eigvalsh(ekf.P).min() > 0.0
    assert asymmetry < 1e-9
    # And it is still a filter: it knows where it is.
    assert np.hypot(*(ekf.pose - truth)[:2]) < 0.1


@pytest.mark.parametrize("theta", [0.5, 3.0, -3.1, math.pi, -1.6])
@pytest.mark.parametrize("yaw", [0.2, 2.7])
def test_a_line_pushed_through_the_origin_turns_round_and_stays_the_same_line(theta: float, yaw: float) -> None:
    pose, covariance = np.array([1.0, 0.5, yaw]), spread(5, 7, 1e-2)
    ekf = filter_with(np.array([[0.01, theta]]), pose, covariance)
    # The wall is really on the other side of the origin.
    observed = to_frame(np.array([0.10, theta + math.pi]), pose)
    jacobian = np.zeros((2, 5))
    jacobian[:, ekf.columns_of(0)] = ekf._line_jacobian(ekf.x, ekf.columns_of(0))
    difference, total = ekf.innovation(observed, 1e-3 * SEEN, 0)
    gain = covariance @ jacobian.T @ np.linalg.inv(total)
    unsigned = ekf.x + gain @ difference
    assert unsigned[3] < -0.02
    ekf.observe_line(observed, 1e-3 * SEEN, 0)
    assert ekf.x[3] >= 0.0
    assert -math.pi < ekf.x[2] <= math.pi
    assert -math.pi < ekf.x[4] <= math.pi
    np.testing.assert_allclose(nearest_form(ekf.lines[0], unsigned[3:]), unsigned[3:], atol=1e-12)
    flip = np.diag([1.0, 1.0, 1.0, -1.0, 1.0])
    expected = flip @ (np.eye(5) - gain @ jacobian) @ covariance @ flip
    np.testing.assert_allclose(ekf.P, expected, atol=1e-12)
    # What is predicted from it next has not noticed.
    after, total = ekf.innovation(observed, 1e-3 * SEEN, 0)
    turned = filter_with(unsigned[3:].reshape(1, 2), unsigned[:3], flip @ expected @ flip)
    same, same_total = turned.innovation(observed, 1e-3 * SEEN, 0)
    distance = after @ np.linalg.solve(total, after)
    assert distance == pytest.approx(same @ np.linalg.solve(same_total, same), rel=1e-6)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10_000))
def test_angles_and_distances_keep_to_their_ranges(seed: int) -> None:
    generator = np.random.default_rng(seed)
    # Lines at the origin and angles at the seam, where every update crosses something.
    lines = np.array([[0.001, math.pi], [0.002, -3.14], [0.0, 0.0], [0.5, 3.1415]])
    ekf = filter_with(lines, np.array([1.0, 0.4, math.pi]), spread(11, seed, 1e-3))
    for _ in range(10):
        ekf.predict(generator.normal(0.0, 0.1, 3), MOTION)
        index = int(generator.integers(4))
        observed = to_frame(ekf.lines[index], ekf.pose) + generator.normal(0.0, 0.03, 2)
        ekf.observe_line(observed, SEEN, index)
        assert (ekf.lines[:, 0] >= 0.0).all()
        assert (np.abs(np.append(ekf.lines[:, 1], ekf.pose[2])) <= math.pi).all()
        assert np.append(ekf.lines[:, 1], ekf.pose[2]).min() > -math.pi


@settings(deadline=None, max_examples=100)
@given(coordinates, coordinates, angles, st.integers(0, 3), st.integers(0, 1000))
def test_the_opposite_form_of_an_observed_line_gives_the_same_update(
    x: float, y: float, yaw: float, index: int, seed: int
) -> None:
    pose = np.array([x, y, yaw])
    one, other = (filter_with(LINES, pose, spread(11, seed)) for _ in range(2))
    observed = to_frame(LINES[index], pose) + np.array([0.02, -0.03])
    # The same line with its normal turned round: r changes its sign, and the correlation with it.
    opposite = np.array([-observed[0], observed[1] + math.pi])
    turned = SEEN * np.array([[1.0, -1.0], [-1.0, 1.0]])
    for each, line, covariance in ((one, observed, SEEN), (other, opposite, turned)):
        difference, total = each.innovation(line, covariance, index)
        np.testing.assert_allclose(difference, one.innovation(observed, SEEN, index)[0], atol=1e-9)
        np.testing.assert_allclose(total, one.innovation(observed, SEEN, index)[1], atol=1e-12)
    one.observe_line(observed, SEEN, index)
    other.observe_line(opposite, turned, index)
    np.testing.assert_allclose(other.x, one.x, atol=1e-9)
    np.testing.assert_allclose(other.P, one.P, atol=1e-12)


@pytest.mark.parametrize("beyond", [1e-3, 0.05, 1.0])
def test_a_wall_is_the_same_from_both_sides_of_it(beyond: float) -> None:
    # The robot looks at the wall r = 1 from beyond it, where its own line's form is the opposite one.
    line, pose = np.array([[1.0, 0.0]]), np.array([1.0 + beyond, 0.3, 0.0])
    covariance = np.diag([1e-2, 1e-4, 1e-4, 1e-6, 1e-6])
    ekf = filter_with(line, pose, covariance)
    # It sees the wall 0.1 m farther behind it than it believes: it is 0.1 m farther out.
    seen = to_frame(line[0], pose + np.array([0.1, 0.0, 0.0]))
    ekf.observe_line(seen, 1e-6 * np.eye(2), 0)
    assert ekf.pose[0] == pytest.approx(pose[0] + 0.1, abs=1e-3)
    assert ekf.pose[1] == pytest.approx(0.3, abs=1e-3)


def test_an_observation_a_little_across_the_wall_is_a_small_innovation() -> None:
    # Belief on one side of the wall, observation from the other: 2 cm, not a half turn.
    ekf = filter_with(np.array([[1.0, 0.4]]), np.array([0.0, 0.0, 0.4]), np.zeros((5, 5)))
    ekf.x[:2] = 0.99 * np.array([math.cos(0.4), math.sin(0.4)])
    difference, _ = ekf.innovation(np.array([0.01, math.pi]), SEEN, 0)
    np.testing.assert_allclose(difference, [-0.02, 0.0], atol=1e-12)


def test_the_innovations_covariance_is_that_of_landmark_pose_and_observation() -> None:
    pose, covariance = np.array([0.5, -1.0, 2.0]), spread(11, 3)
    ekf = filter_with(LINES, pose, covariance)
    jacobian = np.zeros((2, 11))
    jacobian[:, ekf.columns_of(2)] = ekf._line_jacobian(ekf.x, ekf.columns_of(2))
    observed = to_frame(LINES[2], pose) + np.array([0.01, 0.02])
    difference, total = ekf.innovation(observed, SEEN, 2)
    np.testing.assert_allclose(difference, [0.01, 0.02], atol=1e-12)
    np.testing.assert_allclose(total, jacobian @ covariance @ jacobian.T + SEEN, atol=1e-12)


def test_what_the_filter_gives_away_are_copies() -> None:
    ekf = filter_with(LINES, np.zeros(3), spread(11, 1))
    state, covariance = ekf.x.copy(), ekf.P.copy()
    for given_away in (ekf.pose, ekf.joint_pose_covariance, ekf.lines, ekf.line_covariance(1)):
        given_away.fill(1.0)
    np.testing.assert_array_equal(ekf.x, state)
    np.testing.assert_array_equal(ekf.P, covariance)


def test_the_callers_start_is_not_changed() -> None:
    pose, covariance = np.zeros(3), 1e-3 * np.eye(3)
    LineEKF(pose, covariance).predict(np.array([1.0, 0.0, 0.0]), MOTION)
    np.testing.assert_array_equal(pose, np.zeros(3))
    np.testing.assert_array_equal(covariance, 1e-3 * np.eye(3))


@pytest.mark.parametrize("order", ["C", "F"])
def test_an_update_shrinks_the_covariance_however_it_lies_in_memory(order: str) -> None:
    # filterpy's call, with a measurement of x alone: P changes in place, and that must reach P itself.
    ekf = LineEKF(np.zeros(3), np.array(1e-2 * np.eye(3), order=order))
    measured = np.array([0.1])
    ekf.update(measured, lambda _: np.array([[1.0]]), lambda x: x[:1], np.array([[1e-2]]), columns=np.array([0]))
    assert ekf.pose[0] == pytest.approx(0.05)
    assert ekf.joint_pose_covariance[0, 0] == pytest.approx(0.5e-2)


def test_predict_update_is_refused() -> None:
    with pytest.raises(NotImplementedError, match="predict, then update"):
        LineEKF(np.zeros(3)).predict_update(np.zeros(2), None, None)
