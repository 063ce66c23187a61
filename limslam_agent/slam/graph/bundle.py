"""The bundle: all key poses, walls, loops and links between visits in one least-squares problem.

Points are associated anew at each iteration, and the radius within which points of different visits are linked shrinks.
Steps are added to the poses directly: the chunk graph has given initial poses that are accurate enough.
"""

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.chunk_graph import LOOP_KERNEL
from limslam_agent.slam.graph.key_poses import ERRORS, KeyPoses, Trajectory
from limslam_agent.slam.graph.least_squares import add_links, add_relations
from limslam_agent.slam.graph.local_smoothing import LINK_INFLATION, LINK_KERNEL, line_std, link_std, local_equations
from limslam_agent.slam.graph.point_links import PointCloud, links_across, point_cloud
from limslam_agent.slam.graph.wall_lines import add_lines, find_lines
from limslam_env.geometry import FloatArray, IntArray, se2

_ITERATIONS = 6
_RADIUS, _LAST_RADIUS = 0.4, 0.2  # m, within which other visits are linked in the first and in the last iteration

Relations = tuple[IntArray, FloatArray, FloatArray]
"""Loops between key poses: their ends (f, 2), relative poses (f, 3) and information (f, 3, 3)."""


def bundle(
    keys: KeyPoses,
    trajectory: Trajectory,
    relations: Relations,
    config: GraphConfig,
    range_std: float,
) -> Trajectory:
    """Solve the whole problem."""
    for number in range(_ITERATIONS):
        progress = number / (_ITERATIONS - 1)
        radius = _RADIUS * (_LAST_RADIUS / _RADIUS) ** progress
        cloud = point_cloud(keys, trajectory, range_std)
        trajectory = _iterate(keys, trajectory, cloud, relations, config, range_std, radius)
    return trajectory


def _iterate(
    keys: KeyPoses,
    trajectory: Trajectory,
    cloud: PointCloud,
    relations: Relations,
    config: GraphConfig,
    range_std: float,
    radius: float,
) -> Trajectory:
    """Do one Gauss-Newton step with new associations."""
    std = link_std(range_std)
    lines = find_lines(cloud, config.lines, config.lines.window, config.lines.tolerance)
    equations = local_equations(keys, trajectory, cloud, config, LINK_INFLATION * std, len(lines.angles))
    across = links_across(cloud, radius)
    cross_std = std * LINK_INFLATION * max(1.0, radius / _LAST_RADIUS)
    add_links(equations, trajectory.poses, cloud.geometry, across, cross_std, LINK_KERNEL)
    add_lines(equations, trajectory.poses, cloud, lines, line_std(range_std))
    ends, relative, information = relations
    add_relations(equations, trajectory.poses, ends, (relative, information), LOOP_KERNEL)
    step = equations.solve()
    count = len(keys)
    poses = trajectory.poses + step[: 3 * count].reshape(-1, 3)
    poses[:, 2] = se2.wrap_angle(poses[:, 2])
    return Trajectory(poses, trajectory.bias + step[3 * count : 3 * count + ERRORS])
