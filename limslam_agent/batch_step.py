"""One step of each robot's mind: what `motion`, `tracks`, `consistent` and the grid do, once more for kernels."""

import math

import numpy as np

from limslam_agent.batch_compile import algebra
from limslam_agent.batch_filter import clone, keep_clones, predict
from limslam_agent.batch_grid import crop, see
from limslam_agent.batch_hough import extract, uncontested
from limslam_agent.batch_pieces import incorporate
from limslam_agent.batch_state import (
    BEAM,
    CLONE,
    CLONES,
    DRIVEN,
    DRIVEN_AT,
    DRIVEN_THEN,
    FRESH,
    LAST_HIT,
    NO_PLACE,
    POSE,
    RANGE,
    REFUSED,
    STEP,
    TURNED,
    TURNED_AT,
    WAITING,
    Minds,
    Settings,
)
from limslam_agent.batch_straight import straight_pieces
from limslam_agent.batch_update import ends_at
from limslam_agent.batch_filter import clones_from
from limslam_agent.batch_walls import see_through
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_LEAST_VARIANCE = 1e-12
_AHEAD = 2  # place of the beams ahead among the sides
_SIDES = 3


@algebra
def mind_of(minds: Minds, number: int) -> Minds:
    """The arrays of one robot."""
    return Minds(
        minds.x[number], minds.top[number], minds.rest[number], minds.anchors[number], minds.clones[number],
        minds.counts[number], minds.way[number], minds.waiting[number], minds.walls[number], minds.counted[number],
        minds.reached[number], minds.grid[number], minds.window[number],
    )  # fmt: skip


@algebra
def move(mind: Minds, wheels: FloatArray, settings: Settings) -> None:
    """Predict by the arc of left and right wheel travel (2,), m: `motion.motion_from_wheels`."""
    distance, turn = 0.5 * (wheels[0] + wheels[1]), (wheels[1] - wheels[0]) / settings.axle
    half = 0.5 * turn
    cos, sin = math.cos(half), math.sin(half)
    sinc = math.sin(half) / half if abs(half) > 1e-6 else 1.0 - half * half / 6.0
    slope = (cos - sin / half) / half if abs(half) > 1e-4 else -half / 3.0
    chord, chord_by_turn = distance * sinc, 0.5 * distance * slope
    by_arc = np.array([
        [sinc * cos, chord_by_turn * cos - 0.5 * chord * sin],
        [sinc * sin, chord_by_turn * sin + 0.5 * chord * cos],
        [0.0, 1.0],
    ])  # fmt: skip
    by_wheels = np.empty((POSE, 2))
    covariance = np.zeros((POSE, POSE))
    for i in range(POSE):
        by_wheels[i, 0] = 0.5 * by_arc[i, 0] - by_arc[i, 1] / settings.axle
        by_wheels[i, 1] = 0.5 * by_arc[i, 0] + by_arc[i, 1] / settings.axle
    for k in range(2):
        variance = settings.wheel_variance * abs(wheels[k]) + _LEAST_VARIANCE
        for i in range(POSE):
            for j in range(POSE):
                covariance[i, j] += by_wheels[i, k] * variance * by_wheels[j, k]
    increment = np.array([chord * cos, chord * sin, turn])
    predict(mind, increment, covariance)
    mind.way[DRIVEN] += math.hypot(increment[0], increment[1])
    mind.way[TURNED] += abs(turn)


