"""Worlds as wall lists: JSON files ``{"id": ..., "walls": [[x1, y1, x2, y2], ...]}``, lengths in metres."""

import os
from pathlib import Path
from typing import Any

from limslam_env.worlds.formats.json_files import length_rows, read_table, world_of_walls
from limslam_env.worlds.world import World, named


def read_wall_list(path: str | os.PathLike[str]) -> World:
    """The world in a file ``{"id": ..., "walls": [[x1, y1, x2, y2], ...]}``, lengths in metres.

    Walls without length are left out, as is whatever else the file says: here walls have no thickness.

    Raises
    ------
    WorldError
        If the file cannot be used; the message names file and reason.
    """
    with named(path):
        return wall_list_world(read_table(Path(path)))


def wall_list_world(table: dict[str, Any]) -> World:
    """The world in the object of such a file; a WorldError where it cannot be used."""
    return world_of_walls(table, length_rows(table, "walls", 4))
