"""Segmentation of readings into straight wall segments: compiled counterpart of ``consistent.segmentation``.

A wall segment is a row of numbers, whose columns ``kernels.segments`` names.
"""

import math

import numpy as np

from limslam_agent.kernels.segments import (
    ANGLE_STD,
    BEND_AT,
    BENT,
    EXTENT,
    MIDDLE_X,
    MIDDLE_Y,
    THETA,
    R,
    fit_segment,
)
from limslam_agent.kernels.tables import FEWEST
from limslam_agent.kernels.updates import involved
from limslam_agent.slam.batch.algebra import block_of
from limslam_agent.slam.batch.clone_ekf import clones_from
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.batch.state import Filter, Settings
from limslam_agent.slam.consistent.segmentation import AROUND_KINK, DEEPEST
from limslam_env.geometry import FloatArray, IntArray

__all__ = ["ANGLE_STD", "EXTENT", "MIDDLE_X", "MIDDLE_Y", "THETA", "wall_segments"]

MOST_SEGMENTS = 2**DEEPEST


@algebra
def wall_segments(
    ekf: Filter, places: IntArray, readings: FloatArray, points: FloatArray, members: IntArray, line: FloatArray,
    settings: Settings,
) -> tuple[FloatArray, list[IntArray]]:  # fmt: skip
    """Split readings near one line where they bend, and remove ends that bend away.

    Returns the wall segments (k, 8) and the indices of the readings of each.
    """
    segments, own = np.empty((MOST_SEGMENTS, 8)), [members[:0]]
    todo, lines, depths = [members], [line], [DEEPEST]
    start, along, loose = clones_from(ekf), np.empty(len(members)), np.empty(len(members), dtype=np.bool_)
    while todo:
        these, this, depth = todo.pop(), lines.pop(), depths.pop()
        if len(these) < FEWEST:
            continue
        segment = segments[len(own) - 1]
        columns, begins = involved(places, these, len(ekf.clones), start, -1)
        _, clear = fit_segment(
            ekf.x, start, block_of(ekf.top, ekf.rest, columns), begins, places, readings, points, these,
            (this[0], this[1]), settings.std, np.full(len(these), settings.std**2), segment, along, loose,
        )  # fmt: skip
        if not len(clear):
            continue
        here, is_loose = along[: len(these)], loose[: len(these)]
        if depth and segment[BENT] > 0.0:
            # The first half is processed first.
            for half in (these[here > segment[BEND_AT] + AROUND_KINK], these[here < segment[BEND_AT] - AROUND_KINK]):
                if len(half) >= FEWEST:
                    todo.append(half)
                    lines.append(principal_line(points, half))
                    depths.append(depth - 1)
        elif depth and is_loose.any():
            todo.append(these[~is_loose])
            lines.append(np.array([segment[R], segment[THETA]]))
            depths.append(depth - 1)
        else:
            own.append(these)
    return segments, own[1:]


@algebra
def principal_line(points: FloatArray, members: IntArray) -> FloatArray:
    """(r, theta), not normalised, of the line through some points by total least squares."""
    own = points[members]
    middle = np.array([own[:, 0].mean(), own[:, 1].mean()])
    across = np.linalg.svd(own - middle, False)[2][1]  # noqa: FBT003 (numba knows it as a positional argument only)
    return np.array([middle[0] * across[0] + middle[1] * across[1], math.atan2(across[1], across[0])])
