"""The factors of the graph of local maps, with their derivatives.

The nodes are the key poses, the constant errors of odometry, and the walls, each with two unknowns:
a turn about its centre, and an offset.
"""

import math

import numpy as np

from limslam_agent.slam.graph.factors import dynamic_covariance_scaling, geman_mcclure, relation
from limslam_agent.slam.graph.graph import Factors, Keys, RobustKernel
from limslam_agent.slam.map_graph.key_poses import KeyPoses, Trajectory
from limslam_agent.slam.map_graph.point_links import PointCloud
from limslam_agent.slam.map_graph.wall_lines import WallLines
from limslam_env.geometry import FloatArray, IntArray

_LOOP_KERNEL = 3.0  # scale of dynamic covariance scaling, as a chi-square
# rad, within which walls determine the axes of a building, at first and at last
_AXES_WIDTHS = 0.3, 0.1, 0.03


def loop_kernel(widening: float = 1.0) -> RobustKernel:
    """The kernel of loops, which is wider by a factor."""
    return dynamic_covariance_scaling(_LOOP_KERNEL * widening)


def loop_cost(chi2: FloatArray) -> FloatArray:
    """What loops (f,) with these chi-squares cost by their kernel, whose weights are the
    derivatives: at most three times its scale.
    """
    far = 3.0 - 4.0 * _LOOP_KERNEL / (_LOOP_KERNEL + chi2)
    return np.asarray(np.where(chi2 < _LOOP_KERNEL, chi2, _LOOP_KERNEL * far))


def odometry(keys: KeyPoses, trajectory: Trajectory) -> Factors:
    """The motions by odometry between key poses, which depend on its constant errors."""
    first = np.arange(len(keys) - 1)
    steps = keys.steps.calibrated(trajectory.bias)
    by_poses = relation(trajectory.poses, np.column_stack((first, first + 1)), steps)
    by_errors = -keys.steps.by_errors(trajectory.bias)
    errors = by_poses.errors
    # The gain multiplies the true turn. The reported turn has noise, which is all that it is on
    # straight drives, and the gain that explains it best is too small.
    whole = 1.0 + trajectory.bias[2]
    errors[:, 2] /= whole
    by_errors[:, 2, 2] -= errors[:, 2]
    jacobian = np.concatenate((by_poses.jacobian, by_errors), axis=2)
    jacobian[:, 2] /= whole
    return Factors(
        (*by_poses.keys, ("errors", np.zeros_like(first))),
        errors,
        jacobian,
        (1.0 / keys.step_variances)[:, :, None] * np.eye(3),
    )


def point_link(poses: FloatArray, cloud: PointCloud, links: IntArray, std: float) -> Factors:
    """Distances of points from the lines through other points, for links (f, 2) between the points
    of a cloud.

    ``std`` (m) is the standard deviation of each distance.
    """
    key, other = cloud.key[links].T
    points, others = cloud.places[links.T]
    normals = cloud.normals[links[:, 1]]
    apart = points - others
    lever = others - poses[other, :2]
    # A rotation of the second pose moves the point of the line and rotates its normal.
    turned = _cross(normals, apart) - _cross(lever, normals)
    jacobian = np.column_stack(
        (normals, _cross(points - poses[key, :2], normals), -normals, turned)
    )
    keys: Keys = (("poses", key), ("poses", other))
    return _in_stds(keys, np.sum(normals * apart, axis=1), jacobian, std)


def point_on_wall(poses: FloatArray, cloud: PointCloud, walls: WallLines, std: float) -> Factors:
    """Distances of points from their walls. ``std`` (m) is the standard deviation of each."""
    places = cloud.places[walls.points]
    key = cloud.key[walls.points]
    angles = walls.angles[walls.lines]
    normals = np.column_stack((np.cos(angles), np.sin(angles)))
    off = places - walls.centres[walls.lines]
    by_pose = np.column_stack((normals, _cross(places - poses[key, :2], normals)))
    jacobian = np.column_stack((by_pose, _cross(normals, off), -np.ones(len(off))))
    keys: Keys = (("poses", key), ("walls", walls.lines))
    return _in_stds(keys, np.sum(normals * off, axis=1), jacobian, std)


def wall_on_axes(walls: WallLines, std: float) -> Factors:
    """The turn of each wall from the axis of the building that is parallel to it.

    There are two axes, about at right angles, in the directions of most points. The turn of each
    axis is an unknown. ``std`` (rad) is the standard deviation of a wall about its axis.
    """
    count = len(walls.angles)
    turns = np.exp(4j * walls.angles)
    weights = np.bincount(walls.lines, minlength=count)
    middle = np.sum(weights * turns)
    for width in _AXES_WIDTHS:
        near = geman_mcclure(4.0 * width)(np.angle(turns * middle.conj()) ** 2)
        middle = np.sum(weights * near * turns)
    off = np.angle(turns * middle.conj()) / 4.0
    quarters = np.round((walls.angles - off - np.angle(middle) / 4.0) / (0.5 * math.pi))
    jacobian = np.tile([1.0, 0.0, -1.0], (count, 1))
    keys: Keys = (("walls", np.arange(count)), ("axes", quarters.astype(np.int64) % 2))
    return _in_stds(keys, off, jacobian, std)


def _in_stds(keys: Keys, errors: FloatArray, jacobian: FloatArray, std: float) -> Factors:
    return Factors(keys, errors[:, None] / std, jacobian[:, None] / std)


def _cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Cross products (k,) of vectors (k, 2)."""
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
