"""Landmarks of a map as tests make them."""

import numpy as np

from limslam_agent.kernels.extents import add_wall, count_hits
from limslam_agent.kernels.tables import LENGTH, LOW, empty_walls
from limslam_agent.slam.consistent.wall_map import NEW, Wall, WallExtent
from limslam_env.geometry import FloatArray


def wall_along(number: int, along: FloatArray, known_as: int = NEW) -> Wall:
    """A landmark on which beams ended at positions (n,), m along its line."""
    walls = empty_walls(1, 4000)
    add_wall(walls, 0)
    count_hits(walls, 0, np.asarray(along, dtype=float))
    low, length = walls.table[0, [LOW, LENGTH]].tolist()
    extent = WallExtent(low, walls.counted[0, :, :length], walls.reached[0, :, :length])
    return Wall(number, extent, 1, len(along), known_as=known_as)