@algebra
def collect(mind: Minds, ranges: FloatArray, hits: BoolArray, settings: Settings) -> None:
    """Let new hits wait beside a clone of the pose, if the robot has moved enough since it last read."""
    way, any_hit = mind.way, False
    for beam in range(len(hits)):
        if hits[beam] and settings.sides[beam] >= 0:
            way[LAST_HIT + settings.sides[beam]] = way[DRIVEN]
            any_hit = True
    has_moved = (
        way[DRIVEN] - way[DRIVEN_AT] >= settings.min_distance or way[TURNED] - way[TURNED_AT] >= settings.min_turn
    )
    if not (has_moved and any_hit):
        return
    if mind.counts[CLONES] == len(mind.clones):
        mind.counts[NO_PLACE] += 1
        let_go(mind, len(mind.clones) - 1)
    number = clone(mind)
    way[DRIVEN_AT], way[TURNED_AT] = way[DRIVEN], way[TURNED]
    for beam in range(len(hits)):
        side = settings.sides[beam]
        if hits[beam] and side >= 0:
            reading = mind.waiting[side, mind.counts[WAITING + side]]
            reading[CLONE], reading[BEAM] = number, beam
            reading[RANGE], reading[DRIVEN_THEN] = ranges[beam], way[DRIVEN]
            mind.counts[WAITING + side] += 1
            mind.counts[FRESH + side] += 1


@algebra
def let_go(mind: Minds, most: int) -> None:
    """Keep only the clones that readings wait for, and no more than so many: `consistent._let_go`."""
    number = mind.counts[CLONES]
    wanted, count = np.zeros(number, dtype=np.bool_), 0
    for side in range(_SIDES):
        for i in range(mind.counts[WAITING + side]):
            wanted[place_of(mind, mind.waiting[side, i, CLONE])] = True
    for place in range(number - 1, -1, -1):
        if wanted[place] and count == most:
            wanted[place] = False
        count += wanted[place]
    for side in range(_SIDES):
        size = 0
        for i in range(mind.counts[WAITING + side]):
            if wanted[place_of(mind, mind.waiting[side, i, CLONE])]:
                mind.waiting[side, size] = mind.waiting[side, i]
                size += 1
        mind.counts[WAITING + side] = size
    keep_clones(mind, wanted)


@algebra
def place_of(mind: Minds, number: float) -> int:
    """Where a clone is among those that are kept."""
    return int(np.searchsorted(mind.clones[: mind.counts[CLONES]], int(number)))


@algebra
def read(mind: Minds, side: int, settings: Settings) -> tuple[IntArray, FloatArray, FloatArray]:
    """What waits on a side: the places of the clones (n,), the beams and ranges (n, 4), and where they ended (n, 2)."""
    count, start = mind.counts[WAITING + side], clones_from(mind)
    places, reads, points = np.empty(count, dtype=np.int64), np.empty((count, 4)), np.empty((count, 2))
    for i in range(count):
        reading = mind.waiting[side, i]
        beam, places[i] = int(reading[BEAM]), place_of(mind, reading[CLONE])
        reads[i, 0], reads[i, 1] = settings.origins[beam, 0], settings.origins[beam, 1]
        reads[i, 2], reads[i, 3] = settings.angles[beam], reading[RANGE]
        at = start + POSE * places[i]
        points[i, 0], points[i, 1] = ends_at(mind.x[at : at + POSE], reads[i], reads[i, 3])
    return places, reads, points


@algebra
def use(mind: Minds, side: int, settings: Settings, has_ended: bool) -> None:
    """Find lines in what waits, and let go of what is dealt with, or too old: `consistent._use`."""
    mind.counts[FRESH + side] = 0
    places, reads, points = read(mind, side, settings)
    count, waiting = len(places), mind.waiting[side]
    owner, most = np.empty(count, dtype=np.int64), count // max(settings.min_votes, 1) + 1
    lines, ends, done = np.empty((most, 2)), np.empty((most, 2, 2)), np.zeros(count, dtype=np.bool_)
    max_gap = settings.gap_ahead if side == _AHEAD else settings.piece_gap
    number = extract(points, max_gap, settings, owner, lines, ends)
    for index in range(number):
        members = uncontested(points, owner, lines, ends, number, index, settings.near_corner)
        if not len(members):
            continue
        pieces, own = straight_pieces(mind, places, reads, points, members, lines[index], settings)
        # A piece's points are where they were before the pieces beside it corrected the filter.
        where = [located(mind, places[these], reads[these]) for these in own]
        for k in range(len(own)):
            these = own[k]
            latest = waiting[these, DRIVEN_THEN].max()
            is_complete = has_ended or mind.way[DRIVEN] - latest > settings.passed
            done[these] = incorporate(
                mind, places[these], reads[these], where[k], pieces[k], settings, is_complete
            )  # fmt: skip
    oldest, size = np.inf if has_ended else mind.way[DRIVEN] - settings.max_age, 0
    for i in range(count):
        if not done[i] and waiting[i, DRIVEN_THEN] >= oldest:
            waiting[size] = waiting[i]
            size += 1
    mind.counts[WAITING + side] = size
    let_go(mind, settings.max_clones)


