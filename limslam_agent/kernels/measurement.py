"""Beams that meet a line, and how errors move with the world: parts of each update of the consistent filter.

The operations are those of plain numpy in the same order, so that results are the same to the bit.
"""

import math

import numpy as np

from limslam_agent.kernels.compilation import compiled, entry
from limslam_env.geometry import FloatArray


@compiled
def ray_of(
    pose: FloatArray, origin: FloatArray, angle: float
) -> tuple[float, float, float, float]:  # fmt: skip
    """Vector from body to beam in the world's axes, m, and the beam's direction, for a beam read at a pose (3,)."""
    cos, sin, heading = math.cos(pose[2]), math.sin(pose[2]), pose[2] + angle
    return cos * origin[0] - sin * origin[1], sin * origin[0] + cos * origin[1], math.cos(heading), math.sin(heading)


@entry
def ranges_to_line(
    poses: FloatArray, origins: FloatArray, angles: FloatArray, line: FloatArray, anchor: FloatArray, least: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Predicted ranges (n,) of beams to a line, their derivatives by pose (n, 3) and line (n, 2), and cosines (n,).

    Parameters
    ----------
    poses, origins, angles
        Pose from which each beam was read (n, 3), and where it begins (n, 2), m, and its direction (n,), rad, in the
        robot's frame.
    line, anchor
        (d, theta), m and rad, and the anchor (2,), m.
    least
        Least cosine that a range is divided by.
    """
    count = len(poses)
    ranges, by_pose, by_line, cosines = np.empty(count), np.empty((count, 3)), np.empty((count, 2)), np.empty(count)
    nx, ny = math.cos(line[1]), math.sin(line[1])
    for i in range(count):
        offset_x, offset_y, ux, uy = ray_of(poses[i], origins[i], angles[i])
        x, y = poses[i, 0] + offset_x, poses[i, 1] + offset_y
        cosine = nx * ux + ny * uy
        divisor = math.copysign(max(abs(cosine), least), cosine)
        reach = (line[0] - nx * (x - anchor[0]) - ny * (y - anchor[1])) / divisor
        hit_x, hit_y = x + reach * ux - anchor[0], y + reach * uy - anchor[1]
        turning = (-offset_y * nx + offset_x * ny) + reach * (-uy * nx + ux * ny)
        ranges[i], cosines[i] = reach, cosine
        by_pose[i, 0], by_pose[i, 1], by_pose[i, 2] = -nx / divisor, -ny / divisor, -turning / divisor
        by_line[i, 0], by_line[i, 1] = 1.0 / divisor, (hit_x * ny - hit_y * nx) / divisor
    return ranges, by_pose, by_line, cosines


@entry
def ends_of_beams(poses: FloatArray, origins: FloatArray, angles: FloatArray, ranges: FloatArray) -> FloatArray:
    """End points (n, 2), m, of beams with ranges (n,), m; the other parameters are as of :func:`ranges_to_line`."""
    points = np.empty((len(poses), 2))
    for i in range(len(poses)):
        offset_x, offset_y, ux, uy = ray_of(poses[i], origins[i], angles[i])
        points[i, 0] = poses[i, 0] + offset_x + ranges[i] * ux
        points[i, 1] = poses[i, 1] + offset_y + ranges[i] * uy
    return points


@entry
def error_transport(x: FloatArray, poses_end: int, first: int, clones_from: int, anchors: FloatArray) -> FloatArray:
    """Derivative (n, 3) of the filter's state x (n,) by the first robot's pose when robot and world move together.

    Parameters
    ----------
    poses_end, first, clones_from
        Where the poses end in the state, and where lines and clones begin.
    anchors
        Anchors (k, 2), m, of the lines.
    """
    moved = np.zeros((len(x), 3))
    for at in range(0, len(x), 3):
        # The clones do not begin at a multiple of three.
        begin = at if at < poses_end else at - poses_end + clones_from
        if begin >= len(x):
            break
        for k in range(3):
            moved[begin + k, k] = 1.0
        moved[begin, 2], moved[begin + 1, 2] = x[1] - x[begin + 1], x[begin] - x[0]
    for number in range(len(anchors)):
        begin = first + 2 * number
        cos, sin = math.cos(x[begin + 1]), math.sin(x[begin + 1])
        moved[begin, 0], moved[begin, 1] = cos, sin
        moved[begin, 2] = cos * (x[1] - anchors[number, 1]) - sin * (x[0] - anchors[number, 0])
        moved[begin + 1, 2] = 1.0
    return moved
