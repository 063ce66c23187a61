"""Normals of points from their neighbours, and links from points to the lines through other points.

Neighbours are searched in a grid of cells. The points of a cell are sorted by the distance driven,
so that the points of one section of driving are found without reading the points of other visits.
"""

from dataclasses import dataclass

import numpy as np

from limslam_agent.slam.map_graph.key_poses import (
    ANOTHER_VISIT,
    KeyPoses,
    Trajectory,
    points_in_keys,
    to_world,
)
from limslam_env.compilation import entry_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray

# A kernel calls only kernels of its own file.
kernel = entry_of(__name__)

_ROW = 1 << 24
# Neighbours of a point within this distance, m, and this distance driven, m, determine its normal.
# It is reliable with at least so many neighbours, this standard deviation along the line, at most
# this one across, m, this ratio of the two variances, and at least this sine of the angle between
# beam and wall.
_NORMAL_RADIUS = 0.4
_NORMAL_TRAVEL = 3.0
_MIN_NEIGHBOURS = 5
_MIN_SPREAD = 0.07
_MAX_THICKNESS = 0.05
_MAX_RATIO = 0.15
_MIN_INCIDENCE = 0.17
_RADIUS = 0.35  # m, within which points are linked
_BANDS = (
    0.4,
    1.2,
    3.0,
    10.0,
)  # borders of the bands of distance driven, m; the nearest point of each band is linked
MIN_COSINE = 0.85
"""Least cosine between the normals of what lies on one wall."""
# largest distance from the line of points that are linked along the way, as a share of the radius
_MAX_OFFSET = 0.7


@dataclass(frozen=True, eq=False)
class PointCloud:
    """The points of a trajectory in the world: p points in the order of driving."""

    # key, travel: key pose (p,) and distance driven (p,), m, of each point
    key: IntArray
    travel: FloatArray
    places: FloatArray  # points (p, 2), m
    normals: FloatArray  # unit vectors (p, 2) towards the sensor
    good: BoolArray  # whether each normal (p,) is reliable


def point_cloud(keys: KeyPoses, trajectory: Trajectory, range_std: float) -> PointCloud:
    """Transform all points into the world frame and compute their normals."""
    in_key, origin_in_key = points_in_keys(keys, trajectory.bias)
    pose = trajectory.poses[keys.point_key]
    places = to_world(pose, in_key)
    origins = to_world(pose, origin_in_key)
    normals, good = find_normals(places, origins, keys.point_travel, range_std)
    return PointCloud(keys.point_key, keys.point_travel, places, normals, good)


def find_normals(
    places: FloatArray, origins: FloatArray, travel: FloatArray, range_std: float
) -> tuple[FloatArray, BoolArray]:
    """Normals (p, 2) of points by principal component analysis of their neighbours, and whether
    they are reliable.

    Neighbours belong to the same section of driving: the distance between two points includes the
    distance driven between them. Normals point towards the beams' origins.
    """
    index = _index(places, travel, _NORMAL_RADIUS)
    thickness = _MAX_THICKNESS**2 + range_std**2
    limits = np.array([_MIN_NEIGHBOURS, _MIN_SPREAD**2, thickness, _MAX_RATIO, _MIN_INCIDENCE])
    return _normals(places, origins, travel, *index, _NORMAL_RADIUS, _NORMAL_TRAVEL, limits)


def links_along(cloud: PointCloud) -> IntArray:
    """Links (l, 2) between points of one section of driving, to the nearest point in each band of
    distance driven.
    """
    return _links(cloud, _RADIUS, _BANDS, _MAX_OFFSET * _RADIUS)


def links_across(cloud: PointCloud, radius: float) -> IntArray:
    """Links (l, 2) to the nearest point of another visit."""
    return _links(cloud, radius, (ANOTHER_VISIT, np.inf), radius)


def _links(
    cloud: PointCloud, radius: float, borders: tuple[float, ...], most_off: float
) -> IntArray:
    """Links (l, 2) to the nearest point within a radius, m, and ``most_off`` m of its line, in each
    band of driving.
    """
    limits = np.array([radius, MIN_COSINE, most_off])
    index = _index(cloud.places, cloud.travel, radius)
    return _nearest(
        cloud.places,
        cloud.normals,
        cloud.good,
        cloud.travel,
        cloud.key,
        *index,
        np.array(borders),
        limits,
    )


def _index(places: FloatArray, travel: FloatArray, side: float) -> tuple[IntArray, IntArray, float]:
    """Cells (p,) in ascending order, their points (p,) in the order of driving, and the side of a
    cell, m.
    """
    cells = np.floor(places / side).astype(np.int64)
    number = cells[:, 0] * _ROW + cells[:, 1]
    order = np.lexsort((travel, number))
    return number[order], order, side


