"""The readings of a drive as rays in its own frame: what is compared with a map."""

import math
from collections.abc import Sequence

import numpy as np

from limslam_agent.dropouts import short_series
from limslam_agent.kernels.tables import (
    RAY_BEAM,
    RAY_LENGTH,
    RAY_REACH,
    RAY_TO_X,
    RAY_TO_Y,
    RAY_X,
    RAY_Y,
)
from limslam_agent.record import Scan
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

_APART = 0.10, 0.25
"""Of two rays that end in the same square, the later one is kept: side of the squares for rays that
saw something, and for the others, m. What is seen twice is no news.
"""

_BEAMS = (
    36  # largest number of beams whose readings are used: neighbours of so many see nearly the same
)
STEPS = 1500
"""Largest number of latest steps whose rays are used: the frame of a longer drive is bent."""

_RAYS = 600  # largest number of latest rays

LASTING = 4
"""Number of steps in succession in which a beam has to see nothing, so that it is no dropout of the
sensor.
"""


def rays_of(
    steps: Sequence[Scan], robot: RobotSpec, sensor: RangeSensor | None = None
) -> FloatArray:
    """The latest rays (n, 7) of steps, in the order of time: origin, direction, reading and longest
    reading, m, and number of the beam.
    """
    return numbered_rays_of(steps, robot, sensor)[0]


def numbered_rays_of(
    steps: Sequence[Scan], robot: RobotSpec, sensor: RangeSensor | None = None
) -> tuple[FloatArray, IntArray]:
    """The latest rays (n, 7) of steps, and the number of the step (n,) of each of them.

    A beam that has seen nothing has its longest reading. A reading that says nothing, because it is
    not new, too short, or perhaps missed by the sensor, has no ray. ``robot`` has its beams as
    specified. ``sensor`` is known to turn beams and to have a bias; None if it is as specified.
    """
    first = max(len(steps) - STEPS, 0)
    used = slice(None, None, math.ceil(len(robot.beams) / _BEAMS))
    steps = steps[first:]
    poses = np.array([step.pose for step in steps])
    ranges = np.array([step.ranges for step in steps])
    if sensor is not None:
        ranges = sensor.corrected(ranges, robot)
        robot = sensor.mounted(robot)
    ranges = ranges[:, used]
    seen_nothing = ranges >= robot.too_far[used]
    usable = (ranges > robot.too_near[used]) & ~_missed(seen_nothing, np.isfinite(ranges))
    rows, places = np.nonzero(usable)
    beams = np.arange(len(robot.beams))[used][places]
    cos = np.cos(poses[:, 2])[rows]
    sin = np.sin(poses[:, 2])[rows]
    reaches = robot.max_ranges[beams]
    (from_x, from_y), (to_x, to_y) = robot.beam_origins[beams].T, robot.beam_directions[beams].T
    rays = np.empty((len(rows), 7))
    rays[:, RAY_X] = cos * from_x - sin * from_y + poses[rows, 0]
    rays[:, RAY_Y] = sin * from_x + cos * from_y + poses[rows, 1]
    rays[:, RAY_TO_X] = cos * to_x - sin * to_y
    rays[:, RAY_TO_Y] = sin * to_x + cos * to_y
    rays[:, RAY_LENGTH] = np.where(seen_nothing[usable], reaches, ranges[usable])
    rays[:, RAY_REACH] = reaches
    rays[:, RAY_BEAM] = beams
    kept = _latest(rays)[-_RAYS:]
    return rays[kept], first + rows[kept].astype(np.int64)


def step_rays(ranges: FloatArray, robot: RobotSpec) -> FloatArray:
    """The rays (m, 7) of the corrected readings (n_beams,), m, of one step, in the frame of the
    robot.

    ``robot`` has its beams as they are mounted. Readings that saw nothing count, since no other
    step says whether they are dropouts.
    """
    lengths = np.where(ranges >= robot.too_far, robot.max_ranges, ranges)
    columns = (
        robot.beam_origins,
        robot.beam_directions,
        lengths,
        robot.max_ranges,
        np.arange(len(ranges)),
    )
    return np.ascontiguousarray(np.column_stack(columns)[ranges > robot.too_near])


def _missed(seen_nothing: BoolArray, measured: BoolArray) -> BoolArray:
    """Which readings (m, n_beams) may have seen nothing only because the sensor missed what was
    there.

    A beam that measures in some of the steps only is judged by these.
    """
    found = short_series(seen_nothing, LASTING)
    for beam in np.flatnonzero(~measured.all(axis=0)):
        rows = measured[:, beam]
        found[rows, beam] = short_series(seen_nothing[rows, beam][:, None], LASTING)[:, 0]
    return found


def moved(rays: FloatArray, pose: FloatArray) -> FloatArray:
    """The rays (n, 7) with their frame at a pose (3,)."""
    result = rays.copy()
    result[:, RAY_X:RAY_TO_X] = transform_points(pose, rays[:, RAY_X:RAY_TO_X])
    result[:, RAY_TO_X:RAY_LENGTH] = transform_points(
        np.array([0.0, 0.0, pose[2]]), rays[:, RAY_TO_X:RAY_LENGTH]
    )
    return result


def ends_of(rays: FloatArray) -> FloatArray:
    """Where the rays (n, 7) end (n, 2), m."""
    return rays[:, RAY_X:RAY_TO_X] + rays[:, RAY_LENGTH, None] * rays[:, RAY_TO_X:RAY_LENGTH]


def wall_points(rays: FloatArray) -> FloatArray:
    """Where those of the rays (n, 7) end that have seen something (m, 2), m."""
    return ends_of(rays[have_ended(rays)])


def have_ended(rays: FloatArray) -> BoolArray:
    """Which rays (n,) have seen something."""
    return np.asarray(rays[:, RAY_LENGTH] < rays[:, RAY_REACH])


def _latest(rays: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """The numbers of the latest ray in each square, in the order of time."""
    ended = have_ended(rays)
    squares = np.floor(ends_of(rays) / np.where(ended, *_APART)[:, None]).astype(np.int64)
    columns, rows = (squares - squares.min(axis=0, initial=0)).T
    # One number for each square, since numpy sorts numbers much faster than rows.
    numbers = np.ravel_multi_index(
        (ended, columns, rows), (2, columns.max(initial=0) + 1, rows.max(initial=0) + 1)
    )
    _, first = np.unique(numbers[::-1], return_index=True)
    return np.sort(len(rays) - 1 - first)
