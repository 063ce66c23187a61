"""Comparison of the readings of one step with the map, without ground truth.

A beam contradicts the map in two cases. It should end at a wall, and its reading is much longer. Or it ends where the
map is known to be free. In a correct map nearly no beam does so.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from limslam_agent.config.status import ContradictionConfig
from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.geometry.segment import distances
from limslam_env.interface import RobotSpec


class Sight(NamedTuple):
    """What a robot believed and read in one step. Each step makes one, so it has to be cheap.

    Attributes
    ----------
    pose
        Estimated pose (3,), m and rad.
    ranges, measured
        Readings (n_beams,), m, and a mask of the new readings.
    increment
        The motion (3,) that the odometry reports for this step, in the frame of the robot before it, m and rad.
    """

    pose: FloatArray
    ranges: FloatArray
    measured: BoolArray
    increment: FloatArray


@dataclass(frozen=True, eq=False)
class ExpectedRanges:
    """The ranges that a map predicts for m poses.

    Attributes
    ----------
    ranges
        Distance to the first wall (m, n_beams), m. Infinite if the beam meets no wall or nearly grazes it.
    stds
        Standard deviation of the difference between reading and expected range (m, n_beams), m, with the uncertainty of
        the pose.
    """

    ranges: FloatArray
    stds: FloatArray


@dataclass(frozen=True, eq=False)
class KnownMap:
    """The map with which readings are compared.

    Attributes
    ----------
    segments
        The walls (k, 4), m.
    grid
        The occupancy grid before the readings.
    """

    segments: FloatArray
    grid: GridView

    @property
    def frozen(self) -> "KnownMap":
        """The map as it is now, which later steps do not change. The values of the grid's view change with the grid."""
        return KnownMap(self.segments, replace(self.grid, values=self.grid.values.copy()))


@dataclass(frozen=True, eq=False)
class Comparison:
    """The readings of one step beside the map, each (n_beams,).

    Attributes
    ----------
    expected
        Whether the beam should end at a wall.
    fits
        Whether it ended there.
    through
        Whether it passed through that wall.
    ended
        Whether it ended at anything.
    in_free
        Whether it ended in space that is known to be free.
    """

    expected: BoolArray
    fits: BoolArray
    through: BoolArray
    ended: BoolArray
    in_free: BoolArray

    @property
    def counts(self) -> tuple[int, int, int, int]:
        """Numbers of beams: compared, contradicting the map, expected to end at a wall, and fitting that wall."""
        kinds = (self.expected | self.ended, self.through | self.in_free, self.expected, self.fits)
        compared, contradicting, expected, fitting = (int(np.count_nonzero(kind)) for kind in kinds)
        return compared, contradicting, expected, fitting


def expected_ranges(
    robot: RobotSpec,
    poses: FloatArray,
    covariance: FloatArray,
    segments: FloatArray,
    range_std: float,
    config: ContradictionConfig,
) -> ExpectedRanges:
    """The range that the walls of a map predict for each beam.

    Parameters
    ----------
    poses, covariance
        Estimated poses (m, 3), m and rad, and the covariance of each of them (3, 3).
    segments
        Walls (k, 4), m.
    range_std
        Standard deviation of a range, m.
    """
    from limslam_agent.kernels.crossings import WALL_COLUMNS, predict_ranges

    rules, shape = (float(config.inset), float(config.least_cosine)), (len(poses), len(robot.beams))
    walls, ranges, stds = np.empty((len(segments), WALL_COLUMNS)), np.empty(shape), np.empty(shape)
    predict_ranges(poses, covariance, segments, robot.beam_table, range_std, *rules, walls, ranges, stds)
    return ExpectedRanges(ranges, stds)


def compare(
    robot: RobotSpec,
    pose: FloatArray,
    ranges: FloatArray,
    measured: BoolArray,
    known: KnownMap,
    predicted: FloatArray,
    stds: FloatArray,
    range_std: float,
    config: ContradictionConfig,
) -> Comparison:
    """Compare the readings of one step with a map.

    Parameters
    ----------
    pose
        Estimated pose (3,), m and rad.
    ranges, measured
        Readings (n_beams,), m, and a mask of the new readings.
    known
        The map.
    predicted, stds
        The ranges that the walls of the map predict (n_beams,), m, and their standard deviations: one row of
        :class:`ExpectedRanges`.
    range_std
        Standard deviation of a range, m.
    """
    is_usable = measured & (ranges > robot.too_near)
    expected = is_usable & np.isfinite(predicted)
    excess = np.where(expected, np.minimum(ranges, robot.max_ranges) - np.where(expected, predicted, 0.0), 0.0)
    tolerance = np.where(expected, config.sigmas * stds + config.slack, np.inf)
    ended = is_usable & (ranges < robot.too_far)
    in_free = np.zeros(len(ranges), dtype=bool)
    beams = np.flatnonzero(ended)
    ends = transform_points(pose, robot.beam_origins[beams] + ranges[beams, None] * robot.beam_directions[beams])
    in_free[beams] = _in_free(ends, known, config, config.sigmas * range_std + config.slack)
    return Comparison(
        expected=expected,
        fits=expected & (np.abs(excess) <= tolerance),
        through=expected & (excess > tolerance),
        ended=ended,
        in_free=in_free,
    )


def compared(
    robot: RobotSpec,
    sight: Sight,
    usable: BoolArray,
    known: KnownMap,
    covariance: FloatArray,
    range_std: float,
    config: ContradictionConfig,
) -> tuple[Comparison, ExpectedRanges]:
    """The readings of one step that count (n_beams,) beside a map, and the ranges that the map predicts for it."""
    expected = expected_ranges(robot, sight.pose[None], covariance, known.segments, range_std, config)
    outcome = compare(
        robot, sight.pose, sight.ranges, usable, known, expected.ranges[0], expected.stds[0], range_std, config
    )
    return outcome, expected


def _in_free(points: FloatArray, known: KnownMap, config: ContradictionConfig, near: float) -> BoolArray:
    """Whether each point (n, 2) lies in free cells only, and at no wall within ``near``, m."""
    grid, reach = known.grid, config.free_cells
    cells = grid.cells(points)
    is_free: BoolArray = np.all((cells >= reach) & (cells < np.array(grid.values.shape) - reach), axis=1)
    for number in np.flatnonzero(is_free).tolist():
        row, column = cells[number].tolist()
        around = grid.values[row - reach : row + reach + 1, column - reach : column + reach + 1]
        is_free[number] = around.min() >= config.free
    found = np.flatnonzero(is_free)
    if len(found) and len(known.segments):
        is_free[found] = distances(points[found], known.segments).min(axis=1) > near
    return is_free
