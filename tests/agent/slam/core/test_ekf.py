"""The line EKF: equal to filterpy's dense filter, honest where the model is linear, and sound after
many steps.
"""

import math

import numpy as np
import pytest
from filterpy.kalman import ExtendedKalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from limslam_agent.slam.core.ekf import LineEKF
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry

MOTION = np.diag([2e-6, 5e-7, 4e-5])
SEEN = np.array([[1e-4, 3e-5], [3e-5, 2e-4]])
LINES = np.array([(2.0, 0.3), (1.5, 1.9), (3.0, -2.8), (0.8, -1.2)])


def spread(size: int, seed: int, scale: float = 1e-3) -> FloatArray:
    """Some covariance (size, size) with correlations between all numbers."""
    root = np.random.default_rng(seed).normal(size=(size, size + 2))
    return scale * (root @ root.T) / size


def filter_with(lines: FloatArray, pose: FloatArray, covariance: FloatArray) -> LineEKF:
    """A filter with given lines and a given covariance of everything."""
    ekf = LineEKF(pose, covariance[:3, :3])
    for line in lines:
        ekf.augment(line_geometry.to_frame(line, ekf.pose), SEEN)
    ekf.x = np.concatenate((pose, lines.ravel()))
    ekf.P = np.array(covariance)
    return ekf


def random_lines(count: int, generator: np.random.Generator) -> FloatArray:
    return np.column_stack(
        (generator.uniform(0.3, 5.0, count), generator.uniform(-math.pi, math.pi, count))
    )


# The dense filter: the textbook's Jacobians, written out here once more and at full size.


def dense_predict(
    dense: ExtendedKalmanFilter, increment: FloatArray, covariance: FloatArray
) -> None:
    x, y, theta = dense.x[:3]
    cos = math.cos(theta)
    sin = math.sin(theta)
    size = len(dense.x)
    dense.F = np.eye(size)
    dense.F[0, 2] = -sin * increment[0] - cos * increment[1]
    dense.F[1, 2] = cos * increment[0] - sin * increment[1]
    turned = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    dense.Q = np.zeros((size, size))
    dense.Q[:3, :3] = turned @ covariance @ turned.T
    moved = [
        x + cos * increment[0] - sin * increment[1],
        y + sin * increment[0] + cos * increment[1],
    ]
    state = np.concatenate((moved, [se2.wrap_angle(theta + increment[2])], dense.x[3:]))
    dense.predict()
    dense.x = state


def dense_observe(
    dense: ExtendedKalmanFilter, z: FloatArray, covariance: FloatArray, index: int
) -> None:
    first = 3 + 2 * index

    def unsigned(state: FloatArray) -> float:
        r, theta = state[first : first + 2]
        return float(r - state[0] * math.cos(theta) - state[1] * math.sin(theta))

    def predicted(state: FloatArray) -> FloatArray:
        behind = unsigned(state) < 0.0
        return np.array(
            [abs(unsigned(state)), state[first + 1] - state[2] + (math.pi if behind else 0.0)]
        )

    def jacobian(state: FloatArray) -> FloatArray:
        sign = -1.0 if unsigned(state) < 0.0 else 1.0
        cos = math.cos(state[first + 1])
        sin = math.sin(state[first + 1])
        full = np.zeros((2, len(state)))
        full[:, :3] = [[-sign * cos, -sign * sin, 0.0], [0.0, 0.0, -1.0]]
        full[:, first : first + 2] = [[sign, sign * (state[0] * sin - state[1] * cos)], [0.0, 1.0]]
        return full

    def residual(one: FloatArray, other: FloatArray) -> FloatArray:
        return np.array([one[0] - other[0], se2.wrap_angle(one[1] - other[1])])

    dense.update(z, jacobian, predicted, covariance, residual=residual)
    dense.x = np.array(dense.x)
    dense.x[2] = se2.wrap_angle(dense.x[2])
    for row in range(3, len(dense.x), 2):
        if dense.x[row] < 0.0:
            flip = np.eye(len(dense.x))
            flip[row, row] = -1.0
            dense.x[row], dense.x[row + 1] = -dense.x[row], dense.x[row + 1] + math.pi
            dense.P = flip @ dense.P @ flip
        dense.x[row + 1] = se2.wrap_angle(dense.x[row + 1])


