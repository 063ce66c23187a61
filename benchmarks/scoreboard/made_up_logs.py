"""Logs of drives that were made up, and how well they are smoothed when few of their readings are
used.

A robot with a laser scanner of 180 degrees drives through a building that was not used for
development. Its odometry has errors of several kinds, its ranges are older than its odometry, and
people walk past.
"""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from benchmarks.scoreboard.drives import LEAST_WAY, next_place
from benchmarks.suite.runner import data_file
from limslam_agent.config.graph import GraphConfig
from limslam_agent.logs.pose_log import MIN_RANGE, nearest_beams
from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.logs.relations import Relations, relation_errors, summary
from limslam_agent.replay.smoothing import trusted_path
from limslam_agent.slam.map_graph.key_poses import LogData, integrate
from limslam_agent.slam.map_graph.reversing import with_reversing
from limslam_env.bounds import Roadmap, Speeds, poses_along
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2
from limslam_env.interface import RobotSpec, SensorSpec
from limslam_env.metrics import trajectory_metrics
from limslam_env.simulation.sensors import build_wall_index, cast
from limslam_env.worlds.formats.loading import load_world
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan
from limslam_env.worlds.regions import starting_cells
from limslam_env.worlds.world import World, WorldError

ROBOT = RobotSpec(radius=0.25)
BEAMS = np.radians(np.arange(180.0) - 90.0)
"""Directions of the scanner, rad."""
_REACH = 81.91  # m; what the scanner reads where it sees nothing
_CELL = 0.1  # m; of the floors that rings and halls are cut from
_CLEAR = 3  # cells that a robot needs to either side
_RECESSES = 0.4  # share of recesses among the details of walls; the others are boxes
# m; of real plans
_LEAST_SIDE = 10.0
_LARGEST_SIDE = 60.0
# s and m between the ends of a relation that is a loop
_LOOP_AFTER = 60.0
_LOOP_WITHIN = 1.5
_RELATIONS = 300  # of each kind
# m: a drive with few revisits ends after this way, when all places were near
_LEAST_DRIVEN = 40.0
_SEEN_WITHIN = 4.0
# m
_SHORTEST_FLIGHT = 5.0
_LONGEST_FLIGHT = 15.0
# m; longest range that is used, and the standard deviation that the smoother is told
_RANGE = 5.0
_STD = 0.02

# Constant errors of distances and turns (shares), and of the heading (deg/m), whose signs are
# drawn; standard deviations of the heading after one metre (deg) and after one radian (rad); and
# the number of slips.
ODOMETRY = {
    "good": (0.005, 0.005, 0.02, 0.3, 0.01, 0),
    "medium": (0.03, 0.05, 0.2, 1.0, 0.03, 1),
    "uneven": (0.01, 0.02, 2.2, 0.8, 0.02, 0),
    "bad": (0.04, 0.07, 1.0, 1.5, 0.05, 3),
}
_SLIP = (
    0.3,
    0.05,
    math.radians(15.0),
)  # standard deviations of a slip: ahead and aside, m, and turned, rad


def walls_of(floor: BoolArray) -> FloatArray:
    """The borders (k, 4), m, of a floor of cells (columns, rows)."""
    walls = list[FloatArray]()
    for cells, order in ((floor, [0, 1, 2, 3]), (floor.T, [1, 0, 3, 2])):
        for line, changed in enumerate(np.diff(np.pad(cells, 1).astype(np.int8), axis=0)):
            # A wall goes on as long as the floor stays on the same side.
            for low, high in pairwise(np.flatnonzero(np.diff(changed, prepend=0, append=0))):
                if changed[low]:
                    walls.append(np.array([line, low - 1, line, high - 1])[order])
    return _CELL * np.array(walls)


