"""Other people's floor plans in JSON: lists of walls, and the outlines of houses that HouseExpo holds."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.geometry.segment import lengths, polygon_edges
from limslam_env.worlds.world import MAX_FILE_BYTES, MAX_SIDE, SHORTEST_EDGE, World, WorldError, named, number_array


def read_json(path: str | os.PathLike[str]) -> World:
    """The world in a JSON file, which is HouseExpo's if it has the key ``verts``, and a wall list otherwise.

    Raises
    ------
    WorldError
        If the file is neither, or cannot be used; the message names file and reason.
    """
    with named(path):
        table = _table(Path(path))
        if "verts" in table:
            return _house(table)
        if "walls" in table:
            return _plan(table)
        raise WorldError("holds neither 'walls', as a wall list, nor 'verts', as a house of HouseExpo")


def read_wall_list(path: str | os.PathLike[str]) -> World:
    """The world in a file ``{"id": ..., "walls": [[x1, y1, x2, y2], ...]}``, lengths in metres.

    Walls without length are left out, as is whatever else the file says: here walls have no thickness.

    Raises
    ------
    WorldError
        If the file cannot be used; the message names file and reason.
    """
    with named(path):
        return _plan(_table(Path(path)))


def read_house_expo(path: str | os.PathLike[str]) -> World:
    """The world in a file of HouseExpo, ``{"id": ..., "verts": [[x, y], ...]}``: a house's closed outline, m.

    Raises
    ------
    WorldError
        If the file cannot be used; the message names file and reason.
    """
    with named(path):
        return _house(_table(Path(path)))


def read_bytes(path: Path, count: int) -> bytes:
    """The first ``count`` bytes of a file, or all when there are fewer; a WorldError where it cannot be read."""
    try:
        # A pipe or a device might never end.
        if path.is_file():
            with path.open("rb") as file:
                return file.read(count)
    except (OSError, ValueError) as error:
        raise WorldError(f"cannot be read: {error}") from error
    raise WorldError("no such file")


def read_text(path: Path, largest: int) -> str:
    """The text of a file; a WorldError where it has more than ``largest`` bytes or is no UTF-8."""
    content = read_bytes(path, largest + 1)
    if len(content) > largest:
        raise WorldError(f"larger than {largest / 1e6:g} MB")
    try:
        # All three ways to end a line, as everywhere in text files.
        return content.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise WorldError(f"cannot be read: {error}") from error


def _table(path: Path) -> dict[str, Any]:
    # Windows' editors put a mark in front of the text, which JSON does not know.
    text = read_text(path, MAX_FILE_BYTES).removeprefix("\ufeff")
    try:
        table = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise WorldError(f"not JSON: {error}") from error
    if not isinstance(table, dict):
        raise WorldError("holds no table of keys and values")
    return table


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no number")


def _plan(table: dict[str, Any]) -> World:
    return _world(table, _rows(table, "walls", 4))


def _house(table: dict[str, Any]) -> World:
    corners = _rows(table, "verts", 2)
    walls = polygon_edges(corners)
    # The first corner may be given once more as the last one; the outline is closed either way.
    if np.count_nonzero(lengths(walls) >= SHORTEST_EDGE) < 3:
        raise WorldError("verts has fewer than three corners")
    return _world(table, walls)


def _rows(table: dict[str, Any], key: str, width: int) -> FloatArray:
    """Rows (n, width) of lengths, m, that a file has under a key."""
    if key not in table:
        raise WorldError(f"the key {key!r} is missing")
    rows: FloatArray = number_array(table[key], key, 2)
    if not rows.size:
        raise WorldError(f"{key} is empty")
    if rows.shape[1] != width:
        raise WorldError(f"{key} must have {width} numbers a row, not {rows.shape[1]}")
    # Also what JSON writes too large for a float, and what would overflow further on.
    if np.abs(rows).max() > MAX_SIDE:
        raise WorldError(f"{key} reaches further than {MAX_SIDE:g} m")
    return rows


def _world(table: dict[str, Any], walls: FloatArray) -> World:
    if not isinstance(table.get("id"), str):
        raise WorldError("the key 'id' is missing" if "id" not in table else "id must be a text")
    walls = walls[lengths(walls) >= SHORTEST_EDGE]
    extent = np.ptp(walls.reshape(-1, 2), axis=0) if len(walls) else np.zeros(2)
    if not extent.all():
        raise WorldError("its walls stand on one line and enclose nothing")
    return World(table["id"], (float(extent[0]), float(extent[1])), walls)
