"""Worlds from and as maps of ROS's map_server: a picture of cells and a description of it (YAML).

The outlines of what is not free become straight walls and polygons. Maps keep the walls and the
obstacles only.
"""

import math
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy import ndimage

from limslam_env.geometry import FloatArray, no_rows
from limslam_env.geometry.segment import sample
from limslam_env.worlds.formats.pictures import (
    COARSEST,
    FINEST,
    MAX_PIXELS,
    path_name,
    read_picture,
    shades,
    world_of_cells,
)
from limslam_env.worlds.formats.tables import read_text, replace_file
from limslam_env.worlds.free_space import clear
from limslam_env.worlds.world import World, WorldError, named

_YAML_BYTES = 100_000  # a map's YAML has six lines, and PyYAML takes its time
_YAML_DEPTH = 2  # a table, and the origin's three numbers in it
_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
# YAML 1.1 as PyYAML knows it takes 5e-2 for a text; map_server and YAML 1.2 take it for a number.
_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")

_MODES = ("trinary", "scale", "raw")
_RAW = 100  # level of a raw map that is surely occupied; higher ones are unknown

OCCUPIED = 0
FREE = 254
UNKNOWN = 205
"""Levels of a map's cells, as map_server's own saver writes them."""

_MARGIN = 4  # cells around the walls
_BATCH = 100  # walls drawn in one go


@dataclass(frozen=True)
class MapInfo:
    """What the YAML says of the picture.

    ``image`` is relative to the YAML's folder, ``resolution`` the side of a cell, m, and ``origin``
    x, y (m) and yaw (rad, counter-clockwise) of the lower left corner. With ``negate`` white is
    occupied, instead of black. A cell is occupied if it is darker than ``occupied_thresh``, 0 to 1,
    and free up to ``free_thresh``. ``mode`` is trinary, scale (transparent cells are unknown) or
    raw (levels are occupancies in percent).
    """

    image: str
    resolution: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_thresh: float
    free_thresh: float
    mode: str


def read_map_server(path: str | os.PathLike[str]) -> World:
    """The world in a map of map_server: a ``.yaml`` file and the picture that it names.

    Walls run along the outlines of the occupied cells, a quarter of a cell within them, and are
    straightened by up to one cell. A solid patch is an obstacle. Cells that are neither occupied
    nor free are unknown (:func:`world_of_cells`). A WorldError says which file cannot be used, and
    why.
    """
    path = Path(path)
    with named(path):
        info = _info(read_text(path, _YAML_BYTES))
        with named(f"image {info.image!r}"):
            picture = read_picture(path.parent / info.image)
        shade = shades(picture)
        if info.negate:
            shade = shade[::-1]
        if info.mode == "raw":
            shade = np.round((1.0 - shade) * 255.0) / _RAW
        is_occupied = (shade > info.occupied_thresh) & (shade <= 1.0)
        is_free = shade <= info.free_thresh
        occupied = is_occupied[picture.levels]
        unknown = ~(is_occupied | is_free)[picture.levels]
        if info.mode == "scale" and picture.opacity is not None:
            unknown |= picture.opacity < 255
            occupied &= ~unknown
        world = world_of_cells(path_name(path), occupied, unknown, info.resolution, info.origin)
        if picture.white == 255 and is_free[UNKNOWN] and UNKNOWN in picture.levels:
            note = (
                f"cells of the level {UNKNOWN}, which map_server writes where nothing is known, "
                f"are free by free_thresh {info.free_thresh:g}"
            )
            world = replace(world, notes=(*world.notes, note))
        return world


