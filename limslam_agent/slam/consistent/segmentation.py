"""Which of the points that Hough's transform calls a line really lie on one straight wall.

Readings are tested with all that is unsure about the poses they were taken from (generalised least squares), so that
neither a bend of the odometry is taken for a corner, nor two sides of a rounded obstacle for one wall.
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

_FEWEST = 6
_FEWEST_FOR_SHAPE = 10
_DEEPEST = 4
_KINKS_AT = np.array([0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85])
_AROUND_KINK = 0.02


@dataclass(frozen=True, eq=False)
class Piece:
    """Readings of one straight piece of wall.

    Attributes
    ----------
    members
        Which readings (n,).
    theta
        Direction of the normal in the world, rad.
    middle
        Foot of the points' mean on the line (2,), m.
    points
        Where the readings end (n, 2), m.
    length
        Along the wall, without the outermost point at either end, m.
    angle_std
        Of theta, relative to the poses, rad.
    """

    members: IntArray
    theta: float
    middle: FloatArray
    points: FloatArray
    length: float
    angle_std: float


@dataclass(frozen=True, eq=False)
class _Fit:
    piece: Piece
    along: FloatArray
    is_bent: bool
    bend_at: float
    loose: BoolArray


def straight_pieces(
    readings: Readings, members: IntArray, line: FloatArray, belief: CloneEKF, std: float, config: SegmentationConfig
) -> list[Piece]:
    """Cut readings that lie about one line where they bend, and cut off ends that bend away.

    Parameters
    ----------
    readings, members
        All of them, and which (n,) are on the line.
    line
        (r, theta) in the world, as found.
    belief
        Where they were taken from, and how surely.
    std
        Of a range, m.
    config
        When a line is bent.
    """
    return _pieces(readings, members, line, belief, std, config, _DEEPEST)


def _pieces(
    readings: Readings, members: IntArray, line: FloatArray, belief: CloneEKF, std: float, config: SegmentationConfig,
    depth: int,
) -> list[Piece]:  # fmt: skip
    if len(members) < _FEWEST:
        return []
    fit = _fit(readings, members, line, belief, std, config)
    if fit is None:
        return []
    if depth and fit.is_bent:
        halves = (fit.along < fit.bend_at - _AROUND_KINK, fit.along > fit.bend_at + _AROUND_KINK)
        return [
            piece
            for half in halves
            if np.count_nonzero(half) >= _FEWEST
            for piece in _pieces(
                readings, members[half], _principal_line(fit.piece.points[half]), belief, std, config, depth - 1
            )
        ]
    if depth and fit.loose.any():
        again = np.array([fit.piece.middle @ normal(np.array([0.0, fit.piece.theta])), fit.piece.theta])
        return _pieces(readings, members[~fit.loose], again, belief, std, config, depth - 1)
    return [fit.piece]


def _fit(
    readings: Readings, members: IntArray, line: FloatArray, belief: CloneEKF, std: float, config: SegmentationConfig
) -> _Fit | None:
    """The line through readings in generalised least squares, and whether they are straight."""
    own = readings.select(members)
    poses = belief.clone_poses(own.clones)
    points = hit_points(poses, own)
    anchor = line[0] * normal(line) + float((points @ direction(line)).mean()) * direction(line)
    state = np.array([0.0, line[1]])
    first = expected_ranges(poses, own, state, anchor)
    clear = np.abs(first.cosines) > GRAZING
    if np.count_nonzero(clear) < _FEWEST - 1:
        return None
    factor = _factor(first.by_pose[clear], own.clones[clear], belief, std)
    for _ in range(2):
        expected = expected_ranges(poses, own, state, anchor)
        whitened = solve_lower(factor, np.column_stack((own.ranges - expected.ranges, expected.by_line))[clear])
        basis, triangle = np.linalg.qr(whitened[:, 1:])
        step = np.linalg.solve(triangle, basis.T @ whitened[:, 0])
        state = state + step
    left = whitened[:, 0] - basis @ (basis.T @ whitened[:, 0])
    tangent = direction(state)
    # A range that is too long takes a slanted beam's point off the wall and along it: whoever sorts by that finds a
    # bend at the end of every noisy wall. Where the beam meets the line is free of its noise.
    met = own._replace(ranges=np.where(clear, expected.ranges, own.ranges))
    along = (hit_points(poses, met) - anchor) @ tangent
    spread = along[clear] - along[clear].mean()
    piece = Piece(
        members, float(state[1]), anchor + state[0] * normal(state), points, _extent(along),
        std / max(float(np.sqrt(spread @ spread)), 1e-6),
    )  # fmt: skip
    is_bent, bend_at = _bend(along[clear], expected.cosines[clear], left, basis, factor, config)
    loose = np.zeros(len(members), dtype=bool)
    loose[clear] = _loose_ends(along[clear], expected.cosines[clear], left, basis, factor, config)
    return _Fit(piece, along, is_bent, bend_at, loose)


def _bend(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    config: SegmentationConfig,
) -> tuple[bool, float]:  # fmt: skip
    """Whether readings are explained much better by a bent line, and where it would be bent."""
    if len(along) < _FEWEST_FOR_SHAPE or np.ptp(along) <= 0.0:
        return False, 0.0
    places = np.quantile(along, _KINKS_AT)
    scaled = 2.0 * (along - along.min()) / np.ptp(along) - 1.0
    shapes = np.column_stack((np.maximum(along[:, None] - places, 0.0), scaled[:, None] ** np.array([2, 3, 4])))
    shapes = solve_lower(factor, shapes / cosines[:, None])
    shapes -= basis @ (basis.T @ shapes)
    kinks, curves = shapes[:, : len(places)], shapes[:, len(places) :]
    squares = np.maximum(np.sum(kinks**2, axis=0), 1e-9)
    angles = left @ kinks / squares
    gains = angles**2 * squares
    best = int(np.argmax(gains))
    curved, _ = np.linalg.qr(curves)
    is_kinked = gains[best] > config.kink_gate and abs(angles[best]) > config.min_kink
    return bool(is_kinked or np.sum((left @ curved) ** 2) > config.curve_gate), float(places[best])


def _loose_ends(
    along: FloatArray, cosines: FloatArray, left: FloatArray, basis: FloatArray, factor: FloatArray,
    config: SegmentationConfig,
) -> BoolArray:  # fmt: skip
    """Readings (n,) at either end that lie off the line all on one side: the beginning of something else."""
    loose = np.zeros(len(along), dtype=bool)
    for end in (along.min(), along.max()):
        zone = np.abs(along - end) < config.end_zone
        shape = solve_lower(factor, zone / cosines)
        shape -= basis @ (basis.T @ shape)
        square = float(shape @ shape)
        if not zone.all() and square > 1e-9 and float(left @ shape) ** 2 > config.end_gate * square:
            loose |= zone
    return loose


def _factor(by_pose: FloatArray, clones: IntArray, belief: CloneEKF, std: float) -> FloatArray:
    """Cholesky factor of the readings' covariance (n, n), that of the poses included."""
    own, places = np.unique(clones, return_inverse=True)
    by_poses, rows = np.zeros((len(clones), 3 * len(own))), np.arange(len(clones))
    for number in range(3):
        by_poses[rows, 3 * places + number] = by_pose[:, number]
    return np.asarray(
        np.linalg.cholesky(by_poses @ belief.clone_covariance(own) @ by_poses.T + std**2 * np.eye(len(clones)))
    )


def _extent(along: FloatArray) -> float:
    ordered = np.sort(along)[1:-1]
    return float(ordered[-1] - ordered[0])


def _principal_line(points: FloatArray) -> FloatArray:
    middle = points.mean(axis=0)
    across = np.linalg.svd(points - middle, full_matrices=False)[2][1]
    return np.array([middle @ across, math.atan2(across[1], across[0])])
