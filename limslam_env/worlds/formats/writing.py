"""Writes a world in the format that a file's name asks for."""

import os
from pathlib import Path

from limslam_env.worlds.formats.text_files import replace_file
from limslam_env.worlds.formats.toml import world_toml
from limslam_env.worlds.world import World, WorldError


def write_world(world: World, path: str | os.PathLike[str], resolution: float = 0.05) -> None:
    """Write a world as ``.toml``, or as ``.yaml`` for map_server with a ``.pgm`` beside it.

    A map holds walls and obstacles only: doors, starts and the loop are not written. Walls are one cell thick, enclosed
    cells are free, and cells outside are unknown.

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
        replace_file(path, world_toml(world).encode())
    elif path.suffix in {".yaml", ".yml"}:
        # Needs YAML, which worlds in TOML do without.
        from limslam_env.worlds.formats.map_server_writer import write_map

        write_map(world, path, resolution)
    else:
        raise WorldError(f"{path}: a world is written as .toml or .yaml, not {path.suffix!r}")
