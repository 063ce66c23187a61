"""Factors of the graph with their Jacobians, which are added to normal equations.

The unknowns have this order: three for each key pose, the five constant errors of odometry, two for each line (turn
about its centre, offset). A step is added to the parameters of a pose directly.
"""

import numpy as np

from limslam_agent.config.graph import OdometryErrorConfig
from limslam_agent.slam.graph.key_poses import ERRORS, KeyPoses, Trajectory, calibrated_rates, calibrated_steps
from limslam_agent.slam.least_squares.normal_equations import NormalEquations
from limslam_env.compilation import entry_of
from limslam_env.geometry import FloatArray, IntArray, se2

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)


def pose_columns(keys: IntArray) -> IntArray:
    """Columns (f, 3) of key poses (f,)."""
    return np.asarray(3 * keys[:, None] + np.arange(3))


def relation_factor(
    poses: FloatArray, first: IntArray, second: IntArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Errors (f, 3) of measured relative poses (f, 3), and their Jacobians (f, 3, 6) by the first and second pose.

    The error is the estimated relative pose minus the measured relative pose, with a wrapped heading.
    """
    a, b = poses[first], poses[second]
    cos, sin = np.cos(a[:, 2]), np.sin(a[:, 2])
    dx, dy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1]
    x, y = cos * dx + sin * dy, cos * dy - sin * dx
    turn = se2.wrap_angle(b[:, 2] - a[:, 2] - measured[:, 2])
    jacobian = np.zeros((len(a), 3, 6))
    jacobian[:, 0, 3] = jacobian[:, 1, 4] = cos
    jacobian[:, 0, 4], jacobian[:, 1, 3] = sin, -sin
    jacobian[:, :2, :2] = -jacobian[:, :2, 3:5]
    jacobian[:, 0, 2], jacobian[:, 1, 2] = y, -x
    jacobian[:, 2, 2], jacobian[:, 2, 5] = -1.0, 1.0
    return np.column_stack((x - measured[:, 0], y - measured[:, 1], turn)), jacobian


def relation_covariances(jacobian: FloatArray, joint: FloatArray, first: IntArray, second: IntArray) -> FloatArray:
    """Covariances (f, 3, 3) of relative poses, from their Jacobians (f, 3, 6) by the first and second pose.

    ``joint`` (3 c, 3 c) is the covariance of all poses.
    """
    columns = np.hstack((pose_columns(first), pose_columns(second)))
    return np.asarray(jacobian @ joint[columns[:, :, None], columns[:, None, :]] @ jacobian.transpose(0, 2, 1))


def odometry_factor(keys: KeyPoses, trajectory: Trajectory) -> tuple[FloatArray, FloatArray]:
    """Errors (m - 1, 3) of odometry between key poses, and their Jacobians (m - 1, 3, 11).

    The Jacobians refer to both poses and the constant errors of odometry.
    """
    first = np.arange(len(keys) - 1)
    steps = calibrated_steps(keys, trajectory.bias)
    error, by_poses = relation_factor(trajectory.poses, first, first + 1, steps)
    by_bias = np.zeros((len(first), 3, ERRORS))
    # The derivative of the calibrated step by the heading bias: half the missing heading rotates the step.
    by_bias[:, 0, 0], by_bias[:, 1, 0] = 0.5 * keys.step_forward * steps[:, 1], -0.5 * keys.step_forward * steps[:, 0]
    by_bias[:, 2, 0] = -keys.step_forward
    by_bias[:, :2, 1] = -steps[:, :2] / (1.0 + trajectory.bias[1])
    by_bias[:, 2, 2] = -keys.step[:, 2] - trajectory.bias[3] * keys.step_rate[:, 2]
    by_bias[:, :, 3] = -calibrated_rates(keys, trajectory.bias)
    by_bias[:, 0, 4], by_bias[:, 1, 4] = steps[:, 1], -steps[:, 0]
    return error, np.concatenate((by_poses, by_bias), axis=2)


def add_odometry(
    equations: NormalEquations, keys: KeyPoses, trajectory: Trajectory, motion: OdometryErrorConfig
) -> None:
    """Add the odometry between key poses, and the prior of its constant errors."""
    error, jacobian = odometry_factor(keys, trajectory)
    count = len(keys)
    first = np.arange(count - 1)
    bias = np.arange(3 * count, 3 * count + ERRORS)
    columns = np.hstack((pose_columns(first), pose_columns(first + 1), np.tile(bias, (count - 1, 1))))
    equations.add(columns, jacobian, error, _diagonals(1.0 / keys.step_variances))
    stds = motion.bias_std, motion.scale_std, motion.turn_gain_std, motion.delay_std, motion.direction_std
    prior = np.array([stds]) ** -2.0
    equations.add(bias[None], np.eye(ERRORS)[None], trajectory.bias[None], _diagonals(prior))


def add_links(
    equations: NormalEquations,
    poses: FloatArray,
    geometry: tuple[IntArray, FloatArray, FloatArray],
    links: IntArray,
    std: float,
    bend: float,
) -> None:
    """Add links (l, 2) from points to the lines through other points, with the Geman-McClure kernel.

    Parameters
    ----------
    equations
        The normal equations to which the links are added.
    poses
        Key poses (m, 3).
    geometry
        Key pose (p,) of each point, and its place (p, 2), m, and normal (p, 2) in the frame of the key pose.
    links
        Index of the point, and index of the other point, whose line should contain the first point.
    std, bend
        Standard deviation of a link, m, and the scale of the kernel in standard deviations.
    """
    if not len(links):
        return
    key = geometry[0]
    order = np.argsort(key[links[:, 0]] * len(poses) + key[links[:, 1]], kind="stable")
    pairs, hessian, gradient = _link_blocks(poses, *geometry, links[order], std, bend)
    columns = np.hstack((pose_columns(pairs[:, 0]), pose_columns(pairs[:, 1])))
    equations.add_blocks(columns, hessian, gradient)


def add_relations(
    equations: NormalEquations,
    poses: FloatArray,
    ends: IntArray,
    relations: tuple[FloatArray, FloatArray],
    loop_kernel: float,
) -> None:
    """Add loops between key poses ``ends`` (f, 2) with dynamic covariance scaling.

    ``relations`` are the relative poses (f, 3) and their information (f, 3, 3); the weight is min(1, 2 phi / (phi +
    chi^2))^2 with phi = ``loop_kernel`` (Agarwal et al., "Robust map optimization using dynamic covariance scaling",
    2013).
    """
    if not len(ends):
        return
    measured, information = relations
    error, jacobian = relation_factor(poses, ends[:, 0], ends[:, 1], measured)
    weight = loop_weights(error, information, loop_kernel)
    columns = np.hstack((pose_columns(ends[:, 0]), pose_columns(ends[:, 1])))
    equations.add(columns, jacobian, error, information * weight[:, None, None])


def loop_weights(error: FloatArray, information: FloatArray, loop_kernel: float) -> FloatArray:
    """Weights (f,) of loops with errors (f, 3) and information (f, 3, 3) by dynamic covariance scaling."""
    chi2 = np.einsum("fi,fij,fj->f", error, information, error)
    return np.asarray(np.minimum(1.0, 2.0 * loop_kernel / (loop_kernel + chi2)) ** 2)


def _diagonals(values: FloatArray) -> FloatArray:
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


@kernel
def link_error(
    first: FloatArray, second: FloatArray, point: FloatArray, other: FloatArray, normal: FloatArray, by: FloatArray
) -> float:
    """Distance of a point of the first pose from the line through another point of the second pose.

    ``point`` is given in the first pose's frame, ``other`` and ``normal`` in the second's; the derivatives by both
    poses are written to ``by`` (6,).
    """
    c, s = np.cos(first[2]), np.sin(first[2])
    ax, ay = c * point[0] - s * point[1], s * point[0] + c * point[1]
    c, s = np.cos(second[2]), np.sin(second[2])
    bx, by_ = c * other[0] - s * other[1], s * other[0] + c * other[1]
    nx, ny = c * normal[0] - s * normal[1], s * normal[0] + c * normal[1]
    dx, dy = first[0] + ax - second[0] - bx, first[1] + ay - second[1] - by_
    by[0], by[1], by[2] = nx, ny, ax * ny - ay * nx
    by[3], by[4] = -nx, -ny
    # A rotation of the second pose moves the point of the line and rotates its normal.
    by[5] = (nx * dy - ny * dx) - (bx * ny - by_ * nx)
    return float(nx * dx + ny * dy)


@kernel
def _link_blocks(
    poses: FloatArray, key: IntArray, places: FloatArray, normals: FloatArray, links: IntArray, std: float, bend: float
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Sums over links that are sorted by their pair of key poses: pairs (k, 2), blocks (k, 6, 6), gradients (k, 6)."""
    count = 1
    for row in range(1, len(links)):
        same = key[links[row, 0]] == key[links[row - 1, 0]] and key[links[row, 1]] == key[links[row - 1, 1]]
        count += 0 if same else 1
    pairs = np.empty((count, 2), np.int64)
    hessian, gradient, by = np.zeros((count, 6, 6)), np.zeros((count, 6)), np.empty(6)
    last = -1
    for row in range(len(links)):
        i, j = links[row]
        a, b = key[i], key[j]
        if last < 0 or pairs[last, 0] != a or pairs[last, 1] != b:
            last += 1
            pairs[last, 0], pairs[last, 1] = a, b
        error = link_error(poses[a], poses[b], places[i], places[j], normals[j], by)
        weight = 1.0 / ((1.0 + (error / (bend * std)) ** 2) ** 2 * std * std)
        for u in range(6):
            gradient[last, u] += weight * by[u] * error
            for v in range(6):
                hessian[last, u, v] += weight * by[u] * by[v]
    return pairs, hessian, gradient
