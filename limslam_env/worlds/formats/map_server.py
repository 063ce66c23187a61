"""Worlds from maps of ROS's map_server: a picture of cells (PGM or PNG) and a description of it (YAML)."""

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.worlds.formats.outlines import outlines_of
from limslam_env.worlds.formats.pictures import read_levels
from limslam_env.worlds.formats.text_files import read_text
from limslam_env.worlds.world import World, WorldError, named

FINEST, COARSEST = 0.001, 10.0
"""Smallest and largest side of a cell, m."""

_YAML_BYTES = 100_000  # a map's YAML has six lines, and PyYAML takes its time
_YAML_DEPTH = 2  # a table, and the origin's three numbers in it
_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
# YAML 1.1 as PyYAML knows it takes 5e-2 for a text; map_server and YAML 1.2 take it for a number.
_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")


@dataclass(frozen=True)
class MapInfo:
    """What the YAML says of the picture.

    Attributes
    ----------
    image
        File of the picture, relative to the YAML's folder.
    resolution
        Side of a cell, m.
    origin
        x, y (m) and yaw (rad, counter-clockwise) of the picture's lower left corner.
    negate
        Whether white is occupied, instead of black.
    occupied_thresh
        A cell is a wall if it is more occupied than this, 0 to 1.
    """

    image: str
    resolution: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_thresh: float


def read_map_server(path: str | os.PathLike[str]) -> World:
    """The world in a map of map_server: a ``.yaml`` file and the ``.pgm`` or ``.png`` picture that it names.

    Walls run along the outlines of the occupied cells, a quarter of a cell within them, and are straightened by up to
    one cell. A solid patch is an obstacle. Cells that are unknown are not walls.

    Raises
    ------
    WorldError
        If one of the files cannot be used; the message names file and reason.
    """
    path = Path(path)
    with named(path):
        info = _info(read_text(path, _YAML_BYTES))
        with named(f"image {info.image!r}"):
            samples, largest = read_levels(path.parent / info.image)
        # The shade of each level: 0 for white, which is free, and 1 for black.
        shade = np.arange(largest + 1) / largest if info.negate else np.arange(largest, -1, -1) / largest
        # A file's name may hold bytes that are no text.
        name = path.stem.encode("utf-8", "replace").decode()
        return _world(name, (shade > info.occupied_thresh)[samples], info)


def _info(text: str) -> MapInfo:
    table = _yaml_table(text)
    missing = [key for key in _KEYS if key not in table]
    if missing:
        raise WorldError(f"the key {missing[0]!r} is missing")
    if not isinstance(table["image"], str):
        raise WorldError("image must be a file's name")
    if table.get("mode", "trinary") not in ("trinary", "scale"):
        # Raw levels are costs, of which map_server itself does not say what a wall is.
        raise WorldError("mode must be trinary or scale: others do not say which cells are walls")
    if not isinstance(table["origin"], list) or len(table["origin"]) != 3:
        raise WorldError("origin must be three numbers: x, y, yaw")
    x, y, yaw = (_number(value, "origin", -1e6, 1e6) for value in table["origin"])
    negate = table["negate"] if isinstance(table["negate"], bool) else _number(table["negate"], "negate", 0.0, 1.0)
    if negate not in (0, 1):
        raise WorldError("negate must be 0 or 1")
    occupied = _number(table["occupied_thresh"], "occupied_thresh", 0.0, 1.0)
    _number(table["free_thresh"], "free_thresh", 0.0, occupied)
    resolution = _number(table["resolution"], "resolution", FINEST, COARSEST)
    return MapInfo(table["image"], resolution, (x, y, yaw), bool(negate), occupied)


def _yaml_table(text: str) -> dict[Any, Any]:
    try:
        _check_plain(text)
        table = yaml.safe_load(text)
    # PyYAML lets through what Python says of impossible dates and of numbers with thousands of digits.
    except (yaml.YAMLError, ValueError, ArithmeticError, RecursionError) as error:
        raise WorldError(f"not a map's YAML: {' '.join(str(error).split())}") from error
    if not isinstance(table, dict):
        raise WorldError("not a map's YAML: no table of keys and values")
    return table


def _check_plain(text: str) -> None:
    """Refuse what no map needs: tags, nesting, and aliases, of which a few lines can stand for gigabytes."""
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None) is not None:
            raise yaml.YAMLError("a map has neither aliases nor tags")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _YAML_DEPTH:
            raise yaml.YAMLError("nested deeper than a map is")


def _number(value: Any, key: str, low: float, high: float) -> float:
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        value = float(value)
    if type(value) not in (int, float) or not low <= value <= high:
        raise WorldError(f"{key} must be a number from {low:g} to {high:g}")
    return float(value)


def _world(name: str, occupied: BoolArray, info: MapInfo) -> World:
    polygons, walls = outlines_of(occupied)
    x, y, yaw = info.origin
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    width, height = np.abs(turn.T) @ (np.array(occupied.shape[::-1]) * info.resolution)

    def placed(points: FloatArray) -> FloatArray:
        return np.asarray(points * info.resolution @ turn + (x, y))

    return World(
        name,
        (float(width), float(height)),
        placed(walls.reshape(-1, 2)).reshape(-1, 4),
        tuple(placed(polygon) for polygon in polygons),
    )
