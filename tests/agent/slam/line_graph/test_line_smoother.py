"""The line smoother: its Jacobians, its optimum, its covariances, and what it can calibrate."""

import numpy as np
import pytest
from support.drives import ROBOT
from support.smoother_runs import noisy_run, state_from_motions, true_labels

from limslam_agent.slam.line_graph.factors import expected_readings, motion_jacobians, motions_between
from limslam_agent.slam.line_graph.line_smoother import pose_columns, solve
from limslam_agent.slam.line_graph.problem import (
    CALIBRATION_PRIOR,
)
from limslam_agent.slam.line_graph.reassociation import solve_labels
from limslam_env.geometry import se2


def smoothed(problem, poses):
    return solve_labels(problem, state_from_motions(problem), true_labels(problem, poses)).solution


def nees(true, estimated, covariances):
    error = true - estimated
    error[..., 2] = se2.wrap_angle(error[..., 2])
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariances, error[..., None])[..., 0])


@pytest.mark.parametrize("turn", [0.0, 1e-5, 0.3, -1.2])
def test_derivatives_of_motions_are_differences(turn):
    poses = np.array([[0.3, -0.2, 0.7], [0.35, -0.17, 0.7 + turn]])
    found = motion_jacobians(poses, ROBOT.axle)[0]
    for column in range(6):
        change = np.zeros((2, 3))
        change.flat[column] = 1e-6
        ends = [motions_between(poses + sign * change, ROBOT.axle)[0] for sign in (1.0, -1.0)]
        assert found[:, column] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-6)


@pytest.mark.parametrize("width", [0.0, 0.03, 1.2])
def test_derivatives_of_readings_are_differences(width):
    pose, line, anchor = np.array([0.3, 0.2, 0.4]), np.array([0.1, 0.9]), np.array([1.0, 1.1])
    beam = np.array([0.05, 0.08, 0.6])

    def expected_at(pose, line):
        return expected_readings(pose[None], beam[None], line[None], anchor[None], width)

    found = expected_at(pose, line)
    derivatives = np.append(found.by_pose[0], found.by_line[0])
    for column in range(5):
        change = np.zeros(5)
        change[column] = 1e-6
        ends = [expected_at(pose + sign * change[:3], line + sign * change[3:]).ranges[0] for sign in (1.0, -1.0)]
        assert derivatives[column] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-6)


def test_covariances_are_those_of_a_dense_solution():
    problem, poses = noisy_run(4)
    first = solve_labels(problem, state_from_motions(problem), true_labels(problem, poses))
    # The equations are linearised at the state before the last step, which is the optimum here.
    solution = solve(problem, first.state, first.labels)
    covariances = solution.of_poses
    # The same equations, with nothing eliminated: numerical derivatives of all residuals by all poses and lines.
    state, labels = solution.state, true_labels(problem, poses)
    steps, count = problem.steps, len(state.lines)
    jacobians = motion_jacobians(state.poses[0], ROBOT.axle)
    whole = np.zeros((3 * steps + 2 * count, 3 * steps + 2 * count))
    for step in range(steps - 1):
        own = slice(3 * step, 3 * step + 6)
        jacobian = problem.roots[0, step] @ jacobians[step]
        whole[own, own] += jacobian.T @ jacobian
    for k in np.flatnonzero(solution.weights):
        place, line = 3 * problem.readings.places[k], 3 * steps + 2 * labels[k]
        columns = np.r_[place : place + 3, line : line + 2]
        row = numbered_row(problem, state, labels[k], k)
        whole[np.ix_(columns, columns)] += np.outer(row, row) / problem.range_std**2
    dense = np.linalg.inv(whole[3:, 3:])
    for step in (1, steps // 2, steps - 1):
        block = slice(3 * step - 3, 3 * step)
        assert covariances[0, step] == pytest.approx(dense[block, block], rel=1e-3, abs=1e-12)
    # The joint covariance of the last pose and the lines, from which a renewal goes on.
    unknowns = solution.unknowns
    columns = np.append(pose_columns(unknowns.ends[-1:]), np.arange(unknowns.first_line, unknowns.size))
    rows = np.searchsorted(unknowns.kept, columns)
    joint = solution.covariance[np.ix_(rows, rows)]
    assert joint == pytest.approx(dense[3 * steps - 6 :, 3 * steps - 6 :], rel=1e-3, abs=1e-9)


def numbered_row(problem, state, line, k):
    """Derivatives (5,) of one reading by its pose and its line."""
    pose = state.poses[0, problem.readings.places[k]]
    found = expected_readings(pose[None], problem.beams[[k]], state.lines[[line]], state.anchors[[line]], 0.0)
    return np.append(found.by_pose[0], found.by_line[0])


def test_errors_are_as_large_as_the_covariances_say():
    mean = []
    for seed in range(12):
        problem, poses = noisy_run(seed)
        solution = smoothed(problem, poses)
        covariances = solution.of_poses
        mean.append(nees(poses[0, 30:], solution.state.poses[0, 30:], covariances[0, 30:]).mean() / 3.0)
    # The mean of 12 runs of strongly correlated poses: chi-square of about 36 degrees of freedom, over 36.
    assert 0.5 < np.mean(mean) < 1.6


def test_wheel_sizes_are_found():
    problem, poses = noisy_run(6, mismatch=0.02, prior=CALIBRATION_PRIOR)
    solution = smoothed(problem, poses)
    # The left wheel reports 2 % too much: it is smaller than specified.
    assert solution.state.calibration[0, :2] == pytest.approx([-0.02, 0.02], abs=0.006)
    error = np.linalg.norm(solution.state.poses[0, :, :2] - poses[0, :, :2], axis=1).max()
    plain, _ = noisy_run(6, mismatch=0.02)
    assert error < 0.5 * np.linalg.norm(state_from_motions(plain).poses[0, :, :2] - poses[0, :, :2], axis=1).max()


def test_a_range_bias_is_found():
    problem, poses = noisy_run(7, noise=0.0, prior=CALIBRATION_PRIOR)
    biased = problem.readings.distances + 0.015
    object.__setattr__(problem.readings, "distances", biased)
    assert smoothed(problem, poses).state.calibration[0, 3] == pytest.approx(0.015, abs=0.004)
