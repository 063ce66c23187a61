"""Random floor plans: rooms, corridors, doors, slanted walls and obstacles, with settings for
each.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from limslam_env.config import Setting, bounds_of, lies_within
from limslam_env.geometry.numbers import check_number
from limslam_env.messages import described
from limslam_env.worlds.generation.furnishing import Polygon, Segment, corner_cut, furnish
from limslam_env.worlds.generation.room_layout import (
    DOOR_MARGIN,
    Measures,
    Room,
    Span,
    door_in,
    layout,
    opened,
    sections,
    with_openings,
)
from limslam_env.worlds.world import World

LONGEST_SIDE = 100.0
MOST_OBSTACLES = 20.0
SMALLEST_OBSTACLE = 0.2

SPARE = 0.25
"""Least space between objects in a room beyond the robot's diameter, m."""

DOOR_SPARE = 0.10
"""Beyond a robot's diameter, m: the least width of doors and corridors."""


@dataclass(frozen=True)
class FloorPlanConfig:
    """Measures of random floor plans. A setting that is a range (low, high) is drawn from, for each
    plan or thing.

    Attributes
    ----------
    width, height
        Sides of the building, m; drawn for each plan.
    min_room
        Shortest side of a room, m.
    corridor
        Chance that a building that is wide enough has a corridor, and that each large part of it
        has another.
    corridor_width
        Width of a corridor, m; drawn for each.
    door_width
        Width of a door, m; drawn for each.
    loops
        Share of possible doors that are opened beyond the tree that joins all rooms: 0 leaves one
        way between any two rooms, 1 opens a door in every wall between two rooms that has space for
        one.
    slanted
        Chance, for each room, of a slanted wall that stands out from a wall or on its own, and of a
        slanted cut, for each corner of the building.
    obstacles
        Expected number of obstacles per 10 m^2 of room, where they find a place. They are convex
        polygons of 3 to 8 corners.
    obstacle_size
        Distance across an obstacle, m; drawn for each.

    Examples
    --------
    >>> import gymnasium as gym
    >>> from limslam_env import FloorPlanConfig
    >>> plans = FloorPlanConfig(width=(6.0, 9.0), height=6.0, obstacles=0.0)
    >>> env = gym.make("LimSlam-World-v0", world=plans)
    >>> _, info = env.reset(seed=3)
    >>> 6.0 <= env.unwrapped.world.size[0] <= 9.0
    True
    """

    width: Setting = (6.0, 10.0)
    height: Setting = (6.0, 10.0)
    min_room: float = 1.8
    corridor: float = 0.6
    corridor_width: Setting = (1.0, 1.4)
    door_width: Setting = (0.6, 1.0)
    loops: float = 0.3
    slanted: float = 0.3
    obstacles: float = 1.0
    obstacle_size: Setting = (0.3, 1.0)

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, list):
                object.__setattr__(self, name, tuple(value))
        for name in (
            "width",
            "height",
            "min_room",
            "corridor_width",
            "door_width",
            "obstacle_size",
        ):
            _check_length(name, getattr(self, name))
        for name in ("corridor", "loops", "slanted"):
            check_number(name, getattr(self, name), 0.0, 1.0)
        check_number("obstacles per 10 m^2", self.obstacles, 0.0, MOST_OBSTACLES)
        if bounds_of(self.obstacle_size)[0] < SMALLEST_OBSTACLE:
            raise ValueError(
                f"obstacle_size must be {SMALLEST_OBSTACLE:g} m or more, not {self.obstacle_size}"
            )
        _check_rooms(self)

    def check(self, radius: float) -> None:
        """Raise a ValueError if a robot of ``radius`` (m) does not get through all doors and
        corridors.
        """
        if not (math.isfinite(radius) and radius > 0.0):
            raise ValueError(f"a robot's radius must be a positive length, not {radius}")
        needed = round(2.0 * radius + DOOR_SPARE, 6)
        for name in ("door_width", "corridor_width"):
            narrowest = bounds_of(getattr(self, name))[0]
            if narrowest < needed:
                raise ValueError(
                    f"{name} {narrowest:g} m is too narrow for a robot of {radius:g} m radius, "
                    f"which needs {needed:g} m"
                )


