"""Normals of points from their neighbours, and links from points to the lines through other points.

Neighbours are searched in a grid of cells. The points of a cell are sorted by the distance driven,
so that the points of one section of driving are found without reading the points of other visits.
"""

from typing import NamedTuple

import numpy as np

from limslam_agent.slam.map_graph.key_poses import (
    KeyPoses,
    Trajectory,
    points_in_keys,
    to_world,
)
from limslam_env.compilation import compiled, entry_of
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


class PointCloud(NamedTuple):
    """The points of a trajectory in the world: p points in the order of driving."""

    # key, travel: key pose (p,) and distance driven (p,), m, of each point
    key: IntArray
    travel: FloatArray
    places: FloatArray  # points (p, 2), m
    normals: FloatArray  # unit vectors (p, 2) towards the sensor
    good: BoolArray  # whether each normal (p,) is reliable


def point_cloud(keys: KeyPoses, trajectory: Trajectory) -> PointCloud:
    """Transform all points into the world frame and compute their normals."""
    in_key, origin_in_key = points_in_keys(keys, trajectory.bias)
    key = keys.point_key
    travel = keys.travel[keys.point_event]
    pose = trajectory.poses[key]
    places = to_world(pose, in_key)
    origins = to_world(pose, origin_in_key)
    normals, good = find_normals(places, origins, travel, keys.data.range_std)
    return PointCloud(key, travel, places, normals, good)


def find_normals(
    places: FloatArray, origins: FloatArray, travel: FloatArray, range_std: float
) -> tuple[FloatArray, BoolArray]:
    """Normals (p, 2) of points by principal component analysis of their neighbours, and whether
    they are reliable.

    Neighbours belong to the same section of driving: the distance between two points includes the
    distance driven between them. Normals point towards the beams' origins.
    """
    limits = np.array(
        [
            _MIN_NEIGHBOURS,
            _MIN_SPREAD**2,
            _MAX_THICKNESS**2 + range_std**2,
            _MAX_RATIO,
            _MIN_INCIDENCE,
        ]
    )
    return _normals(_index(places, travel, _NORMAL_RADIUS), origins, _NORMAL_TRAVEL, limits)


def links_along(cloud: PointCloud) -> IntArray:
    """Links (l, 2) between points of one section of driving, to the nearest point in each band of
    distance driven.
    """
    return _links(cloud, _RADIUS, _BANDS, _MAX_OFFSET * _RADIUS)


def links_across(cloud: PointCloud, radius: float, another_visit: float) -> IntArray:
    """Links (l, 2) to the nearest point of another visit, after so much driving, m."""
    return _links(cloud, radius, (another_visit, np.inf), radius)


def _links(
    cloud: PointCloud, radius: float, borders: tuple[float, ...], most_off: float
) -> IntArray:
    """Links (l, 2) to the nearest point within a radius, m, and ``most_off`` m of its line, in each
    band of driving.
    """
    index = _index(cloud.places, cloud.travel, radius)
    limits = np.array([MIN_COSINE, most_off])
    found = _nearest(index, cloud, np.array(borders), limits)
    points, bands = np.nonzero(found >= 0)
    return np.column_stack((points, found[points, bands]))


class _Index(NamedTuple):
    """Points in a grid of cells."""

    places: FloatArray  # (p, 2), m
    travel: FloatArray  # distance driven (p,), m
    cells: IntArray  # cells (p,) in ascending order
    order: IntArray  # points (p,) of these cells, in the order of driving
    side: float  # of a cell, within which neighbours lie, m


def _index(places: FloatArray, travel: FloatArray, side: float) -> _Index:
    cells = np.floor(places / side).astype(np.int64)
    number = cells[:, 0] * _ROW + cells[:, 1]
    order = np.lexsort((travel, number))
    return _Index(places, travel, number[order], order, side)


@compiled
def _around(index: _Index, place: int, reach: float, cells: IntArray, out: IntArray) -> int:
    """Set the first numbers to the points around a point, which has a place in the order, up to a
    distance driven from it, and return their number.

    The points are visited in their order. Those of a cell have the same cells (9, 2) around them,
    whose begins move on to where no point lies too far behind.
    """
    count = 0
    point = index.order[place]
    middle = index.travel[point]
    is_new = place == 0 or index.cells[place] != index.cells[place - 1]
    for k in range(9):
        if is_new:
            column = int(np.floor(index.places[point, 0] / index.side)) + k // 3 - 1
            cell = column * _ROW + int(np.floor(index.places[point, 1] / index.side)) + k % 3 - 1
            cells[k, 0] = np.searchsorted(index.cells, cell)
            cells[k, 1] = np.searchsorted(index.cells, cell + 1)
        for other in index.order[cells[k, 0] : cells[k, 1]]:
            if index.travel[other] > middle + reach:
                break
            if index.travel[other] < middle - reach:
                cells[k, 0] += 1
            else:
                out[count] = other
                count += 1
    return count


@kernel
def _normals(
    index: _Index, origins: FloatArray, reach: float, limits: FloatArray
) -> tuple[FloatArray, BoolArray]:
    count = len(index.places)
    normals = np.zeros((count, 2))
    good = np.zeros(count, np.bool_)
    near = np.empty(count, np.int64)
    cells = np.empty((9, 2), np.int64)
    per_metre = (index.side / reach) ** 2
    for place in range(count):
        i = index.order[place]
        x = index.places[i, 0]
        y = index.places[i, 1]
        n = sx = sy = sxx = syy = sxy = 0.0
        for j in near[: _around(index, place, reach, cells, near)]:
            dx = index.places[j, 0] - x
            dy = index.places[j, 1] - y
            ds = index.travel[j] - index.travel[i]
            if dx * dx + dy * dy + per_metre * ds * ds <= index.side**2:
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


@compiled
def _band(gap: float, borders: FloatArray) -> int:
    """Index of the band that contains a distance driven; the last band has no upper limit."""
    band = 0
    while band < len(borders) - 2 and gap >= borders[band + 1]:
        band += 1
    return band


@kernel
def _nearest(index: _Index, cloud: PointCloud, borders: FloatArray, limits: FloatArray) -> IntArray:
    """The nearest point (p, bands) that each point is linked to in each band; -1 for none."""
    bands = len(borders) - 1
    reach = borders[bands]
    per_metre = (index.side / reach) ** 2
    found = np.full((len(cloud.places), bands), -1)
    near = np.empty(len(cloud.places), np.int64)
    cells = np.empty((9, 2), np.int64)
    nearest = np.empty(bands)
    for place in range(len(cloud.places)):
        i = index.order[place]
        around = near[: _around(index, place, reach, cells, near)]
        if not cloud.good[i]:
            continue
        nearest[:] = index.side**2
        for j in around:
            gap = abs(cloud.travel[j] - cloud.travel[i])
            if not cloud.good[j] or gap < borders[0] or cloud.key[j] == cloud.key[i]:
                continue
            dx = cloud.places[i, 0] - cloud.places[j, 0]
            dy = cloud.places[i, 1] - cloud.places[j, 1]
            square = dx * dx + dy * dy + per_metre * gap * gap
            band = _band(gap, borders)
            if square >= nearest[band]:
                continue
            nx = cloud.normals[j, 0]
            ny = cloud.normals[j, 1]
            cosine = cloud.normals[i, 0] * nx + cloud.normals[i, 1] * ny
            if cosine > limits[0] and abs(dx * nx + dy * ny) < limits[1]:
                found[i, band] = j
                nearest[band] = square
    return found
