"""A hall in which no two places look alike, drives in it, and the map of a drive."""

from itertools import pairwise

import numpy as np
from support.drives import ranges_at

from limslam_agent.config.presets import GridConfig
from limslam_agent.grid.occupancy import drawn_grid
from limslam_agent.places.localisation import KnownPlaces
from limslam_agent.record import Scan
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env import RobotSpec
from limslam_env.geometry import se2

ROBOT = RobotSpec()
STD = 0.01
SENSOR = RangeSensor(STD)
# An L-shaped hall with a niche and a pillar: no two places look alike.
HALL = np.array(
    [
        [0, 0, 6, 0],
        [6, 0, 6, 2.4],
        [6, 2.4, 2.6, 2.4],
        [2.6, 2.4, 2.6, 5],
        [2.6, 5, 0, 5],
        [0, 5, 0, 3.4],
        [0, 3.4, 0.7, 3.4],
        [0.7, 3.4, 0.7, 2.6],
        [0.7, 2.6, 0, 2.6],
        [0, 2.6, 0, 0],
        [4.2, 0.9, 4.8, 0.9],
        [4.8, 0.9, 4.8, 1.4],
        [4.8, 1.4, 4.2, 1.4],
        [4.2, 1.4, 4.2, 0.9],
    ],
    dtype=float,
)
SQUARE = np.array([[0, 0, 3, 0], [3, 0, 3, 3], [3, 3, 0, 3], [0, 3, 0, 0]], dtype=float)
WAY = [[1.0, 0.7], [5.4, 0.6], [5.4, 1.8], [3.4, 1.8], [1.5, 1.6], [1.7, 4.2], [1.0, 1.0]]
PART = [[1.6, 0.9], [1.6, 1.8], [1.6, 3.6]]


def poses_along(corners, spacing=0.03):
    """Poses (n, 3) along straight lines between corners (k, 2)."""
    rows = []
    for start, end in pairwise(corners):
        way = np.subtract(end, start)
        shares = np.arange(0.0, 1.0, spacing / np.hypot(*way))
        rows += [[*(start + share * way), np.arctan2(*way[::-1])] for share in shares]
    return np.array(rows)


def readings(poses, segments, sensor=SENSOR):
    """What a robot reads (n, n_beams), m: a wide beam reads the nearest point of a wall inside of
    it.
    """
    fans = np.linspace(-sensor.cone, sensor.cone, 41) if sensor.cone else [0.0]
    robots = [
        SENSOR._replace(turns=(float(fan),) * len(ROBOT.beams)).mounted(ROBOT) for fan in fans
    ]
    found = [[ranges_at(pose, segments, robot) for pose in poses] for robot in robots]
    return np.minimum(np.min(found, axis=0) + sensor.bias, ROBOT.max_ranges)


def drive(corners, segments, frame=(0.0, 0.0, 0.0), sensor=SENSOR):
    """The steps of a drive, in the frame of a pose (3,)."""
    poses = poses_along(corners)
    local = se2.compose(se2.inverse(np.array(frame)), poses)
    return [Scan(*each) for each in zip(local, readings(poses, segments, sensor), strict=True)]


def known(corners, segments):
    """The map of a drive."""
    poses = poses_along(corners)
    ranges = readings(poses, segments)[:, None]
    grid = drawn_grid(
        GridConfig(), ROBOT, poses[:, None], ranges, np.ones(ranges.shape, dtype=bool)
    )
    return KnownPlaces(segments, grid, SENSOR)
