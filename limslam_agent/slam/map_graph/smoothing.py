"""Smoothing of key poses: along the way, before any loop is known, and with loops and other visits,
in the bundle.

All associations of points are made anew at each iteration. Along the way, each step is applied to
the relative motions between key poses, which are then integrated again: a rotation in the middle of
the log moves all later poses. The bundle adds its steps to the poses, since the chunk graph has
given initial poses that are accurate enough.
"""

import math
from dataclasses import replace

import numpy as np

from limslam_agent.config.graph import WallLineConfig
from limslam_agent.slam.graph.factors import Relations, geman_mcclure, prior, relation
from limslam_agent.slam.graph.graph import Graph, Nodes
from limslam_agent.slam.map_graph.factors import (
    loop_kernel,
    odometry,
    point_link,
    point_on_wall,
    wall_on_axes,
)
from limslam_agent.slam.map_graph.key_poses import ERRORS, KeyPoses, Trajectory, integrate
from limslam_agent.slam.map_graph.point_links import links_across, links_along, point_cloud
from limslam_agent.slam.map_graph.wall_lines import find_lines
from limslam_env.geometry import FloatArray, IntArray, se2

# m, beside the noise of a range
_LINK_STD = 0.08
_WALL_STD = 0.12
# scales of the kernels, in standard deviations
_LINK_KERNEL = 2.0
_WALL_KERNEL = 1.0
_WALL_PRIOR = 0.01  # inverse variance of the turn, rad^2, and of the offset, m^2, of each wall
# of the standard deviations of links, where more than the local trajectory follows from them
_INFLATION = 1.5
_BUNDLE_ITERATIONS = 6
_FURTHER = 2  # iterations of a window whose earlier part is smooth
# m, within which points of different visits are linked, at first and at last
_RADIUS = 0.4
_LAST_RADIUS = 0.2
# Standard deviation of the walls about the axes of a building, rad, which is so many times as large
# at first, and the scale of its kernel. Where odometry loses the heading by more than the last
# number, walls are not given to axes.
_AXES_STD = math.radians(0.5)
_FIRST_AXES = 8.0
_AXES_KERNEL = 2.0
_MOST_LOST = math.radians(7.0)
_FIRST_WINDOW = 4.0  # m, in which walls are found in the first iteration with walls


def smooth_locally(keys: KeyPoses, trajectory: Trajectory) -> Trajectory:
    """Smooth along the way, first with links alone, then with walls in windows that grow.

    Without walls, the headings drift. With walls from the start, the estimated bias of odometry is
    wrong. Tolerances shrink in both parts.
    """
    counts = keys.config.smoothing
    walls = keys.config.lines
    for number in range(counts.link_iterations):
        widening = max(1.0, 2.0 * 0.7**number)
        trajectory = _chained(trajectory, _graph(keys, trajectory, link_factor=widening))
    last = max(1, counts.line_iterations - 3)
    for number in range(counts.line_iterations):
        progress = min(1.0, number / last)
        window = _FIRST_WINDOW + (walls.window - _FIRST_WINDOW) * progress
        widening = 1.8 - 0.8 * progress
        near = replace(walls, window=window, tolerance=widening * walls.tolerance)
        axes_factor = _FIRST_AXES ** (1.0 - progress)
        graph = _graph(keys, trajectory, walls=near, wall_factor=widening, axes_factor=axes_factor)
        trajectory = _chained(trajectory, graph)
    return trajectory


def smooth_further(keys: KeyPoses, trajectory: Trajectory) -> Trajectory:
    """Smooth along the way from a trajectory of which all but the end is smooth."""
    for _ in range(_FURTHER):
        trajectory = _chained(trajectory, _graph(keys, trajectory, walls=keys.config.lines))
    return trajectory


def bundle(keys: KeyPoses, trajectory: Trajectory, relations: Relations) -> Trajectory:
    """Solve for all key poses with walls, loops, and links between visits, which are nearer at each
    iteration.
    """
    for number in range(_BUNDLE_ITERATIONS):
        radius = _RADIUS * (_LAST_RADIUS / _RADIUS) ** (number / (_BUNDLE_ITERATIONS - 1))
        by_poses, by_bias = _step(bundle_graph(keys, trajectory, relations, radius, _INFLATION))
        poses = trajectory.poses + by_poses
        poses[:, 2] = se2.wrap_angle(poses[:, 2])
        trajectory = Trajectory(poses, trajectory.bias + by_bias)
    return trajectory


