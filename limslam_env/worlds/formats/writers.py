"""Worlds into files: TOML, which keeps everything, and ROS's map_server format, which keeps the walls."""

import math
import os
import secrets
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy import ndimage

from limslam_env.geometry import FloatArray
from limslam_env.geometry.segment import sample
from limslam_env.worlds.formats.map_server import COARSEST, FINEST, MAX_PIXELS
from limslam_env.worlds.free_space import block_inside
from limslam_env.worlds.world import World, WorldError

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
"""Levels of a map's cells, as map_server's own saver writes them."""

_MARGIN = 4  # cells around the walls
_BATCH = 100  # walls drawn in one go
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\b": "\\b", "\t": "\\t", "\n": "\\n", "\f": "\\f", "\r": "\\r"}


def world_toml(world: World) -> str:
    """The text of a TOML file from which ``parse_world`` makes an equal world."""
    lines = [f"name = {_quoted(world.name)}", f"size = {list(world.size)}", *_listed("walls", world.walls.tolist())]
    if world.obstacles:
        lines += _listed("obstacles", [polygon.tolist() for polygon in world.obstacles])
    for key in ("doors", "starts", "loop"):
        rows = getattr(world, key).tolist()
        lines += _listed(key, rows) if rows else []
    return "\n".join(lines) + "\n"


def write_world(world: World, path: str | os.PathLike[str], resolution: float = 0.05) -> None:
    """Write a world as ``.toml``, or as ``.yaml`` for map_server with a ``.pgm`` beside it.

    A map has walls and obstacles only: of a world's doors, starts and loop nothing is left in it. Its walls are
    one cell thick; what they close in is free, and the outside is unknown.

    Parameters
    ----------
    world
        What to write.
    path
        Where to. A file that is there already is replaced, and stays as it was if the new one cannot be written.
    resolution
        Side of a map's cell, m.

    Raises
    ------
    WorldError
        If the suffix is neither, the map would have too many cells, or nothing can be written there.
    """
    path = Path(path)
    if path.suffix == ".toml":
        _put(path, world_toml(world).encode())
    elif path.suffix in {".yaml", ".yml"}:
        _write_map(world, path, resolution)
    else:
        raise WorldError(f"{path}: a world is written as .toml or .yaml, not {path.suffix!r}")


def _write_map(world: World, path: Path, resolution: float) -> None:
    if not FINEST <= resolution <= COARSEST:
        raise WorldError(f"{path}: cells must measure {FINEST:g} to {COARSEST:g} m, not {resolution:g}")
    corners = world.edges.reshape(-1, 2)
    # Half a cell off: walls on round numbers run through the middle of cells, not between two.
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
    _put(image, f"P5\n{columns} {rows}\n255\n".encode() + levels.tobytes())
    _put(path, yaml.safe_dump(about, sort_keys=False, allow_unicode=True, default_flow_style=None).encode())


def _levels(world: World, low: FloatArray, cell: float, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """The map's cells (rows, columns), row 0 at the bottom."""
    free = np.ones(shape, dtype=bool)
    # A cell is a wall if the wall goes through it: points no further apart than a cell skip none.
    for walls in np.array_split(world.edges, math.ceil(len(world.edges) / _BATCH)):
        points, _ = sample(walls, cell)
        columns, rows = np.floor((points - low) / cell).astype(int).T
        free[rows, columns] = False
    for polygon in world.obstacles:
        block_inside(free, polygon, low, cell)
    # Steps to four sides: a slanting wall's cells touch at corners, and must not let the outside in.
    regions, _ = ndimage.label(free)
    levels = np.where(regions == regions[0, 0], UNKNOWN, FREE)
    return np.where(free, levels, OCCUPIED).astype(np.uint8)


def _put(path: Path, content: bytes) -> None:
    """Write a file beside its place, and move it there when it is whole."""
    beside = path.with_name(f".{secrets.token_hex(8)}.part")
    try:
        try:
            beside.write_bytes(content)
            beside.replace(path)
        finally:
            beside.unlink(missing_ok=True)
    except (OSError, ValueError) as error:
        raise WorldError(f"{path}: cannot be written: {error}") from error


def _listed(key: str, rows: list[Any]) -> list[str]:
    # What Python writes of a list of floats is TOML, and the shortest that reads back as the same floats.
    return [f"{key} = [", *(f"    {row}," for row in rows), "]"]


def _quoted(text: str) -> str:
    """A text as TOML's basic string, which can hold every character."""
    return '"' + "".join(_ESCAPES.get(letter) or _visible(letter) for letter in text) + '"'


def _visible(letter: str) -> str:
    return f"\\u{ord(letter):04x}" if ord(letter) < 32 or ord(letter) == 127 else letter
