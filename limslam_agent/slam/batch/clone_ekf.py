"""The filter of one robot in fixed arrays: compiled counterpart of ``consistent.clone_ekf``.

The functions that ``consistent.filter_access`` names are those that the decisions of a step call.

Letters x, P, F, Q, H, S, W are those of the literature. :class:`~limslam_agent.slam.batch.state.Filter` says how P is
stored. Functions that inner loops call take arrays instead of the filter, because each array of a tuple that is passed
on costs as much time as a beam.
"""

import math

import numpy as np

from limslam_agent.kernels import updates
from limslam_agent.kernels.algebra import wrapped
from limslam_agent.kernels.measurement import hit_points, towards
from limslam_agent.kernels.segments import cut_at_bends
from limslam_agent.kernels.tables import FEWEST_TO_COMPARE
from limslam_agent.kernels.updates import clear_readings, gathered, involved, iterate, stack_changes
from limslam_agent.slam.batch.algebra import add_products, block_of, gather_rows
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.batch.state import CLONES, LINES, NEXT_CLONE, Filter
from limslam_agent.slam.consistent.clone_ekf import EQUALITY_NOISE, LINE_PRIOR
from limslam_agent.slam.consistent.limits import HUBER
from limslam_agent.slam.core import carried_anchors
from limslam_agent.slam.core.carried_anchors import KNOWN_PLACE
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE
from limslam_env.geometry import FloatArray, IntArray

_by_carried_anchor = algebra(carried_anchors.by_carried_anchor)


@algebra
def clones_from(ekf: Filter) -> int:
    """Index in the state at which the clones begin."""
    return POSE + 2 * ekf.counts[LINES]


@algebra
def size_of(ekf: Filter) -> int:
    """Length of the state."""
    return POSE + 2 * ekf.counts[LINES] + POSE * ekf.counts[CLONES]


@algebra
def predict(ekf: Filter, increment: FloatArray, covariance: FloatArray) -> None:
    """Move the robot by an increment (3,) in its frame, m, m, rad, with its covariance (3, 3)."""
    x, top, size = ekf.x, ekf.top, size_of(ekf)
    cos, sin = math.cos(x[2]), math.sin(x[2])
    by_x, by_y = -sin * increment[0] - cos * increment[1], cos * increment[0] - sin * increment[1]
    x[0] += cos * increment[0] - sin * increment[1]
    x[1] += sin * increment[0] + cos * increment[1]
    x[2] = wrapped(x[2] + increment[2])
    for j in range(size):
        top[0, j] += by_x * top[2, j]
        top[1, j] += by_y * top[2, j]
    turned = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    for i in range(POSE):
        top[i, 0] += by_x * top[i, 2]
        top[i, 1] += by_y * top[i, 2]
    for i in range(POSE):
        for j in range(POSE):
            for k in range(POSE):
                for m in range(POSE):
                    top[i, j] += turned[i, k] * covariance[k, m] * turned[j, m]


@algebra
def clone(ekf: Filter) -> int:
    """Add a copy of the pose to the state, which must have room for it, and return the copy's number."""
    x, top, rest, old = ekf.x, ekf.top, ekf.rest, size_of(ekf)
    for k in range(POSE):
        base = (old + k) * (old + k + 1) // 2
        for j in range(old):
            rest[base + j] = top[k, j]
        for m in range(k + 1):
            rest[base + old + m] = top[k, m]
        x[old + k] = x[k]
    for k in range(POSE):
        for m in range(POSE):
            top[k, old + m] = top[k, m]
    number = ekf.counts[NEXT_CLONE]
    ekf.clones[ekf.counts[CLONES]] = number
    ekf.counts[CLONES] += 1
    ekf.counts[NEXT_CLONE] += 1
    return number