@kernel
def _span(
    cells: IntArray, order: IntArray, travel: FloatArray, cell: int, low: float, high: float
) -> tuple[int, int]:
    """First and last (excluded) index in ``order`` of a cell's points that were seen between two
    distances driven.
    """
    begin = int(np.searchsorted(cells, cell))
    end = int(np.searchsorted(cells, cell + 1))
    while begin < end and travel[order[begin]] < low:
        begin += 1
    stop = begin
    while stop < end and travel[order[stop]] <= high:
        stop += 1
    return begin, stop


@kernel
def _normals(
    places: FloatArray,
    origins: FloatArray,
    travel: FloatArray,
    cells: IntArray,
    order: IntArray,
    side: float,
    radius: float,
    reach: float,
    limits: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    count = len(places)
    normals = np.zeros((count, 2))
    good = np.zeros(count, np.bool_)
    per_metre = (radius / reach) ** 2
    for i in range(count):
        x = places[i, 0]
        y = places[i, 1]
        s = travel[i]
        column = int(np.floor(x / side))
        row = int(np.floor(y / side))
        n = sx = sy = sxx = syy = sxy = 0.0
        for a in range(column - 1, column + 2):
            for b in range(row - 1, row + 2):
                begin, end = _span(cells, order, travel, a * (1 << 24) + b, s - reach, s + reach)
                for place in range(begin, end):
                    j = order[place]
                    dx = places[j, 0] - x
                    dy = places[j, 1] - y
                    ds = travel[j] - s
                    if dx * dx + dy * dy + per_metre * ds * ds <= radius * radius:
                        n += 1.0
                        sx = sx + dx
                        sy = sy + dy
                        sxx = sxx + dx * dx
                        syy = syy + dy * dy
                        sxy = sxy + dx * dy
        sx = sx / n
        sy = sy / n
        sxx = sxx / n - sx * sx
        syy = syy / n - sy * sy
        sxy = sxy / n - sx * sy
        middle = 0.5 * (sxx + syy)
        half = 0.5 * np.sqrt((sxx - syy) ** 2 + 4.0 * sxy * sxy)
        angle = 0.5 * np.arctan2(2.0 * sxy, sxx - syy)
        nx = -np.sin(angle)
        ny = np.cos(angle)
        ox = origins[i, 0] - x
        oy = origins[i, 1] - y
        towards = ox * nx + oy * ny
        if towards < 0.0:
            nx = -nx
            ny = -ny
        normals[i, 0] = nx
        normals[i, 1] = ny
        wide = middle + half
        thin = middle - half
        straight = wide > limits[1] and thin < limits[2] and thin < limits[3] * wide
        good[i] = (
            n >= limits[0]
            and straight
            and abs(towards) > limits[4] * max(np.sqrt(ox * ox + oy * oy), 1e-6)
        )
    return normals, good


@kernel
def _band(gap: float, borders: FloatArray) -> int:
    """Index of the band that contains a distance driven; the last band has no upper limit."""
    band = 0
    while band < len(borders) - 2 and gap >= borders[band + 1]:
        band += 1
    return band


@kernel
def _nearest(
    places: FloatArray,
    normals: FloatArray,
    good: BoolArray,
    travel: FloatArray,
    key: IntArray,
    cells: IntArray,
    order: IntArray,
    side: float,
    borders: FloatArray,
    limits: FloatArray,
) -> IntArray:
    bands = len(borders) - 1
    radius = limits[0]
    reach = borders[bands]
    per_metre = (radius / reach) ** 2
    links = np.empty((len(places) * bands, 2), np.int64)
    count = 0
    best = np.empty(bands, np.int64)
    nearest = np.empty(bands)
    for i in np.nonzero(good)[0]:
        x = places[i, 0]
        y = places[i, 1]
        s = travel[i]
        best[:] = -1
        nearest[:] = radius * radius
        column = int(np.floor(x / side))
        row = int(np.floor(y / side))
        for a in range(column - 1, column + 2):
            for b in range(row - 1, row + 2):
                begin, end = _span(cells, order, travel, a * (1 << 24) + b, s - reach, s + reach)
                for place in range(begin, end):
                    j = order[place]
                    gap = abs(travel[j] - s)
                    if not good[j] or gap < borders[0] or key[j] == key[i]:
                        continue
                    dx = x - places[j, 0]
                    dy = y - places[j, 1]
                    square = dx * dx + dy * dy + per_metre * gap * gap
                    band = _band(gap, borders)
                    if square >= nearest[band]:
                        continue
                    cosine = normals[i, 0] * normals[j, 0] + normals[i, 1] * normals[j, 1]
                    if (
                        cosine > limits[1]
                        and abs(dx * normals[j, 0] + dy * normals[j, 1]) < limits[2]
                    ):
                        best[band] = j
                        nearest[band] = square
        for band in range(bands):
            if best[band] >= 0:
                links[count, 0] = i
                links[count, 1] = best[band]
                count += 1
    return links[:count].copy()
