"""Worlds as tables of keys and values, lengths in metres: TOML, which keeps everything, and three
kinds of JSON.

A JSON file has the keys of TOML, or it is a wall list, ``{"id": ..., "walls": [[x1, y1, x2, y2],
...]}``, or a house of HouseExpo, ``{"id": ..., "verts": [[x, y], ...]}``, which is its outline (Li
et al., "HouseExpo: a large-scale 2D indoor layout dataset", 2019). Files are read up to a limit of
size, and replaced in one step.
"""

import json
import os
import secrets
from pathlib import Path
from typing import Any

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.geometry.segment import lengths, polygon_edges
from limslam_env.toml_text import read_toml_text
from limslam_env.worlds.world import MAX_SIDE, SHORTEST_EDGE, World, WorldError, named

MAX_FILE_BYTES = 20_000_000

_KEYS = {"name", "size", "walls", "obstacles", "doors", "starts", "loop"}


def parse_world(text: str, label: str) -> World:
    """A world from the text of a TOML file; a WorldError, which names the ``label``, if it is
    none.
    """
    try:
        table = read_toml_text(text)
    except ValueError as error:
        # Besides its own error, tomllib lets through what Python says of numbers with thousands of
        # digits.
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
        **{
            key: number_array(table[key], key, 2)
            for key in ("doors", "starts", "loop")
            if key in table
        },
    )


def world_table(world: World) -> dict[str, Any]:
    """The table of keys from which ``keyed_world`` makes an equal world."""
    return {
        "name": world.name,
        "size": list(world.size),
        "walls": world.walls.tolist(),
        "obstacles": [polygon.tolist() for polygon in world.obstacles],
        **{key: getattr(world, key).tolist() for key in ("doors", "starts", "loop")},
    }


def world_toml(world: World) -> str:
    """The text of a TOML file from which ``parse_world`` makes an equal world."""
    import tomli_w

    table = world_table(world)
    lines = [tomli_w.dumps({"name": table.pop("name")}).rstrip("\n")]
    lines.append(f"size = {table.pop('size')}")
    for key, rows in table.items():
        lines += _listed(key, rows) if rows or key == "walls" else []
    return "\n".join(lines) + "\n"


def _listed(key: str, rows: list[Any]) -> list[str]:
    # What Python writes of a list of floats is TOML, and the shortest that reads back as the same
    # floats.
    return [f"{key} = [", *(f"    {row}," for row in rows), "]"]


def read_json(path: str | os.PathLike[str]) -> World:
    """The world in a JSON file.

    It is HouseExpo's if it has the key ``verts``, and a wall list if it has ``walls`` and ``id``.
    Otherwise it has the keys of a world in TOML. A WorldError says what is wrong with the file.
    """
    with named(path):
        table = _read_table(Path(path))
        if "verts" in table:
            walls = polygon_edges(_length_rows(table, "verts", 2))
            # A file may repeat the first corner at the end; the outline is closed either way.
            if np.count_nonzero(lengths(walls) >= SHORTEST_EDGE) < 3:
                raise WorldError("verts has fewer than three corners")
            return _world_of_walls(table, walls)
        if "walls" in table and "id" in table:
            # Whatever else the file says is left out: here walls have no thickness.
            return _world_of_walls(table, _length_rows(table, "walls", 4))
        if "walls" in table:
            return keyed_world(table)
        raise WorldError(
            "holds neither 'walls', as a world or a wall list, nor 'verts', as a house of HouseExpo"
        )


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
    """The rows (n, width) of lengths, m, under a key of a file; a WorldError where there are
    none.
    """
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
    """The world with the name in a file's key ``id`` and with walls (n, 4), m; walls without length
    are left out.
    """
    if not isinstance(table.get("id"), str):
        raise WorldError("the key 'id' is missing" if "id" not in table else "id must be a text")
    walls = walls[lengths(walls) >= SHORTEST_EDGE]
    extent = np.ptp(walls.reshape(-1, 2), axis=0) if len(walls) else np.zeros(2)
    if not extent.all():
        raise WorldError("its walls stand on one line and enclose nothing")
    return World(table["id"], (float(extent[0]), float(extent[1])), walls)


def _no_number(name: str) -> None:
    raise ValueError(f"{name} is no number")


def read_bytes(path: Path, count: int) -> bytes:
    """The first ``count`` bytes of a file, or all when there are fewer; a WorldError where it
    cannot be read.
    """
    try:
        # A pipe or a device might never end.
        if path.is_file():
            with path.open("rb") as file:
                return file.read(count)
    except (OSError, ValueError) as error:
        raise WorldError(f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    raise WorldError("no such file")


def read_text(path: Path, largest: int) -> str:
    """The text of a file; a WorldError where it has more than ``largest`` bytes or is no UTF-8."""
    content = read_bytes(path, largest + 1)
    if len(content) > largest:
        raise WorldError(f"larger than {largest / 1e6:g} MB")
    try:
        # Lines may end in any of three ways, and a byte order mark may stand before the text.
        return content.decode("utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise WorldError(f"cannot be read: {error}") from error


def number_array(value: Any, key: str, dimensions: int) -> Any:
    """Nested lists of a file's numbers as an array; a WorldError, which names the ``key``, for
    anything else.
    """

    def is_number_list(item: Any, depth: int) -> bool:
        if depth > 0:
            return isinstance(item, list) and all(is_number_list(part, depth - 1) for part in item)
        # Whole numbers of a file may be too large for a float; floats that are not finite are named
        # later.
        return isinstance(item, float) or (type(item) is int and abs(item) <= MAX_SIDE * 1e6)

    if not is_number_list(value, dimensions):
        raise WorldError(
            f"{key} must be a list of {'numbers' if dimensions == 1 else 'lists of numbers'}"
        )
    counts = [len(row) for row in value] if dimensions > 1 else []
    odd = next((row for row, count in enumerate(counts) if count != counts[0]), None)
    if odd is not None:
        raise WorldError(f"{key}[{odd}] has {counts[odd]} numbers, and {key}[0] has {counts[0]}")
    return np.array(value, dtype=float)


def replace_file(path: Path, content: bytes) -> None:
    """Write a file under another name in the same folder, then rename it, so that no incomplete
    file is ever seen.
    """
    beside = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        try:
            beside.write_bytes(content)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except (OSError, ValueError) as error:
        raise WorldError(f"{path}: cannot be written: {error}") from error
