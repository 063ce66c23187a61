"""Leaves out readings near a corner, because they may belong to either of two walls.

This needs lines, points and the known walls, and nothing else of the estimator, so it is a module of its own.
"""

from collections.abc import Iterator

import numpy as np

from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.consistent.wall_map import WallMap
from limslam_agent.slam.core.hough import ExtractedLine
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import angle_between, direction, distance, normal

BESIDE_CORNER = 0.15
"""A reading this close to the end of another line, m along it, may belong to either line."""


def uncontested(points: FloatArray, lines: list[ExtractedLine], near: float) -> Iterator[tuple[FloatArray, IntArray]]:
    """Each line (2,), and its readings without those near a corner that could also belong to another line.

    Parameters
    ----------
    points
        End points of all readings (n, 2), m.
    lines
        The lines that were extracted from them.
    near
        A point may belong to a line that is less than this far away, m.
    """
    for line in lines:
        members = np.sort(line.members)
        for other in lines:
            if other is line:
                continue
            places = np.sort(other.fit.ends @ direction(other.fit.line))
            along = points[members] @ direction(other.fit.line)
            beside = (along > places[0] - BESIDE_CORNER) & (along < places[1] + BESIDE_CORNER)
            members = members[~(beside & (np.abs(distance(other.fit.line, points[members])) < near))]
        yield line.fit.line, members


def on_crossing_wall(
    points: FloatArray, theta: float, near: float, min_kink: float, belief: CloneEKF, walls: WallMap
) -> BoolArray:
    """Which points (n,) of a line may lie on a known wall that crosses the line.

    At a corner, readings of the next wall look like a turn of the first one, and they would turn the robot.

    Parameters
    ----------
    points
        Points of the line (n, 2), m.
    theta
        Direction of the line's normal, rad.
    near
        A point may belong to a wall that is less than this far away, m.
    min_kink
        A wall crosses the line if their directions differ by more than this, rad.
    belief, walls
        The lines of the landmarks, and their extents.
    """
    lines, anchors = belief.anchored, belief.anchors
    crosses = np.abs(angle_between(lines[:, 1] - theta)) > min_kink
    ends = np.array([wall.extent.ends for wall in walls.walls]).reshape(-1, 2)[crosses]
    lines, offsets = lines[crosses], points[:, None] - anchors[crosses]
    along = np.sum(offsets * direction(lines), axis=2)
    is_beside = (along > ends[:, 0] - BESIDE_CORNER) & (along < ends[:, 1] + BESIDE_CORNER)
    return np.asarray((is_beside & (np.abs(np.sum(offsets * normal(lines), axis=2) - lines[:, 0]) < near)).any(axis=1))
