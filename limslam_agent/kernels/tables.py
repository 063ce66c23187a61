"""Constants and arrays that plain and compiled functions share. This module does not load numba."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import FloatArray, IntArray

FROM_X, FROM_Y, TOWARDS_X, TOWARDS_Y, TOO_NEAR, TOO_FAR, ANGLE, FARTHEST = range(8)
"""Columns of ``RobotSpec.beam_table``."""

RAY_X, RAY_Y, RAY_TO_X, RAY_TO_Y, RAY_LENGTH, RAY_REACH, RAY_BEAM = range(7)
"""Columns of a table of rays: origin, m, direction, reading, m, longest reading, m, and number of
the beam. A reading of a beam that saw nothing is its longest one.
"""

PREVIOUS, ROWS, MOVED, BETWEEN, UNUSED = range(5)
"""Columns of a table of what is known of the repeats of each beam (n_beams, 13): the latest
reading, m; the rows in which it stands so far, and how far the robot has moved in them, m; what
came before it, as ``limslam_agent.kernels.repeats`` says; and the rows since a reading was used.
"""

WALL_CHANGES, RESOLUTION, SINGLE, LONG_CHANGES, LONG_ROWS, SHORTEST, AT_SHORTEST, HOLD = range(
    5, 13
)
"""Further columns: how many readings of walls have changed; the smallest change, m, and the number
of changes that are no larger; how many readings stood in several rows, in how many; the least of
these numbers of rows, and how many stood in so few; and for how many rows an equal reading counts
as repeated: 0 for a beam that repeats none so far, and -1 for one that never does.
"""

REPEATS = 13
"""Number of columns of this table."""

READING, TIMES, TURN, TURNED, LEAST_TURNED, MOST_TURNED = range(6)
"""Rows of a table of what each beam (6, n_beams) has read without a change: the reading, m, and how
often it was read; the turn of the robot since it was read last, and all these turns, rad; and the
least and the largest of all turns since the reading changed, rad.
"""

STEADY = 6
"""Number of rows of this table."""

STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2.0**0.5), (1, -1, 2.0**0.5))
"""Steps from a cell to those that come after it: rows, columns, and the length in cells."""

POSE = 3
"""Length of a pose in the filter's state."""

GRAZING = 0.2
"""Least cosine between a beam and a line's normal. A reading at a flatter angle says too little
about the line.
"""

FLATTEST = math.acos(GRAZING)
"""Largest angle between a line's normal and the middle of a beam that does not graze the line,
rad.
"""

LEAST_DIVISOR = 1e-9
"""Least number that is divided by, so that a beam parallel to a line meets it very far away, at a
finite range.
"""

FEWEST_TO_COMPARE = 4
"""Least number of readings that are compared with a line."""

THETA, MIDDLE_X, MIDDLE_Y, EXTENT, ANGLE_STD = range(5)
"""Columns of a segment: the wall's direction, its middle, its length and the direction's standard
deviation.
"""

FEWEST = 6
"""Least number of readings of a wall segment."""

FEWEST_FOR_SHAPE = 10
"""Least number of readings that are tested for a kink or a curve."""

KINKS_AT = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Quantiles of the readings' positions at which a kink is tested for."""

KINK_GATE = 12.0
MIN_KINK = math.radians(8.0)
"""Least gain in chi-square (one degree of freedom) of a model with a kink, and least angle of that
kink, rad.
"""

CURVE_GATE = 14.0
"""Least gain in chi-square (three degrees of freedom) of a smooth curve."""

AROUND_KINK = 0.02
DEEPEST = 4
"""Readings within this distance of a kink, m, are in neither half; a line is cut at most this many
times in a row.
"""

END_ZONE = 0.10
END_GATE = 6.0
"""Points within this distance of an end, m, belong to another wall if chi-square falls by more than
this without them.
"""

NOTHING = 0.45
"""Likelihood that a beam sees nothing at a random place."""

UNRELATED = 0.02
"""Likelihood that a reading has nothing to do with the map of the place where it was taken."""

THROUGH_SIGMAS = 3.0
THROUGH_SLACK = 0.05
"""A beam has passed through a wall if it is longer than the distance to the wall's line by this
many standard deviations and by this length, m.
"""

BIN = 0.05
"""Length of a bin, m."""

LOW, LENGTH, GROUPS, READINGS, NUMBER, CHANGES = range(6)
"""Columns of ``Walls.table``: the first bin, the number of bins, the updates and the readings in
them, a number that identifies the landmark (an older landmark has a smaller number), and how often
the extent has changed.
"""

HITS, MISSES = range(2)
"""Rows of ``Walls.counted``."""

LEAST, MOST = range(2)
"""Rows of ``Walls.reached``, and columns of ``Walls.ends``."""

NEXT_NUMBER, CLOSURES, OVERFLOWS = range(3)
"""Places in ``Walls.tally``: the number of the next landmark, how many pairs were merged, and how
often there was no room in the arrays.
"""