def cut_world(
    name: str,
    rectangles: FloatArray,
    details: float,
    generator: np.random.Generator,
    driven: FloatArray | None = None,
) -> World:
    """A world whose floor is cut from solid ground: rectangles (k, 5) of x, y, width, height, m,
    and free or not.

    Boxes and recesses of up to 0.5 m stand at its walls, ``details`` of them a metre, but not on a
    way (n, 2), m, that will be driven. The start is in the first one.
    """
    width, height = (rectangles[:, :2] + rectangles[:, 2:4]).max(axis=0) + 1.0
    floor = np.zeros((math.ceil(width / _CELL), math.ceil(height / _CELL)), dtype=np.bool_)
    for *corners, free in rectangles:
        i, j, m, n = (round(each / _CELL) for each in corners)
        floor[i : i + m, j : j + n] = free
    borders = np.concatenate([np.argwhere(np.diff(floor, axis=axis)) for axis in (0, 1)])
    for i, j in generator.choice(borders, int(details * _CELL * len(borders))):
        m, n = generator.integers(1, 6, 2)
        floor[i - m : i + m, j - n : j + n] = generator.random() < _RECESSES
    for i, j in () if driven is None else _cells_along(driven):
        floor[i - _CLEAR : i + _CLEAR + 1, j - _CLEAR : j + _CLEAR + 1] = True
    start = np.array([[*rectangles[0, :2] + 0.9, 0.0]])
    return World(name, (width, height), walls_of(floor), starts=start)


def travel_along(way: FloatArray) -> FloatArray:
    """The distance (n,) driven to each point of a way (n, 2), m."""
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(way, axis=0).T)))


def between(where: FloatArray, known: FloatArray, rows: FloatArray) -> FloatArray:
    """Rows (k, c) at some places (k,), by the rows (n, c) at known places (n,)."""
    return np.column_stack([np.interp(where, known, column) for column in rows.T])


def _cells_along(way: FloatArray) -> IntArray:
    """The cells (k, 2) along a way (n, 2), m."""
    travel = travel_along(way)
    points = between(np.arange(0.0, travel[-1], _CELL), travel, way)
    return np.unique(np.round(points / _CELL).astype(np.int64), axis=0)


def _ring(generator: np.random.Generator) -> World:
    """Corridors around one to three blocks that cannot be entered."""
    width, height, wide = generator.uniform((20.0, 14.0, 1.8), (42.0, 28.0, 2.8))
    blocks = generator.integers(1, 4)
    step = (height - wide) / blocks
    rows = [
        [1.0 + wide, 1.0 + wide + row * step, width - 2.0 * wide, step - wide, False]
        for row in range(blocks)
    ]
    return cut_world(
        "ring",
        np.array([[1.0, 1.0, width, height, True], *rows]),
        generator.uniform(0.02, 0.2),
        generator,
    )


def _halls(generator: np.random.Generator) -> World:
    """Two to four halls in a row, joined by corridors."""
    x = 1.0
    wide = generator.uniform(1.8, 2.8)
    rectangles = list[list[float]]()
    for width, height, gap, y in generator.uniform(
        (8, 8, 2, 1), (15, 15, 8, 5), (generator.integers(2, 5), 4)
    ):
        rectangles += [[x, 1.0, width, height, True], [x + width - 0.1, y, gap + 0.2, wide, True]]
        x += width + gap
    return cut_world("halls", np.array(rectangles[:-1]), generator.uniform(0.05, 0.2), generator)


def _rooms(generator: np.random.Generator) -> World:
    """A random plan of rooms and corridors."""
    config = FloorPlanConfig(
        width=(14.0, 32.0),
        height=(10.0, 22.0),
        min_room=2.6,
        corridor=1.0,
        corridor_width=(1.5, 2.4),
        door_width=(0.9, 1.3),
        obstacles=generator.uniform(0.1, 1.5),
    )
    return floor_plan(config, generator, ROBOT.radius + 0.1)


def _real(generator: np.random.Generator) -> World:
    """A floor plan of the recorded data, of a closed building of a usual size."""
    files = sorted(data_file("kth").glob("*.json"))
    for number in generator.permutation(len(files)):
        world = load_world(files[number])
        sides = np.ptp(world.edges.reshape(-1, 2), axis=0)
        with suppress(WorldError):
            if sides.min() >= _LEAST_SIDE and sides.max() <= _LARGEST_SIDE:
                world.check(ROBOT.radius)
                return world
    raise ValueError("there is no floor plan that a robot can drive in")


