"""A rectangle cut into rooms and corridors, and doors between them. Lengths are whole millimetres.

Whole numbers keep every decision exact, so that a plan is the same on every machine.
"""

from collections import defaultdict
from collections.abc import Iterable
from typing import NamedTuple, TypeAlias

import numpy as np

# A door stands this far from the ends of the wall between two rooms: each jamb is a piece that
# beams can see.
DOOR_MARGIN = 150

# Walls meet a third one from two sides either far enough apart for a robot to tell, or not at all.
_JOG = 400

# A part whose sides are both shorter than this many smallest rooms may stay whole.
_LARGE_ROOM = 3
_STAYS_WHOLE = 0.25

# A part of the building gets a corridor of its own when it has room for this many rooms in a row.
_WING = 4

# Rooms turn to the corridor first: its doors are drawn with this share of the others' weight.
_CORRIDOR_WEIGHT = 0.25

_Interval: TypeAlias = tuple[int, int]


class Span(NamedTuple):
    """A line segment from ``low`` to ``high`` (mm) along an axis, 0 for x, 1 for y, ``at`` a place
    on the other.
    """

    axis: int
    at: int
    low: int
    high: int

    def ends(self) -> tuple[int, int, int, int]:
        """Both ends as x1, y1, x2, y2."""
        if self.axis == 0:
            return self.low, self.at, self.high, self.at
        return self.at, self.low, self.at, self.high


class Room(NamedTuple):
    """A rectangle from its lower left corner ``low`` (x, y) to its upper right one ``high``, mm."""

    low: tuple[int, int]
    high: tuple[int, int]
    is_corridor: bool = False

    def side(self, axis: int) -> int:
        """Extent along an axis, mm."""
        return self.high[axis] - self.low[axis]

    def between(self, axis: int, low: int, high: int, *, is_corridor: bool = False) -> "Room":
        """The part from ``low`` to ``high`` along an axis."""
        if axis == 0:
            return Room((low, self.low[1]), (high, self.high[1]), is_corridor)
        return Room((self.low[0], low), (self.high[0], high), is_corridor)


class Section(NamedTuple):
    """A wall segment that two rooms share, and the numbers of the rooms."""

    span: Span
    rooms: tuple[int, int]


class Measures(NamedTuple):
    """What rooms are drawn by: the settings of ``FloorPlanConfig``, lengths in mm.

    ``clearance`` is the least distance between things that do not touch.
    """

    min_room: int
    corridor_width: _Interval
    corridor: float
    clearance: int
    slanted: float
    obstacles: float
    obstacle_size: _Interval


def layout(
    size: tuple[int, int], measures: Measures, generator: np.random.Generator
) -> tuple[list[Room], list[Span]]:
    """Cut a rectangle of a size (x, y), mm, into rooms and corridors, and walls between them, still
    without doors.

    Where a wall ends, the rooms on its two sides share it for the length of a shortest side at
    least, for no corridor lies in a corner. So all rooms can be joined if that length is enough for
    a door, however the cuts fall.
    """
    cutter = _Cutter(measures, generator)
    todo: list[_Part] = [(Room((0, 0), size), None)]
    while todo:
        part, axis = todo.pop()
        parts = cutter.corridor_cut(part, axis) or cutter.room_cut(part, axis)
        todo += parts
        if not parts:
            cutter.rooms.append(part)
    return cutter.rooms, cutter.walls


# A part of the building that may be cut, and the axis that a corridor through it runs along; None:
# the longer side.
_Part: TypeAlias = tuple[Room, int | None]