class Walls(NamedTuple):
    """The landmarks of one map, in the order in which the filter holds their lines, with room for
    further ones.

    For the n maps of a batch, each array has one more axis in front.

    Attributes
    ----------
    table
        (landmarks, 6), whose columns are named above.
    counted, reached
        (landmarks, 2, bins): beams that ended and that passed; least and largest position of a hit,
        m along the line.
    ends
        Positions of the outermost hits (landmarks, 2), m along the line.
    tally
        (3,), whose places are named above.
    """

    table: IntArray
    counted: NDArray[np.int32]
    reached: FloatArray
    ends: FloatArray
    tally: IntArray


def empty_walls(landmarks: int, bins: int, *maps: int) -> Walls:
    """Room for so many landmarks and bins, in one map or in an array of maps."""
    return Walls(
        table=np.zeros((*maps, landmarks, 6), dtype=np.int64),
        counted=np.zeros((*maps, landmarks, 2, bins), dtype=np.int32),
        reached=np.zeros((*maps, landmarks, 2, bins)),
        ends=np.zeros((*maps, landmarks, 2)),
        tally=np.zeros((*maps, 3), dtype=np.int64),
    )


POSES_END, LINES_FROM, LINES, CLONES, NEXT_CLONE = range(5)
"""Places in ``Filter.counts``: where the poses end in the state and where the lines begin, how many
lines and clones it holds, and the number of the next clone. Clones are numbered in the order in
which they are made.
"""


class Cells(NamedTuple):
    """The cells of a grid, counted from the world's origin.

    Attributes
    ----------
    values, stamps
        Values (rows, columns), and the number of the update that has changed each of them last.
    corner
        Column and row (2,) of the first cell.
    size
        Side of a cell, m.
    rules
        What is added where a beam crosses, what is subtracted where one ends, and the largest
        absolute value (3,).
    """

    values: NDArray[np.int16]
    stamps: NDArray[np.int32]
    corner: IntArray
    size: float
    rules: IntArray


class Filter(NamedTuple):
    """A state of poses, lines and clones, in this order, in arrays that have room.

    Between the poses and the lines stand the constant errors of the odometry, once they are
    estimated. For the n filters of a batch, each array has one more axis.

    Attributes
    ----------
    x, P
        State (s,) and covariance (s, s), of which ``kernels.covariance`` says what is kept.
    by_errors
        Derivative (s, k) of the state by the constant errors that it takes to be zero; k is 0 in a
        batch.
    anchors, clones
        Of the lines (l, 2), m, and the numbers of the clones (c,), in order.
    counts
        (5 or more,), whose places are named above.
    bend
        Standard deviation of the curvature of walls, 1/m; 0 where they are straight.
    """

    x: FloatArray
    P: FloatArray
    by_errors: FloatArray
    anchors: FloatArray
    clones: IntArray
    counts: IntArray
    bend: float = 0.0


# These functions take the counts only: compiled code counts references to each array that it hands
# on.


def line_at(counts: IntArray, index: int) -> int:
    """Index in the state at which a line begins."""
    return int(counts[LINES_FROM] + 2 * index)


def clones_from(counts: IntArray) -> int:
    """Index in the state at which the clones begin."""
    return int(counts[LINES_FROM] + 2 * counts[LINES])


def size_of(counts: IntArray) -> int:
    """Length of the state."""
    return int(counts[LINES_FROM] + 2 * counts[LINES] + POSE * counts[CLONES])


class Readings(NamedTuple):
    """Ranges, each of which was read from the pose of a clone.

    Attributes
    ----------
    places
        Places (n,) of the clones in the state.
    rows
        (n, 6): origin x, y of the beam in the robot's frame, m, its direction, rad, its range, m,
        half its opening angle, rad, and the number of the beam.
    variances
        Of the ranges (n,), m^2.
    """

    places: IntArray
    rows: FloatArray
    variances: FloatArray


def select(readings: Readings, chosen: IntArray) -> Readings:
    """Some of the readings."""
    return Readings(readings.places[chosen], readings.rows[chosen], readings.variances[chosen])


class Update(NamedTuple):
    """An update of a filter of s states by m measurements, which depend on k of these states.

    Attributes
    ----------
    columns, H
        These states (k,), and the derivative (m, k) of the measurements by them.
    innovation, factor, W
        The innovation (m,), the Cholesky factor L (m, m) of its covariance S, and L^-1 H P (m, s).
    moved
        By what the transport of the error to the state at which H was found exceeds that to the
        filter's state (s, 3).
    change
        What is still to be added to the state (s,).
    """

    columns: IntArray
    H: FloatArray
    innovation: FloatArray
    factor: FloatArray
    W: FloatArray
    moved: FloatArray
    change: FloatArray


class LineRules(NamedTuple):
    """Which lines the Hough transform finds in points.

    Attributes
    ----------
    max_gap, near_line, least
        Longest gap in a line, largest distance of a point from its line, and least length of a
        line, m.
    min_votes, r_step, theta_step
        Threshold, and sizes of the bins, m and rad.
    only_best
        Whether to stop after the first candidate that has lines.
    """

    max_gap: float
    near_line: float
    least: float
    min_votes: int
    r_step: float
    theta_step: float
    only_best: bool
