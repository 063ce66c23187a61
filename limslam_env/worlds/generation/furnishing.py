"""The content of rooms: slanted walls and polygons, placed so that a robot can drive around all of
them.

Lengths are whole millimetres and distances are compared as squares, without rounding. Corners of
polygons come from sums, products and quotients of floats alone, which every machine rounds alike;
sines and cosines it may not.
"""

from dataclasses import dataclass, field
from math import isqrt
from typing import NamedTuple, TypeAlias

import numpy as np

from limslam_env.worlds.generation.room_layout import Measures, Room

Point: TypeAlias = tuple[int, int]
Segment: TypeAlias = tuple[int, int, int, int]
Polygon: TypeAlias = list[Point]

_TRIES = 6

# Beside the clearance, so that nothing stands in a doorway.
_BEFORE_DOORS = 150

_SHORTEST_CUT = 300
_LONGEST_CUT = 1200
_SHALLOWEST_STUB = 500
_DEEPEST_STUB = 1800
_STUB_SHARE = 0.8
_STUB_TRIES = 16
_FREE_HALF = (150, 500)
_AT_WALL_SHARE = 0.4
_RECTANGLE_SHARE = 0.3
_UPRIGHT_SHARE = 0.7


def furnish(
    room: Room,
    doors: list[Segment],
    cuts: list[Segment],
    measures: Measures,
    generator: np.random.Generator,
) -> tuple[list[Segment], list[Polygon]]:
    """Slanted walls and obstacles for a room with its doors and cut corners; objects that do not
    fit are left out.

    All keep the clearance from everything but the one wall that they may stand at. So what is free
    is still one piece, for every robot that the clearance lets pass. Corridors stay empty. The
    polygons are convex, with their corners counter-clockwise.
    """
    contents = _Contents(room, doors, cuts)
    if room.is_corridor:
        return [], []
    if generator.random() < measures.slanted:
        _put_slanted_wall(contents, measures.clearance, generator)
    expected = measures.obstacles * (room.side(0) * room.side(1)) / 1e7
    # The fraction of the expected number is the probability of one more obstacle.
    for _ in range(int(expected + generator.random())):
        _put_obstacle(contents, measures, generator)
    return contents.walls, contents.obstacles


