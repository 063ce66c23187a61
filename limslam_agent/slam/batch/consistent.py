"""Which wall a piece is, and what follows from it: the association of `consistent` once more, for kernels."""

import math

import numpy as np

from limslam_agent.slam.batch.algebra import sort_with, wrapped
from limslam_agent.slam.batch.clone_ekf import add_line, clones_from, correct, gather_rows, keep, size_of
from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.batch.segmentation import ANGLE_STD, EXTENT, MIDDLE_X, MIDDLE_Y, THETA
from limslam_agent.slam.batch.state import (
    CLOSURES,
    GROUPS,
    LINES,
    NO_PLACE,
    POSE,
    READINGS,
    Filter,
    Settings,
    Walls,
)
from limslam_agent.slam.batch.update import block_of, disagreement, end_points, observe
from limslam_agent.slam.batch.wall_map import absorb, along_all, along_of, ends_of, forget_wall, hit, remove_wall
from limslam_env.geometry import FloatArray, IntArray

_STRAIGHTNESS = (1e-3**2, 1e-4**2)
_EXACT = (1e-4**2, 1e-5**2)


@algebra
def is_near(
    state: FloatArray, anchors: FloatArray, index: int, theta: float, x: float, y: float, angle: float, offset: float
) -> bool:
    """Whether a landmark's direction differs by less than ``angle`` (rad), and it passes a point within ``offset``."""
    d, own = state[POSE + 2 * index], state[POSE + 2 * index + 1]
    turn = abs((own - theta + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
    off = (x - anchors[index, 0]) * math.cos(own) + (y - anchors[index, 1]) * math.sin(own) - d
    return turn < angle and abs(off) < offset


@algebra
def candidates(
    mind: Filter, walls: Walls, places: IntArray, reads: FloatArray, points: FloatArray, piece: FloatArray,
    settings: Settings,
    scores: FloatArray, rows: IntArray, told: FloatArray,
) -> int:  # fmt: skip
    """How many landmarks a piece may be of: scores and indices, best first; by index, what is left and who tells."""
    loose, size = 2.0 * math.atan2(2.0 * settings.std, max(piece[EXTENT], 0.1)), 0
    x, y, limit = piece[MIDDLE_X], piece[MIDDLE_Y], settings.max_angle + loose
    for index in range(mind.counts[LINES]):
        if not is_near(mind.x, mind.anchors, index, piece[THETA], x, y, limit, settings.max_offset):
            continue
        along, (low, high) = along_all(mind, index, points), ends_of(walls, index)
        if max(along.min() - high, low - along.max()) > settings.max_end_gap:
            continue
        of_line, left, used = disagreement(mind, places, reads, index, settings.std)
        if used:
            scores[size], rows[size], told[index, 0], told[index, 1] = of_line, index, left, used
            size += 1
    sort_with(scores, rows, size)
    return size


@algebra
def incorporate(
    mind: Filter, walls: Walls, places: IntArray, reads: FloatArray, points: FloatArray, piece: FloatArray,
    settings: Settings,
    is_complete: bool,
) -> bool:  # fmt: skip
    """Take a piece of wall for a landmark that is known, or for a new one; whether it has been dealt with."""
    room = len(mind.anchors)
    scores, rows, told = np.empty(room), np.empty(room, dtype=np.int64), np.empty((room, 2))
    number = candidates(mind, walls, places, reads, points, piece, settings, scores, rows, told)
    while number > 1 and scores[1] <= settings.gate:
        if not closes_loop(mind, walls, rows[0], rows[1], settings):
            break
        number = candidates(mind, walls, places, reads, points, piece, settings, scores, rows, told)
    best, second = scores[0] if number else np.inf, scores[1] if number > 1 else np.inf
    if second <= settings.gate and second - best < settings.ambiguity:
        return True
    if best <= settings.gate:
        index = rows[0]
        if not fits(mind, walls, index, points, piece, settings, best, told[index, 0], told[index, 1]):
            return False
        update(mind, walls, places, reads, index, settings, settings.iterations)
        return True
    least = settings.new_length_complete if is_complete else settings.new_length
    is_enough = len(points) >= settings.new_readings * settings.std
    is_sure = is_enough and piece[ANGLE_STD] <= settings.max_angle_std
    if best < settings.far_gate or piece[EXTENT] < least or not is_sure:
        return False
    if mind.counts[LINES] == room:
        mind.counts[NO_PLACE] += 1
        return False
    index = add_line(mind, piece[THETA], piece[MIDDLE_X], piece[MIDDLE_Y])
    forget_wall(walls, index)
    update(mind, walls, places, reads, index, settings, settings.first_iterations)
    return True


@algebra
def fits(
    mind: Filter, walls: Walls, index: int, points: FloatArray, piece: FloatArray, settings: Settings,
    of_line: float, left: float, used: float,
) -> bool:  # fmt: skip
    """Whether a piece of a known landmark is good enough to correct by."""
    free = max(used - 2.0, 1.0)
    if left > free + settings.left_sigmas * math.sqrt(2.0 * free) + 2.0 or piece[EXTENT] < settings.min_length:
        return False
    (low, high), inside = ends_of(walls, index), 0
    for along in along_all(mind, index, points):
        inside += low - settings.end_slack < along < high + settings.end_slack
    is_clear = (
        piece[EXTENT] >= settings.beyond_length
        and of_line <= settings.beyond_gate
        and piece[ANGLE_STD] <= settings.beyond_angle_std
    )
    return inside / len(points) >= 0.5 or is_clear


@algebra
def update(
    mind: Filter, walls: Walls, places: IntArray, reads: FloatArray, index: int, settings: Settings, iterations: int
) -> None:
    """Correct the filter by readings of a wall, let the wall grow, and look for others that are the same."""
    observe(mind, places, reads, index, settings.std, iterations, settings.huber)
    points = end_points(mind.x, clones_from(mind), places, reads, reads[:, 3])
    for along in along_all(mind, index, points):
        hit(walls, mind.counts, index, along)
    walls.table[index, GROUPS] += 1
    walls.table[index, READINGS] += len(places)
    found = True
    while found:
        found, most = False, 2.0 * settings.max_offset
        theta, x, y = mind.x[POSE + 2 * index + 1], mind.anchors[index, 0], mind.anchors[index, 1]
        for other in range(mind.counts[LINES]):
            if other == index or not is_near(mind.x, mind.anchors, other, theta, x, y, settings.max_angle, most):
                continue
            if closes_loop(mind, walls, other, index, settings):
                # The younger is no more; if that is this one, there is nothing left to look at.
                if other < index:
                    return
                found = True
                break


@algebra
def closes_loop(mind: Filter, walls: Walls, first: int, second: int, settings: Settings) -> bool:
    """Whether two landmarks are one wall; then they are made one, and the younger is no more."""
    older, younger = min(first, second), max(first, second)
    a, b = POSE + 2 * older, POSE + 2 * younger
    low, high = ends_of(walls, younger)
    nx, ny = math.cos(mind.x[b + 1]), math.sin(mind.x[b + 1])
    foot_x, foot_y = mind.anchors[younger, 0] + mind.x[b] * nx, mind.anchors[younger, 1] + mind.x[b] * ny
    one = along_of(mind, older, foot_x - low * ny, foot_y + low * nx)
    two = along_of(mind, older, foot_x - high * ny, foot_y + high * nx)
    least, most = ends_of(walls, older)
    overlap = min(max(one, two), most) - max(min(one, two), least)
    if not settings.closes_loops or overlap < settings.min_overlap:
        return False
    between_x = mind.anchors[younger, 0] - mind.anchors[older, 0]
    between_y = mind.anchors[younger, 1] - mind.anchors[older, 1]
    cos, sin = math.cos(mind.x[a + 1]), math.sin(mind.x[a + 1])
    middle = 0.5 * (low + high)
    offset = abs(
        (foot_x - middle * ny - mind.anchors[older, 0]) * cos + (foot_y + middle * nx - mind.anchors[older, 1]) * sin
        - mind.x[a]
    )  # fmt: skip
    turned = math.cos(mind.x[a + 1] - mind.x[b + 1]) < 0.0
    sign = -1.0 if turned else 1.0
    off = np.array([
        sign * (mind.x[a] - between_x * cos - between_y * sin) - mind.x[b],
        wrapped(mind.x[a + 1] - mind.x[b + 1] + (math.pi if turned else 0.0)),
    ])  # fmt: skip
    H = np.array([[sign, sign * (between_x * sin - between_y * cos), -1.0, 0.0], [0.0, 1.0, 0.0, -1.0]])
    columns = np.array([a, a + 1, b, b + 1])
    S = H @ block_of(mind.top, mind.rest, columns) @ H.T
    squared = quadratic(S, off, _STRAIGHTNESS)
    if squared > settings.one_wall_gate or abs(off[1]) > settings.max_angle or offset > settings.max_offset:
        return False
    origin_x, origin_y = mind.anchors[younger, 0], mind.anchors[younger, 1]
    equate(mind, H, columns, S, off)
    factor = 1.0 if -ny * -math.sin(mind.x[a + 1]) + nx * math.cos(mind.x[a + 1]) > 0.0 else -1.0
    absorb(walls, mind.counts, older, younger, factor, along_of(mind, older, origin_x, origin_y))
    remove_wall(walls, younger, mind.counts[LINES])
    remove_line(mind, younger)
    mind.counts[CLOSURES] += 1
    return True


@algebra
def quadratic(S: FloatArray, off: FloatArray, more: tuple[float, float]) -> float:
    """The square of an offset (2,) by its covariance and some more."""
    a, b, c = S[0, 0] + more[0], 0.5 * (S[0, 1] + S[1, 0]), S[1, 1] + more[1]
    return (c * off[0] ** 2 - 2.0 * b * off[0] * off[1] + a * off[1] ** 2) / (a * c - b * b)


@algebra
def equate(mind: Filter, H: FloatArray, columns: IntArray, S: FloatArray, off: FloatArray) -> None:
    """Correct two lines, and the whole state, by their being equal."""
    size = size_of(mind)
    HP, change = H @ gather_rows(mind.top, mind.rest, columns, size), np.empty(size)
    # With S = L L^T and W = L^-1 H P, the gain's correction is W^T L^-1 y.
    first = math.sqrt(S[0, 0] + _EXACT[0])
    beside = S[1, 0] / first
    second = math.sqrt(S[1, 1] + _EXACT[1] - beside * beside)
    y = -off[0] / first
    z = (-off[1] - beside * y) / second
    for j in range(size):
        HP[0, j] /= first
        HP[1, j] = (HP[1, j] - beside * HP[0, j]) / second
        change[j] = y * HP[0, j] + z * HP[1, j]
    correct(mind, np.zeros((size, POSE)), HP, 2, change)


@algebra
def remove_line(mind: Filter, index: int) -> None:
    """Let go of a line."""
    size, row = size_of(mind), POSE + 2 * index
    kept = np.empty(size - 2, dtype=np.int64)
    for new in range(size - 2):
        kept[new] = new if new < row else new + 2
    keep(mind, kept, size - 2)
    for place in range(index, mind.counts[LINES] - 1):
        mind.anchors[place] = mind.anchors[place + 1]
    mind.counts[LINES] -= 1