WORLDS: dict[str, Callable[[np.random.Generator], World]] = {
    "rooms": _rooms,
    "ring": _ring,
    "halls": _halls,
    "real": _real,
}


def driven_path(
    world: World, length: float, generator: np.random.Generator, *, revisits: bool = True
) -> FloatArray:
    """Poses (n, 3) in each control period of a drive of at least ``length`` m from place to place,
    with stops there.

    Without ``revisits``, the robot only goes to new places, and stops when no place is far from
    where it has been. Headings are not wrapped.
    """
    space = world.free_space(ROBOT.radius)
    centres = space.centres(starting_cells(world, space))
    roads = Roadmap(world, ROBOT.radius, centres[generator.integers(len(centres))])
    speeds = Speeds(generator.uniform(0.3, 0.7), generator.uniform(0.5, 1.2))
    at = roads.places[0]
    been = [roads.places[0]]
    driven = 0.0
    parts = [np.array([[*at, 0.0]])]
    while driven < length:
        goal, farthest = next_place(roads, been, generator, revisits=revisits)
        if not revisits and driven > _LEAST_DRIVEN and farthest < _SEEN_WITHIN:
            break
        way = roads.way(at, goal)
        if way is None or np.hypot(*(goal - at)) < LEAST_WAY:
            continue
        leg = poses_along(parts[-1][-1], way, ROBOT, speeds)
        parts += [leg[1:], np.tile(leg[-1], (int(generator.integers(1, 30)), 1))]
        driven += float(travel_along(leg[:, :2])[-1])
        at = goal
        been = [*been, *way]
    return np.concatenate(parts)


@dataclass(frozen=True, eq=False)
class MadeUpLog:
    """A drive: the kind of its building with the seed, its kind of odometry, a key of ``ODOMETRY``,
    and its scans.

    Of these: times (n,), s; true poses and odometry (n, 3); ranges (n, b), m, of ``BEAMS`` or of
    the beams that it was made for.
    """

    name: str
    errors: str
    time: FloatArray
    truth: FloatArray
    odometry: FloatArray
    ranges: FloatArray


def flight_log(seed: int, beams: FloatArray) -> MadeUpLog:
    """A short flight of a seed, of 5 to 15 m without a second visit, with beams (b,), rad."""
    generator = np.random.default_rng([seed, 6])
    world = _rooms(generator)
    path = driven_path(world, _LONGEST_FLIGHT, generator, revisits=False)
    path = path[travel_along(path[:, :2]) <= generator.uniform(_SHORTEST_FLIGHT, _LONGEST_FLIGHT)]
    time = ROBOT.control_period * np.arange(float(len(path)))
    errors = str(generator.choice(("good", "medium")))
    odometry = drifting_odometry(path, (*ODOMETRY[errors][:5], 0), generator)
    ranges = seen_ranges(world, time, path, generator, beams)
    return MadeUpLog(f"flight{seed}", errors, time, path, odometry, ranges)


def made_up_log(seed: int, length: float | None = None, *, revisits: bool = True) -> MadeUpLog:
    """The log of a seed; the kinds of buildings take turns. ``length`` is the distance driven, m;
    None to draw it.
    """
    generator = np.random.default_rng(seed)
    kind = list(WORLDS)[seed % len(WORLDS)]
    world = WORLDS[kind](generator)
    path = driven_path(
        world, length or generator.uniform(100.0, 220.0), generator, revisits=revisits
    )
    period = ROBOT.control_period
    delay = generator.uniform(0.0, 0.15)
    time = np.arange(0.0, period * (len(path) - 1) - delay, generator.uniform(0.15, 0.4))
    times = period * np.arange(float(len(path)))
    truth = between(time, times, path)
    later = between(time + delay, times, path)
    errors = str(generator.choice(list(ODOMETRY)))
    odometry = drifting_odometry(later, ODOMETRY[errors], generator)
    return MadeUpLog(
        f"{kind}{seed}", errors, time, truth, odometry, seen_ranges(world, time, truth, generator)
    )