class _Cutter:
    """The cuts of one layout, and the intervals where further walls may meet existing ones."""

    def __init__(self, measures: Measures, generator: np.random.Generator) -> None:
        self.rooms: list[Room] = []
        self.walls: list[Span] = []
        self._measures = measures
        self._generator = generator
        self._blocked: defaultdict[tuple[int, int], list[_Interval]] = defaultdict(list)

    def corridor_cut(self, part: Room, axis: int | None) -> list[_Part]:
        """The parts on both sides of a new corridor, in which further ones lead off it; or none."""
        smallest = self._measures.min_room
        along = axis if axis is not None else int(part.side(1) > part.side(0))
        across = 1 - along
        width = int(self._generator.integers(*self._measures.corridor_width, endpoint=True))
        is_large = min(part.side(0), part.side(1)) >= _WING * smallest + width
        if (self.walls and not is_large) or self._generator.random() >= self._measures.corridor:
            return []
        blocked = self._blocked_for(part, across)
        blocked += [(low - width, high - width) for low, high in blocked]
        places = _free_places(
            part.low[across] + smallest, part.high[across] - smallest - width, blocked
        )
        if not places:
            return []
        lower = self._drawn(places)
        upper = lower + width
        self._add_wall(part, along, lower)
        self._add_wall(part, along, upper)
        self.rooms.append(part.between(across, lower, upper, is_corridor=True))
        return [
            (part.between(across, upper, part.high[across]), across),
            (part.between(across, part.low[across], lower), across),
        ]

    def room_cut(self, part: Room, axis: int | None) -> list[_Part]:
        """Two parts with a wall between them; or none when the part is a room as it is."""
        smallest = self._measures.min_room
        first = int(part.side(1) > part.side(0))
        if part.side(first) < _LARGE_ROOM * smallest and self._generator.random() < _STAYS_WHOLE:
            return []
        # Long parts are cut across, so that rooms are no passages; the others either way.
        if 5 * part.side(first) < 7 * part.side(1 - first):
            first = int(self._generator.integers(2))
        for across in (first, 1 - first):
            low = part.low[across] + smallest
            high = part.high[across] - smallest
            places = _free_places(low, high, self._blocked_for(part, across))
            if places:
                at = self._drawn(places)
                self._add_wall(part, 1 - across, at)
                return [
                    (part.between(across, at, part.high[across]), axis),
                    (part.between(across, part.low[across], at), axis),
                ]
        return []

    def _blocked_for(self, part: Room, across: int) -> list[_Interval]:
        """Intervals of an axis at which a wall across it may not meet the sides of a part."""
        sides = (part.low[1 - across], part.high[1 - across])
        return [interval for side in sides for interval in self._blocked[across, side]]

    def _add_wall(self, part: Room, along: int, at: int) -> None:
        """Add a wall through a part, and forbid that later walls meet others close to it."""
        wall = Span(along, at, part.low[along], part.high[along])
        self.walls.append(wall)
        for side in (wall.low, wall.high):
            self._blocked[1 - along, side].append((at - _JOG, at + _JOG))

    def _drawn(self, places: list[_Interval]) -> int:
        """One of the numbers in closed intervals, each as likely as the others."""
        index = int(self._generator.integers(sum(high - low + 1 for low, high in places)))
        for low, high in places:
            if index <= high - low:
                return low + index
            index -= high - low + 1
        raise AssertionError("the index lies in one of the intervals")


def sections(rooms: list[Room], shortest: int) -> list[Section]:
    """Wall segments of at least ``shortest`` mm that two rooms share; two rectangles share one at
    most.
    """
    found = []
    for axis in (0, 1):
        across = 1 - axis
        below = defaultdict(list)
        for number, room in enumerate(rooms):
            below[room.high[across]].append(number)
        for number, room in enumerate(rooms):
            for other in below[room.low[across]]:
                low = max(room.low[axis], rooms[other].low[axis])
                high = min(room.high[axis], rooms[other].high[axis])
                if high - low >= shortest:
                    found.append(Section(Span(axis, room.low[across], low, high), (other, number)))
    return found


def opened(
    candidates: list[Section], rooms: list[Room], loops: float, generator: np.random.Generator
) -> list[Section]:
    """The sections that get a door: a random tree over all rooms, and a fraction ``loops`` of the
    remaining ones.
    """
    weights = generator.random(len(candidates)).tolist()
    for number, section in enumerate(candidates):
        weights[number] *= _CORRIDOR_WEIGHT ** sum(
            rooms[room].is_corridor for room in section.rooms
        )
    root = list(range(len(rooms)))
    tree: list[Section] = []
    others: list[Section] = []
    for number in sorted(range(len(candidates)), key=weights.__getitem__):
        first, second = (_root_of(room, root) for room in candidates[number].rooms)
        (others if first == second else tree).append(candidates[number])
        root[first] = second
    return tree + others[: round(loops * len(others))]


def door_in(section: Section, width: _Interval, generator: np.random.Generator) -> Span:
    """A door (mm) at a drawn place of a section, of a drawn width, with a margin to the section's
    ends.
    """
    axis, at, low, high = section.span
    space = high - low - 2 * DOOR_MARGIN
    opening = int(generator.integers(width[0], min(width[1], space), endpoint=True))
    start = low + DOOR_MARGIN + int(generator.integers(space - opening, endpoint=True))
    return Span(axis, at, start, start + opening)


def with_openings(walls: Iterable[Span], doors: Iterable[Span]) -> list[Span]:
    """The parts of walls between their doors."""
    in_line = defaultdict(list)
    for door in sorted(doors):
        in_line[door.axis, door.at].append(door)
    pieces = []
    for wall in walls:
        start = wall.low
        for door in in_line[wall.axis, wall.at]:
            if wall.low < door.low < wall.high:
                pieces.append(wall._replace(low=start, high=door.low))
                start = door.high
        pieces.append(wall._replace(low=start))
    return pieces


def _free_places(low: int, high: int, blocked: Iterable[_Interval]) -> list[_Interval]:
    """Closed intervals between ``low`` and ``high`` outside of open ones."""
    places = []
    for start, end in sorted(blocked):
        places.append((low, min(start, high)))
        low = max(low, end)
    places.append((low, high))
    return [(first, last) for first, last in places if first <= last]


def _root_of(room: int, root: list[int]) -> int:
    while root[room] != room:
        root[room] = root[root[room]]
        room = root[room]
    return room
