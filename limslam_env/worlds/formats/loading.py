"""Any world: by the name of a shipped one, or from a file in any format that can be read."""

import os
from importlib import resources
from pathlib import Path
from typing import TypeAlias

from limslam_env.worlds.formats.readers import read_json, read_text
from limslam_env.worlds.world import MAX_FILE_BYTES, World, WorldError, named, parse_world

WorldSource: TypeAlias = str | os.PathLike[str] | World


def load_world(source: WorldSource) -> World:
    """A world by the name of a shipped one, by the path of a file, or as it is.

    Raises
    ------
    WorldError
        If there is no such world, or it cannot be used; the message names file and reason.
    """
    if isinstance(source, World):
        return source
    if isinstance(source, str) and source in shipped_worlds():
        text = resources.files("limslam_env.worlds").joinpath(f"{source}.toml").read_text(encoding="utf-8")
        return parse_world(text, source)
    path = Path(source)
    try:
        is_there = path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        is_there = False
    if not is_there:
        if path.suffix:
            raise WorldError(f"{path}: no such file")
        raise WorldError(f"no world is called {source!r}; there are {', '.join(shipped_worlds())}, or give a file")
    return _load_file(path)


def _load_file(path: Path) -> World:
    if path.suffix == ".toml":
        with named(path):
            text = read_text(path, MAX_FILE_BYTES)
        return parse_world(text, str(path))
    if path.suffix == ".json":
        return read_json(path)
    if path.suffix in {".yaml", ".yml"}:
        # Brings OpenCV and YAML, which worlds of TOML and JSON can do without.
        from limslam_env.worlds.formats.map_server import read_map_server

        return read_map_server(path)
    raise WorldError(f"{path}: not a world file that can be read (.toml, .yaml, .json)")


def shipped_worlds() -> list[str]:
    """Names of the worlds that come with the package."""
    files = resources.files("limslam_env.worlds").iterdir()
    return sorted(Path(file.name).stem for file in files if file.name.endswith(".toml"))