def corner_cut(room: Room, clearance: int, generator: np.random.Generator) -> Point | None:
    """How much of a room's sides along x and y (mm) a cut takes off at an outer corner; None if
    there is no space.
    """
    longest = [
        min(_LONGEST_CUT, room.side(axis) // 3, room.side(axis) - clearance) for axis in (0, 1)
    ]
    if room.is_corridor or min(longest) < _SHORTEST_CUT:
        return None
    along_x, along_y = (
        int(generator.integers(_SHORTEST_CUT, end, endpoint=True)) for end in longest
    )
    return along_x, along_y


class _Disc(NamedTuple):
    """The smallest circle that is kept for an obstacle: centre and radius, mm."""

    x: int
    y: int
    radius: int


@dataclass
class _Contents:
    """The content of a room during generation: its openings, the corners that are cut off, and
    slanted walls.

    ``discs`` are circles around what stands free, ``boxes`` lower left and upper right corners of
    what stands at a wall, and ``obstacles`` the polygons within them.
    """

    room: Room
    doors: list[Segment]
    cuts: list[Segment]
    walls: list[Segment] = field(default_factory=list)
    discs: list[_Disc] = field(default_factory=list)
    boxes: list[Segment] = field(default_factory=list)
    obstacles: list[Polygon] = field(default_factory=list)


def _put_slanted_wall(contents: _Contents, clearance: int, generator: np.random.Generator) -> None:
    """A stub that starts at a wall, or sometimes a free-standing slanted wall."""
    if generator.random() < _STUB_SHARE:
        for _ in range(_STUB_TRIES):
            stub = _stub(contents.room, clearance, generator)
            if stub is not None and _keeps_clear(stub, contents, clearance):
                contents.walls.append(stub)
                return
    across, up = (int(half) for half in generator.integers(*_FREE_HALF, size=2, endpoint=True))
    up = up if generator.random() < 0.5 else -up
    disc = _placed(contents, isqrt(across * across + up * up) + 1, clearance, generator)
    if disc is not None:
        contents.discs.append(disc)
        contents.walls.append((disc.x - across, disc.y - up, disc.x + across, disc.y + up))


def _stub(room: Room, clearance: int, generator: np.random.Generator) -> Segment | None:
    """A wall from a drawn side of a room inwards, at 45 degrees or more to that side; None if it
    finds no space.
    """
    axis = int(generator.integers(2))
    is_high = bool(generator.integers(2))
    deepest = min(_DEEPEST_STUB, room.side(1 - axis) - clearance)
    first = room.low[axis] + clearance
    last = room.high[axis] - clearance
    if deepest < _SHALLOWEST_STUB or first > last:
        return None
    depth = int(generator.integers(_SHALLOWEST_STUB, deepest, endpoint=True))
    lean = int(generator.integers(depth // 4, depth, endpoint=True))
    foot = int(generator.integers(first, last, endpoint=True))
    head = foot + (lean if generator.random() < 0.5 else -lean)
    if not first <= head <= last:
        return None
    base = room.low[1 - axis]
    tip = room.low[1 - axis] + depth
    if is_high:
        base = room.high[1 - axis]
        tip = room.high[1 - axis] - depth
    return (foot, base, head, tip) if axis == 0 else (base, foot, tip, head)


def _put_obstacle(contents: _Contents, measures: Measures, generator: np.random.Generator) -> None:
    radius = int(generator.integers(*measures.obstacle_size, endpoint=True)) // 2
    if generator.random() < _AT_WALL_SHARE:
        box = _box_at_wall(contents, radius, measures.clearance, generator)
        if box is not None:
            contents.boxes.append(box)
            contents.obstacles.append(_corners(box))
            return
    disc = _placed(contents, radius, measures.clearance, generator)
    if disc is not None:
        contents.discs.append(disc)
        # The radius is a millimetre smaller, since corners are rounded to millimetres.
        contents.obstacles.append(_polygon(disc._replace(radius=radius - 1), generator))


def _box_at_wall(
    contents: _Contents, radius: int, clearance: int, generator: np.random.Generator
) -> Segment | None:
    """A rectangle with its longer side on a wall, and half a diagonal of ``radius``; None if it
    finds no place.
    """
    room = contents.room
    axis = int(generator.integers(2))
    is_high = bool(generator.integers(2))
    depth, width = sorted(int(2 * radius * side) for side in _on_circle(_drawn_quarter(generator)))
    first = room.low[axis] + clearance
    last = room.high[axis] - clearance - width
    if first > last or room.side(1 - axis) < depth + clearance:
        return None
    base = room.high[1 - axis] - depth if is_high else room.low[1 - axis]
    for foot in generator.integers(first, last, size=_TRIES, endpoint=True).tolist():
        box = (
            (foot, base, foot + width, base + depth)
            if axis == 0
            else (base, foot, base + depth, foot + width)
        )
        corners = _corners(box)
        edges = [
            (*start, *end) for start, end in zip(corners, corners[1:] + corners[:1], strict=True)
        ]
        if (
            all(
                _boxes_are_apart((disc.x, disc.y, disc.x, disc.y), box, disc.radius + clearance)
                for disc in contents.discs
            )
            and all(_boxes_are_apart(box, other, clearance) for other in contents.boxes)
            and all(_keeps_clear(edge, contents, clearance) for edge in edges)
        ):
            return box
    return None


def _drawn_quarter(generator: np.random.Generator) -> float:
    """The angle of a rectangle's corner on a quarter circle, not too near to either end."""
    return 0.05 + 0.15 * float(generator.random())


def _placed(
    contents: _Contents, radius: int, clearance: int, generator: np.random.Generator
) -> _Disc | None:
    """A disc at a drawn place where it keeps the clearance from everything in the room; None if
    none was found.
    """
    keep = radius + clearance
    low = [side + keep for side in contents.room.low]
    high = [side - keep for side in contents.room.high]
    if low[0] > high[0] or low[1] > high[1]:
        return None
    for _ in range(_TRIES):
        x, y = (int(place) for place in generator.integers(low, high, endpoint=True))
        if (
            all(
                (x - disc.x) ** 2 + (y - disc.y) ** 2 >= (keep + disc.radius) ** 2
                for disc in contents.discs
            )
            and all(_boxes_are_apart((x, y, x, y), box, keep) for box in contents.boxes)
            and not any(_is_near((x, y), wall, keep) for wall in (*contents.cuts, *contents.walls))
            and not any(_is_near((x, y), door, keep + _BEFORE_DOORS) for door in contents.doors)
        ):
            return _Disc(x, y, radius)
    return None


def _keeps_clear(wall: Segment, contents: _Contents, clearance: int) -> bool:
    return all(
        _are_apart(wall, other, clearance) for other in (*contents.cuts, *contents.walls)
    ) and all(_are_apart(wall, door, clearance + _BEFORE_DOORS) for door in contents.doors)


def _polygon(disc: _Disc, generator: np.random.Generator) -> Polygon:
    """A convex polygon of 3 to 8 corners within a disc, counter-clockwise: a rectangle, or corners
    on an ellipse.
    """
    if generator.random() < _RECTANGLE_SHARE:
        x, y = _on_circle(_drawn_quarter(generator))
        corners = [(x, y), (-x, y), (-x, -y), (x, -y)]
        is_upright = generator.random() < _UPRIGHT_SHARE
        turn = 0.0 if is_upright else float(generator.random())
    else:
        count = int(generator.integers(3, 8, endpoint=True))
        flatness = 1.0 - 0.4 * float(generator.random())
        turns = (np.arange(count) + 0.4 * generator.random(count)) / count
        corners = [(x, flatness * y) for x, y in map(_on_circle, turns.tolist())]
        turn = float(generator.random())
    cosine, sine = _on_circle(turn)
    return [
        (
            disc.x + round(disc.radius * (cosine * x - sine * y)),
            disc.y + round(disc.radius * (sine * x + cosine * y)),
        )
        for x, y in corners
    ]


def _on_circle(turn: float) -> tuple[float, float]:
    """A point of the unit circle, at a fraction ``turn`` (0 to 1) of the circle."""
    quarter = int(4.0 * turn)
    half = 4.0 * turn - quarter  # stands for the tangent of half the angle
    x = (1.0 - half * half) / (1.0 + half * half)
    y = 2.0 * half / (1.0 + half * half)
    return ((x, y), (-y, x), (-x, -y), (y, -x))[quarter % 4]


def _corners(box: Segment) -> Polygon:
    x1, y1, x2, y2 = box
    return [(x1, y1), (x2, y1), (x2, y2), (x1, y2)]


def _boxes_are_apart(first: Segment, second: Segment, distance: int) -> bool:
    """Whether two boxes, which may be points, keep a distance (mm)."""
    beside = max(first[0] - second[2], 0, second[0] - first[2])
    above = max(first[1] - second[3], 0, second[1] - first[3])
    return beside * beside + above * above >= distance * distance


def _is_near(point: Point, segment: Segment, distance: int) -> bool:
    """Whether a point is nearer to a segment than a distance (mm)."""
    x1, y1, x2, y2 = segment
    span_x = x2 - x1
    span_y = y2 - y1
    to_x = point[0] - x1
    to_y = point[1] - y1
    along = to_x * span_x + to_y * span_y
    squared = span_x * span_x + span_y * span_y
    if along <= 0:
        return to_x * to_x + to_y * to_y < distance * distance
    if along >= squared:
        return (point[0] - x2) ** 2 + (point[1] - y2) ** 2 < distance * distance
    across = span_x * to_y - span_y * to_x
    return across * across < distance * distance * squared


def _are_apart(first: Segment, second: Segment, distance: int) -> bool:
    """Whether two segments do not cross and keep a distance (mm)."""
    ends = [(first[:2], second), (first[2:], second), (second[:2], first), (second[2:], first)]
    return not _cross(first, second) and not any(
        _is_near(end, other, distance) for end, other in ends
    )


def _cross(first: Segment, second: Segment) -> bool:
    def side(segment: Segment, x: int, y: int) -> bool:
        return (segment[2] - segment[0]) * (y - segment[1]) > (segment[3] - segment[1]) * (
            x - segment[0]
        )

    return side(first, *second[:2]) != side(first, *second[2:]) and side(
        second, *first[:2]
    ) != side(second, *first[2:])