def _info(text: str) -> MapInfo:
    table = _yaml_table(text)
    missing = [key for key in _KEYS if key not in table]
    if missing:
        raise WorldError(f"the key {missing[0]!r} is missing")
    if not isinstance(table["image"], str):
        raise WorldError("image must be a file's name")
    mode = str(table.get("mode", _MODES[0])).lower()
    if mode not in _MODES:
        raise WorldError(f"mode must be one of {', '.join(_MODES)}")
    if not isinstance(table["origin"], list) or len(table["origin"]) != 3:
        raise WorldError("origin must be three numbers: x, y, yaw")
    x, y, yaw = (_number(value, "origin", -1e6, 1e6) for value in table["origin"])
    negate = (
        table["negate"]
        if isinstance(table["negate"], bool)
        else _number(table["negate"], "negate", 0.0, 1.0)
    )
    if negate not in (0, 1):
        raise WorldError("negate must be 0 or 1")
    occupied = _number(table["occupied_thresh"], "occupied_thresh", 0.0, 1.0)
    free = _number(table["free_thresh"], "free_thresh", 0.0, occupied)
    resolution = _number(table["resolution"], "resolution", FINEST, COARSEST)
    return MapInfo(table["image"], resolution, (x, y, yaw), bool(negate), occupied, free, mode)


def _yaml_table(text: str) -> dict[Any, Any]:
    try:
        _check_plain(text)
        table = yaml.safe_load(text)
    # PyYAML lets through what Python says of impossible dates and of numbers with thousands of
    # digits.
    except (yaml.YAMLError, ValueError, ArithmeticError, RecursionError) as error:
        raise WorldError(f"not a map's YAML: {' '.join(str(error).split())}") from error
    if not isinstance(table, dict):
        raise WorldError("not a map's YAML: no table of keys and values")
    return table


def _check_plain(text: str) -> None:
    """Refuse what no map needs: tags, nesting, and aliases, of which a few lines can stand for
    gigabytes.
    """
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None) is not None:
            raise yaml.YAMLError("a map has neither aliases nor tags")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(
            event, yaml.CollectionEndEvent
        )
        if depth > _YAML_DEPTH:
            raise yaml.YAMLError("nested deeper than a map is")


def _number(value: Any, key: str, low: float, high: float) -> float:
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        value = float(value)
    if type(value) not in (int, float) or not low <= value <= high:
        raise WorldError(f"{key} must be a number from {low:g} to {high:g}")
    return float(value)


def write_map(world: World, path: Path, resolution: float) -> None:
    """Write a world as a ``.yaml`` and a ``.pgm`` beside it, with cells of ``resolution``, m."""
    if not FINEST <= resolution <= COARSEST:
        raise WorldError(
            f"{path}: cells must measure {FINEST:g} to {COARSEST:g} m, not {resolution:g}"
        )
    corners = world.edges.reshape(-1, 2)
    # The grid is shifted by half a cell, so that walls on round numbers run through the middle of
    # cells.
    low = corners.min(axis=0) - (_MARGIN + 0.5) * resolution
    columns, rows = (np.floor((corners.max(axis=0) - low) / resolution)).astype(int) + 1 + _MARGIN
    if rows * columns > MAX_PIXELS:
        raise WorldError(
            f"{path}: {columns} x {rows} cells of {resolution:g} m; a map has up to {MAX_PIXELS}"
        )
    image = path.with_suffix(".pgm")
    about = {
        "image": image.name,
        "resolution": float(resolution),
        "origin": [*low.tolist(), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    levels = _levels(world, low, resolution, (rows, columns))[::-1]
    replace_file(image, f"P5\n{columns} {rows}\n255\n".encode() + levels.tobytes())
    replace_file(
        path,
        yaml.safe_dump(
            about, sort_keys=False, allow_unicode=True, default_flow_style=None
        ).encode(),
    )


def _levels(
    world: World, low: FloatArray, cell: float, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """The map's cells (rows, columns), row 0 at the bottom."""
    free = np.ones(shape, dtype=bool)
    # A cell is a wall if the wall goes through it: points no further apart than a cell skip none.
    for walls in np.array_split(world.edges, math.ceil(len(world.edges) / _BATCH)):
        points, _ = sample(walls, cell)
        columns, rows = np.floor((points - low) / cell).astype(int).T
        free[rows, columns] = False
    clear(free, no_rows(4), world.obstacles, 0.0, low, cell)
    # Steps to four sides: a slanting wall's cells touch at corners, and must not let the outside
    # in.
    regions, _ = ndimage.label(free)
    levels = np.where(regions == regions[0, 0], UNKNOWN, FREE)
    return np.where(free, levels, OCCUPIED).astype(np.uint8)
