"""How exactly a smoothed path is known, by the posterior covariance of its graph.

The equations are those that gave the path. A stretch that no loop and no other visit holds is known
as exactly as odometry and its links say. How good the
odometry is follows from the path itself: its variances are estimated by their evidence.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from limslam_agent.config.graph import OdometryErrorConfig
from limslam_agent.slam.graph.factors import Relations
from limslam_agent.slam.graph.graph import Graph
from limslam_agent.slam.map_graph.factors import odometry
from limslam_agent.slam.map_graph.key_poses import KeyPoses, Trajectory
from limslam_agent.slam.map_graph.smoothing import bundle_graph
from limslam_env.geometry import FloatArray

_MOST = 60  # windows over which odometry is judged, and poses of a path that are judged
_ITERATIONS = 3  # of the variances; where a path follows odometry alone, nothing changes
_ASSUMED = 0.2  # windows that tell all, by which the assumed variances of odometry count
_LEAST_STD = 1e-5  # of a constant error of odometry
# Standard deviation of the size of a path, of which links make each part a little too short
_SCALE_STD = 0.004


def position_covariance(keys: KeyPoses, trajectory: Trajectory, relations: Relations) -> FloatArray:
    """The joint covariance (2 k, 2 k) of positions along a path after rigid alignment, m^2.

    Parameters
    ----------
    keys, trajectory
        The key poses, and the smoothed path.
    relations
        The loops between key poses.
    """
    if len(keys) < 2:
        return np.zeros((2, 2))
    keys = with_learned_noise(keys, trajectory, partial(bundle_graph, relations=relations))
    return covariance_in(bundle_graph(keys, trajectory, relations), keys, trajectory)


def covariance_in(graph: Graph, keys: KeyPoses, trajectory: Trajectory) -> FloatArray:
    """The covariance as in :func:`position_covariance`, of the path of a graph."""
    evenly = _evenly(keys.key_driven[-1], keys.config.maps.length)
    numbers = np.unique(np.searchsorted(keys.key_driven, evenly))
    columns = graph.nodes.columns("poses")[numbers, :2].ravel()
    rows = np.zeros((graph.nodes.size, len(columns)))
    rows[columns, np.arange(len(columns))] = 1.0
    white = graph.whitened(rows)
    positions = trajectory.poses[numbers, :2]
    scaled = _SCALE_STD * (positions - positions.mean(axis=0)).ravel()
    return aligned_covariance(white.T @ white, positions) + np.outer(scaled, scaled)


def with_learned_noise(
    keys: KeyPoses, trajectory: Trajectory, graph_of: Callable[[KeyPoses, Trajectory], Graph]
) -> KeyPoses:
    """The key poses with the variances of odometry that make a path likeliest in its graph."""
    for _ in range(_ITERATIONS):
        ratios = odometry_ratios(keys, trajectory, graph_of(keys, trajectory))
        keys = replace(keys, step_variances=keys.step_variances * ratios)
    return keys


def with_learned_errors(
    keys: KeyPoses, trajectory: Trajectory, graph: Graph | None = None
) -> KeyPoses:
    """The key poses with narrower priors of the constant errors of odometry.

    The prior variance of an error is the square of its estimate and, with a graph, the variance of
    the estimate in it. Without, an estimate that is not evident shrinks towards zero.
    """
    learned = trajectory.bias**2
    if graph is not None:
        columns = graph.nodes.columns("errors")[0]
        rows = np.zeros((graph.nodes.size, len(columns)))
        rows[columns, np.arange(len(columns))] = 1.0
        learned = learned + (graph.whitened(rows) ** 2).sum(axis=0)
    config = keys.config
    stds = np.sqrt(np.clip(learned, _LEAST_STD**2, np.square(config.motion.stds)))
    motion = OdometryErrorConfig(*stds.tolist())
    return replace(keys, config=replace(config, motion=motion))


def aligned_covariance(covariance: FloatArray, positions: FloatArray) -> FloatArray:
    """The joint covariance (2 k, 2 k) of positions (k, 2), m, after their rigid alignment with the
    true ones.

    The alignment removes what moves and turns all positions together: an orthogonal projection.
    """
    basis = rigid_motions(positions)
    half = covariance - basis @ (basis.T @ covariance)
    return np.asarray(half - (half @ basis) @ basis.T)


def rigid_motions(positions: FloatArray) -> FloatArray:
    """An orthonormal basis (2 k, 3) of what moves and turns all positions (k, 2) together."""
    centred = positions - positions.mean(axis=0)
    rigid = np.zeros((2 * len(positions), 3))
    rigid[0::2, 0] = rigid[1::2, 1] = 1.0
    rigid[0::2, 2] = -centred[:, 1]
    rigid[1::2, 2] = centred[:, 0]
    basis, _ = np.linalg.qr(rigid)
    return np.asarray(basis)


def odometry_ratios(keys: KeyPoses, trajectory: Trajectory, graph: Graph) -> FloatArray:
    """Ratios (3,) of the variances of odometry (along, across, heading) to those that are assumed.

    The squares of the errors of odometry over two chunks, since they last for seconds, by what the
    graph of the path tells of them: one less the share of the variance that remains (MacKay, 1992).
    A window that tells nothing has no weight, so few steps are enough. The square root damps them,
    since the path stays the same.
    """
    factors = odometry(keys, trajectory)
    errors = factors.errors
    driven = keys.key_driven
    half = keys.config.maps.length
    begins = np.searchsorted(driven, _evenly(driven[-1] - 2.0 * half, half))
    ends = np.minimum(np.searchsorted(driven, driven[begins] + 2.0 * half), len(errors))
    begins = np.minimum(begins, ends - 1)
    columns = graph.nodes.columns_of(factors.keys)
    squares = np.zeros((len(begins), 3))
    told = np.zeros((len(begins), 3))
    # One window at a time, since each needs dense columns of all unknowns.
    for window, (begin, end) in enumerate(zip(begins, ends, strict=True)):
        rows = np.zeros((graph.nodes.size, 3))
        for part in range(3):
            np.add.at(rows[:, part], columns[begin:end], factors.jacobian[begin:end, part])
        posterior = (graph.whitened(rows) ** 2).sum(axis=0)
        variances = keys.step_variances[begin:end].sum(axis=0)
        squares[window] = errors[begin:end].sum(axis=0) ** 2 / variances
        told[window] = np.maximum(1.0 - posterior / variances, 0.0)
    return np.asarray(np.sqrt((squares.sum(axis=0) + _ASSUMED) / (told.sum(axis=0) + _ASSUMED)))


def _evenly(length: float, apart: float) -> FloatArray:
    """Distances along a path from its begin on, m, which are so far apart unless that are too
    many.
    """
    return np.arange(0.0, max(length, 1e-9), max(apart, length / _MOST))
