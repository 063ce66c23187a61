"""Worlds as tables of keys and values, lengths in metres: TOML, which keeps everything, and three kinds of JSON.

A JSON file has the keys of TOML, or it is a wall list, ``{"id": ..., "walls": [[x1, y1, x2, y2], ...]}``, or a house of
HouseExpo, ``{"id": ..., "verts": [[x, y], ...]}``, which is its outline (Li et al., "HouseExpo: a large-scale 2D indoor
layout dataset", 2019).
"""

import json
import os
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.geometry.segment import lengths, polygon_edges
from limslam_env.worlds.formats.text_files import MAX_FILE_BYTES, number_array, read_text
from limslam_env.worlds.world import MAX_SIDE, SHORTEST_EDGE, World, WorldError, named

_KEYS = {"name", "size", "walls", "obstacles", "doors", "starts", "loop"}


def parse_world(text: str, label: str) -> World:
    """A world from the text of a TOML file; ``label`` names it in errors.

    Raises
    ------
    WorldError
        If the text is not a world.
    """
    try:
        table = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        # Besides its own error, tomllib lets through what Python says of numbers with thousands of digits.
        raise WorldError(f"{label}: not TOML: {error}") from error
    with named(label):
        return keyed_world(table)


def keyed_world(table: dict[str, Any]) -> World:
    """The world in the table of a file; a WorldError where it cannot be used."""
    unknown = sorted(set(table) - _KEYS)
    if unknown:
        raise WorldError(f"unknown key {unknown[0]!r}; a world has {', '.join(sorted(_KEYS))}")
    missing = sorted({"name", "size", "walls"} - set(table))
    if missing:
        raise WorldError(f"the key {missing[0]!r} is missing")
    if not isinstance(table.get("obstacles", []), list):
        raise WorldError("obstacles must be a list of polygons")
    return World(
        name=table["name"],
        size=tuple(number_array(table["size"], "size", 1)),
        walls=number_array(table["walls"], "walls", 2),
        obstacles=tuple(
            number_array(polygon, f"obstacles[{number}]", 2)
            for number, polygon in enumerate(table.get("obstacles", []))
        ),
        **{key: number_array(table[key], key, 2) for key in ("doors", "starts", "loop") if key in table},
    )


def world_toml(world: World) -> str:
    """The text of a TOML file from which ``parse_world`` makes an equal world."""
    import tomli_w

    name = tomli_w.dumps({"name": world.name}).rstrip("\n")
    lines = [name, f"size = {list(world.size)}", *_listed("walls", world.walls.tolist())]
    if world.obstacles:
        lines += _listed("obstacles", [polygon.tolist() for polygon in world.obstacles])
    for key in ("doors", "starts", "loop"):
        rows = getattr(world, key).tolist()
        lines += _listed(key, rows) if rows else []
    return "\n".join(lines) + "\n"


def _listed(key: str, rows: list[Any]) -> list[str]:
    # What Python writes of a list of floats is TOML, and the shortest that reads back as the same floats.
    return [f"{key} = [", *(f"    {row}," for row in rows), "]"]


def read_json(path: str | os.PathLike[str]) -> World:
    """The world in a JSON file.

    It is HouseExpo's if it has the key ``verts``, and a wall list if it has ``walls`` and ``id``. Otherwise it has the
    keys of a world in TOML.

    Raises
    ------
    WorldError
        If the file is none of them, or cannot be used; the message names file and reason.
    """
    with named(path):
        table = _read_table(Path(path))
        if "verts" in table:
            return _house(table)
        if "walls" in table:
            return _wall_list(table) if "id" in table else keyed_world(table)
        raise WorldError("holds neither 'walls', as a world or a wall list, nor 'verts', as a house of HouseExpo")


def _house(table: dict[str, Any]) -> World:
    """The world inside of an outline; a WorldError where the outline cannot be used."""
    walls = polygon_edges(_length_rows(table, "verts", 2))
    # A file may repeat the first corner at the end; the outline is closed either way.
    if np.count_nonzero(lengths(walls) >= SHORTEST_EDGE) < 3:
        raise WorldError("verts has fewer than three corners")
    return _world_of_walls(table, walls)


def _wall_list(table: dict[str, Any]) -> World:
    """The world of a wall list; a WorldError where it cannot be used.

    Walls without length are left out, as is whatever else the file says: here walls have no thickness.
    """
    return _world_of_walls(table, _length_rows(table, "walls", 4))


def _read_table(path: Path) -> dict[str, Any]:
    """The object in a JSON file; a WorldError where the file holds something else."""
    text = read_text(path, MAX_FILE_BYTES)
    try:
        table = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise WorldError(f"not JSON: {error}") from error
    if not isinstance(table, dict):
        raise WorldError("holds no table of keys and values")
    return table


def _length_rows(table: dict[str, Any], key: str, width: int) -> FloatArray:
    """The rows (n, width) of lengths, m, under a key of a file; a WorldError where there are none."""
    rows: FloatArray = number_array(table[key], key, 2)
    if not rows.size:
        raise WorldError(f"{key} is empty")
    if rows.shape[1] != width:
        raise WorldError(f"{key} must have {width} numbers a row, not {rows.shape[1]}")
    # Also what JSON writes too large for a float, and what would overflow further on.
    if np.abs(rows).max() > MAX_SIDE:
        raise WorldError(f"{key} reaches further than {MAX_SIDE:g} m")
    return rows


def _world_of_walls(table: dict[str, Any], walls: FloatArray) -> World:
    """The world with the name in a file's key ``id`` and with walls (n, 4), m; walls without length are left out."""
    if not isinstance(table.get("id"), str):
        raise WorldError("the key 'id' is missing" if "id" not in table else "id must be a text")
    walls = walls[lengths(walls) >= SHORTEST_EDGE]
    extent = np.ptp(walls.reshape(-1, 2), axis=0) if len(walls) else np.zeros(2)
    if not extent.all():
        raise WorldError("its walls stand on one line and enclose nothing")
    return World(table["id"], (float(extent[0]), float(extent[1])), walls)


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no number")
