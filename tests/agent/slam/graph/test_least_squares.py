"""Jacobians of the graph's factors against central differences, and its normal equations against dense ones."""

import numpy as np

from limslam_agent.config.graph import PointConfig
from limslam_agent.slam.graph.key_poses import LogData, Trajectory, choose_keys, odometry_trajectory
from limslam_agent.slam.graph.least_squares import (
    add_robust,
    link_factor,
    odometry_factor,
    relation_factor,
)
from limslam_agent.slam.graph.wall_lines import line_factor
from limslam_agent.slam.least_squares.normal_equations import NormalEquations, pose_columns

RNG = np.random.default_rng(3)


def central_differences(function, values, step=1e-6):
    columns = []
    for place in range(values.size):
        high, low = values.copy(), values.copy()
        high.flat[place] += step
        low.flat[place] -= step
        columns.append((function(high) - function(low)) / (2.0 * step))
    return np.stack(columns, axis=-1)


def curved_log(count=60):
    time = np.arange(count, dtype=float)
    turn = np.cumsum(RNG.normal(0.0, 0.1, count))
    odometry = np.column_stack((np.cumsum(0.1 * np.cos(turn)), np.cumsum(0.1 * np.sin(turn)), turn))
    ranges = RNG.uniform(0.5, 3.0, (count, 2))
    hit = np.ones((count, 2), dtype=bool)
    return LogData(time, odometry, ranges, hit, np.zeros((2, 2)), np.array([1.5, -1.5]), 5.0)


def keys_of(log):
    return choose_keys(log, PointConfig())


def test_relation_jacobian():
    poses = RNG.normal(0.0, 2.0, (2, 3))
    measured = RNG.normal(0.0, 1.0, (1, 3))

    def error(both):
        return relation_factor(both, np.array([0]), np.array([1]), measured)[0][0]

    _, jacobian = relation_factor(poses, np.array([0]), np.array([1]), measured)
    assert np.allclose(jacobian[0], central_differences(error, poses), atol=1e-7)


def test_odometry_jacobian_by_poses_and_constant_errors():
    keys = keys_of(curved_log())
    bias = np.array([0.02, 0.01, -0.02, 0.1, 0.03])
    poses = odometry_trajectory(keys, np.array([1.0, 2.0, 0.5])).poses + RNG.normal(0.0, 0.02, (len(keys), 3))
    _, jacobian = odometry_factor(keys, Trajectory(poses, bias))
    by_bias = central_differences(lambda each: odometry_factor(keys, Trajectory(poses, each))[0], bias)
    by_poses = central_differences(lambda each: odometry_factor(keys, Trajectory(each, bias))[0], poses)
    # The missed heading is spread along the step: second-order terms of it are left out.
    assert np.allclose(jacobian[:, :, 6:], by_bias, atol=1e-3)
    for row in range(len(keys) - 1):
        assert np.allclose(jacobian[row, :, :6], by_poses[row, :, 3 * row : 3 * row + 6], atol=1e-7)


def rotation(heading):
    return np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])


def test_link_jacobian():
    poses = RNG.normal(0.0, 2.0, (2, 3))
    point, other = RNG.normal(0.0, 2.0, (2, 2))
    normal = np.array([np.cos(0.7), np.sin(0.7)])

    def factor(both):
        (first, second), turns = both, [rotation(each[2]) for each in both]
        in_world = turns[0] @ point + first[:2], turns[1] @ other + second[:2], turns[1] @ normal
        return link_factor(first[None], second[None], *(each[None] for each in in_world))

    wanted = central_differences(lambda both: factor(both)[0][0], poses)
    assert np.allclose(factor(poses)[1][0], wanted, atol=1e-7)


def test_line_jacobian():
    pose, place = RNG.normal(0.0, 2.0, 3), RNG.normal(0.0, 2.0, 2)
    centre, angle = RNG.normal(0.0, 2.0, 2), 0.4

    def factor(unknowns):
        x, y, heading, turn, offset = unknowns
        moved, seen = centre + offset * np.array([np.cos(angle), np.sin(angle)]), rotation(heading) @ place + [x, y]
        return line_factor(np.array([[x, y, heading]]), seen[None], np.array([angle + turn]), moved[None])

    unknowns = np.append(pose, [0.0, 0.0])
    wanted = central_differences(lambda each: factor(each)[0][0], unknowns)
    assert np.allclose(factor(unknowns)[1][0], wanted, atol=1e-7)


def test_robust_factors_are_summed_with_their_weights():
    columns = np.array([[0, 1, 3], [0, 1, 4], [0, 1, 3], [2, 1, 4]])
    jacobian, errors, equations = RNG.normal(size=(4, 3)), np.array([0.1, -0.4, 0.02, 3.0]), NormalEquations(5)
    add_robust(equations, columns, jacobian, errors, 0.2, 2.0)
    wanted = np.zeros(5)
    for row, each, error in zip(columns, jacobian, errors, strict=True):
        wanted[row] += each * error / ((1.0 + (error / 0.4) ** 2) * 0.2) ** 2
    assert np.allclose(equations.gradient, wanted)


def test_the_sparse_step_equals_a_dense_one():
    equations = NormalEquations(9)
    first, second = np.array([0, 1, 0]), np.array([1, 2, 2])
    poses = RNG.normal(0.0, 1.0, (3, 3))
    error, jacobian = relation_factor(poses, first, second, RNG.normal(0.0, 1.0, (3, 3)))
    information = np.tile(np.diag([4.0, 5.0, 6.0]), (3, 1, 1))
    columns = np.hstack((pose_columns(first), pose_columns(second)))
    equations.add(columns, jacobian, error, information)
    dense = np.zeros((9, 9))
    for row in range(3):
        wide = np.zeros((3, 9))
        wide[:, columns[row]] = jacobian[row]
        dense += wide.T @ information[row] @ wide
    step = np.zeros(9)
    step[3:] = -np.linalg.solve(dense[3:, 3:], equations.gradient[3:])
    assert np.allclose(equations.solve(), step)
    covariance = np.zeros((9, 9))
    covariance[3:, 3:] = np.linalg.inv(dense[3:, 3:])
    wanted = jacobian[1] @ covariance[np.ix_(columns[1], columns[1])] @ jacobian[1].T
    assert np.allclose(equations.covariances(columns, jacobian)[1], wanted)