def bundle_graph(
    keys: KeyPoses,
    trajectory: Trajectory,
    relations: Relations,
    radius: float = _LAST_RADIUS,
    link_factor: float = 1.0,
) -> Graph:
    """The graph of a bundle that links visits within a radius, m.

    ``link_factor`` multiplies the standard deviations of points about links.
    """
    graph = _graph(keys, trajectory, link_factor, keys.config.lines, radius=radius, axes_factor=1.0)
    graph.add_robust(relation(trajectory.poses, *relations), loop_kernel())
    return graph


def cautious_graph(keys: KeyPoses, trajectory: Trajectory) -> Graph:
    """The graph by which a locally smoothed trajectory is known: odometry and links along it."""
    return _graph(keys, trajectory, link_factor=_INFLATION)


def odometry_graph(keys: KeyPoses, trajectory: Trajectory) -> Graph:
    """The graph of odometry alone."""
    graph = Graph(Nodes(poses=(len(keys), 3), errors=(1, ERRORS)))
    _add_odometry(graph, keys, trajectory)
    return graph


def motion_covariances(graph: Graph, poses: FloatArray, numbers: IntArray) -> FloatArray:
    """Covariances (c - 1, 3, 3) of the motions between the key poses ``numbers`` (c,), of all poses
    (m, 3).
    """
    ends = np.column_stack((numbers[:-1], numbers[1:]))
    return graph.covariances(relation(poses, ends, np.zeros((len(ends), 3))))


def _graph(
    keys: KeyPoses,
    trajectory: Trajectory,
    link_factor: float = 1.0,
    walls: WallLineConfig | None = None,
    wall_factor: float = 1.0,
    radius: float = 0.0,
    axes_factor: float = 0.0,
) -> Graph:
    """The graph of odometry, links along the way, and walls and links between visits if asked.

    The factors are those of the standard deviations of points about links and walls, and of walls
    about the axes of the building, which are not used if it is zero. ``radius`` is that of links
    between visits, m.
    """
    config = keys.config
    poses = trajectory.poses
    cloud = point_cloud(keys, trajectory)
    lines = find_lines(cloud, walls) if walls else None
    count = len(lines.angles) if lines else 0
    lost = float(keys.step_variances[:, 2].sum() + (trajectory.bias[0] * keys.driven) ** 2)
    has_axes = count > 0 and axes_factor > 0.0 and lost < _MOST_LOST**2
    graph = Graph(
        Nodes(poses=(len(keys), 3), errors=(1, ERRORS), walls=(count, 2), axes=(2 * has_axes, 1))
    )
    _add_odometry(graph, keys, trajectory)
    std = link_factor * math.hypot(_LINK_STD, keys.data.range_std)
    robust = geman_mcclure(_LINK_KERNEL)
    graph.add_robust(point_link(poses, cloud, links_along(cloud), std), robust)
    if radius:
        links = links_across(cloud, radius, config.maps.another_visit)
        widening = max(1.0, radius / _LAST_RADIUS)
        graph.add_robust(point_link(poses, cloud, links, widening * std), robust)
    if lines:
        wall_std = wall_factor * math.hypot(_WALL_STD, keys.data.range_std)
        on_walls = point_on_wall(poses, cloud, lines, wall_std)
        graph.add_robust(on_walls, geman_mcclure(_WALL_KERNEL))
        graph.add(prior("walls", np.zeros((count, 2)), _WALL_PRIOR * np.eye(2)))
        if has_axes:
            on_axes = wall_on_axes(lines, axes_factor * _AXES_STD)
            graph.add_robust(on_axes, geman_mcclure(_AXES_KERNEL))
            graph.add(prior("axes", np.zeros((2, 1)), _WALL_PRIOR * np.eye(1)))
    return graph


def _add_odometry(graph: Graph, keys: KeyPoses, trajectory: Trajectory) -> None:
    graph.add(odometry(keys, trajectory))
    known = np.diag(np.array(keys.config.motion.stds) ** -2.0)
    graph.add(prior("errors", trajectory.bias[None], known))


def _chained(trajectory: Trajectory, graph: Graph) -> Trajectory:
    """Apply the step of a graph to the relative motions between key poses and integrate them
    again.
    """
    by_poses, by_bias = _step(graph)
    poses = trajectory.poses
    first = np.arange(len(poses) - 1)
    motions = relation(poses, np.column_stack((first, first + 1)), np.zeros((len(first), 3)))
    change = np.einsum("fij,fj->fi", motions.jacobian, np.hstack((by_poses[:-1], by_poses[1:])))
    return Trajectory(
        integrate(poses[0] + by_poses[0], motions.errors + change), trajectory.bias + by_bias
    )


def _step(graph: Graph) -> tuple[FloatArray, FloatArray]:
    """The step of the poses (m, 3) and of the constant errors of odometry (5,)."""
    step = graph.solve()
    return step[graph.nodes.columns("poses")], step[graph.nodes.columns("errors")[0]]
