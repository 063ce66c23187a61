"""Leaves out readings near a corner, because they may belong to either of two walls.

This needs the lines and the points, and nothing else of the estimator, so it is a module of its own.
"""

from collections.abc import Iterator

import numpy as np

from limslam_agent.kernels.tables import FEWEST
from limslam_agent.slam.core.hough import ExtractedLine
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.line import direction, distance

BESIDE_CORNER = 0.15
"""A reading this close to the end of another line, m along it, may belong to either line."""


def uncontested(points: FloatArray, lines: list[ExtractedLine], near: float) -> Iterator[tuple[FloatArray, IntArray]]:
    """Each line (2,), and its readings without those near a corner that could also belong to another line.

    A line with too few readings left for a wall segment is left out.

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
        if len(members) >= FEWEST:
            yield line.fit.line, members
