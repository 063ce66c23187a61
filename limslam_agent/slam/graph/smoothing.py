"""Smoothing of key poses: along the way, before any loop is known, and with loops and other visits,
in the bundle.

All associations of points are made anew at each iteration. Along the way, each step is applied to
the relative motions between key poses, which are then integrated again: a rotation in the middle of
the log moves all later poses. The bundle adds its steps to the poses, since the chunk graph has
given initial poses that are accurate enough.
"""

from dataclasses import replace

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import ERRORS, KeyPoses, Trajectory, integrate
from limslam_agent.slam.graph.least_squares import (
    Relations,
    add_links,
    add_odometry,
    add_relations,
    relation_factor,
)
from limslam_agent.slam.graph.point_links import links_across, links_along, point_cloud
from limslam_agent.slam.graph.wall_lines import add_lines, find_lines
from limslam_agent.slam.least_squares.normal_equations import NormalEquations, pose_columns
from limslam_env.geometry import FloatArray, IntArray, se2

# m, beside the noise of a range
_LINK_STD = 0.08
_LINE_STD = 0.12
# of the standard deviations of links, where more than the local trajectory follows from them
_INFLATION = 1.5
_BUNDLE_ITERATIONS = 6
# m, within which points of different visits are linked, at first and at last
_RADIUS = 0.4
_LAST_RADIUS = 0.2
_FIRST_WINDOW = 4.0  # m, in which walls are found in the first iteration with walls


def smooth_locally(
    keys: KeyPoses, trajectory: Trajectory, config: GraphConfig, range_std: float
) -> Trajectory:
    """Smooth along the way, first with links alone, then with walls in windows that grow.

    Without walls, the headings drift. With walls from the start, the estimated bias of odometry is
    wrong. Tolerances shrink in both parts.
    """
    counts = config.smoothing
    walls = config.lines
    for number in range(counts.link_iterations):
        widening = max(1.0, 2.0 * 0.7**number)
        trajectory = _chained(
            trajectory,
            _equations(keys, trajectory, config, range_std, link_factor=widening).solve(),
        )
    last = max(1, counts.line_iterations - 3)
    for number in range(counts.line_iterations):
        progress = min(1.0, number / last)
        window = _FIRST_WINDOW + (walls.window - _FIRST_WINDOW) * progress
        widening = 1.8 - 0.8 * progress
        near = replace(
            config, lines=replace(walls, window=window, tolerance=widening * walls.tolerance)
        )
        equations = _equations(keys, trajectory, near, range_std, wall_factor=widening)
        trajectory = _chained(trajectory, equations.solve())
    return trajectory


def bundle(
    keys: KeyPoses,
    trajectory: Trajectory,
    relations: Relations,
    config: GraphConfig,
    range_std: float,
) -> Trajectory:
    """Solve for all key poses with walls, loops, and links between visits, which are nearer at each
    iteration.
    """
    for number in range(_BUNDLE_ITERATIONS):
        radius = _RADIUS * (_LAST_RADIUS / _RADIUS) ** (number / (_BUNDLE_ITERATIONS - 1))
        equations = bundle_equations(
            keys, trajectory, relations, config, range_std, radius, _INFLATION
        )
        by_poses, by_bias = _divided(equations.solve(), len(keys))
        poses = trajectory.poses + by_poses
        poses[:, 2] = se2.wrap_angle(poses[:, 2])
        trajectory = Trajectory(poses, trajectory.bias + by_bias)
    return trajectory


def bundle_equations(
    keys: KeyPoses,
    trajectory: Trajectory,
    relations: Relations,
    config: GraphConfig,
    range_std: float,
    radius: float = _LAST_RADIUS,
    link_factor: float = 1.0,
) -> NormalEquations:
    """Normal equations of a bundle that links visits within a radius, m.

    Without ``link_factor``, the stated errors of 23 made-up logs were right on average (NEES / 2 of
    0.95).
    """
    return _equations(
        keys,
        trajectory,
        config,
        range_std,
        relations,
        link_factor=link_factor,
        wall_factor=1.0,
        radius=radius,
    )


def cautious_equations(
    keys: KeyPoses, trajectory: Trajectory, config: GraphConfig, range_std: float
) -> NormalEquations:
    """Normal equations of a smoothed trajectory by odometry and links along the way, for its
    covariances.
    """
    return _equations(keys, trajectory, config, range_std, link_factor=_INFLATION)


def motion_covariances(
    equations: NormalEquations, poses: FloatArray, numbers: IntArray
) -> FloatArray:
    """Covariances (c - 1, 3, 3) of the motions between the key poses ``numbers`` (c,), of all poses
    (m, 3).
    """
    first = numbers[:-1]
    second = numbers[1:]
    _, jacobian = relation_factor(poses, first, second, np.zeros((len(first), 3)))
    return equations.covariances(np.hstack((pose_columns(first), pose_columns(second))), jacobian)


def _equations(
    keys: KeyPoses,
    trajectory: Trajectory,
    config: GraphConfig,
    range_std: float,
    relations: Relations | None = None,
    *,
    link_factor: float = 1.0,
    wall_factor: float = 0.0,
    radius: float = 0.0,
) -> NormalEquations:
    """Normal equations of odometry, links along the way, and walls, links between visits and loops
    if asked.

    The factors are those of the standard deviations of points about links and walls. ``radius`` is
    that of links between visits, m.
    """
    cloud = point_cloud(keys, trajectory, range_std)
    poses = trajectory.poses
    lines = find_lines(cloud, config.lines) if wall_factor else None
    equations = NormalEquations(3 * len(keys) + ERRORS + (2 * len(lines.angles) if lines else 0))
    add_odometry(equations, keys, trajectory, config.motion)
    link_std, line_std = (float(np.hypot(each, range_std)) for each in (_LINK_STD, _LINE_STD))
    add_links(equations, poses, cloud, links_along(cloud), link_factor * link_std)
    if radius:
        widening = max(1.0, radius / _LAST_RADIUS)
        add_links(
            equations, poses, cloud, links_across(cloud, radius), widening * link_factor * link_std
        )
    if lines:
        add_lines(equations, poses, cloud, lines, wall_factor * line_std)
    if relations:
        add_relations(equations, poses, *relations)
    return equations


def _chained(trajectory: Trajectory, step: FloatArray) -> Trajectory:
    """Apply a step to the relative motions between key poses and integrate them again."""
    count = len(trajectory.poses)
    first = np.arange(count - 1)
    motions, jacobian = relation_factor(
        trajectory.poses, first, first + 1, np.zeros((count - 1, 3))
    )
    by_poses, by_bias = _divided(step, count)
    change = np.einsum("fij,fj->fi", jacobian, np.hstack((by_poses[:-1], by_poses[1:])))
    return Trajectory(
        integrate(trajectory.poses[0] + by_poses[0], motions + change), trajectory.bias + by_bias
    )


def _divided(step: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """The parts of a step for the poses (count, 3) and for the constant errors of odometry (5,)."""
    return step[: 3 * count].reshape(-1, 3), step[3 * count : 3 * count + ERRORS]
