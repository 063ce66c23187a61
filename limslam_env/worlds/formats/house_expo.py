"""Worlds of HouseExpo (Li et al., "HouseExpo: a large-scale 2D indoor layout dataset", 2019): outlines of houses.

A house is a JSON file ``{"id": ..., "verts": [[x, y], ...]}``, lengths in metres.
"""

from typing import Any

import numpy as np

from limslam_env.geometry.segment import lengths, polygon_edges
from limslam_env.worlds.formats.json_files import length_rows, world_of_walls
from limslam_env.worlds.world import SHORTEST_EDGE, World, WorldError


def house_world(table: dict[str, Any]) -> World:
    """The world in the object of such a file; a WorldError where it cannot be used."""
    corners = length_rows(table, "verts", 2)
    walls = polygon_edges(corners)
    # A file may repeat the first corner at the end; the outline is closed either way.
    if np.count_nonzero(lengths(walls) >= SHORTEST_EDGE) < 3:
        raise WorldError("verts has fewer than three corners")
    return world_of_walls(table, walls)
