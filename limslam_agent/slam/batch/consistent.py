"""The consistent estimator after the prediction: compiled counterpart of ``consistent.consistent``."""

import math

import numpy as np

from limslam_agent.kernels.algebra import sort_with
from limslam_agent.kernels.measurement import hit_points, towards
from limslam_agent.kernels.tables import FEWEST, MIN_KINK, TURN_SIGMAS
from limslam_agent.slam.batch.algebra import squared_distance
from limslam_agent.slam.batch.clone_ekf import (
    add_line,
    clone,
    clones_from,
    difference,
    disagreement,
    keep_clones,
    merge,
    observe,
    side_of,
)
from limslam_agent.slam.batch.compilation import algebra, compiled
from limslam_agent.slam.batch.hough import extract_lines
from limslam_agent.slam.batch.pending_readings import collect, is_due, place_of, readings_of
from limslam_agent.slam.batch.segmentation import ANGLE_STD, EXTENT, MIDDLE_X, MIDDLE_Y, THETA, wall_segments
from limslam_agent.slam.batch.state import (
    CLONE,
    CLONES,
    CLOSURES,
    DRIVEN_THEN,
    FRESH,
    LINES,
    OVERFLOWS,
    PENDING,
    Filter,
    Settings,
    Walls,
)
from limslam_agent.slam.batch.wall_extent import ends_of
from limslam_agent.slam.batch.wall_map import (
    add,
    along_line,
    along_point,
    clear_along_beams,
    grow,
    kinds,
    moved_along,
    shared,
)
from limslam_agent.slam.batch.wall_map import merge as merge_walls
from limslam_agent.slam.consistent.consistent import SHORTEST
from limslam_agent.slam.consistent.limits import (
    BEYOND_ANGLE_STD,
    BEYOND_GATE,
    BEYOND_LENGTH,
    COMPLETE_AFTER,
    END_SLACK,
    FAR_GATE,
    FIRST_ITERATIONS,
    GAP_AHEAD,
    HUBER,
    ITERATIONS,
    LEAST_LENGTH,
    LENGTH_IF_COMPLETE,
    MAX_ANGLE,
    MAX_ANGLE_STD,
    MAX_END_GAP,
    MAX_OFFSET,
    MIN_OVERLAP,
    ONE_WALL_GATE,
    RESIDUAL_SIGMAS,
)
from limslam_agent.slam.consistent.pending_readings import AHEAD, SIDES
from limslam_agent.slam.consistent.segmentation import BESIDE_CORNER
from limslam_agent.slam.consistent.wall_map import STRAIGHTNESS
from limslam_agent.slam.core import wall_faces
from limslam_agent.slam.core.ekf import POSE
from limslam_agent.slam.core.wall_faces import NEGATIVE, POSITIVE, SURE
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_NUM_SIDES = len(SIDES)

board_evidence, board_odds = compiled(wall_faces.board_evidence), compiled(wall_faces.board_odds)
is_wall = compiled(wall_faces.is_wall)


@algebra
def measure(
    ekf: Filter, walls: Walls, travel: FloatArray, pending: FloatArray, ranges: FloatArray, measured: BoolArray,
    hits: BoolArray, settings: Settings, beams: FloatArray,
) -> None:  # fmt: skip
    """Count what new beams have passed through, and collect the new hits if they are due."""
    clear_along_beams(ekf, walls, ranges, measured, settings, beams)
    if is_due(travel, hits, settings, beams):
        if ekf.counts[CLONES] == len(ekf.clones):
            ekf.counts[OVERFLOWS] += 1
            prune(ekf, pending, len(ekf.clones) - 1)
        collect(ekf.counts, travel, pending, ranges, hits, beams, clone(ekf))