def drifting_odometry(
    truth: FloatArray, errors: tuple[float, ...], generator: np.random.Generator
) -> FloatArray:
    """Poses (n, 3) by odometry with errors like one of ``ODOMETRY``, along a path (n, 3) of true
    poses.
    """
    scale, gain, turn, per_metre, per_radian, slips = errors
    signs = generator.choice((-1.0, 1.0), 3)
    moves = se2.between(truth[:-1], truth[1:])
    driven = np.hypot(moves[:, 0], moves[:, 1])
    turned = np.abs(moves[:, 2])
    stds = np.radians(per_metre) * np.sqrt(driven) + per_radian * np.sqrt(turned)
    moves[:, 2] += signs[1] * gain * moves[:, 2] + signs[2] * np.radians(turn) * driven
    moves[:, 2] += stds * generator.standard_normal(len(moves))
    moves[:, :2] *= 1.0 + signs[0] * scale + 0.05 * generator.standard_normal((len(moves), 1))
    for place in generator.choice(len(moves), int(slips), replace=False):
        moves[place] += generator.normal(0.0, _SLIP)
    return integrate(np.zeros(3), moves)


def seen_ranges(
    world: World,
    time: FloatArray,
    truth: FloatArray,
    generator: np.random.Generator,
    beams: FloatArray = BEAMS,
) -> FloatArray:
    """Ranges (n, b), m, of beams (b,), rad, with noise, lost readings, walls of glass that are not
    seen, and people who walk past.
    """
    edges = world.edges[generator.random(len(world.edges)) >= generator.choice((0.0, 0.05))]
    angles = truth[:, 2:] + beams
    directions = np.stack((np.cos(angles), np.sin(angles)), axis=-1).reshape(-1, 2)
    origins = np.repeat(truth[:, :2], len(beams), axis=0)
    ranges, _ = cast(build_wall_index(edges), origins, directions, np.full(angles.size, _REACH))
    ranges = ranges.reshape(angles.shape)
    for begin in np.cumsum(
        generator.exponential(generator.uniform(8.0, 60.0), int(time[-1] / 8.0))
    ):
        lasts, (bearing, distance) = (
            generator.uniform(1.0, 5.0),
            generator.uniform((-1.5, 0.5), (1.5, 4.0), (2, 2)).T,
        )
        rows = np.flatnonzero((time >= begin) & (time < begin + lasts))
        share = ((time[rows] - begin) / lasts)[:, None]
        away = distance[0] + share * (distance[1] - distance[0])
        covered = np.abs(beams - bearing[0] - share * (bearing[1] - bearing[0])) < 0.2 / away
        ranges[rows] = np.where(covered, np.minimum(ranges[rows], away), ranges[rows])
    seen = (ranges < _REACH) & (
        generator.random(ranges.shape) >= generator.choice((0.0, 0.01, 0.08))
    )
    noisy = ranges + generator.choice((0.01, 0.03)) * generator.standard_normal(ranges.shape)
    return np.where(seen, np.maximum(noisy, MIN_RANGE), _REACH)


def as_recorded(log: MadeUpLog, beams: tuple[float, ...], max_range: float) -> RecordedLog:
    """The log as it is read from a file, with some of its beams, deg, and their longest range,
    m.
    """
    count = log.ranges.shape[1]
    directions = BEAMS if count == len(BEAMS) else np.radians(beams)
    used = nearest_beams(np.degrees(directions), beams)
    sensors = tuple(
        SensorSpec(0.0, 0.0, float(directions[beam]), MIN_RANGE, max_range) for beam in used
    )
    return RecordedLog(
        robot=replace(ROBOT, beams=sensors),
        time=log.time,
        ranges=np.minimum(log.ranges[:, used], max_range).astype(np.float32),
        has_scan=np.ones(len(log.time), dtype=np.bool_),
        start_pose=log.truth[0],
        odometry=log.odometry,
        true_pose=log.truth,
    )


