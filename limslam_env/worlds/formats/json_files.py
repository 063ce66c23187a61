"""Worlds as JSON: what the two formats, wall lists and HouseExpo, have in common."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.geometry.segment import lengths
from limslam_env.worlds.formats.text_files import MAX_FILE_BYTES, number_array, read_text
from limslam_env.worlds.world import MAX_SIDE, SHORTEST_EDGE, World, WorldError


def read_table(path: Path) -> dict[str, Any]:
    """The object in a JSON file; a WorldError where the file holds something else."""
    # Windows' editors put a mark in front of the text, which JSON does not know.
    text = read_text(path, MAX_FILE_BYTES).removeprefix("\ufeff")
    try:
        table = json.loads(text, parse_constant=_no_number)
    except (ValueError, RecursionError) as error:
        raise WorldError(f"not JSON: {error}") from error
    if not isinstance(table, dict):
        raise WorldError("holds no table of keys and values")
    return table


def length_rows(table: dict[str, Any], key: str, width: int) -> FloatArray:
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


def world_of_walls(table: dict[str, Any], walls: FloatArray) -> World:
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
