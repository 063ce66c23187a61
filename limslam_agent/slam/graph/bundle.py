"""The bundle: all key poses, walls, loops and links between visits in one least-squares problem.

Points are associated anew at each iteration, and the radius within which points of different visits are linked shrinks.
Steps are added to the poses directly: the chunk graph has given initial poses that are accurate enough.
"""

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import ERRORS, KeyPoses, Trajectory
from limslam_agent.slam.graph.least_squares import add_links, add_relations
from limslam_agent.slam.graph.local_smoothing import line_std, link_std, local_equations
from limslam_agent.slam.graph.point_links import PointCloud, links_across, point_cloud
from limslam_agent.slam.graph.wall_lines import add_lines, find_lines
from limslam_env.geometry import FloatArray, IntArray, se2

Relations = tuple[IntArray, FloatArray, FloatArray]
"""Loops between key poses: their ends (f, 2), relative poses (f, 3) and information (f, 3, 3)."""


def bundle(
    keys: KeyPoses,
    trajectory: Trajectory,
    relations: Relations,
    config: GraphConfig,
    range_std: float,
    iterations: int,
) -> Trajectory:
    """Solve the whole problem in a given number of iterations."""
    settings = config.bundle
    for number in range(iterations):
        progress = number / max(1, iterations - 1)
        radius = settings.radius * (settings.last_radius / settings.radius) ** progress
        cloud = point_cloud(keys, trajectory, config.links, range_std)
        trajectory, largest = _iterate(keys, trajectory, cloud, relations, config, range_std, radius)
        if largest < settings.tolerance and progress == 1.0:
            break
    return trajectory


def _iterate(
    keys: KeyPoses,
    trajectory: Trajectory,
    cloud: PointCloud,
    relations: Relations,
    config: GraphConfig,
    range_std: float,
    radius: float,
) -> tuple[Trajectory, float]:
    """Do one Gauss-Newton step with new associations, and return the largest turn of a pose in this step, rad."""
    settings, std = config.bundle, link_std(config, range_std)
    lines = find_lines(cloud, config.lines, config.lines.window, config.lines.tolerance)
    equations = local_equations(keys, trajectory, cloud, config, settings.link_inflation * std, len(lines.angles))
    across = links_across(cloud, radius, config.links)
    cross_std = std * settings.cross_inflation * max(1.0, radius / settings.last_radius)
    add_links(equations, trajectory.poses, cloud.geometry, across, cross_std, config.links.kernel)
    add_lines(equations, trajectory.poses, cloud, lines, line_std(config, range_std), config.lines.inflation)
    ends, relative, information = relations
    add_relations(equations, trajectory.poses, ends, (relative, information), config.chunks.loop_kernel)
    step = equations.solve(settings.damping)
    count = len(keys)
    by_pose = step[: 3 * count].reshape(-1, 3)
    largest = float(np.abs(by_pose[:, 2]).max())
    share = min(1.0, settings.max_turn / max(largest, 1e-9))
    poses = trajectory.poses + share * by_pose
    poses[:, 2] = se2.wrap_angle(poses[:, 2])
    return Trajectory(poses, trajectory.bias + share * step[3 * count : 3 * count + ERRORS]), largest