@algebra
def process(
    ekf: Filter, walls: Walls, pending_all: FloatArray, side: int, driven: float, settings: Settings, beams: FloatArray,
    has_ended: bool,
) -> None:  # fmt: skip
    """Find wall segments in the pending readings of a side, use them, and drop what is consumed or too old."""
    ekf.counts[FRESH + side] = 0
    count, pending = ekf.counts[PENDING + side], pending_all[side]
    places, readings = readings_of(pending[:count], ekf.clones[: ekf.counts[CLONES]], beams, settings.cone)
    points = hit_points(ekf.x, clones_from(ekf), places, readings, readings[:, 3])
    owner, most = np.empty(count, dtype=np.int64), count // max(settings.min_votes, 1) + 1
    lines, ends, consumed = np.empty((most, 2)), np.empty((most, 2, 2)), np.zeros(count, dtype=np.bool_)
    max_gap = GAP_AHEAD if side == AHEAD else settings.segment_gap
    number = extract_lines(points, max_gap, settings, owner, lines, ends)
    for index in range(number):
        members = uncontested(points, owner, lines, ends, number, index, settings.near_line)
        if not len(members):
            continue
        # The lines before this one have updated the filter, so the end points are computed anew.
        rays = towards(ekf.x, clones_from(ekf), places, readings, lines[index, 1])
        now = hit_points(ekf.x, clones_from(ekf), places, rays, readings[:, 3])
        segments, own = wall_segments(ekf, places, readings, now, members, lines[index], settings)
        for k in range(len(own)):
            these = own[k]
            latest = pending[these, DRIVEN_THEN].max()
            is_complete = has_ended or driven - latest > COMPLETE_AFTER
            consumed[these] = incorporate(
                ekf, walls, places[these], readings[these], now[these], segments[k], settings, is_complete
            )  # fmt: skip
    oldest, size = np.inf if has_ended else driven - settings.max_age, 0
    for i in range(count):
        if not consumed[i] and pending[i, DRIVEN_THEN] >= oldest:
            pending[size] = pending[i]
            size += 1
    ekf.counts[PENDING + side] = size
    prune(ekf, pending_all, settings.max_clones)


@algebra
def prune(ekf: Filter, pending: FloatArray, most: int) -> None:
    """Marginalise clones without pending readings, and the oldest clones if there are more than ``most``."""
    number = ekf.counts[CLONES]
    clones = ekf.clones[:number]
    wanted, count = np.zeros(number, dtype=np.bool_), 0
    for side in range(_NUM_SIDES):
        for i in range(ekf.counts[PENDING + side]):
            wanted[place_of(clones, pending[side, i, CLONE])] = True
    for place in range(number - 1, -1, -1):
        if wanted[place] and count == most:
            wanted[place] = False
        count += wanted[place]
    for side in range(_NUM_SIDES):
        size = 0
        for i in range(ekf.counts[PENDING + side]):
            if wanted[place_of(clones, pending[side, i, CLONE])]:
                pending[side, size] = pending[side, i]
                size += 1
        ekf.counts[PENDING + side] = size
    keep_clones(ekf, wanted)


@compiled
def uncontested(
    points: FloatArray, owner: IntArray, lines: FloatArray, ends: FloatArray, size: int, index: int, most: float
) -> IntArray:
    """Indices (n,) of a line's points without those near a corner that could also belong to another line."""
    chosen, count = np.empty(len(points), dtype=np.int64), 0
    for i in range(len(points)):
        is_own = owner[i] == index
        for other in range(size):
            if not is_own or other == index:
                continue
            cos, sin = math.cos(lines[other, 1]), math.sin(lines[other, 1])
            first = -sin * ends[other, 0, 0] + cos * ends[other, 0, 1]
            last = -sin * ends[other, 1, 0] + cos * ends[other, 1, 1]
            along = -sin * points[i, 0] + cos * points[i, 1]
            is_beside = min(first, last) - BESIDE_CORNER < along < max(first, last) + BESIDE_CORNER
            off = abs(points[i, 0] * cos + points[i, 1] * sin - lines[other, 0])
            is_own = not (is_beside and off < most)
        if is_own:
            chosen[count] = i
            count += 1
    return chosen[:count] if count >= FEWEST else chosen[:0]


