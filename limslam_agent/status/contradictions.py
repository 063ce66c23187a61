"""Comparison of the readings of one step with the map, without ground truth.

A beam contradicts the map in two cases. It should end at a wall, and its reading is much longer. Or it ends where the
map is known to be free. In a correct map nearly no beam does so.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec

# A beam should end at a wall if it meets the wall at least so far (m) inside the wall's ends, and if the cosine of its
# angle to the wall's normal is at least so large.
INSET, LEAST_COSINE = 0.10, 0.35
# A beam has passed through a wall if its reading exceeds the expected range by more than this number of standard
# deviations plus a length, m.
SIGMAS, _SLACK = 3.0, 0.10
# A beam has ended in free space if all cells around its end, up to the second number of cells to each side, have at
# least the first value, and no wall of the map is near its end. A wall is near if its distance is less than SIGMAS
# standard deviations of a range plus _SLACK. Walls are corrected when a loop is closed, and the grid is not.
FREE, FREE_CELLS = 4, 2
_NEVER = 1 << 15  # no cell has this value


def log_likelihood_ratio(contradicting: int, count: int, share: float, other: float) -> float:
    """Logarithm of the likelihood ratio of two explanations of ``contradicting`` ones among ``count`` comparisons.

    By the explanations, these shares of all comparisons contradict the map.
    """
    fitting = count - contradicting
    return contradicting * math.log(share / other) + fitting * math.log((1.0 - share) / (1.0 - other))


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
    walls
        Number of that wall (m, n_beams). It means nothing if the range is infinite.
    """

    ranges: FloatArray
    stds: FloatArray
    walls: IntArray


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
    sensor: RangeSensor,
) -> ExpectedRanges:
    """The range that the walls of a map predict for each beam.

    Parameters
    ----------
    poses, covariance
        Estimated poses (m, 3), m and rad, and the covariance of each of them (3, 3).
    segments
        Walls (k, 4), m.
    sensor
        How ranges are measured.
    """
    from limslam_agent.kernels.crossings import WALL_COLUMNS, predict_ranges

    shape = len(poses), len(robot.beams)
    walls, ranges, stds = np.empty((len(segments), WALL_COLUMNS)), np.empty(shape), np.empty(shape)
    first = np.empty(shape, dtype=np.int64)
    predict_ranges(
        poses, covariance, segments, robot.beam_table, sensor.numbers, INSET, LEAST_COSINE, walls, ranges, stds, first
    )
    return ExpectedRanges(ranges, stds, first)


def compare(
    robot: RobotSpec,
    pose: FloatArray,
    ranges: FloatArray,
    measured: BoolArray,
    known: KnownMap,
    predicted: FloatArray,
    stds: FloatArray,
    sensor: RangeSensor,
    *,
    free_space_counts: bool = True,
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
    sensor
        How ranges are measured.
    free_space_counts
        Whether a reading that ends in free space contradicts the map.
    """
    from limslam_agent.kernels.crossings import compare_readings

    grid, found = known.grid, np.empty((5, len(ranges)), dtype=bool)
    # One kind of array, or the kernel would be compiled for each kind.
    compare_readings(
        pose, ranges, measured, predicted, stds, robot.beam_table, sensor.numbers, SIGMAS, _SLACK,
        known.segments, np.array(grid.values), grid.low, float(grid.cell), FREE_CELLS,
        FREE if free_space_counts else _NEVER, found,
    )  # fmt: skip
    return Comparison(*found)


def compared(
    robot: RobotSpec,
    sight: Sight,
    usable: BoolArray,
    known: KnownMap,
    covariance: FloatArray,
    sensor: RangeSensor,
    *,
    free_space_counts: bool,
) -> tuple[Comparison, ExpectedRanges]:
    """The readings of one step that count (n_beams,) beside a map, and the ranges that the map predicts for it."""
    expected = expected_ranges(robot, sight.pose[None], covariance, known.segments, sensor)
    outcome = compare(
        robot, sight.pose, sight.ranges, usable, known, expected.ranges[0], expected.stds[0], sensor,
        free_space_counts=free_space_counts,
    )  # fmt: skip
    return outcome, expected
