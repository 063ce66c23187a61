"""A world: its walls, obstacles, doors and starts, and checks that robots can use it."""

import functools
import hashlib
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray, no_rows
from limslam_env.geometry.numbers import LARGEST_COORDINATE, is_number
from limslam_env.geometry.segment import distances, inside_polygon, lengths, polygon_edges
from limslam_env.messages import counted, one_line
from limslam_env.worlds.free_space import FreeSpace, cell_for, free_space
from limslam_env.worlds.openings import openings

MAX_SIDE = 500.0
MAX_EDGES = 100_000
SHORTEST_EDGE = 1e-6
MAX_LENGTH = 50_000.0
"""Largest total length of walls and obstacle edges, m. The time of the checks grows with it."""

_PAIRS = 200_000  # points and edges that are compared in one go


class WorldError(ValueError):
    """A world, or the file that describes one, that cannot be used. The message, of one line, says
    where and why.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


@dataclass(frozen=True, eq=False, repr=False)
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
    notes
        What the reader of a file has to say about it, one line each. They are no part of the world:
        worlds that differ in them only are equal.

    Examples
    --------
    >>> import gymnasium as gym
    >>> import limslam_env
    >>> from limslam_env import World
    >>> corners = [[0, 0, 3, 0], [3, 0, 3, 2], [3, 2, 0, 2], [0, 2, 0, 0]]
    >>> room = World("room", (3.0, 2.0), corners, starts=[[1.0, 1.0, 0.0]])
    >>> env = gym.make("LimSlam-World-v0", world=room)
    """

    name: str
    size: tuple[float, float]
    walls: FloatArray
    obstacles: tuple[FloatArray, ...] = ()
    doors: FloatArray = field(default_factory=lambda: no_rows(4))
    starts: FloatArray = field(default_factory=lambda: no_rows(3))
    loop: FloatArray = field(default_factory=lambda: no_rows(2))
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _check_name(self.name)
        for name, width in (("walls", 4), ("doors", 4), ("starts", 3), ("loop", 2)):
            object.__setattr__(self, name, _frozen(getattr(self, name), name, width))
        obstacles = tuple(_frozen(polygon, "obstacles", 2) for polygon in self.obstacles)
        object.__setattr__(self, "obstacles", obstacles)
        if len(self.size) != 2 or not all(
            is_number(side) and 0.0 < side <= MAX_SIDE for side in self.size
        ):
            sides = ", ".join(f"{side:g}" if is_number(side) else str(side) for side in self.size)
            raise WorldError(
                f"size must be two lengths up to {MAX_SIDE:g} m, not [{sides}]: are they in m?"
            )
        object.__setattr__(self, "size", (float(self.size[0]), float(self.size[1])))
        _check_edges(self)
        for number, theta in enumerate(self.starts[:, 2]):
            if abs(theta) > 4.0 * math.pi:
                raise WorldError(
                    f"starts[{number}]: a heading is within 4 pi rad, not {theta:g}: is it in rad?"
                )

    @functools.cached_property
    def edges(self) -> FloatArray:
        """Everything that blocks a beam, (k, 4): the walls first, then the obstacles' edges in
        order.
        """
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

    def __repr__(self) -> str:
        width, height = self.size
        parts = [
            counted(len(self.walls), "wall"),
            counted(len(self.obstacles), "obstacle"),
            counted(len(self.doors), "door"),
            counted(len(self.starts), "start"),
        ]
        return f"<World {self.name!r}: {width:g} x {height:g} m, {', '.join(parts)}>"

    def __reduce__(self) -> tuple[type["World"], tuple[Any, ...]]:
        # A pickle is read by the constructor, which makes read-only arrays. Those of numpy's own
        # pickles are writable.
        return World, tuple(getattr(self, part.name) for part in fields(self))

    def _repr_png_(self) -> bytes:
        """The picture that a notebook shows."""
        from limslam_env.worlds.picture import world_png

        return world_png(self.edges, self.doors, self.obstacles, self.starts)

    def free_space(self, radius: float) -> FreeSpace:
        """The space where a disc of ``radius`` (m) fits; cached for later calls."""
        return _free_space(self, radius)

    def check(self, radius: float) -> None:
        """Raise a WorldError if a start collides with a robot of ``radius`` (m), if it fits
        nowhere, or could leave.
        """
        if len(self.starts):
            self._check_starts(self.starts, radius, "starts[{}]".format)
            self._check_closed(self.starts[:, :2], radius, "starts[{}]".format)
            return
        space = self.free_space(radius)
        region = space.largest_closed_region()
        if not region.any():
            raise WorldError(
                f"world {self.name!r}: no closed region has room for a robot of {radius:g} m radius"
                f"{self.opening_note(radius)}"
            )
        self._check_closed(space.first_centre(region)[None], radius, lambda _: "its largest region")

    def check_poses(self, poses: FloatArray, radius: float) -> None:
        """Raise a WorldError if one of the poses (n, 3) is not finite, or no start for a robot of
        ``radius`` (m).
        """
        self._check_starts(poses, radius, lambda _: "start")
        self._check_closed(poses[:, :2], radius, lambda number: f"start {_text(poses[number])}")

    def _check_closed(self, points: FloatArray, radius: float, label: Callable[[int], str]) -> None:
        is_open = _wide_space(self, radius).is_open(points)
        if is_open.any():
            raise WorldError(
                f"world {self.name!r}: {label(int(np.argmax(is_open)))} lies in a region that is "
                "not closed: "
                f"a robot of {radius:g} m radius could leave the world"
                f"{self.opening_note(radius)}"
            )

    def opening_note(self, radius: float) -> str:
        """Where the outline is open for a robot of ``radius`` (m), in words that follow a reason;
        empty if it is closed.
        """
        found = "; ".join(map(str, openings(self.edges, self.obstacles, radius)))
        return f"; the outline is open at {found}" if found else ""

    def _check_starts(self, starts: FloatArray, radius: float, label: Callable[[int], str]) -> None:
        is_pose = (
            (np.abs(starts) <= LARGEST_COORDINATE).all(axis=1)
            if starts.ndim == 2 and starts.shape[1] == 3
            else np.zeros(1, bool)
        )
        if not is_pose.all():
            raise WorldError(
                f"world {self.name!r}: {label(int(np.argmin(is_pose)))} must be (x, y, theta), "
                f"three finite numbers of at most {LARGEST_COORDINATE:g} m or rad"
            )
        gaps, is_inside = self._gaps(starts[:, :2])
        collides = is_inside | (gaps < radius)
        if collides.any():
            first = int(np.argmax(collides))
            reason = (
                "inside an obstacle" if is_inside[first] else f"{gaps[first]:.3f} m from a wall"
            )
            raise WorldError(
                f"world {self.name!r}: {label(first)} {_text(starts[first])} collides: "
                f"a robot of {radius:g} m radius {reason}"
            )

    def _gaps(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Distance (m) of each point (n, 2) from the nearest edge, and whether it lies inside an
        obstacle.
        """
        gaps = np.zeros(len(points))
        is_inside = np.zeros(len(points), dtype=bool)
        parts = np.array_split(np.arange(len(points)), len(points) * len(self.edges) // _PAIRS + 1)
        for part in parts:
            gaps[part] = distances(points[part], self.edges).min(axis=1, initial=np.inf)
            for polygon in self.obstacles:
                is_inside[part] |= inside_polygon(points[part], polygon)
        return gaps, is_inside


# Checks, starts, coverage and metrics all ask for it. The largest floor plans have grids of tens of
# megabytes.
@functools.lru_cache(maxsize=8)
def _free_space(world: World, radius: float) -> FreeSpace:
    return free_space(world.edges, radius, cell_for(world.edges, radius), world.obstacles)


@functools.lru_cache(maxsize=2)
def _wide_space(world: World, radius: float) -> FreeSpace:
    # A gap that the grid is too coarse to be sure of counts as a way out.
    cell = cell_for(world.edges, radius)
    return free_space(world.edges, radius - 0.75 * cell, cell, world.obstacles)


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
    bad = ~(np.abs(array) <= LARGEST_COORDINATE)
    if bad.any():
        row = int(np.argwhere(bad)[0, 0])
        kind = f"above {LARGEST_COORDINATE:g}" if np.isfinite(array[row]).all() else "not finite"
        raise WorldError(f"{name}[{row}] holds a number that is {kind}")
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
            raise WorldError(
                f"obstacles[{number}] has {len(polygon)} corners; a polygon needs three"
            )
    if not 1 <= len(world.edges) <= MAX_EDGES:
        raise WorldError(
            f"{len(world.edges)} walls and obstacle edges; 1 to {MAX_EDGES} can be used"
        )
    if (
        np.abs(world.edges).max() > MAX_SIDE
        or np.ptp(world.edges.reshape(-1, 2), axis=0).max() > MAX_SIDE
    ):
        raise WorldError(f"walls reach further than {MAX_SIDE:g} m")
    total = float(lengths(world.edges).sum())
    if total > MAX_LENGTH:
        raise WorldError(
            f"walls and obstacle edges are {total / 1e3:.0f} km long; {MAX_LENGTH / 1e3:g} km can "
            "be used"
        )
    short = np.nonzero(lengths(world.edges) < SHORTEST_EDGE)[0]
    if short.size:
        kind = (
            f"walls[{short[0]}]"
            if short[0] < len(world.walls)
            else f"obstacle edge {short[0] - len(world.walls)}"
        )
        raise WorldError(f"{kind} has no length")


def _text(pose: FloatArray) -> str:
    return "(" + ", ".join(f"{value:g}" for value in pose) + ")"