@algebra
def turn_between(state: FloatArray, index: int, theta: float) -> float:
    """Angle between a landmark and a line with its normal at theta, rad."""
    turn: float = abs((state[POSE + 2 * index + 1] - theta + 0.5 * math.pi) % math.pi - 0.5 * math.pi)
    return turn


@algebra
def incorporate(
    ekf: Filter, walls: Walls, places: IntArray, readings: FloatArray, points: FloatArray, segment: FloatArray,
    settings: Settings,
    is_complete: bool,
) -> bool:  # fmt: skip
    """Associate a wall segment with a known landmark, or add a new one; whether the readings are consumed."""
    room = len(ekf.anchors)
    scores, rows, details = np.empty(room), np.empty(room, dtype=np.int64), np.empty((room, 2))
    number = candidates(ekf, walls, places, readings, points, segment, settings, scores, rows, details)
    while number > 1 and scores[1] <= settings.gate:
        if not closes_loop(ekf, walls, rows[0], rows[1], settings):
            break
        number = candidates(ekf, walls, places, readings, points, segment, settings, scores, rows, details)
    best, second = scores[0] if number else np.inf, scores[1] if number > 1 else np.inf
    is_enough = len(points) >= settings.new_readings * settings.std
    is_sure = is_enough and segment[ANGLE_STD] <= MAX_ANGLE_STD
    gate = FAR_GATE if is_sure and second >= FAR_GATE else settings.gate
    if best <= gate:
        index = rows[0]
        if not fits(ekf, walls, index, points, segment, best, details[index, 0], details[index, 1]):
            return False
        update(ekf, walls, places, readings, index, settings, ITERATIONS)
        return True
    least = LENGTH_IF_COMPLETE if is_complete else settings.new_length
    if best < FAR_GATE or segment[EXTENT] < least or not is_sure:
        return False
    if ekf.counts[LINES] == room:
        ekf.counts[OVERFLOWS] += 1
        return False
    index = add_line(ekf, segment[THETA], segment[MIDDLE_X], segment[MIDDLE_Y])
    add(walls, index)
    update(ekf, walls, places, readings, index, settings, FIRST_ITERATIONS)
    return True


@algebra
def candidates(
    ekf: Filter, walls: Walls, places: IntArray, readings: FloatArray, points: FloatArray, segment: FloatArray,
    settings: Settings,
    scores: FloatArray, rows: IntArray, details: FloatArray,
) -> int:  # fmt: skip
    """Number of landmarks that a wall segment may show.

    Fills their scores and indices ``rows``, best first, and by index what is left over and how many readings were used.
    """
    loose, size = 2.0 * math.atan2(2.0 * settings.std, max(segment[EXTENT], SHORTEST)), 0
    x, y, limit = segment[MIDDLE_X], segment[MIDDLE_Y], MAX_ANGLE + loose
    for index in range(ekf.counts[LINES]):
        if not is_near(ekf.x, ekf.anchors, index, segment[THETA], x, y, limit, MAX_OFFSET):
            continue
        along, (low, high) = along_line(ekf, index, points), ends_of(walls, index)
        if max(along.min() - high, low - along.max()) > MAX_END_GAP:
            continue
        of_line, left, used, offset, variance = disagreement(ekf, places, readings, index, settings.std)
        if used and may_show(ekf, walls, places, readings, index, along, offset, variance):
            scores[size], rows[size], details[index, 0], details[index, 1] = of_line, index, left, used
            size += 1
    sort_with(scores, rows, size)
    return size


