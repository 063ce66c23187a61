"""Segmentation: splits the readings of a line found by the Hough transform into straight wall segments.

The tests for straightness are generalised least squares with the joint covariance of the poses that the readings were
taken from. So a bend that comes from the odometry's error is not taken for a corner, and two sides of a rounded
obstacle are not taken for one wall.
"""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.config.consistent import SegmentationConfig
from limslam_agent.slam.consistent.beam_model import GRAZING, Readings, expected_ranges, hit_points
from limslam_agent.slam.consistent.clone_ekf import CloneEKF
from limslam_agent.slam.core.triangular import solve_lower
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.line import direction, normal

FEWEST = 6
"""Least number of readings of a wall segment."""

FEWEST_FOR_SHAPE = 10
"""Least number of readings that are tested for a kink or a curve."""

DEEPEST = 4
"""A line is split at most this many times in a row."""

KINKS_AT = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Quantiles of the readings' positions at which a kink is tested for."""

AROUND_KINK = 0.02
"""Readings within this distance of a kink are in neither half, m."""

LEAST_SPREAD = 1e-6
"""Least root of the summed squared distances of readings from their middle, m, that the angle's error is based on."""

LEAST_GAIN = 1e-9
"""Least squared norm of a shape that is divided by."""


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

    @property
    def hole(self) -> float:
        """Largest distance between neighbouring end points along the wall, m."""
        along = np.sort(self.points @ direction(np.array([0.0, self.theta])))
        return float(np.diff(along).max())


@dataclass(frozen=True, eq=False)
class _Fit:
    segment: WallSegment
    along: FloatArray
    is_bent: bool
    bend_at: float
    loose: BoolArray


