"""Segmentation: splits the readings of a line found by the Hough transform into straight wall segments.

Readings near a corner are left out, because they may belong to either of two walls.

The tests for straightness are generalised least squares with the joint covariance of the poses that the readings were
taken from. So a bend that comes from the odometry's error is not taken for a corner, and two sides of a rounded
obstacle are not taken for one wall.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from limslam_agent.kernels.tables import FEWEST
from limslam_agent.slam.consistent.beam_model import Readings
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.core.hough import ExtractedLine
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import direction, distance

BESIDE_CORNER = 0.15
"""A reading this close to the end of another line, m along it, may belong to either line."""

DEEPEST = 4
"""A line is split at most this many times in a row."""

AROUND_KINK = 0.02
"""Readings within this distance of a kink are in neither half, m."""


@dataclass(frozen=True, eq=False)
class WallSegment:
    """Readings of one straight segment of a wall.

    Attributes
    ----------
    members
        Indices of the readings (n,).
    theta
        Direction of the wall's normal in the world, rad.
    middle
        Projection of the readings' mean end point on the line that was found (2,), m. It is where the poses are now,
        as all landmarks are. The fit also moves the poses, and with them the line: by metres if these are uncertain.
    points
        End points of the readings (n, 2), m.
    length
        Extent along the wall without the outermost reading at either end, m.
    angle_std
        Standard deviation of theta relative to the poses, rad.
    residuals, ranges
        Residuals (k,) of those readings that do not graze the wall, in standard deviations, independent but for the
        fitted line, and the ranges of these readings (k,), m.
    """

    members: IntArray
    theta: float
    middle: FloatArray
    points: FloatArray
    length: float
    angle_std: float
    residuals: FloatArray
    ranges: FloatArray


class _Fit(NamedTuple):
    """A fitted segment, where its readings are along it, and what splits it."""

    segment: WallSegment
    along: FloatArray
    r: float
    is_bent: bool
    bend_at: float
    loose: BoolArray


class _Source(NamedTuple):
    """All readings near a line: as compiled functions take them, their end points, and the variances of the ranges."""

    belief: CloneEKF
    places: IntArray
    readings: FloatArray
    points: FloatArray
    variances: FloatArray
    std: float


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


def wall_segments(
    readings: Readings, members: IntArray, line: FloatArray, belief: CloneEKF, std: float
) -> list[WallSegment]:
    """Split readings that lie near one line where they bend, and remove ends that bend away.

    Parameters
    ----------
    readings, members
        All readings, and the indices (n,) of those on the line.
    line
        (r, theta) in the world, as the Hough transform found it.
    belief
        The filter, which holds the poses that the readings were taken from.
    std
        Standard deviation of a range, m.

    Returns
    -------
    segments
        The straight wall segments, in order along the wall.
    """
    places, rows = belief.places(readings.clones), readings.rows
    source = _Source(belief, places, rows, belief.points(places, rows, float(line[1])), readings.variances(std), std)
    return _segments(source, members, (float(line[0]), float(line[1])), DEEPEST)


def _segments(source: _Source, members: IntArray, line: tuple[float, float], depth: int) -> list[WallSegment]:
    """The segments of some readings, which are split at most ``depth`` times."""
    if len(members) < FEWEST:
        return []
    fit = _fit(source, members, line)
    if fit is None:
        return []
    if depth and fit.is_bent:
        halves = (fit.along < fit.bend_at - AROUND_KINK, fit.along > fit.bend_at + AROUND_KINK)
        return [
            segment
            for half in halves
            if np.count_nonzero(half) >= FEWEST
            for segment in _segments(
                source, members[half], _principal_line(fit.segment.points[half]), depth - 1
            )
        ]  # fmt: skip
    if depth and fit.loose.any():
        return _segments(source, members[~fit.loose], (fit.r, fit.segment.theta), depth - 1)
    return [fit.segment]


def _fit(source: _Source, members: IntArray, line: tuple[float, float]) -> _Fit | None:
    """Fit a line to readings by generalised least squares, and test whether they are straight; None if too few."""
    from limslam_agent.kernels.segments import fit_readings

    belief, variances = source.belief, source.variances[members]
    row, along, loose, residuals, clear = fit_readings(
        belief.x, belief.P, belief.clones_from, source.places, source.readings, source.points, members, line,
        source.std, variances,
    )  # fmt: skip
    if not len(clear):
        return None
    if not math.isfinite(residuals[-1]):
        raise np.linalg.LinAlgError("the covariance of the readings is not positive")
    theta, x, y, length, angle_std, r, is_bent, bend_at = row.tolist()
    points, ranges = source.points[members], source.readings[members[clear], 3]
    segment = WallSegment(members, theta, np.array([x, y]), points, length, angle_std, residuals, ranges)
    return _Fit(segment, along, r, is_bent > 0.0, bend_at, loose)


def _principal_line(points: FloatArray) -> tuple[float, float]:
    """(r, theta), not normalised, of the line through points (n, 2), m, by total least squares."""
    middle = points.mean(axis=0)
    across = np.linalg.svd(points - middle, full_matrices=False)[2][1]
    return float(middle @ across), math.atan2(across[1], across[0])