@algebra
def may_show(
    ekf: Filter, walls: Walls, places: IntArray, readings: FloatArray, index: int, along: FloatArray, offset: float,
    variance: float,
) -> bool:  # fmt: skip
    """Whether a landmark was seen from the side of readings near them, or it is a board."""
    side, inside = side_of(ekf, places, readings, index), np.zeros(2)
    for row in range(2):
        low, high = walls.seen[index, row]
        inside[row] = ((along > low - END_SLACK) & (along < high + END_SLACK)).mean()
    low, high = walls.seen[index, side]
    is_close = max(along.min() - high, low - along.max()) <= MAX_END_GAP
    if inside[side] >= 0.5 or (inside[1 - side] < 0.5 and is_close):
        return True
    return is_board(ekf, walls, 1 - side, offset, variance)[0]


@algebra
def is_board(ekf: Filter, walls: Walls, side: int, offset: float, variance: float) -> tuple[bool, bool]:
    """Whether a line that is seen from one side, and a line seen from the other side, are a board; or a wall."""
    behind = -offset if side == POSITIVE else offset
    evidence, (boards, two_faced) = board_evidence(behind, variance + STRAIGHTNESS[0]), kinds(ekf, walls)
    return board_odds(evidence, boards, two_faced) > SURE, is_wall(evidence, behind)


@algebra
def is_one_line(ekf: Filter, walls: Walls, older: int, younger: int, off: FloatArray, covariance: FloatArray) -> bool:
    """Whether two landmarks share a stretch that is seen from one side, or are a board; notes if they are two faces."""
    factor = 1.0 if math.cos(ekf.x[POSE + 2 * older + 1] - ekf.x[POSE + 2 * younger + 1]) > 0.0 else -1.0
    shift = along_point(ekf, younger, ekf.anchors[older, 0], ekf.anchors[older, 1])
    seen, other = moved_along(walls.seen[older], factor, shift), walls.seen[younger]
    own = max(shared(seen[0], other[0]), shared(seen[1], other[1]))
    from_positive, from_negative = shared(seen[1], other[0]), shared(seen[0], other[1])
    opposite = max(from_positive, from_negative)
    if own >= min(MIN_OVERLAP, opposite):
        return True
    share = covariance[0, 1] / covariance[1, 1]
    offset, variance = off[0] - share * off[1], covariance[0, 0] - share * covariance[0, 1]
    side = POSITIVE if from_positive >= from_negative else NEGATIVE
    is_thin, is_face = is_board(ekf, walls, side, offset, variance)
    if is_face:
        walls.behind[older] = max(walls.behind[older], opposite)
        walls.behind[younger] = max(walls.behind[younger], opposite)
    return is_thin


@algebra
def is_near(
    state: FloatArray, anchors: FloatArray, index: int, theta: float, x: float, y: float, angle: float, offset: float
) -> bool:
    """Whether a landmark's direction differs by less than ``angle``, rad, and it passes a point within an offset, m."""
    d, own = state[POSE + 2 * index], state[POSE + 2 * index + 1]
    turn = turn_between(state, index, theta)
    off = (x - anchors[index, 0]) * math.cos(own) + (y - anchors[index, 1]) * math.sin(own) - d
    return turn < angle and abs(off) < offset


@algebra
def fits(
    ekf: Filter, walls: Walls, index: int, points: FloatArray, segment: FloatArray, of_line: float, left: float,
    used: float,
) -> bool:  # fmt: skip
    """Whether a wall segment of a known landmark is good enough to update by."""
    if turn_between(ekf.x, index, segment[THETA]) > max(MIN_KINK, TURN_SIGMAS * segment[ANGLE_STD]):
        return False
    free = max(used - 2.0, 1.0)
    if left > free + RESIDUAL_SIGMAS * math.sqrt(2.0 * free) + 2.0 or segment[EXTENT] < LEAST_LENGTH:
        return False
    (low, high), inside = ends_of(walls, index), 0
    for along in along_line(ekf, index, points):
        inside += low - END_SLACK < along < high + END_SLACK
    is_clear = segment[EXTENT] >= BEYOND_LENGTH and of_line <= BEYOND_GATE and segment[ANGLE_STD] <= BEYOND_ANGLE_STD
    return inside / len(points) >= 0.5 or is_clear


