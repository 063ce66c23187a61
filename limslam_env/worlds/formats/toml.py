"""Worlds as TOML: the format of the worlds that come with the package; it keeps everything.

JSON files may have the same keys.
"""

import tomllib
from typing import Any

from limslam_env.worlds.formats.text_files import number_array
from limslam_env.worlds.world import World, WorldError, named

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
