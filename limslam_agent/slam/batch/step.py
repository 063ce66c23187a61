"""One step of each robot's mind: what `motion`, `tracks`, `consistent` and the grid do, once more for kernels."""

import math

import numpy as np

from limslam_agent.slam.batch.clone_ekf import clone, clones_from, keep_clones, predict
from limslam_agent.slam.batch.compilation import algebra, entry
from limslam_agent.slam.batch.consistent import incorporate
from limslam_agent.slam.batch.grid import MarkArray, crop, see
from limslam_agent.slam.batch.hough import extract, uncontested
from limslam_agent.slam.batch.segmentation import straight_pieces
from limslam_agent.slam.batch.state import (
    ANGLE,
    BEAM,
    CLONE,
    CLONES,
    DRIVEN,
    DRIVEN_AT,
    DRIVEN_THEN,
    FRESH,
    FROM_X,
    FROM_Y,
    LAST_HIT,
    NO_PLACE,
    PERIOD,
    POSE,
    RANGE,
    REFUSED,
    SIDE,
    STEP,
    TOO_FAR,
    TOO_NEAR,
    TURNED,
    TURNED_AT,
    WAITING,
    Filter,
    Minds,
    Settings,
    Spec,
    Walls,
)
from limslam_agent.slam.batch.update import end_points
from limslam_agent.slam.batch.wall_map import see_through
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_LEAST_VARIANCE = 1e-12
_AHEAD = 2  # place of the beams ahead among the sides
_SIDES = 3


@algebra
def mind_of(minds: Minds, number: int) -> Minds:
    """The arrays of one robot."""
    belief, walls = minds.filter, minds.walls
    return Minds(
        Filter(
            belief.x[number], belief.top[number], belief.rest[number], belief.anchors[number], belief.clones[number],
            belief.counts[number],
        ),
        Walls(walls.table[number], walls.counted[number], walls.reached[number]),
        minds.way[number], minds.waiting[number], minds.grid[number], minds.window[number],
    )  # fmt: skip


@algebra
def move(mind: Filter, way: FloatArray, wheels: FloatArray, settings: Settings) -> None:
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
    way[DRIVEN] += math.hypot(increment[0], increment[1])
    way[TURNED] += abs(turn)


@algebra
def collect(
    mind: Filter, way: FloatArray, waiting: FloatArray, ranges: FloatArray, hits: BoolArray, settings: Settings,
    beams: FloatArray,
) -> None:  # fmt: skip
    """Let new hits wait beside a clone of the pose, if the robot has moved enough since it last read."""
    any_hit = False
    for beam in range(len(hits)):
        side = int(beams[beam, SIDE])
        if hits[beam] and side >= 0:
            way[LAST_HIT + side] = way[DRIVEN]
            any_hit = True
    has_moved = (
        way[DRIVEN] - way[DRIVEN_AT] >= settings.min_distance or way[TURNED] - way[TURNED_AT] >= settings.min_turn
    )
    if not (has_moved and any_hit):
        return
    if mind.counts[CLONES] == len(mind.clones):
        mind.counts[NO_PLACE] += 1
        let_go(mind, waiting, len(mind.clones) - 1)
    number = clone(mind)
    way[DRIVEN_AT], way[TURNED_AT] = way[DRIVEN], way[TURNED]
    for beam in range(len(hits)):
        side = int(beams[beam, SIDE])
        if hits[beam] and side >= 0:
            reading = waiting[side, mind.counts[WAITING + side]]
            reading[CLONE], reading[BEAM] = number, beam
            reading[RANGE], reading[DRIVEN_THEN] = ranges[beam], way[DRIVEN]
            mind.counts[WAITING + side] += 1
            mind.counts[FRESH + side] += 1


@algebra
def let_go(mind: Filter, waiting: FloatArray, most: int) -> None:
    """Keep only the clones that readings wait for, and no more than so many: `consistent._let_go`."""
    number = mind.counts[CLONES]
    clones = mind.clones[:number]
    wanted, count = np.zeros(number, dtype=np.bool_), 0
    for side in range(_SIDES):
        for i in range(mind.counts[WAITING + side]):
            wanted[place_of(clones, waiting[side, i, CLONE])] = True
    for place in range(number - 1, -1, -1):
        if wanted[place] and count == most:
            wanted[place] = False
        count += wanted[place]
    for side in range(_SIDES):
        size = 0
        for i in range(mind.counts[WAITING + side]):
            if wanted[place_of(clones, waiting[side, i, CLONE])]:
                waiting[side, size] = waiting[side, i]
                size += 1
        mind.counts[WAITING + side] = size
    keep_clones(mind, wanted)


@algebra
def place_of(clones: IntArray, number: float) -> int:
    """Where a clone is among those that are kept."""
    return int(np.searchsorted(clones, int(number)))


@algebra
def read(waiting: FloatArray, clones: IntArray, beams: FloatArray) -> tuple[IntArray, FloatArray]:
    """What waits on a side (n, 4): the places of the clones (n,), and beams and ranges (n, 4)."""
    count = len(waiting)
    places, reads = np.empty(count, dtype=np.int64), np.empty((count, 4))
    for i in range(count):
        beam, places[i] = int(waiting[i, BEAM]), place_of(clones, waiting[i, CLONE])
        reads[i, 0], reads[i, 1] = beams[beam, FROM_X], beams[beam, FROM_Y]
        reads[i, 2], reads[i, 3] = beams[beam, ANGLE], waiting[i, RANGE]
    return places, reads


