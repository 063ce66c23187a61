"""Worlds as maps of ROS's map_server, which keep the walls and the obstacles only."""

import math
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy import ndimage

from limslam_env.geometry import FloatArray, no_rows
from limslam_env.geometry.segment import sample
from limslam_env.worlds.formats.map_server import COARSEST, FINEST
from limslam_env.worlds.formats.pictures import MAX_PIXELS
from limslam_env.worlds.formats.text_files import replace_file
from limslam_env.worlds.free_space import clear
from limslam_env.worlds.world import World, WorldError

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
"""Levels of a map's cells, as map_server's own saver writes them."""

_MARGIN = 4  # cells around the walls
_BATCH = 100  # walls drawn in one go


def write_map(world: World, path: Path, resolution: float) -> None:
    """Write a world as a ``.yaml`` and a ``.pgm`` beside it, with cells of ``resolution``, m.

    Raises
    ------
    WorldError
        If the cells are too small or too many, or a file cannot be written.
    """
    if not FINEST <= resolution <= COARSEST:
        raise WorldError(f"{path}: cells must measure {FINEST:g} to {COARSEST:g} m, not {resolution:g}")
    corners = world.edges.reshape(-1, 2)
    # The grid is shifted by half a cell, so that walls on round numbers run through the middle of cells.
    low = corners.min(axis=0) - (_MARGIN + 0.5) * resolution
    columns, rows = (np.floor((corners.max(axis=0) - low) / resolution)).astype(int) + 1 + _MARGIN
    if rows * columns > MAX_PIXELS:
        raise WorldError(f"{path}: {columns} x {rows} cells of {resolution:g} m; a map has up to {MAX_PIXELS}")
    image = path.with_suffix(".pgm")
    about = {
        "image": image.name,
        "resolution": float(resolution),
        "origin": [*low.tolist(), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    levels = _levels(world, low, resolution, (rows, columns))[::-1]
    replace_file(image, f"P5\n{columns} {rows}\n255\n".encode() + levels.tobytes())
    replace_file(path, yaml.safe_dump(about, sort_keys=False, allow_unicode=True, default_flow_style=None).encode())


def _levels(world: World, low: FloatArray, cell: float, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """The map's cells (rows, columns), row 0 at the bottom."""
    free = np.ones(shape, dtype=bool)
    # A cell is a wall if the wall goes through it: points no further apart than a cell skip none.
    for walls in np.array_split(world.edges, math.ceil(len(world.edges) / _BATCH)):
        points, _ = sample(walls, cell)
        columns, rows = np.floor((points - low) / cell).astype(int).T
        free[rows, columns] = False
    clear(free, no_rows(4), world.obstacles, 0.0, low, cell)
    # Steps to four sides: a slanting wall's cells touch at corners, and must not let the outside in.
    regions, _ = ndimage.label(free)
    levels = np.where(regions == regions[0, 0], UNKNOWN, FREE)
    return np.where(free, levels, OCCUPIED).astype(np.uint8)