@algebra
def located(mind: Minds, places: IntArray, reads: FloatArray) -> FloatArray:
    """Where readings are believed to have ended (n, 2), m."""
    points, start = np.empty((len(places), 2)), clones_from(mind)
    for i in range(len(places)):
        at = start + POSE * places[i]
        points[i, 0], points[i, 1] = ends_at(mind.x[at : at + POSE], reads[i], reads[i, 3])
    return points


@algebra
def step(mind: Minds, ranges: FloatArray, wheels: FloatArray, settings: Settings, marks: FloatArray) -> None:
    """Take in one observation: ranges (b,) and wheel travel (2,), m."""
    beams = len(ranges)
    mind.counts[STEP] += 1
    move(mind, wheels, settings)
    measured, hits = np.zeros(beams, dtype=np.bool_), np.zeros(beams, dtype=np.bool_)
    for beam in range(beams):
        is_number = math.isfinite(ranges[beam])
        mind.counts[REFUSED] += not is_number
        measured[beam] = is_number and mind.counts[STEP] % settings.periods[beam] == 0
        hits[beam] = measured[beam] and settings.too_near[beam] < ranges[beam] < settings.too_far[beam]
    see_through(mind, ranges, measured, settings)
    collect(mind, ranges, hits, settings)
    for side in range(_SIDES):
        is_waiting = mind.counts[WAITING + side] > 0
        has_ended = is_waiting and mind.way[DRIVEN] - mind.way[LAST_HIT + side] > settings.wall_end
        if mind.counts[FRESH + side] >= settings.batch or has_ended:
            use(mind, side, settings, has_ended)
    see(mind, ranges, measured, settings, marks)


@algebra
def step_some(
    minds: Minds, settings: Settings, ranges: FloatArray, wheels: FloatArray, chosen: IntArray, pose: FloatArray,
    covariance: FloatArray, grids: np.ndarray,  # type: ignore[type-arg]
) -> None:  # fmt: skip
    """Take in an observation of some robots, by number, and write down what they believe then."""
    marks = np.zeros((minds.grid.shape[1], minds.grid.shape[2]), dtype=np.uint8)
    for number in chosen:
        mind = mind_of(minds, number)
        step(mind, ranges[number], wheels[number], settings, marks)
        pose[number] = mind.x[:POSE]
        covariance[number] = mind.top[:, :POSE]
        if grids.shape[3]:
            crop(mind, settings.cell, grids[number, 0])


@algebra
def begin(mind: Minds, start: FloatArray, cell: float) -> None:
    """Forget everything and begin at a known pose (3,), m, m, rad."""
    mind.counts[:] = 0
    mind.counts[STEP] = -1
    mind.x[:POSE] = start
    mind.top[:, :POSE] = 0.0
    mind.way[:] = 0.0
    mind.way[DRIVEN_AT], mind.way[TURNED_AT] = -np.inf, -np.inf
    mind.grid[:] = 0
    half = mind.grid.shape[0] // 2
    mind.window[0] = math.floor(start[1] / cell) - half
    mind.window[1] = math.floor(start[0] / cell) - half


@algebra
def begin_some(minds: Minds, starts: FloatArray, chosen: IntArray, cell: float) -> None:
    """The same for some robots, by number."""
    for number in chosen:
        begin(mind_of(minds, number), starts[number], cell)