@algebra
def use(
    mind: Filter, walls: Walls, every: FloatArray, side: int, driven: float, settings: Settings, beams: FloatArray,
    has_ended: bool,
) -> None:  # fmt: skip
    """Find lines in what waits, and let go of what is dealt with, or too old: `consistent._use`."""
    mind.counts[FRESH + side] = 0
    count, waiting = mind.counts[WAITING + side], every[side]
    places, reads = read(waiting[:count], mind.clones[: mind.counts[CLONES]], beams)
    points = end_points(mind.x, clones_from(mind), places, reads, reads[:, 3])
    owner, most = np.empty(count, dtype=np.int64), count // max(settings.min_votes, 1) + 1
    lines, ends, done = np.empty((most, 2)), np.empty((most, 2, 2)), np.zeros(count, dtype=np.bool_)
    max_gap = settings.gap_ahead if side == _AHEAD else settings.piece_gap
    number = extract(points, max_gap, settings, owner, lines, ends)
    for index in range(number):
        members = uncontested(points, owner, lines, ends, number, index, settings.near_corner)
        if not len(members):
            continue
        # The lines before this one have corrected the filter; the pieces of this one will.
        now = end_points(mind.x, clones_from(mind), places, reads, reads[:, 3])
        pieces, own = straight_pieces(mind, places, reads, now, members, lines[index], settings)
        for k in range(len(own)):
            these = own[k]
            latest = waiting[these, DRIVEN_THEN].max()
            is_complete = has_ended or driven - latest > settings.passed
            done[these] = incorporate(
                mind, walls, places[these], reads[these], now[these], pieces[k], settings, is_complete
            )  # fmt: skip
    oldest, size = np.inf if has_ended else driven - settings.max_age, 0
    for i in range(count):
        if not done[i] and waiting[i, DRIVEN_THEN] >= oldest:
            waiting[size] = waiting[i]
            size += 1
    mind.counts[WAITING + side] = size
    let_go(mind, every, settings.max_clones)


@algebra
def take_in(
    minds: Minds, ranges: FloatArray, wheels: FloatArray, settings: Settings, beams: FloatArray, measured: BoolArray
) -> None:
    """Move, take back what beams have gone through, and let new hits wait; marks which readings (b,) are new."""
    mind, hits = minds.filter, np.zeros(len(ranges), dtype=np.bool_)
    mind.counts[STEP] += 1
    move(mind, minds.way, wheels, settings)
    for beam in range(len(ranges)):
        is_number = math.isfinite(ranges[beam])
        mind.counts[REFUSED] += not is_number
        measured[beam] = is_number and mind.counts[STEP] % int(beams[beam, PERIOD]) == 0
        hits[beam] = measured[beam] and beams[beam, TOO_NEAR] < ranges[beam] < beams[beam, TOO_FAR]
    see_through(mind, minds.walls, ranges, measured, settings, beams)
    collect(mind, minds.way, minds.waiting, ranges, hits, settings, beams)


@entry
def step_some(
    minds: Minds,
    spec: Spec,
    ranges: FloatArray,
    wheels: FloatArray,
    chosen: IntArray,
    pose: FloatArray,
    covariance: FloatArray,
    grids: MarkArray,
) -> None:
    """Take in an observation of some robots, by number, and write down what they believe then."""
    # The compiler works through a kernel and all below it once more for each kernel above: one level less is faster.
    marks, settings = np.zeros((minds.grid.shape[1], minds.grid.shape[2]), dtype=np.uint8), spec.settings[0]
    measured = np.zeros(ranges.shape[1], dtype=np.bool_)
    for number in chosen:
        one = mind_of(minds, number)
        belief, way = one.filter, one.way
        take_in(one, ranges[number], wheels[number], settings, spec.beams, measured)
        for side in range(_SIDES):
            is_waiting = belief.counts[WAITING + side] > 0
            has_ended = is_waiting and way[DRIVEN] - way[LAST_HIT + side] > settings.wall_end
            if belief.counts[FRESH + side] >= settings.batch or has_ended:
                use(belief, one.walls, one.waiting, side, way[DRIVEN], settings, spec.beams, has_ended)
        pose[number] = belief.x[:POSE]
        covariance[number] = belief.top[:, :POSE]
        see(pose[number], one.grid, one.window, ranges[number], measured, settings, spec.beams, marks)
        if grids.shape[3]:
            crop(pose[number], one.grid, one.window, settings.cell, grids[number, 0])


@algebra
def begin(mind: Minds, start: FloatArray, cell: float) -> None:
    """Forget everything and begin at a known pose (3,), m, m, rad."""
    belief = mind.filter
    belief.counts[:] = 0
    belief.counts[STEP] = -1
    belief.x[:POSE] = start
    belief.top[:, :POSE] = 0.0
    mind.way[:] = 0.0
    mind.way[DRIVEN_AT], mind.way[TURNED_AT] = -np.inf, -np.inf
    mind.grid[:] = 0
    half = mind.grid.shape[0] // 2
    mind.window[0] = math.floor(start[1] / cell) - half
    mind.window[1] = math.floor(start[0] / cell) - half


@entry
def begin_some(minds: Minds, starts: FloatArray, chosen: IntArray, cell: float) -> None:
    """The same for some robots, by number."""
    for number in chosen:
        begin(mind_of(minds, number), starts[number], cell)
