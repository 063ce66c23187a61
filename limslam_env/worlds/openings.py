"""Where the outline of a building is open, so that a robot could leave."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from limslam_env.geometry import BoolArray, FloatArray, IntArray, no_rows
from limslam_env.geometry.segment import lengths, sample
from limslam_env.worlds.free_space import clear, connected

MOST = 5
"""Most openings that are searched for."""

_MAX_CELLS = 1_000_000
_WIDEST = 1.25  # m, half the widest opening that is searched for at first
_LARGEST = 5.0  # m, the same at last
_STEPS = 20  # of the half width, from the widest opening down to the robot
_FINE = 0.02  # cells, of the half width at the narrowest place
_SMALLEST_ROOM = 0.5  # m^2, of the places where the middle of a disc may be
_INSIDE_SHARE = 0.25  # of the rectangle around a building that is inside
_ALONG = 0.5  # cells, between points along a wall


@dataclass(frozen=True)
class Opening:
    """A place where a wall is missing: its middle x, y and its width, m."""

    x: float
    y: float
    width: float

    def __str__(self) -> str:
        return f"({self.x:.2f}, {self.y:.2f}), {self.width:.2f} m wide"


def openings(edges: FloatArray, obstacles: Sequence[FloatArray], radius: float) -> list[Opening]:
    """The openings of an outline, at most MOST, through which a disc of ``radius`` (m) gets out.

    ``edges`` (k, 4), m, are all that the disc must not touch, those of the ``obstacles``, each
    (k, 2), among them. Discs come from outside, the largest ones first. Where a smaller disc gets
    into a room at last, an opening is found at the narrowest place of its way, and is closed for
    the next ones. Openings that do not lead into the largest part of the building are left out.
    """
    ground = _Ground.around(edges, obstacles, radius)
    found = list[FloatArray]()
    for widest in _widest_openings(ground, radius):
        steps = np.linspace(widest, radius, _STEPS)
        found = _closing(ground, steps)
        closed = ground.with_walls(np.vstack((no_rows(4), *found)))
        inside = closed.clearance >= radius
        labels = connected(inside)
        sizes = np.bincount(labels[inside & ~closed.outside(radius)], minlength=1)
        if sizes.sum() * ground.cell**2 < _INSIDE_SHARE * ground.area:
            continue
        row, column = np.argwhere(labels == int(np.argmax(sizes)))[0]
        others = [found[:number] + found[number + 1 :] for number in range(len(found))]
        return [
            _opening(gap)
            for gap, rest in zip(found, others, strict=True)
            if ground.with_walls(np.vstack((no_rows(4), *rest))).outside(radius)[row, column]
        ]
    return [_opening(gap) for gap in found]


def _opening(gap: FloatArray) -> Opening:
    x, y = (gap[:2] + gap[2:]) / 2.0
    return Opening(float(x), float(y), float(lengths(gap[None])[0]))


def _widest_openings(ground: "_Ground", radius: float) -> list[float]:
    largest = min(_LARGEST, 0.5 * math.sqrt(ground.area))
    found = [min(_WIDEST, largest)]
    while found[-1] < largest:
        found.append(min(2.0 * found[-1], largest))
    return [widest for widest in found if widest > radius]


@dataclass(frozen=True, eq=False)
class _Ground:
    """A grid of cells with sides of ``cell``, m, over a building and around it.

    ``is_wall`` is (rows, columns), row 0 at the bottom, and ``origin`` its lower left corner, m.
    ``points`` (n, 2), m, are on the walls. ``area`` is that of the rectangle around the building.
    """

    origin: FloatArray
    cell: float
    is_wall: BoolArray
    points: FloatArray
    area: float

    @classmethod
    def around(cls, edges: FloatArray, obstacles: Sequence[FloatArray], radius: float) -> "_Ground":
        corners = edges.reshape(-1, 2)
        extent = np.ptp(corners, axis=0)
        margin = min(_LARGEST, 0.5 * float(extent.max())) + 2.0 * radius
        cell = max(radius / 4.0, math.sqrt(float(np.prod(extent + 2.0 * margin)) / _MAX_CELLS))
        origin = corners.min(axis=0) - margin
        columns, rows = np.ceil((extent + 2.0 * margin) / cell).astype(int)
        is_free = np.ones((int(rows), int(columns)), dtype=bool)
        clear(is_free, no_rows(4), obstacles, 0.0, origin, cell)
        empty = cls(origin, cell, ~is_free, no_rows(2), float(np.prod(extent)))
        return empty.with_walls(edges)

    def with_walls(self, walls: FloatArray) -> "_Ground":
        """The same ground with more walls (n, 4)."""
        points, _ = sample(walls, _ALONG * self.cell)
        columns, rows = np.floor((points - self.origin) / self.cell).astype(int).T
        is_wall = self.is_wall.copy()
        is_wall[rows, columns] = True
        return replace(self, is_wall=is_wall, points=np.vstack((self.points, points)))

    @functools.cached_property
    def clearance(self) -> FloatArray:
        """Distance of each cell from the nearest wall, m."""
        free = (~self.is_wall).astype(np.uint8)
        distance = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        return np.asarray(distance * self.cell)

    def labels(self, radius: float) -> IntArray:
        """The number of each cell's region for the middle of a disc; 1 for all outside."""
        labels = connected(self.clearance >= radius)
        is_outside = np.isin(labels, _border(labels)) & (labels > 0)
        return np.where(is_outside, 1, np.where(labels > 0, labels + 1, 0))

    def outside(self, radius: float) -> BoolArray:
        """Where the middle of a disc can be that comes from outside."""
        return np.asarray(self.labels(radius) == 1)

    def gap_at(self, row: int, column: int) -> FloatArray:
        """The narrowest place (4,) near a cell: the points on two walls that are on its sides."""
        middle = self.origin + (np.array([column, row]) + 0.5) * self.cell
        gap = np.array([*middle, *middle])
        for _ in range(4):
            offsets = self.points - middle
            first = offsets[np.argmin((offsets**2).sum(axis=1))]
            beyond = offsets[offsets @ first < -0.5 * np.hypot(*first) * np.hypot(*offsets.T)]
            if not len(beyond):
                break
            second = beyond[np.argmin((beyond**2).sum(axis=1))]
            gap = np.concatenate((middle + first, middle + second))
            middle = (gap[:2] + gap[2:]) / 2.0
        return gap