@algebra
def keep(ekf: Filter, kept: IntArray, size: int) -> None:
    """Marginalise all of the state but ``size`` places of it, in order. The caller updates the counts."""
    x, top, rest = ekf.x, ekf.top, ekf.rest
    for new in range(size):
        old = kept[new]
        if old == new:
            continue
        x[new] = x[old]
        for k in range(POSE):
            top[k, new] = top[k, old]
        base, before = new * (new + 1) // 2, old * (old + 1) // 2
        for j in range(POSE, new + 1):
            rest[base + j] = rest[before + kept[j]]


@algebra
def keep_clones(ekf: Filter, wanted: FloatArray) -> None:
    """Marginalise all clones but the wanted ones (n,), in order. What they contributed to other states remains."""
    start, number, size = clones_from(ekf), ekf.counts[CLONES], 0
    kept = np.empty(size_of(ekf), dtype=np.int64)
    for place in range(start):
        kept[place] = place
    for place in range(number):
        if size < len(wanted) and ekf.clones[place] == wanted[size]:
            ekf.clones[size] = ekf.clones[place]
            for k in range(POSE):
                kept[start + POSE * size + k] = start + POSE * place + k
            size += 1
    if size < number:
        keep(ekf, kept, start + POSE * size)
        ekf.counts[CLONES] = size


@algebra
def add_line(ekf: Filter, theta: float, anchor_x: float, anchor_y: float) -> int:
    """Add a line with an uninformative prior, for which there must be room, and return its index.

    It goes through its anchor, m, with its normal at ``theta``, rad.
    """
    x, top, rest, at, old = ekf.x, ekf.top, ekf.rest, clones_from(ekf), size_of(ekf)
    for i in range(old - 1, at - 1, -1):
        x[i + 2] = x[i]
        for k in range(POSE):
            top[k, i + 2] = top[k, i]
        base, before = (i + 2) * (i + 3) // 2, i * (i + 1) // 2
        for j in range(i, at - 1, -1):
            rest[base + j + 2] = rest[before + j]
        rest[base + at], rest[base + at + 1] = 0.0, 0.0
        for j in range(at - 1, POSE - 1, -1):
            rest[base + j] = rest[before + j]
    for i in range(2):
        base = (at + i) * (at + i + 1) // 2
        rest[base : base + at + i] = 0.0
        rest[base + at + i] = LINE_PRIOR[i]
        top[:, at + i] = 0.0
    x[at], x[at + 1] = 0.0, theta
    index = ekf.counts[LINES]
    ekf.anchors[index, 0], ekf.anchors[index, 1] = anchor_x, anchor_y
    ekf.counts[LINES] += 1
    return index


@algebra
def num_lines(ekf: Filter) -> int:
    """How many lines the filter holds."""
    return ekf.counts[LINES]


@algebra
def line_of(ekf: Filter, index: int) -> tuple[float, float]:
    """A line as (d, theta) about its anchor, m and rad."""
    return ekf.x[POSE + 2 * index], ekf.x[POSE + 2 * index + 1]


@algebra
def anchor_of(ekf: Filter, index: int) -> tuple[float, float]:
    """The anchor of a line, m."""
    return ekf.anchors[index, 0], ekf.anchors[index, 1]


