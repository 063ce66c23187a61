"""Worlds as wall lists: JSON files ``{"id": ..., "walls": [[x1, y1, x2, y2], ...]}``, lengths in metres."""

from typing import Any

from limslam_env.worlds.formats.json_files import length_rows, world_of_walls
from limslam_env.worlds.world import World


def wall_list_world(table: dict[str, Any]) -> World:
    """The world in the object of such a file; a WorldError where it cannot be used.

    Walls without length are left out, as is whatever else the file says: here walls have no thickness.
    """
    return world_of_walls(table, length_rows(table, "walls", 4))