def _border(labels: IntArray) -> IntArray:
    return np.unique(np.concatenate((labels[0], labels[-1], labels[:, 0], labels[:, -1])))


def _closing(ground: _Ground, radii: FloatArray) -> list[FloatArray]:
    """The gaps, each (4,), that discs of decreasing radii get in by, in order."""
    found = list[FloatArray]()
    least = _SMALLEST_ROOM / ground.cell**2
    number = 1
    closed = ground
    while number < len(radii) and len(found) < MOST:
        before = closed.labels(float(radii[number - 1]))
        outside = closed.outside(float(radii[number]))
        sizes = np.bincount(before[outside & (before > 1)], minlength=2)
        rooms = np.flatnonzero(sizes >= least)
        if not rooms.size:
            number += 1
            continue
        gap = _first_gap(closed, before, rooms, float(radii[number]), float(radii[number - 1]))
        found.append(gap)
        closed = closed.with_walls(gap[None])
    return found


def _first_gap(
    ground: _Ground, before: IntArray, rooms: IntArray, low: float, high: float
) -> FloatArray:
    """The gap (4,) by which a disc from outside first gets into one of the rooms, numbers in
    ``before``, as its radius falls from ``high`` to ``low``, m.
    """
    is_room = np.isin(before, rooms)
    while high - low > _FINE * ground.cell:
        middle = 0.5 * (low + high)
        if (ground.outside(middle) & is_room).any():
            low = middle
        else:
            high = middle
    outside = ground.outside(high)
    inside = (ground.clearance >= high) & ~outside
    reached = ground.outside(low)
    between = connected(reached & ~outside & ~inside)
    beside_outside = np.unique(between[_dilated(outside)])
    beside_inside = np.unique(between[_dilated(inside & reached)])
    links = np.intersect1d(beside_outside, beside_inside)
    links = links[links > 0]
    rows, columns = np.nonzero(np.isin(between, links[:1]) if links.size else reached & ~outside)
    nearest = np.argmin(ground.clearance[rows, columns])
    return ground.gap_at(int(rows[nearest]), int(columns[nearest]))


def _dilated(mask: BoolArray) -> BoolArray:
    return np.asarray(cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)), dtype=bool)
