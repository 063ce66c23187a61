"""Local smoothing: the correction of odometry along the way, before any loop is known.

Points are linked to lines through other points of the same section of driving. The first iterations use these links
alone. Later iterations also use walls found by a Hough transform in windows. All associations are made anew at each
iteration. Each step is applied to the relative motions between key poses, which are then integrated again. A rotation
in the middle of the log therefore moves all later poses. Steps that are added to the poses themselves would not do
this, and would distort the trajectory.
"""

import numpy as np

from limslam_agent.config.graph import GraphConfig
from limslam_agent.slam.graph.key_poses import ERRORS, KeyPoses, Trajectory, integrate
from limslam_agent.slam.graph.least_squares import add_links, add_odometry, pose_columns, relation_factor
from limslam_agent.slam.graph.point_links import PointCloud, links_along, point_cloud
from limslam_agent.slam.graph.wall_lines import add_lines, find_lines
from limslam_agent.slam.least_squares.normal_equations import NormalEquations
from limslam_env.geometry import FloatArray, IntArray

_LINK_STD, _LINE_STD = 0.08, 0.12  # m
_FIRST_WINDOW = 4.0  # m, in which lines are found in the first iteration
LINK_KERNEL = 2.0
"""Scale of the Geman-McClure kernel of links, in standard deviations."""
LINK_INFLATION = 1.5
"""Factor of the standard deviations of links along the way, where more than the local trajectory follows from them."""


def smooth_locally(keys: KeyPoses, trajectory: Trajectory, config: GraphConfig, range_std: float) -> Trajectory:
    """Smooth along the way, first with links alone, then with lines in windows of growing length.

    Without lines, the headings drift. With lines from the start, the estimated bias of odometry is wrong.
    """
    for number in range(config.smoothing.link_iterations):
        widening = max(1.0, 2.0 * 0.7**number)
        trajectory = _with_links(keys, trajectory, config, range_std, widening)
    last = max(1, config.smoothing.line_iterations - 3)
    for number in range(config.smoothing.line_iterations):
        trajectory = _with_lines(keys, trajectory, config, range_std, min(1.0, number / last))
    return trajectory


def link_std(range_std: float) -> float:
    """Standard deviation of a link, m, from the model error and the range noise."""
    return float(np.hypot(_LINK_STD, range_std))


def line_std(range_std: float) -> float:
    """Standard deviation of a point about its line, m."""
    return float(np.hypot(_LINE_STD, range_std))


def local_equations(
    keys: KeyPoses, trajectory: Trajectory, cloud: PointCloud, config: GraphConfig, std: float, lines: int = 0
) -> NormalEquations:
    """Normal equations of odometry and links along the way, with unknowns for the lines.

    ``std`` (m) is the standard deviation of a link.
    """
    equations = NormalEquations(3 * len(keys) + ERRORS + 2 * lines)
    add_odometry(equations, keys, trajectory, config.motion)
    links = links_along(cloud)
    add_links(equations, trajectory.poses, cloud.geometry, links, std, LINK_KERNEL)
    return equations


def local_covariances(
    keys: KeyPoses, trajectory: Trajectory, middles: IntArray, config: GraphConfig, range_std: float
) -> FloatArray:
    """Covariances (c - 1, 3, 3) of the motions between key poses (c,), from odometry and links along the way."""
    return motion_covariances(cautious_equations(keys, trajectory, config, range_std), trajectory.poses, middles)


def cautious_equations(
    keys: KeyPoses, trajectory: Trajectory, config: GraphConfig, range_std: float
) -> NormalEquations:
    """Normal equations of a smoothed trajectory, with the larger standard deviation of links of the bundle."""
    cloud = point_cloud(keys, trajectory, range_std)
    std = LINK_INFLATION * link_std(range_std)
    return local_equations(keys, trajectory, cloud, config, std)


def motion_covariances(equations: NormalEquations, poses: FloatArray, numbers: IntArray) -> FloatArray:
    """Covariances (c - 1, 3, 3) of the motions between the key poses ``numbers`` (c,), of all poses (m, 3)."""
    first, second = numbers[:-1], numbers[1:]
    _, jacobian = relation_factor(poses, first, second, np.zeros((len(first), 3)))
    return equations.covariances(np.hstack((pose_columns(first), pose_columns(second))), jacobian)


def chained(trajectory: Trajectory, step: FloatArray) -> Trajectory:
    """Apply a step to the relative motions between key poses and integrate them again."""
    count = len(trajectory.poses)
    first = np.arange(count - 1)
    motions, jacobian = relation_factor(trajectory.poses, first, first + 1, np.zeros((count - 1, 3)))
    by_pose = step[: 3 * count].reshape(-1, 3)
    change = np.einsum("fij,fj->fi", jacobian, np.hstack((by_pose[:-1], by_pose[1:])))
    poses = integrate(trajectory.poses[0] + by_pose[0], motions + change)
    return Trajectory(poses, trajectory.bias + step[3 * count : 3 * count + ERRORS])


def _with_links(
    keys: KeyPoses, trajectory: Trajectory, config: GraphConfig, range_std: float, widening: float
) -> Trajectory:
    cloud = point_cloud(keys, trajectory, range_std)
    equations = local_equations(keys, trajectory, cloud, config, widening * link_std(range_std))
    return chained(trajectory, equations.solve())


def _with_lines(
    keys: KeyPoses, trajectory: Trajectory, config: GraphConfig, range_std: float, progress: float
) -> Trajectory:
    """Do one iteration with lines; windows grow and tolerances shrink as ``progress`` goes from 0 to 1."""
    cloud = point_cloud(keys, trajectory, range_std)
    window = _FIRST_WINDOW + (config.lines.window - _FIRST_WINDOW) * progress
    widening = 1.8 - 0.8 * progress
    lines = find_lines(cloud, config.lines, window, widening * config.lines.tolerance)
    equations = local_equations(keys, trajectory, cloud, config, link_std(range_std), len(lines.angles))
    add_lines(equations, trajectory.poses, cloud, lines, widening * line_std(range_std))
    return chained(trajectory, equations.solve())
