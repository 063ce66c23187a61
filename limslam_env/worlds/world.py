"""A world: its walls, obstacles, doors and starts, and checks that robots can use it."""

import functools
import hashlib
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from limslam_env.geometry import FloatArray, no_rows
from limslam_env.geometry.segment import distances, inside_polygon, lengths, polygon_edges
from limslam_env.messages import one_line
from limslam_env.worlds.free_space import FreeSpace, cell_for, free_space

MAX_SIDE = 500.0
MAX_EDGES = 100_000
SHORTEST_EDGE = 1e-6
MAX_LENGTH = 50_000.0
"""Largest total length of walls and obstacle edges, m. The time of the checks grows with it."""


class WorldError(ValueError):
    """A world, or the file that describes one, that cannot be used. The message, of one line, says where and why."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class OpenWorldError(WorldError):
    """A robot could leave the world."""


@dataclass(frozen=True, eq=False)
class World:
    """The geometry of a building. Arrays are read-only; lengths are in metres, angles in radians.

    Attributes
    ----------
    name
        Name of the world.
    size
        Width and height of the drawing. They add no walls.
    walls
        (n, 4): x1, y1, x2, y2 of each wall. Walls have no thickness.
    obstacles
        Closed polygons, each (k, 2).
    doors
        (m, 4): openings; a good map has no wall there.
    starts
        (s, 3): start poses of the robots. Empty: random starts.
    loop
        (l, 2): corners of a closed tour for driving laps. Empty: no tour.
    """

    name: str
    size: tuple[float, float]
    walls: FloatArray
    obstacles: tuple[FloatArray, ...] = ()
    doors: FloatArray = field(default_factory=lambda: no_rows(4))
    starts: FloatArray = field(default_factory=lambda: no_rows(3))
    loop: FloatArray = field(default_factory=lambda: no_rows(2))

    def __post_init__(self) -> None:
        _check_name(self.name)
        for name, width in (("walls", 4), ("doors", 4), ("starts", 3), ("loop", 2)):
            object.__setattr__(self, name, _frozen(getattr(self, name), name, width))
        obstacles = tuple(_frozen(polygon, "obstacles", 2) for polygon in self.obstacles)
        object.__setattr__(self, "obstacles", obstacles)
        if len(self.size) != 2 or not all(math.isfinite(side) and 0.0 < side <= MAX_SIDE for side in self.size):
            raise WorldError(f"size must be two lengths up to {MAX_SIDE:g} m, not {list(self.size)}")
        object.__setattr__(self, "size", (float(self.size[0]), float(self.size[1])))
        _check_edges(self)

    @functools.cached_property
    def edges(self) -> FloatArray:
        """Everything that blocks a beam, (k, 4): the walls first, then the obstacles' edges in order."""
        edges = np.vstack((self.walls, *(polygon_edges(polygon) for polygon in self.obstacles)))
        edges.setflags(write=False)
        return edges

    @functools.cached_property
    def digest(self) -> str:
        """A digest of the content: equal worlds have equal digests."""
        arrays = (self.walls, *self.obstacles, self.doors, self.starts, self.loop)
        parts = [
            repr((self.name, self.size)).encode(),
            *(repr(array.shape).encode() + array.tobytes() for array in arrays),
        ]
        return hashlib.sha256(b"|".join(parts)).hexdigest()[:16]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, World) and other.digest == self.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def __reduce__(self) -> tuple[type["World"], tuple[Any, ...]]:
        # Through the constructor: numpy's own way back from a pickle makes arrays that can be written to.
        return World, tuple(getattr(self, part.name) for part in fields(self))

    def free_space(self, radius: float) -> FreeSpace:
        """The space where a disc of ``radius`` (m) fits; cached for later calls."""
        return _free_space(self, radius)

    def check(self, radius: float) -> None:
        """Make sure that a robot of ``radius`` (m) can start here and never leave.

        Raises
        ------
        WorldError
            If a start collides, if the robot's disc could escape, or if it fits nowhere.
        """
        for number, start in enumerate(self.starts):
            self._check_start(start, radius, f"starts[{number}]")
        if len(self.starts):
            self._check_closed([(f"starts[{number}]", start) for number, start in enumerate(self.starts)], radius)
            return
        space = self.free_space(radius)
        region = space.largest_closed_region()
        if not region.any():
            raise WorldError(f"world {self.name!r}: no closed region has room for a robot of {radius:g} m radius")
        self._check_closed([("its largest region", space.first_centre(region))], radius)

    def check_pose(self, pose: FloatArray, radius: float) -> None:
        """Make sure that a robot of ``radius`` (m) may start at ``pose`` (3,).

        Raises
        ------
        WorldError
            If the pose is not finite, collides, or lies where the robot could leave the world.
        """
        self._check_start(pose, radius, "start")
        self._check_closed([(f"start {_text(pose)}", pose)], radius)

    def _check_closed(self, places: list[tuple[str, FloatArray]], radius: float) -> None:
        # A gap that the grid is too coarse to be sure of counts as a way out.
        cell = cell_for(self.edges, radius)
        wide = free_space(self.edges, radius - 0.75 * cell, cell, self.obstacles)
        for label, place in places:
            region = wide.region_of(place[:2])
            if not region.any() or wide.reaches_border(region):
                raise OpenWorldError(
                    f"world {self.name!r}: {label} lies in a region that is not closed: "
                    f"a robot of {radius:g} m radius could leave the world"
                )

    def _check_start(self, start: FloatArray, radius: float, label: str) -> None:
        if start.shape != (3,) or not np.isfinite(start).all():
            raise WorldError(f"world {self.name!r}: {label} must be three finite numbers (x, y, theta)")
        gap = float(distances(start[None, :2], self.edges).min())
        inside = any(inside_polygon(start[None, :2], polygon)[0] for polygon in self.obstacles)
        if inside or gap < radius:
            reason = "inside an obstacle" if inside else f"{gap:.3f} m from a wall"
            raise WorldError(
                f"world {self.name!r}: {label} {_text(start)} collides: a robot of {radius:g} m radius {reason}"
            )


