"""Logs of long drives through made-up buildings that look alike in many places.

A campus is a ring of corridors of several hundred metres, with cross corridors. Some of its
corridors have no doors, along others stand equal rooms like the rungs of a ladder, and some of its
crossings are halls. A robot with a laser scanner of 180 degrees drives through it on rounds of
different lengths.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from benchmarks.scoreboard.made_up_logs import (
    ROBOT,
    MadeUpLog,
    between,
    cut_world,
    drifting_odometry,
    seen_ranges,
)
from limslam_env.bounds import Speeds, poses_along
from limslam_env.geometry import FloatArray
from limslam_env.worlds.world import World

# Sides of the campus, the wider one along x, and sides of its halls; m
_WIDTH = (150.0, 240.0)
_HEIGHT = (90.0, 180.0)
_HALL = (9.0, 16.0)
_CORRIDOR = (1.8, 3.0)  # m, width
# m
_ROOM_WIDTH = (3.0, 5.0)
_ROOM_DEPTH = (3.0, 6.0)
# m: thickness of the walls between rooms, and width of their doors
_WALL = 0.2
_DOOR = 1.0
# shares of crossings, corridors, and rooms entered
_HALLS = 0.3
_LADDERS = 0.5
_VISITS = 0.08
_BESIDE = 0.3  # m; standard deviation of the way from the middle of a corridor
_DETAILS = (0.01, 0.06)  # boxes and recesses per metre of wall
_DRIVEN = (900.0, 1900.0)  # m
_SPACING = (0.1, 0.5)  # m between two scans
_SPEED = 0.6  # m/s
_BEAMS = (11, 6, 36, 4)

# The turns of the first two are those of the logs, by the relations of 20 m and more. With the last
# one, odometry ends some metres off. The columns are those of ``ODOMETRY`` in
# :mod:`benchmarks.scoreboard.made_up_logs`.
ODOMETRY = {
    "as fr079": (0.01, 0.01, 0.7, 2.0, 0.02, 0),
    "as csail": (0.01, 0.01, 0.1, 0.8, 0.02, 0),
    "better": (0.003, 0.001, 0.001, 0.04, 0.002, 0),
}


@dataclass(frozen=True, eq=False)
class _Plan:
    """The crossings (columns, rows, 2), m, and the rectangles (k, 5) that are cut from the ground:
    x, y, width, height, m, and free or not. ``rooms`` has the doors and the middles (r, 2, 2), m,
    of the rooms of a corridor, by the indices of its two crossings.
    """

    crossings: FloatArray
    rectangles: list[list[float]]
    rooms: dict[tuple[int, int], FloatArray]


def _plan(generator: np.random.Generator) -> _Plan:
    columns = int(generator.integers(3, 5))
    rows = int(generator.integers(2, 4))
    width = generator.uniform(*_WIDTH)
    height = generator.uniform(*_HEIGHT)
    xs = 12.0 + width * _spread(columns, generator)
    ys = 12.0 + height * _spread(rows, generator)
    crossings = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1)
    plan = _Plan(crossings, [], {})
    for column in range(columns):
        for row in range(rows):
            for other in ((column + 1, row), (column, row + 1)):
                if other[0] < columns and other[1] < rows:
                    _add_corridor(plan, (column, row), other, generator)
    for middle in crossings.reshape(-1, 2):
        if generator.random() < _HALLS:
            sides = generator.uniform(*_HALL, 2)
            plan.rectangles.append([*(middle - 0.5 * sides), *sides, True])
    return plan


def _spread(count: int, generator: np.random.Generator) -> FloatArray:
    """Places from 0 to 1, the inner ones near to equal distances."""
    places = np.linspace(0.0, 1.0, count)
    places[1:-1] += generator.uniform(-0.25, 0.25, count - 2) / (count - 1)
    return places


def _add_corridor(
    plan: _Plan,
    first: tuple[int, int],
    second: tuple[int, int],
    generator: np.random.Generator,
) -> None:
    """Cut a corridor between two crossings, and perhaps equal rooms along one or both sides."""
    begin = plan.crossings[first]
    end = plan.crossings[second]
    along = int(first[0] == second[0])
    wide = generator.uniform(*_CORRIDOR)
    length = float((end - begin)[along])
    plan.rectangles.append(
        _rectangle(begin, along, (-0.5 * wide, length + 0.5 * wide), (-0.5 * wide, 0.5 * wide))
    )
    if generator.random() >= _LADDERS:
        return
    broad = generator.uniform(*_ROOM_WIDTH)
    deep = generator.uniform(*_ROOM_DEPTH)
    margin = _HALL[1]
    count = int((length - 2.0 * margin) / (broad + _WALL))
    doors = list[FloatArray]()
    for side in generator.permutation((-1.0, 1.0))[: generator.integers(1, 3)]:
        near = 0.5 * wide + _WALL
        for number in range(count):
            low = margin + number * (broad + _WALL)
            middle = low + 0.5 * broad
            across = sorted((side * near, side * (near + deep)))
            plan.rectangles.append(_rectangle(begin, along, (low, low + broad), across))
            door = (middle - 0.5 * _DOOR, middle + 0.5 * _DOOR)
            opening = sorted((side * (0.5 * wide - 0.1), side * (near + 0.1)))
            plan.rectangles.append(_rectangle(begin, along, door, opening))
            for away in (0.0, side * (near + 0.5 * deep)):
                doors.append(begin + np.array([middle, away] if along == 0 else [away, middle]))
    plan.rooms[_ends(plan, first, second)] = np.array(doors).reshape(-1, 2, 2)


def _rectangle(
    begin: FloatArray,
    along: int,
    span: tuple[float, float],
    across: list[float] | tuple[float, float],
) -> list[float]:
    """A free rectangle by its spans along an axis and across it, m, from a point (2,)."""
    low, high = (
        begin + np.array(each if along == 0 else each[::-1])
        for each in zip(span, across, strict=True)
    )
    return [*low, *(high - low), True]


def _ends(plan: _Plan, first: tuple[int, int], second: tuple[int, int]) -> tuple[int, int]:
    rows = plan.crossings.shape[1]
    low, high = sorted((first[0] * rows + first[1], second[0] * rows + second[1]))
    return low, high


def _route(plan: _Plan, length: float, generator: np.random.Generator) -> FloatArray:
    """Points (n, 2), m, of a drive from crossing to crossing, which seldom turns back, with visits
    of rooms.
    """
    columns, rows = plan.crossings.shape[:2]
    at = (0, 0)
    before = (0, 0)
    points = [plan.crossings[at]]
    driven = 0.0
    while driven < length:
        near = [
            (at[0] + step, at[1] + up)
            for step, up in ((1, 0), (-1, 0), (0, 1), (0, -1))
            if 0 <= at[0] + step < columns and 0 <= at[1] + up < rows
        ]
        choices = [each for each in near if each != before] or near
        following = choices[generator.integers(len(choices))]
        begin = plan.crossings[at]
        end = plan.crossings[following]
        rooms = plan.rooms.get(_ends(plan, at, following), np.zeros((0, 2, 2)))
        rooms = rooms[generator.random(len(rooms)) < _VISITS]
        for door, middle in rooms[np.argsort(((rooms[:, 0] - begin) ** 2).sum(axis=1))]:
            points += [door, middle, door]
        points.append(end)
        driven += float(np.hypot(*(end - begin)))
        before = at
        at = following
    return np.array(points)


def _wandering(route: FloatArray, generator: np.random.Generator) -> FloatArray:
    """A route (n, 2), m, whose long legs do not lie in the middle of the corridors."""
    points = [route[0]]
    for begin, end in pairwise(route):
        length = float(np.hypot(*(end - begin)))
        aside = np.array([begin[1] - end[1], end[0] - begin[0]]) / max(length, 1e-9)
        for share in np.arange(10.0, length - 5.0, generator.uniform(8.0, 20.0)) / max(
            length, 1e-9
        ):
            off = np.clip(generator.normal(0.0, _BESIDE), -0.45, 0.45)
            points.append(begin + share * (end - begin) + off * aside)
        points.append(end)
    return np.array(points)


def campus_world(seed: int, driven: tuple[float, float] = _DRIVEN) -> tuple[World, FloatArray]:
    """The building of a seed, and the points (n, 2), m, of a drive through it, whose least and
    largest length is ``driven``, m.
    """
    generator = np.random.default_rng([seed, 4])
    plan = _plan(generator)
    way = _wandering(_route(plan, generator.uniform(*driven), generator), generator)
    details = generator.uniform(*_DETAILS)
    rectangles = np.array(plan.rectangles)
    return cut_world(f"campus{seed}", rectangles, details, generator, way), way


def campus_log(
    seed: int, driven: tuple[float, float] = _DRIVEN, kinds: Sequence[str] = tuple(ODOMETRY)
) -> MadeUpLog:
    """The log of a seed, whose number decides how many beams are used of it: see
    :func:`campus_beams`. Its odometry is one of ``kinds``.
    """
    world, route = campus_world(seed, driven)
    generator = np.random.default_rng([seed, 5])
    path = poses_along(np.array([*route[0], 0.0]), route[1:], ROBOT, Speeds(_SPEED, 1.0))
    step = generator.uniform(*_SPACING) / (_SPEED * ROBOT.control_period)
    rows = np.arange(0.0, len(path) - 1.0, step)
    truth = between(rows, np.arange(float(len(path))), path)
    time = ROBOT.control_period * rows
    kind = str(generator.choice(list(kinds)))
    odometry = drifting_odometry(truth, ODOMETRY[kind], generator)
    ranges = seen_ranges(world, time, truth, generator)
    return MadeUpLog(f"campus{seed}", kind, time, truth, odometry, ranges)


def campus_beams(seed: int) -> tuple[float, ...]:
    """The directions of the beams that are used of a log, deg: 11, 6, 36 or 4 in turns."""
    spread = np.linspace(math.pi / 2, -math.pi / 2, _BEAMS[seed % len(_BEAMS)])
    return tuple(np.round(np.degrees(spread), 4).tolist())