@algebra
def update(
    ekf: Filter, walls: Walls, places: IntArray, readings: FloatArray, index: int, settings: Settings, iterations: int
) -> None:
    """Update filter and map by readings of a landmark, and merge it with others that are the same wall."""
    observe(ekf, places, readings, index, settings.std, iterations, HUBER)
    rays = towards(ekf.x, clones_from(ekf), places, readings, ekf.x[POSE + 2 * index + 1])
    points = hit_points(ekf.x, clones_from(ekf), places, rays, readings[:, 3])
    grow(ekf, walls, index, points, side_of(ekf, places, readings, index))
    found = True
    while found:
        found, most = False, 2.0 * MAX_OFFSET
        theta, x, y = ekf.x[POSE + 2 * index + 1], ekf.anchors[index, 0], ekf.anchors[index, 1]
        for other in range(ekf.counts[LINES]):
            if other == index or not is_near(ekf.x, ekf.anchors, other, theta, x, y, MAX_ANGLE, most):
                continue
            if closes_loop(ekf, walls, other, index, settings):
                # The younger landmark is removed. If that is this one, there is nothing left to compare.
                if other < index:
                    return
                found = True
                break


@algebra
def separation(ekf: Filter, walls: Walls, older: int, younger: int) -> tuple[float, float]:
    """Length, m, that two landmarks share along the older one, and the distance, m, of the younger's middle from it."""
    a, b = POSE + 2 * older, POSE + 2 * younger
    low, high = ends_of(walls, younger)
    nx, ny = math.cos(ekf.x[b + 1]), math.sin(ekf.x[b + 1])
    foot_x, foot_y = ekf.anchors[younger, 0] + ekf.x[b] * nx, ekf.anchors[younger, 1] + ekf.x[b] * ny
    one = along_point(ekf, older, foot_x - low * ny, foot_y + low * nx)
    two = along_point(ekf, older, foot_x - high * ny, foot_y + high * nx)
    least, most = ends_of(walls, older)
    overlap = min(max(one, two), most) - max(min(one, two), least)
    cos, sin = math.cos(ekf.x[a + 1]), math.sin(ekf.x[a + 1])
    middle = 0.5 * (low + high)
    offset = abs(
        (foot_x - middle * ny - ekf.anchors[older, 0]) * cos + (foot_y + middle * nx - ekf.anchors[older, 1]) * sin
        - ekf.x[a]
    )  # fmt: skip
    return overlap, offset


@algebra
def closes_loop(ekf: Filter, walls: Walls, first: int, second: int, settings: Settings) -> bool:
    """Whether two landmarks are one wall; then they are merged, and the younger one is removed."""
    older, younger = min(first, second), max(first, second)
    overlap, offset = separation(ekf, walls, older, younger)
    if not settings.closes_loops or overlap < MIN_OVERLAP:
        return False
    off, jacobian, columns, covariance = difference(ekf, older, younger)
    squared = squared_distance(covariance, off, STRAIGHTNESS)
    if abs(off[1]) > MAX_ANGLE or offset > MAX_OFFSET:
        return False
    if not is_one_line(ekf, walls, older, younger, off, covariance) or squared > ONE_WALL_GATE:
        return False
    theta = ekf.x[POSE + 2 * younger + 1]
    nx, ny = math.cos(theta), math.sin(theta)
    origin_x, origin_y = ekf.anchors[younger, 0], ekf.anchors[younger, 1]
    merge(ekf, younger, jacobian, columns, covariance, off)
    theta = ekf.x[POSE + 2 * older + 1]
    factor = 1.0 if -ny * -math.sin(theta) + nx * math.cos(theta) > 0.0 else -1.0
    merge_walls(ekf, walls, older, younger, factor, along_point(ekf, older, origin_x, origin_y))
    ekf.counts[CLOSURES] += 1
    return True
