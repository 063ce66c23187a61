"""Worlds as tables of keys: what the TOML files of worlds and JSON files with the same keys have in common."""

from typing import Any

from limslam_env.worlds.formats.text_files import number_array
from limslam_env.worlds.world import World, WorldError

_KEYS = {"name", "size", "walls", "obstacles", "doors", "starts", "loop"}


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