# Checks, starts, coverage and metrics all ask for it. The largest floor plans have grids of tens of megabytes.
@functools.lru_cache(maxsize=8)
def _free_space(world: World, radius: float) -> FreeSpace:
    return free_space(world.edges, radius, cell_for(world.edges, radius), world.obstacles)


@contextmanager
def named(label: object) -> Iterator[None]:
    """Put ``label``, such as a file's name, in front of the message of a ``WorldError``."""
    try:
        yield
    except WorldError as error:
        raise WorldError(f"{label}: {error}") from error


def _frozen(value: Any, name: str, width: int) -> FloatArray:
    array = np.array(value, dtype=float)
    if array.shape == (0,):
        array = no_rows(width)
    if array.ndim != 2 or array.shape[1] != width:
        raise WorldError(f"{name} must have {width} numbers a row, not shape {array.shape}")
    if not np.isfinite(array).all():
        row = int(np.argwhere(~np.isfinite(array))[0, 0])
        raise WorldError(f"{name}[{row}] holds a number that is not finite")
    array.setflags(write=False)
    return array


def _check_name(name: Any) -> None:
    if not isinstance(name, str):
        raise WorldError("name must be a text")
    try:
        name.encode()
    except UnicodeEncodeError as error:
        # JSON and YAML can spell half a surrogate pair, which no file can hold.
        raise WorldError(f"name {name!r} holds an invalid character") from error


def _check_edges(world: World) -> None:
    for number, polygon in enumerate(world.obstacles):
        if len(polygon) < 3:
            raise WorldError(f"obstacles[{number}] has {len(polygon)} corners; a polygon needs three")
    if not 1 <= len(world.edges) <= MAX_EDGES:
        raise WorldError(f"{len(world.edges)} walls and obstacle edges; 1 to {MAX_EDGES} can be used")
    if np.abs(world.edges).max() > MAX_SIDE or np.ptp(world.edges.reshape(-1, 2), axis=0).max() > MAX_SIDE:
        raise WorldError(f"walls reach further than {MAX_SIDE:g} m")
    total = float(lengths(world.edges).sum())
    if total > MAX_LENGTH:
        raise WorldError(f"walls and obstacle edges are {total / 1e3:.0f} km long; {MAX_LENGTH / 1e3:g} km can be used")
    short = np.nonzero(lengths(world.edges) < SHORTEST_EDGE)[0]
    if short.size:
        kind = f"walls[{short[0]}]" if short[0] < len(world.walls) else f"obstacle edge {short[0] - len(world.walls)}"
        raise WorldError(f"{kind} has no length")


def _text(pose: FloatArray) -> str:
    return "(" + ", ".join(f"{value:g}" for value in pose) + ")"
