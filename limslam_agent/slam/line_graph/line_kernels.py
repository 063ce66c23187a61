"""Compiled parts of data association: the best lines of readings, and crossings of walls.

Lines are (d, alpha) about one anchor each, as in :mod:`limslam_agent.slam.line_graph.factors`. A place along a
line is its distance from the anchor, m.
"""

import math

import numpy as np

from limslam_agent.kernels.measurement import read_share
from limslam_agent.kernels.tables import BIN, GRAZING
from limslam_agent.slam.line_graph.compilation import compiled, entry
from limslam_agent.slam.line_graph.wall_faces import NEGATIVE, POSITIVE
from limslam_env.geometry import FloatArray, IntArray


@compiled
def ray(pose: FloatArray, beam: FloatArray) -> tuple[float, float, float, float]:
    """Origin of a beam, m, and its direction, in the world frame."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    x, y = pose[0] + cos * beam[0] - sin * beam[1], pose[1] + sin * beam[0] + cos * beam[1]
    return x, y, math.cos(pose[2] + beam[2]), math.sin(pose[2] + beam[2])


@entry
def best_lines(
    poses: FloatArray,
    places: IntArray,
    beams: FloatArray,
    distances: FloatArray,
    lines: FloatArray,
    anchors: FloatArray,
    ends: FloatArray,
    beyond: float,
    width: float,
    best: IntArray,
    misfits: FloatArray,
) -> None:
    """For each reading, the line (k,) that predicts it best, among the lines that the beam meets near enough.

    Parameters
    ----------
    ends, beyond, width
        Ends (m, 2, 2) of the part of each line that was read from each side, m, the distance beyond the ends at which a
        beam may meet it, and half the opening angle of the beams, rad.
    best, misfits
        Output arrays: the line or -1, and the misfits of the reading to the best and the second line (k, 2), m.
    """
    normals = _normals(lines, anchors)
    for k in range(len(places)):
        best[k], misfits[k, 0], misfits[k, 1] = -1, math.inf, math.inf
        x, y, ux, uy = ray(poses[places[k]], beams[k])
        for line in range(len(lines)):
            nx, ny = normals[line, 0], normals[line, 1]
            cosine, height = nx * ux + ny * uy, normals[line, 2] - nx * x - ny * y
            distance = height / cosine
            if abs(cosine) < GRAZING or distance <= 0.0:
                continue
            along = nx * (y + distance * uy) - ny * (x + distance * ux) - normals[line, 3]
            misfit = abs(distance * read_share(cosine, width) - distances[k])
            low, high = ends[line, POSITIVE if cosine < 0.0 else NEGATIVE]
            if misfit >= misfits[k, 1] or along < low - beyond or along > high + beyond:
                continue
            if misfit < misfits[k, 0]:
                misfits[k, 1], misfits[k, 0], best[k] = misfits[k, 0], misfit, line
            else:
                misfits[k, 1] = misfit


@compiled
def _normals(lines: FloatArray, anchors: FloatArray) -> FloatArray:
    """For each line, its normal, and the coordinates of the line and its anchor along normal and direction (m, 4)."""
    result = np.empty((len(lines), 4))
    for line in range(len(lines)):
        nx, ny = math.cos(lines[line, 1]), math.sin(lines[line, 1])
        x, y = anchors[line, 0], anchors[line, 1]
        result[line, 0], result[line, 1] = nx, ny
        result[line, 2], result[line, 3] = lines[line, 0] + nx * x + ny * y, nx * y - ny * x
    return result


@entry
def count_crossings(
    poses: FloatArray,
    places: IntArray,
    beams: FloatArray,
    reached: FloatArray,
    lines: FloatArray,
    anchors: FloatArray,
    low: IntArray,
    hits: IntArray,
    margin: float,
    misses: IntArray,
) -> int:
    """Count the beams that passed through lines; return the number of beams that passed through a wall.

    A beam passed through a line if it reached more than ``margin`` beyond it, m along the line's normal. It passed
    through a wall, counted at most once, if other beams ended in that bin of the line and close to the bin on both
    sides.

    Parameters
    ----------
    reached
        Length of the free path of each beam (k,), m.
    low, hits
        First bin (m,) of each line, and the number of beams that ended in each bin (m, b), 0 beyond a line's last bin.
    misses
        Counts (m, b) of beams that passed through each bin, which are increased.
    """
    count, normals = 0, _normals(lines, anchors)
    for k in range(len(places)):
        is_against = False
        x, y, ux, uy = ray(poses[places[k]], beams[k])
        for line in range(len(lines)):
            nx, ny = normals[line, 0], normals[line, 1]
            cosine = nx * ux + ny * uy
            distance = (normals[line, 2] - nx * x - ny * y) / cosine
            if abs(cosine) < GRAZING or distance <= 0.0 or distance + margin / abs(cosine) >= reached[k]:
                continue
            along = nx * (y + distance * uy) - ny * (x + distance * ux) - normals[line, 3]
            place = math.floor(along / BIN) - low[line]
            if place < 0 or place >= hits.shape[1]:
                continue
            misses[line, place] += 1
            is_against |= _is_wall(hits[line], place)
        count += is_against
    return count


@compiled
def _is_wall(hits: IntArray, place: int) -> bool:
    """Whether beams ended in a bin, and in at least one of the two adjacent bins on each side of it."""
    if place < 2 or place >= len(hits) - 2 or hits[place] == 0:
        return False
    return bool(hits[place - 1] + hits[place - 2] > 0 and hits[place + 1] + hits[place + 2] > 0)
