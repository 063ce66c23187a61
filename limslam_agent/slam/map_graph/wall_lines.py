"""Straight walls, found by the Hough transform in windows of distance driven.

The points of a line are removed, and lines are searched again until there are no more. In the
least-squares problem a line has two unknowns: a rotation about its centre and an offset.
"""

from dataclasses import dataclass

import numpy as np

from limslam_agent.config.graph import WallLineConfig
from limslam_agent.kernels.lines import extract_lines
from limslam_agent.kernels.tables import LineRules
from limslam_agent.slam.map_graph.point_links import MIN_COSINE, PointCloud
from limslam_env.geometry import BoolArray, FloatArray, IntArray, no_rows
from limslam_env.geometry.line import direction, normal

_OFFSET_BIN = 0.08  # m, of the Hough space


@dataclass(frozen=True, eq=False)
class WallLines:
    """A number l of lines, with k assignments of points to lines.

    Attributes
    ----------
    angles, centres
        Directions of the normals (l,), rad, and centres (l, 2), m.
    points, lines
        Assignments (k,): a point and its line, sorted by line and then by point. A point may belong
        to one line in each window that contains the point.
    """

    angles: FloatArray
    centres: FloatArray
    points: IntArray
    lines: IntArray


def find_lines(cloud: PointCloud, config: WallLineConfig) -> WallLines:
    """Lines of the points of all windows of driving."""
    end = cloud.travel[-1] if len(cloud.travel) else 0.0
    window = config.window
    begins = np.arange(0.0, max(end - 0.5 * window, 1e-3), 0.5 * window)
    spans = np.searchsorted(cloud.travel, np.column_stack((begins, begins + window)))
    return lines_in(cloud.places, cloud.normals, cloud.good, spans, config)


def lines_in(
    places: FloatArray,
    normals: FloatArray,
    good: BoolArray,
    spans: IntArray,
    config: WallLineConfig,
) -> WallLines:
    """Lines among the points of each span (w, 2), which is given by its first point and its last
    point (excluded).
    """
    none = np.zeros(0, dtype=np.int64)
    angles = [np.zeros(0)]
    centres = [no_rows(2)]
    points = [none]
    owners = [none]
    count = 0
    for begin, end in spans.tolist():
        label, turns = _window(places[begin:end], normals[begin:end], good[begin:end], config)
        members = np.flatnonzero(label >= 0)
        members = members[np.argsort(label[members], kind="stable")]
        firsts = np.flatnonzero(np.diff(label[members], prepend=-1))
        sizes = np.diff(firsts, append=len(members))[:, None]
        angles.append(turns)
        centres.append(
            np.add.reduceat(places[begin + members], firsts) / sizes if len(turns) else no_rows(2)
        )
        points.append(begin + members)
        owners.append(count + label[members])
        count += len(turns)
    found = (
        np.concatenate(angles),
        np.concatenate(centres),
        np.concatenate(points),
        np.concatenate(owners),
    )
    return WallLines(*found)


def _window(
    places: FloatArray, normals: FloatArray, good: BoolArray, config: WallLineConfig
) -> tuple[IntArray, FloatArray]:
    """The line of each point (p,) of a window, -1 for none, and the directions (l,) of the lines'
    normals, rad.

    Only points whose own normal is reliable vote. A line has those of them whose normals are close
    to its own, and the points without a reliable normal between its ends.
    """
    label = np.full(len(places), -1)
    found = [no_rows(2)]
    reach = [no_rows(2)]
    count = 0
    rules = LineRules(
        config.max_gap,
        config.tolerance,
        config.min_length,
        config.min_points,
        _OFFSET_BIN,
        config.angle_bin,
        only_best=False,
    )
    while True:
        voters = np.flatnonzero(good & (label < 0))
        owner, lines, ends = extract_lines(places[voters], rules)
        voters = voters[owner >= 0]
        owner = owner[owner >= 0]
        cosines = np.sum(normals[voters] * normal(lines)[owner], axis=1)
        sides = np.sign(np.bincount(owner, cosines, len(lines)))
        fits = cosines * sides[owner] > MIN_COSINE
        enough = np.bincount(owner[fits], minlength=len(lines)) >= config.min_points
        fits &= enough[owner]
        if not enough.any():
            break
        label[voters[fits]] = count + (np.cumsum(enough) - 1)[owner[fits]]
        # Lines whose normal points away from the side that they are seen from are turned round.
        lines[:, 0], lines[:, 1] = (
            sides * lines[:, 0],
            lines[:, 1] + np.where(sides < 0.0, np.pi, 0.0),
        )
        along = np.einsum("led,ld->le", ends, direction(lines))
        found.append(lines[enough])
        reach.append(np.sort(along[enough], axis=1))
        count += int(enough.sum())
    every, (low, high) = np.concatenate(found), np.concatenate(reach).T
    rest = np.flatnonzero(~good)
    off = places[rest] @ normal(every).T - every[:, 0]
    along = places[rest] @ direction(every).T
    is_on = (np.abs(off) < config.tolerance) & (low < along) & (along < high)
    if count:
        label[rest] = np.where(is_on.any(axis=1), is_on.argmax(axis=1), -1)
    return label, every[:, 1]
