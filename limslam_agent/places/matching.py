"""The poses at which one map fits into another.

Walls of buildings have few directions, so few turns of the local map can be right. For each of them, all shifts are
compared at once: the score of a shift is a correlation, which the fast Fourier transform computes (J. Lewis, "Fast
normalized cross-correlation", 1995). The score counts points of walls that the other map confirms, less points of
either map that lie where the other map is free. The best poses are refined by least squares of distances from points to
lines, and judged again without the rounding of cells.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.ndimage import maximum_filter

from limslam_agent.places.place_map import PlaceMap, wall_distances
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.line import angle_between
from limslam_env.geometry.se2 import compose, inverse, transform_points, wrap_angle
from limslam_env.geometry.segment import distances, lengths

APART, _APART_TURN = 0.40, math.radians(15.0)
"""Two poses are different if they are farther apart than this, m or rad."""

_PEAKS = 12  # poses that are refined and compared
# A point of a wall is confirmed if a wall of the other map is this near, m, and their directions differ by less, rad.
_NEAR, _TURN = 0.12, math.radians(20.0)
_CONTRADICTION = 2.0  # price of a contradicted point, in confirmed points
_ANGLES = 180  # bins of wall directions, over half a turn
_SMOOTHING = 2.0  # bins
_LIKELY = 0.5  # turns are searched whose walls agree at least half as well as those of the best turn
_ROUNDS, _CAPTURE = 8, (0.35, 0.15)  # of the refinement, and distances of points that count, first and last, m


@dataclass(frozen=True, eq=False)
class Fit:
    """A pose of the local map in the other map's frame, and how well the maps agree there.

    Attributes
    ----------
    pose
        The pose (3,), m and rad.
    score
        Points of walls that the other map confirms, less the price of points that lie where the other map is free; of
        both maps.
    forward, backward
        Confirmed points among the confirmed and contradicted points of the local map, and of the other map.
    contradictions
        Number of points of either map that lie where the other map is certainly free.
    known
        Confirmed points among all points of the local map.
    walls, across
        Length of the confirmed walls of the local map, m: in all, and at right angles to their main direction.
    """

    pose: FloatArray
    score: float
    forward: float
    backward: float
    contradictions: int
    known: float
    walls: float
    across: float


def best_fits(known: PlaceMap, local: PlaceMap) -> list[Fit]:
    """The poses at which a local map fits best into a known map, the best one first. No two of them are close."""
    if not len(known.points) or not len(local.points):
        return []
    rough = [_refined(known, local, pose) for pose in _peaks(known, local)]
    fits = sorted((judged(known, local, pose) for pose in rough), key=lambda fit: -fit.score)
    kept, middle = list[Fit](), local.middle
    for fit in fits:
        if all(are_apart(fit.pose, other.pose, middle) for other in kept):
            kept.append(fit)
    return kept


def are_apart(first: FloatArray, second: FloatArray, middle: FloatArray) -> bool:
    """Whether two poses (3,) of a local map or a drive place its middle (2,), or turn it, differently."""
    shift = transform_points(first, middle[None]) - transform_points(second, middle[None])
    turn = abs(wrap_angle(float(first[2] - second[2])))
    return float(np.hypot(*shift[0])) > APART or turn > _APART_TURN


def judged(known: PlaceMap, local: PlaceMap, pose: FloatArray) -> Fit:
    """How well two maps agree at a pose (3,) of the local map."""
    is_hit, *doubts = _verdicts(local, pose, known)
    is_met, *doubts_of_known = _verdicts(known, inverse(pose), local)
    confirmed, met = int(np.count_nonzero(is_hit)), int(np.count_nonzero(is_met))
    (doubted, against), (doubted_there, missed) = (
        [int(np.count_nonzero(each)) for each in found] for found in (doubts, doubts_of_known)
    )
    walls, across = _extents(local, is_hit)
    return Fit(
        pose=pose,
        score=confirmed + met - _CONTRADICTION * (doubted + doubted_there),
        forward=confirmed / max(confirmed + against, 1),
        backward=met / max(met + missed, 1),
        contradictions=against + missed,
        known=confirmed / max(len(local.points), 1),
        walls=walls,
        across=across,
    )


def _verdicts(one: PlaceMap, pose: FloatArray, other: PlaceMap) -> list[BoolArray]:
    """Which points of a map at a pose (3,) in the frame of another map are confirmed, doubted, and contradicted."""
    points = transform_points(pose, one.points)
    confirmed = wall_distances(points, one.angles[one.owners] + pose[2], other, _TURN) < _NEAR
    return [confirmed, *(~confirmed & other.lies_in(cells, points) for cells in (other.clear, other.inner))]


def _extents(local: PlaceMap, confirmed: BoolArray) -> tuple[float, float]:
    """Length of the confirmed walls, m, and its part at right angles to the direction in which most of them run."""
    counts = np.bincount(local.owners, minlength=len(local.segments))
    share = np.bincount(local.owners, weights=confirmed, minlength=len(local.segments)) / np.maximum(counts, 1)
    sizes, angles = share * lengths(local.segments), local.angles
    across = np.abs(np.sin(angles[:, None] - angles)) @ sizes
    return float(sizes.sum()), float(across.min(initial=np.inf) if len(across) else 0.0)


def _peaks(known: PlaceMap, local: PlaceMap) -> list[FloatArray]:
    """Poses (3,) at the highest local maxima of the score, over all shifts and the likely turns."""
    cell, centre = known.cell, local.middle
    reach = float(np.hypot(*(_corners(local) - centre).T).max())
    pad = int(np.ceil(reach / cell)) + 1
    low = np.minimum(known.low, known.points.min(axis=0)) - pad * cell
    high = np.maximum(known.low + cell * np.array(known.clear.shape[::-1]), known.points.max(axis=0)) + pad * cell
    shape = tuple(fft.next_fast_len(int(size), real=True) for size in np.ceil((high - low) / cell)[::-1] + 1)
    walls = _raster(known.points, low, cell, shape)
    near = maximum_filter(walls, size=3)
    clear = _raster(_centres(known), low, cell, shape) * (near == 0)
    values, walls_there = fft.rfft2(near - _CONTRADICTION * clear), fft.rfft2(walls)
    found: list[tuple[float, FloatArray]] = []
    free = _centres(local) - centre
    for turn in likely_turns(known, local):
        turned = np.array([0.0, 0.0, turn])
        hits = _raster(transform_points(turned, local.points - centre), np.zeros(2), cell, shape)
        open_ground = _raster(transform_points(turned, free), np.zeros(2), cell, shape)
        scores = fft.irfft2(
            values * fft.rfft2(hits).conj() - _CONTRADICTION * walls_there * fft.rfft2(open_ground).conj(),
            s=shape,
        )
        tops = np.argwhere((scores == maximum_filter(scores, size=5, mode="wrap")) & (scores > 0.0))
        for row, column in tops[np.argsort(-scores[tops[:, 0], tops[:, 1]])][:_PEAKS].tolist():
            middle = low + cell * np.array([column, row])
            found.append((scores[row, column], compose(np.array([*middle, turn]), np.array([*-centre, 0.0]))))
    found.sort(key=lambda each: -each[0])
    return [pose for _, pose in found[:_PEAKS]]


def likely_turns(known: PlaceMap, local: PlaceMap) -> FloatArray:
    """The turns (t,), rad, by which the local map's walls get the directions of the known map's walls."""
    one, other = (_directions(each) for each in (known, local))
    agreement = np.real(np.fft.ifft(np.fft.fft(one) * np.fft.fft(other).conj()))
    is_top = (agreement >= np.roll(agreement, 1)) & (agreement > np.roll(agreement, -1))
    turns = np.flatnonzero(is_top & (agreement >= _LIKELY * agreement.max())) * np.pi / _ANGLES
    return np.concatenate((turns, turns + np.pi))


def _directions(place: PlaceMap) -> FloatArray:
    """Length of the walls (180,) by their direction, m, smoothed."""
    bins = np.arange(_ANGLES) * np.pi / _ANGLES
    apart = angle_between(place.angles[:, None] - bins)
    return np.asarray(lengths(place.segments) @ np.exp(-0.5 * (apart / (_SMOOTHING * np.pi / _ANGLES)) ** 2))


def _centres(place: PlaceMap) -> FloatArray:
    """Centres (n, 2) of the clear cells, m."""
    return np.asarray(place.low + (np.argwhere(place.clear)[:, ::-1] + 0.5) * place.cell)


def _corners(place: PlaceMap) -> FloatArray:
    """Corners (4, 2) of the area that a map covers, m."""
    high = place.low + place.cell * np.array(place.clear.shape[::-1])
    low, high = np.minimum(place.low, place.points.min(axis=0)), np.maximum(high, place.points.max(axis=0))
    return np.array([[low[0], low[1]], [low[0], high[1]], [high[0], low[1]], [high[0], high[1]]])


def _raster(points: FloatArray, low: FloatArray, cell: float, shape: tuple[int, ...]) -> FloatArray:
    """Cells (rows, columns) that hold a point (n, 2), as 1 and 0. Points outside come in again on the other side."""
    cells = np.rint((points - low) / cell - (0.5 if low.any() else 0.0)).astype(np.int64)
    grid = np.zeros(shape)
    grid[cells[:, 1] % shape[0], cells[:, 0] % shape[1]] = 1.0
    return grid


def _refined(known: PlaceMap, local: PlaceMap, pose: FloatArray) -> FloatArray:
    """A pose (3,) that minimises the squared distances of the local map's points from the known map's walls."""
    angles, directions = local.angles[local.owners], known.angles
    normals = np.column_stack((-np.sin(directions), np.cos(directions)))
    for capture in np.linspace(*_CAPTURE, _ROUNDS):
        points = transform_points(pose, local.points)
        apart = np.abs(angle_between(angles[:, None] + pose[2] - directions))
        away = np.where(apart < _TURN, distances(points, known.segments), np.inf)
        nearest = away.argmin(axis=1)
        used = away[np.arange(len(points)), nearest] < capture
        if np.count_nonzero(used) < 3:
            break
        walls, lever = normals[nearest[used]], points[used] - pose[:2]
        off = np.sum(walls * (known.segments[nearest[used], :2] - points[used]), axis=1)
        rows = np.column_stack((walls, walls[:, 1] * lever[:, 0] - walls[:, 0] * lever[:, 1]))
        # The small weights keep directions without walls where they are.
        pose = pose + np.linalg.solve(rows.T @ rows + 1e-3 * np.eye(3), rows.T @ off)
    return np.array([*pose[:2], wrap_angle(float(pose[2]))])
