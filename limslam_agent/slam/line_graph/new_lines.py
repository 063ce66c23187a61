"""Lines of readings that no line explains: short faces, such as those of pillars, which the filter
could not use.

The readings are grouped by the places where their beams ended. In each group, the line with the
most readings is taken, its readings are removed, and the search begins again. It is a Hough
transform with the direction that a face looks to: the opposite faces of a pillar can be nearer to
each other than the noise of a range.
"""

import math

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from limslam_agent.kernels.tables import FEWEST, GRAZING
from limslam_agent.slam.core.line_fit import fit_line
from limslam_agent.slam.line_graph.problem import Problem, State
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import normal

_JOINED = 0.10  # m: readings that ended nearer to each other are of one group
_DIRECTIONS = np.linspace(0.0, 2.0 * math.pi, 72, endpoint=False)  # rad, into which a face may look
# m, standard deviations: how far from its line a reading may be
_NARROWEST = 0.03
_WIDEST_IN_STDS = 2.5
_MAX_ANGLE_STD = math.radians(12.0)  # of a new line
_FITS = 3  # of a line to its readings, which are chosen anew for each


def faces(problem: Problem, state: State, unexplained: IntArray) -> list[IntArray]:
    """The readings of each new line, among those that no line explains (u,)."""
    places = problem.readings.places[unexplained]
    distances = problem.true(problem.readings, state.calibration)[unexplained]
    rays = state.rays(places, problem.beams[unexplained], distances)
    ahead = rays[:, 2:4]
    points = rays[:, :2] + distances[:, None] * ahead
    pairs = cKDTree(points).query_pairs(_JOINED, output_type="ndarray")
    near = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    count, group = connected_components(near, directed=False)
    order = np.argsort(group, kind="stable")
    return [
        unexplained[members[face]]
        for members in np.split(order, np.searchsorted(group[order], np.arange(1, count)))
        for face in _faces(points[members], ahead[members], problem.range_std)
    ]


def _faces(points: FloatArray, ahead: FloatArray, std: float) -> list[IntArray]:
    """The readings of each face in a group of readings that ended at points (n, 2), m, in
    directions (n, 2).
    """
    free = np.arange(len(points))
    found = list[IntArray]()
    width = max(_NARROWEST, _WIDEST_IN_STDS * std)
    while len(free) >= FEWEST:
        own = _best_face(points[free], ahead[free], std, width)
        if len(own) < FEWEST:
            break
        spread = np.linalg.svd(
            points[free[own]] - points[free[own]].mean(axis=0), compute_uv=False
        )[0]
        if std <= _MAX_ANGLE_STD * spread:
            found.append(free[own])
        free = np.delete(free, own)
    return found


def _best_face(points: FloatArray, ahead: FloatArray, std: float, width: float) -> IntArray:
    """The points of the line that most of the points (n, 2) are near."""
    normals = np.stack((np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)))
    heights = np.sort(np.where(ahead @ normals < -GRAZING, points @ normals, np.inf), axis=0)
    ends = np.stack(
        [np.searchsorted(each, each + width, side="right") for each in heights.T], axis=1
    )
    votes = np.where(np.isfinite(heights), ends - np.arange(len(points))[:, None], 0)
    first, best = np.unravel_index(votes.argmax(), votes.shape)
    facing = normals[:, best]
    height = heights[[first, ends[first, best] - 1], best].mean()
    half = 0.5 * width
    for _ in range(_FITS):
        own = np.flatnonzero(
            (ahead @ facing < -GRAZING) & (np.abs(points @ facing - height) <= half)
        )
        if len(own) < FEWEST:
            break
        line = fit_line(points[own], std).line
        turned = normal(line)
        half = width
        sign = math.copysign(1.0, float(turned @ facing))
        facing = sign * turned
        height = sign * float(line[0])
    return own
