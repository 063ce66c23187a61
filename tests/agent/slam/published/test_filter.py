"""The filter of the published method: honest where the model is linear, and sound after many
steps.
"""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from limslam_agent.slam.core.motion import Motion
from limslam_agent.slam.published import ObservedLine
from limslam_agent.slam.published.features import Scan
from limslam_agent.slam.published.filter import LineFilter
from limslam_env.geometry import FloatArray, se2
from limslam_env.geometry import line as line_geometry

NOISE = np.diag([2e-6, 5e-7, 4e-5])
LINES = np.array([(2.0, 0.3), (1.5, 1.9), (3.0, -2.8), (0.8, -1.2)])
LINE_NOISE = np.diag([1e-4, 1e-4])


def seen(line: FloatArray, covariance: FloatArray = LINE_NOISE) -> ObservedLine:
    return ObservedLine(line, covariance, np.zeros((2, 2)), Scan())


def test_errors_stay_inside_their_chi_square_band_where_the_model_is_nearly_linear() -> None:
    # Noise so small that curvature does not count; what is left is the algebra, and NEES tells if
    # it is right.
    runs = 200
    steps = 20
    small = 1e-4
    generator = np.random.default_rng(21)
    start = np.array([0.4, -0.2, 1.0])
    first, noise, of_line = (
        small**2 * np.diag(d) for d in ([1.0, 2.0, 0.5], [1.0, 0.2, 0.7], [1.0, 2.0])
    )
    pose_nees = np.zeros(runs)
    state_nees = np.zeros(runs)
    innovations = np.zeros(runs)
    for run in range(runs):
        truth = generator.multivariate_normal(start, first)
        ekf = LineFilter(start)
        ekf.P = first.copy()
        for step in range(steps):
            increment = np.array([0.1, 0.0, 0.2 * math.sin(step)])
            truth = se2.compose(truth, increment)
            ekf.move(Motion(generator.multivariate_normal(increment, noise), noise))
            for index, line in enumerate(LINES):
                expected = line_geometry.to_frame(line, truth)
                observed = seen(generator.multivariate_normal(expected, of_line), of_line)
                if step == 0:
                    ekf.augment(observed)
                    continue
                difference, covariance = ekf.innovation(observed, index)
                innovations[run] += difference @ np.linalg.solve(covariance, difference)
                ekf.observe(observed, index)
        error = np.concatenate(
            (ekf.poses[0] - truth, (line_geometry.nearest_form(ekf.lines, LINES) - LINES).ravel())
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
    ekf = LineFilter(np.array([1.0, 0.4, math.pi]))
    for line in lines:
        ekf.augment(seen(line_geometry.to_frame(line, ekf.poses[0])))
    ekf.x[3:] = lines.ravel()
    root = generator.normal(size=(11, 13))
    ekf.P = 1e-3 * (root @ root.T) / 11
    for _ in range(10):
        ekf.move(Motion(generator.normal(0.0, 0.1, 3), NOISE))
        index = int(generator.integers(4))
        expected = line_geometry.to_frame(ekf.lines[index], ekf.poses[0])
        ekf.observe(seen(expected + generator.normal(0.0, 0.03, 2)), index)
        angles = np.append(ekf.lines[:, 1], ekf.poses[0, 2])
        assert (ekf.lines[:, 0] >= 0.0).all()
        assert (np.abs(angles) <= math.pi).all()
        assert angles.min() > -math.pi
        np.testing.assert_allclose(ekf.P, ekf.P.T, atol=1e-12)


# Several robots.

STARTS = np.array([[1.0, 1.0, 0.3], [2.0, 0.5, -2.0]])


def test_the_filter_of_two_is_two_filters_until_they_see_one_wall() -> None:
    together = LineFilter(STARTS)
    alone = [LineFilter(start) for start in STARTS]
    for robot, ekf in enumerate(alone):
        for turn in (0.1, -0.05, 0.2):
            for filter_, number in ((together, robot), (ekf, 0)):
                filter_.move(Motion(np.array([0.05, 0.0, turn]), NOISE), number)
        line = np.array([0.7 + 0.2 * robot, 0.4])
        together.augment(seen(line), robot)
        ekf.augment(seen(line))
        together.observe(seen(line + 0.01), robot, robot)
        ekf.observe(seen(line + 0.01), 0)
    for robot, ekf in enumerate(alone):
        np.testing.assert_allclose(together.poses[robot], ekf.poses[0], atol=1e-12)
        part = slice(3 * robot, 3 * robot + 3)
        np.testing.assert_allclose(
            together.joint_pose_covariance[part, part], ekf.joint_pose_covariance, atol=1e-12
        )
        np.testing.assert_allclose(together.lines[robot], ekf.lines[0], atol=1e-12)
    assert not together.P[:3, 3:6].any()
    # A wall that both see ties their poses together, and nobody becomes less certain by it.
    before = together.joint_pose_covariance
    together.observe(seen(line_geometry.to_frame(together.lines[0], together.poses[1])), 0, 1)
    after = together.joint_pose_covariance
    assert np.abs(after[:3, 3:]).max() > 0.0
    assert np.linalg.eigvalsh(before - after).min() > -1e-12
