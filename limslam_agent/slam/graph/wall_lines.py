"""Straight walls, found by the Hough transform in windows of distance driven.

The points of a line are removed, and lines are searched again until there are no more. In the least-squares problem a
line has two unknowns: a rotation about its centre and an offset.
"""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.graph import WallLineConfig
from limslam_agent.kernels.lines import extract_lines
from limslam_agent.slam.graph.key_poses import ERRORS
from limslam_agent.slam.graph.point_links import MIN_COSINE, PointCloud
from limslam_agent.slam.least_squares.normal_equations import NormalEquations
from limslam_env.compilation import entry_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray, no_rows
from limslam_env.geometry.line import direction, normal

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

_OFFSET_BIN = 0.08  # m, of the Hough space


@dataclass(frozen=True, eq=False)
class WallLines:
    """A number l of lines, with k assignments of points to lines.

    Attributes
    ----------
    angles, centres
        Directions of the normals (l,), rad, and centres (l, 2), m.
    points, lines
        Assignments (k,): a point and its line, sorted by line and then by point. A point may belong to one line in each
        window that contains the point.
    """

    angles: FloatArray
    centres: FloatArray
    points: IntArray
    lines: IntArray


def find_lines(cloud: PointCloud, config: WallLineConfig, window: float, tolerance: float) -> WallLines:
    """Lines of points within ``tolerance`` m, in all windows of ``window`` m of driving."""
    end = cloud.travel[-1] if len(cloud.travel) else 0.0
    begins = np.arange(0.0, max(end - 0.5 * window, 1e-3), 0.5 * window)
    spans = np.searchsorted(cloud.travel, np.column_stack((begins, begins + window)))
    return lines_in(cloud.places, cloud.normals, cloud.good, spans, config, tolerance)


def lines_in(
    places: FloatArray,
    normals: FloatArray,
    good: BoolArray,
    spans: IntArray,
    config: WallLineConfig,
    tolerance: float,
) -> WallLines:
    """Lines among the points of each span (w, 2), which is given by its first point and its last point (excluded)."""
    none = np.zeros(0, dtype=np.int64)
    angles, centres, points, owners, count = [np.zeros(0)], [no_rows(2)], [none], [none], 0
    for begin, end in spans.tolist():
        label, turns = _window(places[begin:end], normals[begin:end], good[begin:end], config, tolerance)
        members = np.flatnonzero(label >= 0)
        members = members[np.argsort(label[members], kind="stable")]
        firsts = np.flatnonzero(np.diff(label[members], prepend=-1))
        sizes = np.diff(firsts, append=len(members))[:, None]
        angles.append(turns)
        centres.append(np.add.reduceat(places[begin + members], firsts) / sizes if len(turns) else no_rows(2))
        points.append(begin + members)
        owners.append(count + label[members])
        count += len(turns)
    found = np.concatenate(angles), np.concatenate(centres), np.concatenate(points), np.concatenate(owners)
    return WallLines(*found)


