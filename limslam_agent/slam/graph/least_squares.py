"""Factors of the graph with their Jacobians, which are added to normal equations.

The unknowns have this order: three for each key pose, the five constant errors of odometry, two for
each line (turn about its centre, offset). A step is added to the parameters of a pose directly.
"""

from collections.abc import Callable

import numpy as np

from limslam_agent.config.graph import OdometryErrorConfig
from limslam_agent.slam.graph.key_poses import (
    ERRORS,
    KeyPoses,
    Trajectory,
    calibrated_rates,
    calibrated_steps,
)
from limslam_agent.slam.graph.point_links import PointCloud
from limslam_agent.slam.least_squares.normal_equations import NormalEquations, pose_columns
from limslam_env.geometry import FloatArray, IntArray, se2

_LINK_KERNEL = 2.0  # scale of the Geman-McClure kernel of links, in standard deviations
_LOOP_KERNEL = 3.0  # the parameter of dynamic covariance scaling, as a chi-square

Relations = tuple[IntArray, FloatArray, FloatArray]
"""Relative poses between poses: their ends (f, 2), relative poses (f, 3) and information (f, 3,
3).
"""


def relation_factor(
    poses: FloatArray, first: IntArray, second: IntArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Errors (f, 3) of measured relative poses (f, 3), and their Jacobians (f, 3, 6) by the first
    and second pose.

    The error is the estimated relative pose minus the measured relative pose, with a wrapped
    heading.
    """
    a = poses[first]
    b = poses[second]
    cos = np.cos(a[:, 2])
    sin = np.sin(a[:, 2])
    dx = b[:, 0] - a[:, 0]
    dy = b[:, 1] - a[:, 1]
    x = cos * dx + sin * dy
    y = cos * dy - sin * dx
    turn = se2.wrap_angle(b[:, 2] - a[:, 2] - measured[:, 2])
    jacobian = np.zeros((len(a), 3, 6))
    jacobian[:, 0, 3] = jacobian[:, 1, 4] = cos
    jacobian[:, 0, 4] = sin
    jacobian[:, 1, 3] = -sin
    jacobian[:, :2, :2] = -jacobian[:, :2, 3:5]
    jacobian[:, 0, 2] = y
    jacobian[:, 1, 2] = -x
    jacobian[:, 2, 2] = -1.0
    jacobian[:, 2, 5] = 1.0
    return np.column_stack((x - measured[:, 0], y - measured[:, 1], turn)), jacobian


def odometry_factor(keys: KeyPoses, trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Errors (m - 1, 3) of odometry between key poses, and their Jacobians (m - 1, 3, 11).

    The Jacobians refer to both poses and the constant errors of odometry.
    """
    first = np.arange(len(keys) - 1)
    steps = calibrated_steps(keys, trajectory.bias)
    error, by_poses = relation_factor(trajectory.poses, first, first + 1, steps)
    by_bias = np.zeros((len(first), 3, ERRORS))
    # The derivative of the calibrated step by the heading bias: half the missing heading rotates
    # the step.
    by_bias[:, 0, 0] = 0.5 * keys.step_forward * steps[:, 1]
    by_bias[:, 1, 0] = -0.5 * keys.step_forward * steps[:, 0]
    by_bias[:, 2, 0] = -keys.step_forward
    by_bias[:, :2, 1] = -steps[:, :2] / (1.0 + trajectory.bias[1])
    by_bias[:, 2, 2] = -keys.step[:, 2] - trajectory.bias[3] * keys.step_rate[:, 2]
    by_bias[:, :, 3] = -calibrated_rates(keys, trajectory.bias)
    by_bias[:, 0, 4] = steps[:, 1]
    by_bias[:, 1, 4] = -steps[:, 0]
    return error, np.concatenate((by_poses, by_bias), axis=2)


def add_odometry(
    equations: NormalEquations, keys: KeyPoses, trajectory: Trajectory, motion: OdometryErrorConfig
) -> None:
    """Add the odometry between key poses, and the prior of its constant errors."""
    error, jacobian = odometry_factor(keys, trajectory)
    count = len(keys)
    first = np.arange(count - 1)
    bias = np.arange(3 * count, 3 * count + ERRORS)
    columns = np.hstack(
        (pose_columns(first), pose_columns(first + 1), np.tile(bias, (count - 1, 1)))
    )
    equations.add(columns, jacobian, error, _diagonals(1.0 / keys.step_variances))
    prior = np.array([motion.stds]) ** -2.0
    equations.add(bias[None], np.eye(ERRORS)[None], trajectory.bias[None], _diagonals(prior))


def add_links(
    equations: NormalEquations, poses: FloatArray, cloud: PointCloud, links: IntArray, std: float
) -> None:
    """Add links (l, 2) from points to the lines through other points; ``std`` (m) is the standard
    deviation of each.
    """
    key, other = cloud.key[links].T
    points, others = cloud.places[links.T]
    errors, jacobian = link_factor(
        poses[key], poses[other], points, others, cloud.normals[links[:, 1]]
    )
    add_robust(
        equations,
        np.hstack((pose_columns(key), pose_columns(other))),
        jacobian,
        errors,
        std,
        _LINK_KERNEL,
    )


def link_factor(
    first: FloatArray,
    second: FloatArray,
    points: FloatArray,
    others: FloatArray,
    normals: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Distances (l,) of points seen from first poses from the lines through others seen from second
    poses (l, 3).

    Also their derivatives (l, 6) by both poses. Points, other points and normals (l, 2) are given
    in the world.
    """
    apart = points - others
    lever = others - second[:, :2]
    # A rotation of the second pose moves the point of the line and rotates its normal.
    turned = cross(normals, apart) - cross(lever, normals)
    by_poses = np.column_stack((normals, cross(points - first[:, :2], normals), -normals, turned))
    return np.sum(normals * apart, axis=1), by_poses


def cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Cross products (k,) of vectors (k, 2)."""
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def add_robust(
    equations: NormalEquations,
    columns: IntArray,
    jacobian: FloatArray,
    errors: FloatArray,
    std: float,
    bend: float,
) -> None:
    """Add factors with columns (f, q), Jacobians (f, q) and errors (f,), m, with the Geman-McClure
    kernel.

    ``std`` (m) is their standard deviation, and ``bend`` is the scale of the kernel in standard
    deviations. The factors of the same columns, of which the first and the last one tell them
    apart, are summed beforehand.
    """
    if not len(columns):
        return
    weights = 1.0 / ((1.0 + (errors / (bend * std)) ** 2) * std) ** 2
    order = np.lexsort((columns[:, -1], columns[:, 0]))
    columns = columns[order]
    jacobian = jacobian[order]
    weighted = weights[order, None] * jacobian
    firsts = np.flatnonzero((np.diff(columns[:, [0, -1]], axis=0, prepend=-1) != 0).any(axis=1))
    hessian = np.add.reduceat(weighted[:, :, None] * jacobian[:, None], firsts)
    gradient = np.add.reduceat(weighted * errors[order, None], firsts)
    equations.add_blocks(columns[firsts], hessian, gradient)


def loop_weights(chi2: FloatArray, widening: float = 1.0) -> FloatArray:
    """Weights (f,) of loops by dynamic covariance scaling with a kernel that is wider by a factor.

    The weight is min(1, 2 phi / (phi + chi^2))^2 (Agarwal et al., "Robust map optimization using
    dynamic covariance scaling", 2013).
    """
    phi = _LOOP_KERNEL * widening
    return np.asarray(np.minimum(1.0, 2.0 * phi / (phi + chi2)) ** 2)


def add_relations(
    equations: NormalEquations,
    poses: FloatArray,
    ends: IntArray,
    measured: FloatArray,
    information: FloatArray,
    weigh: Callable[[FloatArray], FloatArray] = loop_weights,
) -> FloatArray:
    """Add relative poses (f, 3) between poses ``ends`` (f, 2), with their information (f, 3, 3).

    Returns their weights (f,), which ``weigh`` gives by the chi-squares (f,) of their errors.
    """
    error, jacobian = relation_factor(poses, ends[:, 0], ends[:, 1], measured)
    weights = weigh(np.einsum("fi,fij,fj->f", error, information, error))
    columns = np.hstack((pose_columns(ends[:, 0]), pose_columns(ends[:, 1])))
    equations.add(columns, jacobian, error, information * weights[:, None, None])
    return weights


def _diagonals(values: FloatArray) -> FloatArray:
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))
