"""The filter of poses, lines and clones in arrays with room, and what the decisions of a step ask
of it.

:mod:`~limslam_agent.slam.consistent.clone_ekf` explains the state. The functions are plain: the
estimator of one team calls them as they are, and the batch compiles them
(``slam.batch.compiled_steps``). What takes long is a kernel.
"""

import math

import numpy as np

from limslam_agent.kernels.beams import ends_of_beams
from limslam_agent.kernels.covariance import (
    copy_pose,
    correct_state,
    dense_block,
    dense_rows,
    error_transport,
    keep_states,
    move_pose,
)
from limslam_agent.kernels.segments import cut_at_bends
from limslam_agent.kernels.tables import (
    CLONES,
    LINES,
    LINES_FROM,
    NEXT_CLONE,
    POSE,
    POSES_END,
    Filter,
)
from limslam_agent.kernels.updates import compare_readings, update_by_readings
from limslam_agent.slam.consistent.limits import EQUALITY_NOISE, KNOWN_PLACE, LINE_PRIOR, MAX_ANGLE
from limslam_agent.slam.consistent.separate_bias import note_readings, note_update
from limslam_env.geometry import BoolArray, FloatArray, IntArray


def num_lines(ekf: Filter) -> int:
    """How many lines the filter holds."""
    return int(ekf.counts[LINES])


# What is called all the time takes the counts only: compiled code counts references to each array
# that it hands on.


def line_at(counts: IntArray, index: int) -> int:
    """Index in the state at which a line begins."""
    return int(counts[LINES_FROM] + 2 * index)


def clones_from(counts: IntArray) -> int:
    """Index in the state at which the clones begin."""
    return int(counts[LINES_FROM] + 2 * counts[LINES])


def size_of(counts: IntArray) -> int:
    """Length of the state."""
    return int(counts[LINES_FROM] + 2 * counts[LINES] + POSE * counts[CLONES])


def begins_of(counts: IntArray) -> tuple[int, int, int]:
    """Where the poses end in the state, and where lines and clones begin."""
    return int(counts[POSES_END]), int(counts[LINES_FROM]), clones_from(counts)


def line_of(ekf: Filter, index: int) -> tuple[float, float]:
    """A line as (d, theta) about its anchor, m and rad."""
    at = line_at(ekf.counts, index)
    return float(ekf.x[at]), float(ekf.x[at + 1])


def anchor_of(ekf: Filter, index: int) -> tuple[float, float]:
    """The anchor of a line, m."""
    return float(ekf.anchors[index, 0]), float(ekf.anchors[index, 1])