def _window(
    places: FloatArray, normals: FloatArray, good: BoolArray, config: WallLineConfig, tolerance: float
) -> tuple[IntArray, FloatArray]:
    """The line of each point (p,) of a window, -1 for none, and the directions (l,) of the lines' normals, rad.

    Only points whose own normal is reliable vote. A line has those of them whose normals are close to its own, and the
    points without a reliable normal between its ends.
    """
    label, found, reach, count = np.full(len(places), -1), [no_rows(2)], [no_rows(2)], 0
    while True:
        voters = np.flatnonzero(good & (label < 0))
        owner, lines, ends = extract_lines(
            places[voters], config.max_gap, config.min_points, _OFFSET_BIN, config.angle_bin, tolerance,
            config.min_length, only_best=False,
        )  # fmt: skip
        voters, owner = voters[owner >= 0], owner[owner >= 0]
        cosines = np.sum(normals[voters] * normal(lines)[owner], axis=1)
        sides = np.sign(np.bincount(owner, cosines, len(lines)))
        fits = cosines * sides[owner] > MIN_COSINE
        enough = np.bincount(owner[fits], minlength=len(lines)) >= config.min_points
        fits &= enough[owner]
        if not enough.any():
            break
        label[voters[fits]] = count + (np.cumsum(enough) - 1)[owner[fits]]
        # Lines whose normal points away from the side that they are seen from are turned round.
        lines[:, 0], lines[:, 1] = sides * lines[:, 0], lines[:, 1] + np.where(sides < 0.0, np.pi, 0.0)
        along = np.einsum("led,ld->le", ends, direction(lines))
        found.append(lines[enough])
        reach.append(np.sort(along[enough], axis=1))
        count += int(enough.sum())
    every, (low, high) = np.concatenate(found), np.concatenate(reach).T
    rest = np.flatnonzero(~good)
    off, along = places[rest] @ normal(every).T - every[:, 0], places[rest] @ direction(every).T
    is_on = (np.abs(off) < tolerance) & (low < along) & (along < high)
    if count:
        label[rest] = np.where(is_on.any(axis=1), is_on.argmax(axis=1), -1)
    return label, every[:, 1]


def add_lines(equations: NormalEquations, poses: FloatArray, cloud: PointCloud, lines: WallLines, std: float) -> None:
    """Add the distances of points from their lines, with the Geman-McClure kernel, and a weak prior of the lines.

    ``std`` (m) is the standard deviation of a point about its line, and the scale of the kernel.
    """
    if not len(lines.angles):
        return
    places = cloud.places[lines.points]
    pairs, hessian, gradient = _line_blocks(
        poses, cloud.key[lines.points], places, lines.lines, lines.angles, lines.centres, std
    )
    first = 3 * len(poses) + ERRORS
    columns = np.hstack((3 * pairs[:, :1] + np.arange(3), first + 2 * pairs[:, 1:] + np.arange(2)))
    equations.add_blocks(columns, hessian, gradient)
    own = first + np.arange(2 * len(lines.angles)).reshape(-1, 2)
    equations.add_blocks(own, np.tile(0.01 * np.eye(2), (len(own), 1, 1)), np.zeros((len(own), 2)))


@kernel
def line_error(pose: FloatArray, place: FloatArray, angle: float, centre: FloatArray, by: FloatArray) -> float:
    """Distance of a point, observed from a pose, to a line; writes the derivatives by pose and line to ``by`` (5,)."""
    nx, ny = np.cos(angle), np.sin(angle)
    dx, dy = place[0] - centre[0], place[1] - centre[1]
    by[0], by[1] = nx, ny
    by[2] = (place[0] - pose[0]) * ny - (place[1] - pose[1]) * nx
    by[3], by[4] = nx * dy - ny * dx, -1.0
    return float(nx * dx + ny * dy)


@kernel
def _line_blocks(
    poses: FloatArray,
    key: IntArray,
    places: FloatArray,
    line: IntArray,
    angles: FloatArray,
    centres: FloatArray,
    std: float,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Sums over points sorted by line and key pose: pairs (k, 2) of key pose and line, (k, 5, 5), (k, 5)."""
    count = 1
    for row in range(1, len(key)):
        count += 0 if key[row] == key[row - 1] and line[row] == line[row - 1] else 1
    pairs = np.empty((count, 2), np.int64)
    hessian, gradient, by = np.zeros((count, 5, 5)), np.zeros((count, 5)), np.empty(5)
    last = -1
    for row in range(len(key)):
        a, b = key[row], line[row]
        if last < 0 or pairs[last, 0] != a or pairs[last, 1] != b:
            last += 1
            pairs[last, 0], pairs[last, 1] = a, b
        error = line_error(poses[a], places[row], angles[b], centres[b], by)
        weight = 1.0 / ((1.0 + (error / std) ** 2) * std) ** 2
        for u in range(5):
            gradient[last, u] += weight * by[u] * error
            for v in range(5):
                hessian[last, u, v] += weight * by[u] * by[v]
    return pairs, hessian, gradient
