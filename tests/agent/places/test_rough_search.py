"""The rough search of a map adds up what its cells say of the ends and the ways of rays."""

from types import SimpleNamespace

import numpy as np
import pytest
from support.halls import readings

from limslam_agent.grid.occupancy import GridView
from limslam_agent.kernels.rays import scan_poses
from limslam_agent.places.localisation import KnownPlaces
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_agent.status.rays import rays_of
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

ROBOT, SENSOR = RobotSpec(), RangeSensor(0.01)


def floor(width, *heights):
    """A free floor with walls along it at some heights, m."""
    walls = np.array([[0.0, y, width, y] for y in heights])
    shape = int(10 * heights[-1]) + 5, int(10 * width)
    return KnownPlaces(walls, GridView(np.zeros(2), 0.1, np.full(shape, 9, dtype=np.int16)), SENSOR)


def rays_along(place, low, high, y):
    """The rays of a drive from one place to another along the walls."""
    poses = np.array([[x, y, 0.0] for x in np.arange(low, high, 0.03)])
    ranges = readings(poses, place.segments)
    return rays_of([SimpleNamespace(pose=pose, ranges=row) for pose, row in zip(poses, ranges, strict=True)], ROBOT)


SMALL = floor(8.0, 1.0, 4.0)


def test_the_rough_search_adds_up_the_cells_of_ends_and_ways():
    _, fields, tried = SMALL._rough
    cells = fields.transpose(0, 3, 1, 4, 2).reshape(2, 2 * tried.shape[0], 2 * tried.shape[1])
    rays, turns = rays_along(SMALL, 1.0, 4.0, 0.5)[:40], np.array([0.4, -2.0])
    middle, scores = rays[:, :2].mean(axis=0), np.empty((2, *tried.shape), dtype=np.float32)
    scan_poses(turns, rays, middle, fields, 0.05, np.empty(rays.shape, dtype=np.int64), scores)
    ended = rays[:, 4] < rays[:, 5]
    inner = np.where(ended, np.maximum(rays[:, 4] - 0.2, 0.0), rays[:, 4])
    assert 0 < ended.sum() < len(rays)
    for number, turn in enumerate(turns):
        for place in ((30, 20), (4, 51), (45, 70)):
            total = 0.0
            for kind, along in ((0, rays[:, 4]), (1, inner), (1, 0.5 * inner)):
                ends = rays[:, :2] - middle + along[:, None] * rays[:, 2:4]
                points = transform_points(np.array([0.0, 0.0, turn]), ends)
                column, row = (2 * np.array(place)[::-1] + np.floor(points / 0.05 + 0.5)).astype(int).T
                inside = (row >= 0) & (row < cells.shape[1]) & (column >= 0) & (column < cells.shape[2])
                inside &= ended | (kind == 1)
                total += cells[kind, row[inside], column[inside]].sum()
            assert scores[(number, *place)] == pytest.approx(total, abs=1e-3)