def lines_near(ekf: Filter, theta: float, x: float, y: float, offset: float) -> IntArray:
    """Lines (k,) with about this direction, rad, that pass a point, m, at less than ``offset``,
    m.
    """
    first = line_at(ekf.counts, 0)
    end = clones_from(ekf.counts)
    anchors = ekf.anchors[: ekf.counts[LINES]]
    d = ekf.x[first:end:2]
    own = ekf.x[first + 1 : end : 2]
    turn = np.abs((own - theta + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
    off = np.abs((x - anchors[:, 0]) * np.cos(own) + (y - anchors[:, 1]) * np.sin(own) - d)
    return np.flatnonzero((turn < MAX_ANGLE) & (off < offset))


def end_points(ekf: Filter, places: IntArray, readings: FloatArray, theta: float) -> FloatArray:
    """End points (n, 2), m, of readings on a wall with its normal at ``theta``, rad; on the middle
    of beams if NaN.
    """
    return ends_of_beams(ekf.x, clones_from(ekf.counts), places, readings, theta)


def straight_segments(
    ekf: Filter,
    places: IntArray,
    readings: FloatArray,
    points: FloatArray,
    members: IntArray,
    line: FloatArray,
    std: float,
    variances: FloatArray,
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Cut readings near one line into straight segments: ``kernels.segments.cut_at_bends``."""
    start = clones_from(ekf.counts)
    return cut_at_bends(
        ekf.x, ekf.P, start, places, readings, points, members, line, std, variances
    )


def compare(
    ekf: Filter, places: IntArray, readings: FloatArray, index: int, variances: FloatArray
) -> float:
    """How badly readings fit a line: ``kernels.updates.compare_readings``."""
    line = line_at(ekf.counts, index)
    anchor = anchor_of(ekf, index)
    return compare_readings(
        ekf.x, ekf.P, clones_from(ekf.counts), places, readings, line, anchor, variances
    )


def clone(ekf: Filter, robot: int, jitter: FloatArray) -> int:
    """Add a copy of a robot's pose to the state, which must have room for it, and return the copy's
    number.

    The copy is where the robot is, and the pose is the sum of what its encoders have reported:
    ``jitter`` (3, 3) is the covariance of their difference, in the robot's frame.
    """
    number = ekf.counts[NEXT_CLONE]
    size = size_of(ekf.counts)
    whole = ekf.counts[POSES_END]
    copy_pose(ekf.x, ekf.P, ekf.by_errors, size, whole, POSE * robot)
    by_pose = np.zeros((POSE, POSE))
    by_increment = np.zeros((POSE, POSE))
    move_pose(ekf.x, ekf.P, size + POSE, size, np.zeros(POSE), jitter, by_pose, by_increment, whole)
    ekf.clones[ekf.counts[CLONES]] = number
    ekf.counts[CLONES] += 1
    ekf.counts[NEXT_CLONE] += 1
    return int(number)


def keep(ekf: Filter, is_kept: BoolArray) -> None:
    """Marginalise all of the state (n,) but those to keep. The caller updates the counts."""
    kept = np.empty((2, len(is_kept)), dtype=np.int64)
    keep_states(ekf.x, ekf.P, ekf.by_errors, ekf.counts[POSES_END], is_kept, kept)


def keep_clones(ekf: Filter, wanted: FloatArray) -> None:
    """Marginalise all clones but the wanted ones (n,). What they contributed to other states
    remains.
    """
    clones = ekf.clones[: ekf.counts[CLONES]]
    is_wanted = np.zeros(ekf.counts[CLONES], dtype=np.bool_)
    is_wanted[np.searchsorted(clones, wanted.astype(np.int64))] = True
    if is_wanted.all():
        return
    is_kept = np.ones(size_of(ekf.counts), dtype=np.bool_)
    is_kept[clones_from(ekf.counts) :] = np.repeat(is_wanted, POSE)
    keep(ekf, is_kept)
    left = clones[is_wanted]
    ekf.clones[: len(left)], ekf.counts[CLONES] = left, len(left)


def add_line(ekf: Filter, theta: float, x: float, y: float) -> int:
    """Add a line with an uninformative prior, for which there must be room, and return its index.

    It goes through its anchor (x, y), m, with its normal at ``theta``, rad.
    """
    at = clones_from(ekf.counts)
    old = size_of(ekf.counts)
    index = num_lines(ekf)
    after = at + 2
    new = old + 2
    ekf.x[after:new], ekf.by_errors[after:new] = ekf.x[at:old].copy(), ekf.by_errors[at:old].copy()
    ekf.P[after:new, :old] = ekf.P[at:old, :old].copy()
    ekf.P[:new, after:new] = ekf.P[:new, at:old].copy()
    ekf.P[at:after, :new] = 0.0
    ekf.P[:new, at:after] = 0.0
    ekf.by_errors[at:after] = 0.0
    ekf.x[at] = 0.0
    ekf.x[at + 1] = theta
    ekf.P[at, at], ekf.P[at + 1, at + 1] = LINE_PRIOR
    ekf.anchors[index, 0] = x
    ekf.anchors[index, 1] = y
    ekf.counts[LINES] += 1
    return index


def observe(
    ekf: Filter,
    places: IntArray,
    readings: FloatArray,
    index: int,
    variances: FloatArray,
    iterations: int,
    huber: float,
) -> None:
    """Update by readings of one line: the iterated EKF, linearised anew at each iteration.

    The readings (n, 6) with variances (n,), m^2, were taken from the clones at these places (n,).
    Residuals of more than ``huber`` standard deviations are down-weighted (P. Huber, "Robust
    estimation of a location parameter", 1964); 0 for no weights.
    """
    counts = ekf.counts
    found = update_by_readings(
        ekf.x,
        ekf.P,
        size_of(counts),
        begins_of(counts),
        ekf.anchors,
        counts[LINES],
        index,
        places,
        readings,
        variances,
        iterations,
        huber,
        ekf.bend,
    )
    moved, change, _, _, _, _, W, _, chosen = found
    if not len(chosen):
        return
    again = correct_state(
        ekf.x, ekf.P, len(change), begins_of(counts), ekf.anchors, counts[LINES], moved, W, change
    )
    note_readings(
        ekf, found, again, places, readings, line_of(ekf, index)[1], clones_from(counts), index
    )


def equality(ekf: Filter, older: int, younger: int) -> tuple[FloatArray, FloatArray, IntArray]:
    """Difference (2,) of two lines about the younger's anchor, m and rad, its derivative (2, 7),
    and by which states.

    The offset of two lines that are not exactly parallel depends on where along them it is
    measured. A robot whose place is uncertain by metres does not know where along its walls the
    anchor is. If the anchor were a fixed point, moving the whole world along a wall by some metres
    would explain an offset of some centimetres. So it is carried along with the first robot's pose,
    unless its place is known: then a common motion of robot and world changes nothing in the
    difference (G. Huang, A. Mourikis and S. Roumeliotis, "Observability-based rules for designing
    consistent EKF SLAM estimators", 2010).
    """
    (d, theta), (other_d, other) = line_of(ekf, older), line_of(ekf, younger)
    (from_x, from_y), (x, y) = anchor_of(ekf, older), anchor_of(ekf, younger)
    cos = math.cos(theta)
    sin = math.sin(theta)
    is_turned = math.cos(theta - other) < 0.0
    sign = -1.0 if is_turned else 1.0
    across = sign * (d - (x - from_x) * cos - (y - from_y) * sin) - other_d
    turn = (theta - other + (math.pi if is_turned else 0.0) + math.pi) % (2.0 * math.pi) - math.pi
    H = np.zeros((2, POSE + 4))
    columns = np.empty(POSE + 4, dtype=np.int64)
    H[0, POSE] = sign
    H[0, POSE + 1] = sign * ((x - from_x) * sin - (y - from_y) * cos)
    H[0, POSE + 2] = -1.0
    H[1, POSE + 1] = 1.0
    H[1, POSE + 3] = -1.0
    for k in range(POSE):
        columns[k] = k
    for k in range(2):
        columns[POSE + k], columns[POSE + 2 + k] = (
            line_at(ekf.counts, older) + k,
            line_at(ekf.counts, younger) + k,
        )
    along_x = math.cos(other) - sign * cos
    along_y = math.sin(other) - sign * sin
    variance = 0.0
    by_pose = along_x, along_y, (x - ekf.x[0]) * along_y - (y - ekf.x[1]) * along_x
    for i in range(POSE):
        for j in range(POSE):
            variance += by_pose[i] * ekf.P[i, j] * by_pose[j]
    if variance >= KNOWN_PLACE:
        for k in range(POSE):
            H[0, k] = by_pose[k]
    return np.array([across, turn]), H, columns


def difference(ekf: Filter, older: int, younger: int) -> tuple[FloatArray, FloatArray]:
    """Difference (2,) of two lines about the younger's anchor, m and rad, and its covariance (2,
    2).
    """
    off, H, columns = equality(ekf, older, younger)
    return off, H @ dense_block(ekf.P, columns) @ H.T


def merge(ekf: Filter, older: int, younger: int, iterations: int) -> None:
    """Merge two lines: update by the constraint that they are equal, and marginalise the younger
    one.

    With more than one iteration, the constraint is linearised where the lines are equal. A common
    rotation of all lines and poses then changes nothing in it, so that many merges say nothing
    about the global heading.
    """
    size = size_of(ekf.counts)
    begins = begins_of(ekf.counts)
    count = num_lines(ekf)
    start = ekf.x[:size].copy()
    change = np.zeros(size)
    at_first = error_transport(ekf.x, size, begins, ekf.anchors, count)
    pose = ekf.P[:POSE, :size].copy()
    W = np.zeros((2, size))
    factor = np.zeros((2, 2))
    moved = at_first
    H = factor
    columns = np.arange(0)
    innovation = factor[0]
    for _ in range(iterations):
        ekf.x[:size] += change
        moved = error_transport(ekf.x, size, begins, ekf.anchors, count) - at_first
        off, H, columns = equality(ekf, older, younger)
        # The rows of P as a transport of its error by ``moved`` changes them: see
        # ``correct_state``.
        rows = dense_rows(ekf.P, size, begins[0], columns) + moved[columns] @ pose
        HP = H @ (rows + rows[:, :POSE].copy() @ moved.T.copy())
        so_far = ekf.x[:size] - start
        innovation = H @ so_far[columns] - off
        S = HP[:, columns] @ H.T
        # With S = L L^T and W = L^-1 H P, the correction is W^T L^-1 y.
        factor[0, 0] = math.sqrt(S[0, 0] + EQUALITY_NOISE[0])
        factor[1, 0] = S[1, 0] / factor[0, 0]
        factor[1, 1] = math.sqrt(S[1, 1] + EQUALITY_NOISE[1] - factor[1, 0] ** 2)
        W[0] = HP[0] / factor[0, 0]
        W[1] = (HP[1] - factor[1, 0] * W[0]) / factor[1, 1]
        first = innovation[0] / factor[0, 0]
        change = (
            first * W[0] + (innovation[1] - factor[1, 0] * first) / factor[1, 1] * W[1] - so_far
        )
    again = correct_state(ekf.x, ekf.P, size, begins, ekf.anchors, count, moved, W, change)
    note_update(ekf, H, columns, innovation, factor, W, moved, again, None, np.zeros(2), older)
    is_kept = np.ones(size, dtype=np.bool_)
    is_kept[line_at(ekf.counts, younger) : line_at(ekf.counts, younger) + 2] = False
    keep(ekf, is_kept)
    ekf.anchors[younger : count - 1] = ekf.anchors[younger + 1 : count].copy()
    ekf.counts[LINES] -= 1
