"""The filter of poses, lines and clones in arrays with room, and what the decisions of a step ask
of it.

:mod:`~limslam_agent.slam.consistent.clone_ekf` explains the state. The functions are plain: the
estimator of one team calls them as they are, and the batch compiles them
(``slam.batch.compiled_steps``). What takes long is a kernel.
"""

import math
from typing import Any

import numpy as np

from limslam_agent.kernels.beams import ends_of_beams
from limslam_agent.kernels.covariance import (
    copy_pose,
    correct_state,
    dense_block,
    error_transport,
    keep_states,
    move_pose,
)
from limslam_agent.kernels.tables import (
    CLONES,
    LINES,
    NEXT_CLONE,
    POSE,
    Filter,
    Readings,
    Update,
    clones_from,
    line_at,
    size_of,
)
from limslam_agent.kernels.updates import linear_update, update_by_readings
from limslam_agent.slam.consistent.limits import (
    EQUALITY_NOISE,
    HUBER,
    ITERATIONS,
    KNOWN_PLACE,
    LINE_PRIOR,
    MAX_ANGLE,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray


def num_lines(ekf: Filter) -> int:
    """How many lines the filter holds."""
    return int(ekf.counts[LINES])


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


def end_points(ekf: Filter, readings: Readings, theta: float) -> FloatArray:
    """End points (n, 2), m, of readings on a wall with its normal at ``theta``, rad; on the middle
    of beams if NaN.
    """
    return ends_of_beams(ekf.x, clones_from(ekf.counts), readings.places, readings.rows, theta)


def clone(ekf: Filter, robot: int, jitter: FloatArray) -> int:
    """Add a copy of a robot's pose to the state, which must have room for it, and return the copy's
    number.

    The copy is where the robot is, and the pose is the sum of what its encoders have reported:
    ``jitter`` (3, 3) is the covariance of their difference, in the robot's frame.
    """
    number = ekf.counts[NEXT_CLONE]
    at = size_of(ekf.counts)
    copy_pose(ekf, POSE * robot)
    ekf.clones[ekf.counts[CLONES]] = number
    ekf.counts[CLONES] += 1
    ekf.counts[NEXT_CLONE] += 1
    by_pose = np.zeros((POSE, POSE))
    by_increment = np.zeros((POSE, POSE))
    # A copy: for an array that is read-only, the kernel would be compiled a second time.
    move_pose(ekf, at, np.zeros(POSE), jitter.copy(), by_pose, by_increment)
    return int(number)


def keep(ekf: Filter, is_kept: BoolArray) -> None:
    """Marginalise all of the state (n,) but those to keep. The caller updates the counts."""
    keep_states(ekf, is_kept, np.empty((2, len(is_kept)), dtype=np.int64))


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
    ekf.clones[: len(left)] = left
    ekf.counts[CLONES] = len(left)


def add_line(ekf: Filter, theta: float, x: float, y: float) -> int:
    """Add a line with an uninformative prior, for which there must be room, and return its index.

    It goes through its anchor (x, y), m, with its normal at ``theta``, rad.
    """
    at = clones_from(ekf.counts)
    old = size_of(ekf.counts)
    index = num_lines(ekf)
    after = at + 2
    new = old + 2
    ekf.x[after:new] = ekf.x[at:old].copy()
    ekf.by_errors[after:new] = ekf.by_errors[at:old].copy()
    ekf.P[after:new, :old] = ekf.P[at:old, :old].copy()
    ekf.P[:new, after:new] = ekf.P[:new, at:old].copy()
    ekf.P[at:after, :new] = 0.0
    ekf.P[:new, at:after] = 0.0
    ekf.by_errors[at:after] = 0.0
    ekf.x[at] = 0.0
    ekf.x[at + 1] = theta
    ekf.P[at, at] = LINE_PRIOR[0]
    ekf.P[at + 1, at + 1] = LINE_PRIOR[1]
    ekf.anchors[index, 0] = x
    ekf.anchors[index, 1] = y
    ekf.counts[LINES] += 1
    return index


def observe(
    ekf: Filter,
    readings: Readings,
    index: int,
    listener: Any,
    iterations: int = ITERATIONS,
    huber: float = HUBER,
) -> None:
    """Update by readings of one line: the iterated EKF, linearised anew at each iteration.

    Residuals of more than ``huber`` standard deviations are down-weighted (P. Huber, "Robust
    estimation of a location parameter", 1964); 0 for no weights. The listener, unless it is None,
    is told how the state is corrected.
    """
    update, used, expected = update_by_readings(ekf, readings, index, iterations, huber)
    if len(used.places):
        after = correct_state(ekf, update)
        if listener is not None:
            listener.corrected(update, after, index, used, expected)


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
    d, theta = line_of(ekf, older)
    other_d, other = line_of(ekf, younger)
    from_x, from_y = anchor_of(ekf, older)
    x, y = anchor_of(ekf, younger)
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
        columns[POSE + k] = line_at(ekf.counts, older) + k
        columns[POSE + 2 + k] = line_at(ekf.counts, younger) + k
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


def equalising(
    ekf: Filter, older: int, younger: int, start: FloatArray, at_first: FloatArray
) -> Update:
    """The update by the constraint that two lines are equal, linearised where the state is now.

    The filter's state was ``start`` (s,), where :func:`error_transport` was ``at_first`` (s, 3).
    """
    off, H, columns = equality(ekf, older, younger)
    so_far = ekf.x[: len(start)] - start
    moved = error_transport(ekf) - at_first
    noise = np.diag(np.array(EQUALITY_NOISE))
    update = linear_update(ekf, columns, H, H @ so_far[columns] - off, noise, moved)
    update.change[:] -= so_far
    return update


def merge(
    ekf: Filter, older: int, younger: int, listener: Any, iterations: int = ITERATIONS
) -> None:
    """Merge two lines: update by the constraint that they are equal, and marginalise the younger
    one.

    With more than one iteration, the constraint is linearised where the lines are equal. A common
    rotation of all lines and poses then changes nothing in it, so that many merges say nothing
    about the global heading.
    """
    size = size_of(ekf.counts)
    count = num_lines(ekf)
    start = ekf.x[:size].copy()
    at_first = error_transport(ekf)
    update = equalising(ekf, older, younger, start, at_first)
    for _ in range(iterations - 1):
        ekf.x[:size] += update.change
        update = equalising(ekf, older, younger, start, at_first)
    after = correct_state(ekf, update)
    if listener is not None:
        listener.corrected(update, after, older)
    is_kept = np.ones(size, dtype=np.bool_)
    is_kept[line_at(ekf.counts, younger) : line_at(ekf.counts, younger) + 2] = False
    keep(ekf, is_kept)
    ekf.anchors[younger : count - 1] = ekf.anchors[younger + 1 : count].copy()
    ekf.counts[LINES] -= 1