def dense_augment(
    dense: ExtendedKalmanFilter, z: FloatArray, covariance: FloatArray
) -> ExtendedKalmanFilter:
    size = len(dense.x)
    theta = z[1] + dense.x[2]
    r = z[0] + dense.x[0] * math.cos(theta) + dense.x[1] * math.sin(theta)
    sign = -1.0 if r < 0.0 else 1.0
    by_angle = sign * (dense.x[1] * math.cos(theta) - dense.x[0] * math.sin(theta))
    by_pose = [[sign * math.cos(theta), sign * math.sin(theta), by_angle], [0.0, 0.0, 1.0]]
    by_state = np.vstack((np.eye(size), np.hstack((by_pose, np.zeros((2, size - 3))))))
    by_z = np.vstack((np.zeros((size, 2)), [[sign, by_angle], [0.0, 1.0]]))
    grown = ExtendedKalmanFilter(dim_x=size + 2, dim_z=2)
    line = np.array([abs(r), se2.wrap_angle(theta + (math.pi if r < 0.0 else 0.0))])
    grown.x = np.concatenate((dense.x, line))
    grown.P = by_state @ dense.P @ by_state.T + by_z @ covariance @ by_z.T
    return grown


def assert_equal_filters(ekf: LineEKF, dense: ExtendedKalmanFilter) -> None:
    np.testing.assert_allclose(ekf.x, dense.x, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(ekf.P, dense.P, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("seed", [0])
def test_a_hundred_random_steps_equal_filterpys_dense_filter(seed: int) -> None:
    generator = np.random.default_rng(seed)
    ekf = LineEKF(np.array([0.5, -0.3, 2.8]), spread(3, seed, 1e-4))
    dense = ExtendedKalmanFilter(dim_x=3, dim_z=2)
    dense.x = ekf.pose
    dense.P = ekf.joint_pose_covariance
    for line in random_lines(20, generator):
        seen = line_geometry.to_frame(line, ekf.pose) + generator.multivariate_normal(
            np.zeros(2), SEEN
        )
        ekf.augment(seen, SEEN)
        dense = dense_augment(dense, seen, SEEN)
        assert_equal_filters(ekf, dense)
    for _ in range(100):
        increment = np.array(
            [
                generator.uniform(-0.1, 0.1),
                generator.normal(0.0, 0.01),
                generator.uniform(-0.3, 0.3),
            ]
        )
        ekf.predict(increment, MOTION)
        dense_predict(dense, increment, MOTION)
        assert_equal_filters(ekf, dense)
        index = int(generator.integers(20))
        predicted = line_geometry.to_frame(ekf.lines[index], ekf.pose)
        seen = line_geometry.nearest_form(
            predicted + generator.multivariate_normal(np.zeros(2), SEEN), predicted
        )
        ekf.observe_line(seen, SEEN, index)
        dense_observe(dense, seen, SEEN, index)
        assert_equal_filters(ekf, dense)


def test_errors_stay_inside_their_chi_square_band_where_the_model_is_nearly_linear() -> None:
    # Noise so small that curvature does not count; what is left is the algebra, and NEES tells if
    # it is right.
    runs = 200
    steps = 20
    small = 1e-4
    generator = np.random.default_rng(21)
    start = np.array([0.4, -0.2, 1.0])
    first, motion, seen = (
        small**2 * np.diag(d) for d in ([1.0, 2.0, 0.5], [1.0, 0.2, 0.7], [1.0, 2.0])
    )
    pose_nees = np.zeros(runs)
    state_nees = np.zeros(runs)
    innovations = np.zeros(runs)
    for run in range(runs):
        truth = generator.multivariate_normal(start, first)
        ekf = LineEKF(start, first)
        for step in range(steps):
            increment = np.array([0.1, 0.0, 0.2 * math.sin(step)])
            truth = se2.compose(truth, increment)
            ekf.predict(increment + generator.multivariate_normal(np.zeros(3), motion), motion)
            for index, line in enumerate(LINES):
                observed = line_geometry.to_frame(line, truth) + generator.multivariate_normal(
                    np.zeros(2), seen
                )
                if step == 0:
                    ekf.augment(observed, seen)
                    continue
                difference, covariance = ekf.innovation(observed, seen, index)
                innovations[run] += difference @ np.linalg.solve(covariance, difference)
                ekf.observe_line(observed, seen, index)
        error = np.concatenate(
            (ekf.pose - truth, (line_geometry.nearest_form(ekf.lines, LINES) - LINES).ravel())
        )
        error[2] = se2.wrap_angle(float(error[2]))
        pose_nees[run] = error[:3] @ np.linalg.solve(ekf.joint_pose_covariance, error[:3])
        state_nees[run] = error @ np.linalg.solve(ekf.P, error)
    for values, freedom in (
        (pose_nees, 3),
        (state_nees, 11),
        (innovations, 2 * len(LINES) * (steps - 1)),
    ):
        low, high = chi2.ppf([0.025, 0.975], freedom * runs) / runs
        assert low < values.mean() < high


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
        observed = line_geometry.to_frame(ekf.lines[index], ekf.pose) + generator.normal(
            0.0, 0.03, 2
        )
        ekf.observe_line(observed, SEEN, index)
        assert (ekf.lines[:, 0] >= 0.0).all()
        assert (np.abs(np.append(ekf.lines[:, 1], ekf.pose[2])) <= math.pi).all()
        assert np.append(ekf.lines[:, 1], ekf.pose[2]).min() > -math.pi


# Several robots.

STARTS = np.array([[1.0, 1.0, 0.3], [2.0, 0.5, -2.0]])
LINE_NOISE = np.diag([1e-4, 1e-4])


def moved_pair() -> LineEKF:
    """Two robots that have moved, and a line that the first has seen."""
    ekf = LineEKF(STARTS)
    for step in range(20):
        ekf.predict(np.array([0.03, 0.0, 0.02]), MOTION, 0)
        ekf.predict(np.array([0.02, 0.0, -0.01 * (step % 3)]), MOTION, 1)
    ekf.augment(np.array([0.8, 1.2]), LINE_NOISE, 0)
    return ekf


def test_the_filter_of_two_is_two_filters_until_they_see_one_wall() -> None:
    together = LineEKF(STARTS)
    alone = [LineEKF(start) for start in STARTS]
    for robot, ekf in enumerate(alone):
        for turn in (0.1, -0.05, 0.2):
            for filter_, number in ((together, robot), (ekf, 0)):
                filter_.predict(np.array([0.05, 0.0, turn]), MOTION, number)
        line = np.array([0.7 + 0.2 * robot, 0.4])
        together.augment(line, LINE_NOISE, robot)
        ekf.augment(line, LINE_NOISE)
        together.observe_line(line + 0.01, LINE_NOISE, robot, robot)
        ekf.observe_line(line + 0.01, LINE_NOISE, 0)
    for robot, ekf in enumerate(alone):
        np.testing.assert_allclose(together.poses[robot], ekf.pose, atol=1e-12)
        part = slice(3 * robot, 3 * robot + 3)
        np.testing.assert_allclose(
            together.joint_pose_covariance[part, part], ekf.joint_pose_covariance, atol=1e-12
        )
        np.testing.assert_allclose(together.lines[robot], ekf.lines[0], atol=1e-12)
    assert not together.P[:3, 3:6].any()


def test_a_wall_that_both_see_ties_their_poses_together() -> None:
    ekf = moved_pair()
    seen = line_geometry.to_frame(ekf.lines[0], ekf.poses[1])
    before = ekf.joint_pose_covariance
    ekf.observe_line(seen, LINE_NOISE, 0, 1)
    after = ekf.joint_pose_covariance
    assert np.abs(after[:3, 3:]).max() > 0.0
    assert np.linalg.eigvalsh(before - after).min() > -1e-12, (
        "nobody becomes less certain by a measurement"
    )
