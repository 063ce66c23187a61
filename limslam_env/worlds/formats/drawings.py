"""Drawings of a building: which of their lines are walls and doors, in which unit, and the world
of them.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from limslam_env.geometry import FloatArray, no_rows
from limslam_env.geometry.segment import distances, lengths
from limslam_env.worlds.world import MAX_EDGES, MAX_SIDE, SHORTEST_EDGE, World, WorldError

TOLERANCE = 0.01
"""Largest distance (m) between a curve and the straight walls in its place."""

MAX_ELEMENTS = 100_000
"""Most elements of a drawing, counted as often as it repeats them."""

MAX_DRAWING_BYTES = 20_000_000

_FARTHEST = 1e9  # m, from the origin of a drawing; maps of countries have 1e7
_SMALLEST = 2.0  # m; smaller drawings are a plan on paper
_AT_WALL = 0.05  # m, between the end of a door and a wall
_NAMED = 8  # layers in a note

# The usual English names: Walls, A-WALL-FULL, exterior_wall; a window holds robots as a wall does.
_WALL = re.compile("wall|window|glaz", re.IGNORECASE)
_DOOR = re.compile("door", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Stroke:
    """A line of a drawing: its corners (k, 2), m, y up, and the layers that it is in, outermost
    first.
    """

    corners: FloatArray
    layers: tuple[str, ...]


def unit_of(metres_per_unit: float | None, from_file: float | None) -> float:
    """Length of a drawing's unit, m: the one that is asked for, or else that of the file."""
    unit = from_file if metres_per_unit is None else metres_per_unit
    if unit is None:
        raise WorldError(
            "the drawing does not say how long its unit is: give it in m, as in "
            "--metres-per-unit 0.001 for mm (in Python metres_per_unit=0.001)"
        )
    if not 1e-6 <= unit <= 1e6:
        raise WorldError(f"metres per unit must be 1e-06 to 1e+06, not {unit:g}")
    return unit


def drawn_world(
    name: str,
    strokes: Iterable[Stroke],
    wall_layers: tuple[str, ...] | None,
    *,
    is_unit_sure: bool,
) -> World:
    """The world of the strokes of a drawing, its lower left corner moved to (0, 0).

    Walls are the strokes in ``wall_layers``. Without these they are the strokes in layers whose
    names say walls or windows, or where there are none, all strokes but those of doors. A straight
    line in a layer of doors is an opening if both of its ends are at walls. A note names the layers
    that are not used. A WorldError says why the drawing cannot be used, such as that it has a size
    that no building has, unless ``is_unit_sure``.
    """
    drawn = _counted(strokes)
    kinds, note = _kinds(drawn, wall_layers)
    walls = _edges(stroke for stroke, kind in zip(drawn, kinds, strict=True) if kind == "wall")
    if not len(walls):
        raise WorldError("it has no lines that are walls")
    low = walls.reshape(-1, 2).min(axis=0)
    width, height = np.ptp(walls.reshape(-1, 2), axis=0).tolist()
    if not min(width, height):
        raise WorldError("its walls stand on one line and enclose nothing")
    if max(width, height) > MAX_SIDE or (max(width, height) < _SMALLEST and not is_unit_sure):
        raise WorldError(
            f"its walls measure {width:.3g} x {height:.3g} m: give the length of its unit, m, as "
            "in --metres-per-unit 0.001 for mm"
        )
    corner = np.tile(low, 2)
    doors = _edges(
        stroke
        for stroke, kind in zip(drawn, kinds, strict=True)
        if kind == "door" and _is_opening(stroke.corners, walls)
    )
    return World(name, (width, height), walls - corner, doors=doors - corner, notes=note)


def _counted(strokes: Iterable[Stroke]) -> list[Stroke]:
    """All strokes; a WorldError as soon as there are too many, or one is too far away."""
    found = []
    edges = 0
    # What overflows on the way is refused here.
    with np.errstate(over="ignore", invalid="ignore"):
        for stroke in islice(strokes, MAX_ELEMENTS):
            if not (np.abs(stroke.corners) <= _FARTHEST).all():
                raise WorldError("it holds a number that is too large")
            found.append(stroke)
            edges += len(stroke.corners) - 1
            if edges > MAX_EDGES:
                break
    if edges > MAX_EDGES or len(found) == MAX_ELEMENTS:
        raise WorldError(f"more than {MAX_EDGES} lines: save the layers of walls only")
    return found


def _kinds(
    strokes: list[Stroke], wall_layers: tuple[str, ...] | None
) -> tuple[list[str], tuple[str, ...]]:
    """What each stroke is, ``wall``, ``door`` or neither, and a note about the layers."""
    layers = dict.fromkeys(layer for stroke in strokes for layer in stroke.layers)
    if wall_layers is not None:
        wanted = {name.strip().casefold() for name in wall_layers}
        absent = sorted(wanted - {layer.casefold() for layer in layers})
        if absent:
            raise WorldError(f"no lines are in a layer {absent[0]!r}; there are {_listed(layers)}")
        is_wall = {layer: layer.casefold() in wanted for layer in layers}
    else:
        is_wall = {layer: bool(_WALL.search(layer)) for layer in layers}
    is_any = any(is_wall.values())
    kinds = []
    for stroke in strokes:
        kind = "" if is_any else "wall"
        for layer in stroke.layers:  # the innermost that says something counts
            if is_wall[layer]:
                kind = "wall"
            elif _DOOR.search(layer):
                kind = "door"
        kinds.append(kind)
    outermost = {
        kind: dict.fromkeys(
            stroke.layers[0]
            for stroke, found in zip(strokes, kinds, strict=True)
            if stroke.layers and found == kind
        )
        for kind in ("", "wall")
    }
    if is_any:
        unused = [layer for layer in outermost[""] if layer not in outermost["wall"]]
        return kinds, (f"layers that are not used: {_listed(unused)}",) if unused else ()
    if len(outermost["wall"]) < 2:
        return kinds, ()
    note = f"no layer is called walls, so all lines are walls; layers: {_listed(outermost['wall'])}"
    return kinds, (f"{note}; --layers chooses",)


def _listed(layers: Iterable[str]) -> str:
    names = list(layers)
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return (", ".join(names[:_NAMED]) or "none") + more


def _edges(strokes: Iterable[Stroke]) -> FloatArray:
    """The lines (n, 4) between the corners of strokes, those without length left out."""
    lines = [np.hstack((stroke.corners[:-1], stroke.corners[1:])) for stroke in strokes]
    edges = np.vstack((no_rows(4), *lines))
    return np.asarray(edges[lengths(edges) >= SHORTEST_EDGE])


def _is_opening(corners: FloatArray, walls: FloatArray) -> bool:
    """Whether corners (k, 2) are a line that joins walls (n, 4), and no leaf of a door."""
    if len(corners) != 2:
        return False
    return bool((distances(corners, walls).min(axis=1) <= _AT_WALL).all())