def floor_plan(config: FloorPlanConfig, generator: np.random.Generator, radius: float) -> World:
    """Draw a closed building in which a robot of ``radius`` (m) can get everywhere but into
    obstacles.

    The same state of the generator, for the same settings and radius, gives the same plan on every
    machine, to the last bit; coordinates are whole millimetres. ``doors`` holds every opening
    between two rooms. There are no starts and no loop. A ValueError says that doors or corridors
    may be too narrow for the robot.
    """
    config.check(radius)
    size = _drawn_mm(config.width, generator), _drawn_mm(config.height, generator)
    measures = Measures(
        _mm(config.min_room),
        _range_mm(config.corridor_width),
        config.corridor,
        math.ceil(round(1000.0 * (2.0 * radius + SPARE), 6)),
        config.slanted,
        config.obstacles,
        _range_mm(config.obstacle_size),
    )
    rooms, walls = layout(size, measures, generator)
    doors, doors_of = _doors(rooms, config, generator)
    outline, cuts_of = _outline(rooms, size, measures, generator)
    segments = outline + [wall.ends() for wall in with_openings(walls, doors)]
    obstacles: list[Polygon] = []
    for room in rooms:
        slanted, polygons = furnish(room, doors_of[room], cuts_of[room], measures, generator)
        segments += slanted
        obstacles += polygons
    return _world(size, segments, obstacles, [door.ends() for door in doors])


def _doors(
    rooms: list[Room], config: FloorPlanConfig, generator: np.random.Generator
) -> tuple[list[Span], dict[Room, list[Segment]]]:
    """All doors, and those of each room."""
    width = _range_mm(config.door_width)
    candidates = sections(rooms, width[0] + 2 * DOOR_MARGIN)
    doors = []
    doors_of: dict[Room, list[Segment]] = {room: [] for room in rooms}
    for section in opened(candidates, rooms, config.loops, generator):
        door = door_in(section, width, generator)
        doors.append(door)
        for number in section.rooms:
            doors_of[rooms[number]].append(door.ends())
    return doors, doors_of


def _outline(
    rooms: list[Room], size: tuple[int, int], measures: Measures, generator: np.random.Generator
) -> tuple[list[Segment], dict[Room, list[Segment]]]:
    """The outer walls, counter-clockwise, with some corners cut off; and the cuts of each room."""
    points: Polygon = []
    cuts_of: dict[Room, list[Segment]] = {room: [] for room in rooms}
    for is_right, is_top in ((0, 0), (1, 0), (1, 1), (0, 1)):
        x = is_right * size[0]
        y = is_top * size[1]
        (room,) = [
            room
            for room in rooms
            if x in (room.low[0], room.high[0]) and y in (room.low[1], room.high[1])
        ]
        is_cut = generator.random() < measures.slanted
        cut = corner_cut(room, measures.clearance, generator) if is_cut else None
        if cut is None:
            points.append((x, y))
            continue
        on_x = (x - cut[0] if is_right else cut[0], y)
        on_y = (x, y - cut[1] if is_top else cut[1])
        # On the way round, the side that leads to the corner comes first.
        first, second = (on_y, on_x) if is_right == is_top else (on_x, on_y)
        points += [first, second]
        cuts_of[room].append((*first, *second))
    walls = [(*start, *end) for start, end in zip(points, points[1:] + points[:1], strict=True)]
    return walls, cuts_of


def _world(
    size: tuple[int, int], walls: list[Segment], obstacles: list[Polygon], doors: list[Segment]
) -> World:
    """The world of these millimetres, named after its content."""
    world = World(
        name="random",
        size=(size[0] / 1000.0, size[1] / 1000.0),
        walls=np.array(walls) / 1000.0,
        obstacles=tuple(np.array(polygon) / 1000.0 for polygon in obstacles),
        doors=np.array(doors).reshape(-1, 4) / 1000.0,
    )
    return replace(world, name=f"random-{world.digest[:8]}")


def _check_length(name: str, setting: Setting) -> None:
    if not lies_within(setting, 0.0, LONGEST_SIDE) or bounds_of(setting)[0] <= 0.0:
        raise ValueError(
            f"{name} must be a length up to {LONGEST_SIDE:g} m, or a range of such, not "
            f"{described(setting)}"
        )


def _check_rooms(config: FloorPlanConfig) -> None:
    for name in ("width", "height"):
        if bounds_of(getattr(config, name))[0] < config.min_room:
            raise ValueError(
                f"{name} {getattr(config, name)} is less than min_room, {config.min_room:g} m"
            )
    needed = (_mm(bounds_of(config.door_width)[1]) + 2 * DOOR_MARGIN) / 1000.0
    if config.min_room < needed:
        raise ValueError(
            f"min_room must be {needed:g} m or more, not {config.min_room:g}: the widest door "
            "needs that much wall"
        )


def _mm(length: float) -> int:
    return round(1000.0 * length)


def _range_mm(setting: Setting) -> tuple[int, int]:
    low, high = bounds_of(setting)
    return _mm(low), _mm(high)


def _drawn_mm(setting: Setting, generator: np.random.Generator) -> int:
    return int(generator.integers(*_range_mm(setting), endpoint=True))