@algebra
def lines_near(ekf: Filter, theta: float, x: float, y: float, angle: float, offset: float) -> IntArray:
    """Lines (k,) with a direction within ``angle``, rad, that pass a point, m, at less than ``offset``, m."""
    found, count = np.empty(ekf.counts[LINES], dtype=np.int64), 0
    for index in range(ekf.counts[LINES]):
        d, own = ekf.x[POSE + 2 * index], ekf.x[POSE + 2 * index + 1]
        turn = abs((own - theta + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
        off = (x - ekf.anchors[index, 0]) * math.cos(own) + (y - ekf.anchors[index, 1]) * math.sin(own) - d
        if turn < angle and abs(off) < offset:
            found[count] = index
            count += 1
    return found[:count]


@algebra
def places_of(ekf: Filter, clones: FloatArray) -> IntArray:
    """Places (n,) of clones (n,) in the state."""
    return np.searchsorted(ekf.clones[: ekf.counts[CLONES]], clones.astype(np.int64))


@algebra
def end_points(ekf: Filter, places: IntArray, readings: FloatArray, theta: float) -> FloatArray:
    """End points (n, 2), m, of readings on a wall with its normal at ``theta``, rad; on the middle of beams if NaN."""
    rays = readings if math.isnan(theta) else towards(ekf.x, clones_from(ekf), places, readings, theta)
    return hit_points(ekf.x, clones_from(ekf), places, rays, readings[:, 3])


@algebra
def straight_segments(
    ekf: Filter, places: IntArray, readings: FloatArray, points: FloatArray, members: IntArray, line: FloatArray,
    std: float, variances: FloatArray,
) -> tuple[FloatArray, IntArray, FloatArray]:  # fmt: skip
    """Cut readings near one line into straight segments: ``kernels.segments.cut_at_bends``."""
    start = clones_from(ekf)
    columns, begins = involved(places, members, len(ekf.clones), start, -1)
    block = block_of(ekf.top, ekf.rest, columns)
    return cut_at_bends(ekf.x, start, block, begins, places, readings, points, members, line, std, variances)


@algebra
def compare(
    ekf: Filter, places: IntArray, readings: FloatArray, index: int, variances: FloatArray
) -> tuple[float, float, int, float, float]:
    """How badly readings fit a line: ``kernels.updates.compare``; no reading is used if too few can be compared."""
    start, line, anchor = clones_from(ekf), POSE + 2 * index, (ekf.anchors[index, 0], ekf.anchors[index, 1])
    chosen = clear_readings(ekf.x, start, places, readings, line, anchor)
    if len(chosen) < FEWEST_TO_COMPARE:
        return 0.0, 0.0, 0, 0.0, 0.0
    columns, begins = involved(places, chosen, len(ekf.clones), start, line)
    block = block_of(ekf.top, ekf.rest, columns)
    return updates.compare(ekf.x, start, block, begins, places, readings, chosen, line, anchor, variances)


@algebra
def side_of(ekf: Filter, places: IntArray, readings: FloatArray, index: int) -> int:
    """From which side readings hit a line: ``POSITIVE`` or ``NEGATIVE``."""
    total, start, theta = 0.0, clones_from(ekf), ekf.x[POSE + 2 * index + 1]
    for i in range(len(places)):
        total += math.cos(ekf.x[start + POSE * places[i] + 2] + readings[i, 2] - theta)
    return POSITIVE if total < 0.0 else NEGATIVE


@algebra
def observe(
    ekf: Filter, places: IntArray, readings: FloatArray, index: int, variances: FloatArray, iterations: int
) -> None:
    """Update by readings of one line: the iterated EKF with Huber weights, linearised anew at each iteration."""
    start, size, line = clones_from(ekf), size_of(ekf), POSE + 2 * index
    chosen = clear_readings(
        ekf.x, start, places, readings, line, (ekf.anchors[index, 0], ekf.anchors[index, 1])
    )  # fmt: skip
    if not len(chosen):
        return
    columns, begins = involved(places, chosen, len(ekf.clones), start, line)
    rows = gather_rows(ekf.top, ekf.rest, columns, size)
    moved, _, _, W, _, change = iterate(
        ekf.x, size, (POSE, POSE, start), ekf.anchors, ekf.counts[LINES], ekf.top, rows, columns, begins, places,
        readings, chosen, index, gathered(variances, chosen), iterations, HUBER,
    )  # fmt: skip
    correct(ekf, moved, W, change)


@algebra
def equality(ekf: Filter, older: int, younger: int) -> tuple[FloatArray, FloatArray, IntArray, FloatArray]:
    """Difference (2,) of two lines about the younger's anchor, m and rad, with H (2, n), its columns, and H P H^T."""
    a, b = POSE + 2 * older, POSE + 2 * younger
    between_x = ekf.anchors[younger, 0] - ekf.anchors[older, 0]
    between_y = ekf.anchors[younger, 1] - ekf.anchors[older, 1]
    cos, sin = math.cos(ekf.x[a + 1]), math.sin(ekf.x[a + 1])
    turned = math.cos(ekf.x[a + 1] - ekf.x[b + 1]) < 0.0
    sign = -1.0 if turned else 1.0
    off = np.array([
        sign * (ekf.x[a] - between_x * cos - between_y * sin) - ekf.x[b],
        wrapped(ekf.x[a + 1] - ekf.x[b + 1] + (math.pi if turned else 0.0)),
    ])  # fmt: skip
    H = np.array([[sign, sign * (between_x * sin - between_y * cos), -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    columns = np.array([a, a + 1, b, b + 1])
    x, y = ekf.anchors[younger, 0] - ekf.x[0], ekf.anchors[younger, 1] - ekf.x[1]
    by_pose = np.array(_by_carried_anchor(x, y, ekf.x[a + 1], ekf.x[b + 1], sign))
    if by_pose @ np.ascontiguousarray(ekf.top[:POSE, :POSE]) @ by_pose >= KNOWN_PLACE:
        H = np.concatenate((np.stack((by_pose, np.zeros(POSE))), H), axis=1)
        columns = np.concatenate((np.arange(POSE), columns))
    S = H @ block_of(ekf.top, ekf.rest, columns) @ H.T
    return off, H, columns, S


@algebra
def difference(ekf: Filter, older: int, younger: int) -> tuple[FloatArray, FloatArray]:
    """Difference (2,) of two lines about the younger's anchor, m and rad, and its covariance (2, 2)."""
    off, _, _, covariance = equality(ekf, older, younger)
    return off, covariance


@algebra
def merge(ekf: Filter, older: int, younger: int, iterations: int) -> None:  # noqa: ARG001 (a batch renews no map)
    """Merge two lines: update by the constraint that they are equal, and marginalise the younger one."""
    off, H, columns, S = equality(ekf, older, younger)
    size = size_of(ekf)
    first_line = len(columns) - 4
    HP = np.ascontiguousarray(H[:, first_line:]) @ gather_rows(ekf.top, ekf.rest, columns[first_line:], size)
    if first_line:
        HP += np.ascontiguousarray(H[:, :POSE]) @ np.ascontiguousarray(ekf.top[:, :size])
    change = np.empty(size)
    # With S = L L^T and W = L^-1 H P, the gain's correction is W^T L^-1 y.
    first = math.sqrt(S[0, 0] + EQUALITY_NOISE[0])
    beside = S[1, 0] / first
    second = math.sqrt(S[1, 1] + EQUALITY_NOISE[1] - beside * beside)
    y = -off[0] / first
    z = (-off[1] - beside * y) / second
    for j in range(size):
        HP[0, j] /= first
        HP[1, j] = (HP[1, j] - beside * HP[0, j]) / second
        change[j] = y * HP[0, j] + z * HP[1, j]
    correct(ekf, np.zeros((size, POSE)), HP, change)
    remove_line(ekf, younger)


@algebra
def remove_line(ekf: Filter, index: int) -> None:
    """Marginalise a line."""
    size, row = size_of(ekf), POSE + 2 * index
    kept = np.empty(size - 2, dtype=np.int64)
    for new in range(size - 2):
        kept[new] = new if new < row else new + 2
    keep(ekf, kept, size - 2)
    for place in range(index, ekf.counts[LINES] - 1):
        ekf.anchors[place] = ekf.anchors[place + 1]
    ekf.counts[LINES] -= 1


@algebra
def correct(ekf: Filter, moved: FloatArray, W: FloatArray, change: FloatArray) -> None:
    """Finish an update, as ``stack_changes`` describes it, in one pass over P."""
    size = size_of(ekf)
    height = (len(W) + 2 * POSE + 3) // 4 * 4
    left, right = np.empty((height, size)), np.empty((height, size))
    begins = (POSE, POSE, clones_from(ekf))
    stack_changes(ekf.x, size, begins, ekf.anchors, ekf.counts[LINES], ekf.top, moved, W, change, left, right)
    add_products(ekf.rest, left, right, height, POSE, size)
    ekf.x[2] = wrapped(ekf.x[2])