def known_relations(log: MadeUpLog) -> Relations:
    """True motions of the robot: over about a second, and as many loops where there are any."""
    generator = np.random.default_rng(len(log.time))
    count = len(log.time)
    firsts = generator.choice(count - 1, min(_RELATIONS, count - 1), replace=False)
    near = np.column_stack(
        (firsts, np.minimum(np.searchsorted(log.time, log.time[firsts] + 1.0), count - 1))
    )
    some = generator.integers(count, size=(200 * _RELATIONS, 2))
    apart = np.hypot(*(log.truth[some[:, 0], :2] - log.truth[some[:, 1], :2]).T)
    loops = some[
        (apart < _LOOP_WITHIN) & (log.time[some[:, 1]] - log.time[some[:, 0]] > _LOOP_AFTER)
    ]
    begin, end = np.concatenate((near, loops[:_RELATIONS])).T
    return Relations(log.time[begin], log.time[end], se2.between(log.truth[begin], log.truth[end]))


def sparse_sensor(seed: int, few: float, many: float) -> tuple[tuple[float, ...], float]:
    """The beams of a log, deg (4, 6, 8 or 11 in turns), and the readings of walls in a metre of
    driving, from few to many.
    """
    count = (4, 6, 8, 11)[seed // 8 % 4]
    points = few * (many / few) ** np.random.default_rng([seed, 1]).random()
    return tuple(np.round(np.linspace(90.0, -90.0, count), 4).tolist()), float(f"{points:.3g}")


def thinned(hit: BoolArray, moves: FloatArray, points: float) -> BoolArray:
    """The hits (n, b) of so many scans, evenly spread, that ``points`` of them are left in a metre
    of driving.
    """
    share = min(
        1.0, points * float(np.hypot(moves[:, 0], moves[:, 1]).sum()) / max(1, int(hit.sum()))
    )
    number = np.cumsum(hit.any(axis=1))
    return np.asarray(hit & (np.floor(share * number) > np.floor(share * (number - 1)))[:, None])


def smoothing_scores(
    log: MadeUpLog, sensor: tuple[tuple[float, ...], float], jitter: float
) -> dict[str, Any]:
    """The errors of a log's path, smoothed without the filter in front of it, its status, and the
    processor time.

    The errors are those of the relations, and of the positions after rigid alignment, m, also of
    odometry alone. ``nees_smoothed`` compares the square of the latter error with the stated one.
    ``sensor`` has the beams that are used, deg, and the readings in a metre of driving. ``jitter``
    is the standard deviation of further noise of the ranges, m.
    """
    beams, points = sensor
    used = nearest_beams(np.degrees(BEAMS), beams)
    rows = np.arange(len(log.time))
    # As in logs of robots, some odometry comes by itself.
    rows = np.repeat(rows, 1 + (rows % 10 == 0))
    has_scan = np.append(rows[:-1] < rows[1:], True)
    time_s = log.time[rows]
    odometry = np.round(log.odometry[rows], 6)
    ranges = np.minimum(np.round(log.ranges[rows][:, used], 2), _RANGE)
    ranges = np.where(has_scan[:, None], ranges, _RANGE)
    hit = (ranges > MIN_RANGE) & (ranges < _RANGE)
    moves = se2.between(odometry[:-1], odometry[1:])
    noise = jitter * np.random.default_rng(1).standard_normal(ranges.shape)
    data = LogData(
        time_s,
        odometry,
        np.where(hit, ranges + noise, ranges),
        thinned(hit, moves, points),
        np.zeros((len(beams), 2)),
        BEAMS[used],
        _RANGE,
        _STD,
    )
    config = GraphConfig()
    begin = time.process_time()
    found, signals = trusted_path(with_reversing(data, config), np.zeros(3), config)
    seconds = time.process_time() - begin
    known = known_relations(log)
    errors = relation_errors(known, time_s, found.poses, data.odometry)
    of_odometry = relation_errors(known, time_s, data.odometry, data.odometry)
    aligned, drifted = (
        trajectory_metrics(log.truth[rows], poses)["ate_aligned_m"] or 0.0
        for poses in (found.poses, data.odometry)
    )
    stated = signals.position_std
    return {
        "ate_odometry_m": summary(of_odometry)["relation_error_m"],
        "ate_odometry_aligned_m": drifted,
        "ate_smoothed_m": summary(errors)["relation_error_m"],
        "ate_smoothed_aligned_m": aligned,
        "stated_m": stated,
        "nees_smoothed": (aligned / stated) ** 2 if stated else None,
        "status": signals.status.level,
        "smoothing_cpu_s": seconds,
    }