def wall_segments(
    readings: Readings, members: IntArray, line: FloatArray, belief: CloneEKF, std: float, config: SegmentationConfig
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
    config
        Thresholds of the tests.

    Returns
    -------
    segments
        The straight wall segments, in order along the wall.
    """
    poses = belief.clone_poses(readings.clones)
    points = hit_points(poses, readings.towards(line[1], poses[:, 2]))
    return _segments(readings, points, members, line, belief, std, config, DEEPEST)


def _segments(
    readings: Readings, points: FloatArray, members: IntArray, line: FloatArray, belief: CloneEKF, std: float,
    config: SegmentationConfig, depth: int,
) -> list[WallSegment]:  # fmt: skip
    """The segments of some readings with their end points, which are split at most ``depth`` times."""
    if len(members) < FEWEST:
        return []
    fit = _fit(readings, points[members], members, line, belief, std, config)
    if fit is None:
        return []
    if depth and fit.is_bent:
        halves = (fit.along < fit.bend_at - AROUND_KINK, fit.along > fit.bend_at + AROUND_KINK)
        return [
            segment
            for half in halves
            if np.count_nonzero(half) >= FEWEST
            for segment in _segments(
                readings,
                points,
                members[half],
                _principal_line(fit.segment.points[half]),
                belief,
                std,
                config,
                depth - 1,
            )
        ]
    if depth and fit.loose.any():
        again = np.array([fit.segment.middle @ normal(np.array([0.0, fit.segment.theta])), fit.segment.theta])
        return _segments(readings, points, members[~fit.loose], again, belief, std, config, depth - 1)
    return [fit.segment]


def _fit(
    readings: Readings, points: FloatArray, members: IntArray, line: FloatArray, belief: CloneEKF, std: float,
    config: SegmentationConfig,
) -> _Fit | None:  # fmt: skip
    """Fit a line to readings by generalised least squares, and test whether they are straight; None if too few."""
    own = readings.select(members)
    poses = belief.clone_poses(own.clones)
    anchor = line[0] * normal(line) + float((points @ direction(line)).mean()) * direction(line)
    state = np.array([0.0, line[1]])
    first = expected_ranges(poses, own, state, anchor)
    clear = np.abs(first.cosines) > GRAZING
    if np.count_nonzero(clear) < FEWEST - 1:
        return None
    factor = _factor(first.by_pose[clear], own.select(np.flatnonzero(clear)), belief, std)
    for _ in range(2):
        expected = expected_ranges(poses, own, state, anchor)
        whitened = solve_lower(factor, np.column_stack((own.ranges - expected.ranges, expected.by_line))[clear])
        basis, triangle = np.linalg.qr(whitened[:, 1:])
        step = np.linalg.solve(triangle, basis.T @ whitened[:, 0])
        state = state + step
    left = whitened[:, 0] - basis @ (basis.T @ whitened[:, 0])
    tangent = direction(state)
    # The error of a slanted beam's range moves its end point along the wall. Positions from end points would therefore
    # show a bend at the end of every noisy wall; positions where the beams meet the line do not contain that error.
    met = own.towards(state[1], poses[:, 2])._replace(ranges=np.where(clear, expected.ranges, own.ranges))
    along = (hit_points(poses, met) - anchor) @ tangent
    spread = along[clear] - along[clear].mean()
    segment = WallSegment(
        members, float(state[1]), anchor, points, _extent(along),
        std / max(float(np.sqrt(spread @ spread)), LEAST_SPREAD), left, own.ranges[clear],
    )  # fmt: skip
    is_bent, bend_at = _bend(along[clear], expected.cosines[clear], left, basis, factor, config)
    loose = np.zeros(len(members), dtype=bool)
    loose[clear] = _loose_ends(along[clear], expected.cosines[clear], left, basis, factor, config)
    return _Fit(segment, along, is_bent, bend_at, loose)


def _bend(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    config: SegmentationConfig,
) -> tuple[bool, float]:  # fmt: skip
    """Whether a kinked or curved line explains readings much better, and the position of the best kink, m."""
    if len(along) < FEWEST_FOR_SHAPE or np.ptp(along) <= 0.0:
        return False, 0.0
    places = _quantiles(np.sort(along), np.array(KINKS_AT))
    scaled = 2.0 * (along - along.min()) / np.ptp(along) - 1.0
    shapes = np.column_stack((np.maximum(along[:, None] - places, 0.0), scaled[:, None] ** np.array([2, 3, 4])))
    shapes = solve_lower(factor, shapes / cosines[:, None])
    shapes -= basis @ (basis.T @ shapes)
    kinks, curves = shapes[:, : len(places)], shapes[:, len(places) :]
    squares = np.maximum(np.sum(kinks**2, axis=0), LEAST_GAIN)
    angles = left @ kinks / squares
    gains = angles**2 * squares
    best = int(np.argmax(gains))
    curved, _ = np.linalg.qr(curves)
    is_kinked = gains[best] > config.kink_gate and abs(angles[best]) > config.min_kink
    return bool(is_kinked or np.sum((left @ curved) ** 2) > config.curve_gate), float(places[best])


def _quantiles(ordered: FloatArray, shares: FloatArray) -> FloatArray:
    """What ``np.quantile`` gives for sorted numbers (n,), in a fifth of its time."""
    places = shares * (len(ordered) - 1)
    low = places.astype(np.int64)
    first, second, part = ordered[low], ordered[np.minimum(low + 1, len(ordered) - 1)], places - low
    step = second - first
    return np.where(part >= 0.5, second - step * (1.0 - part), first + step * part)


def _loose_ends(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    config: SegmentationConfig,
) -> BoolArray:  # fmt: skip
    """Readings (n,) at either end that all lie on one side of the line: they belong to another object."""
    loose = np.zeros(len(along), dtype=bool)
    for end in (along.min(), along.max()):
        zone = np.abs(along - end) < config.end_zone
        shape = solve_lower(factor, zone / cosines)
        shape -= basis @ (basis.T @ shape)
        square = float(shape @ shape)
        if not zone.all() and square > LEAST_GAIN and float(left @ shape) ** 2 > config.end_gate * square:
            loose |= zone
    return loose


def _factor(by_pose: FloatArray, readings: Readings, belief: CloneEKF, std: float) -> FloatArray:
    """Cholesky factor of the covariance (n, n) of the readings, the uncertainty of the poses included."""
    own, places = np.unique(readings.clones, return_inverse=True)
    by_poses, rows = np.zeros((len(places), 3 * len(own))), np.arange(len(places))
    for number in range(3):
        by_poses[rows, 3 * places + number] = by_pose[:, number]
    return np.asarray(
        np.linalg.cholesky(
            by_poses @ belief.clone_covariance(own) @ by_poses.T + readings.variances(std) * np.eye(len(places))
        )
    )


def _extent(along: FloatArray) -> float:
    """Length of the range of positions (n,), m, without the outermost at either end."""
    ordered = np.sort(along)[1:-1]
    return float(ordered[-1] - ordered[0])


def _principal_line(points: FloatArray) -> FloatArray:
    """(r, theta), not normalised, of the line through points (n, 2), m, by total least squares."""
    middle = points.mean(axis=0)
    across = np.linalg.svd(points - middle, full_matrices=False)[2][1]
    return np.array([middle @ across, math.atan2(across[1], across[0])])
