"""Reads any world: a shipped one by its name, a random floor plan by its seed, or any supported
file; and writes it.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import TypeAlias

import numpy as np

from limslam_env.messages import announce
from limslam_env.worlds.formats.tables import (
    MAX_FILE_BYTES,
    parse_world,
    read_json,
    read_text,
    replace_file,
    world_toml,
)
from limslam_env.worlds.world import World, WorldError, named

RANDOM = "random:"
"""Beginning of the names of random floor plans; the seed follows, and then the size if it is
given.
"""

# A seed of at most 30 digits, and then, if given, width and height in m.
_PLAN = re.compile(
    r"([0-9]{1,30})(?::([0-9]{1,3}(?:\.[0-9]{1,3})?)x([0-9]{1,3}(?:\.[0-9]{1,3})?))?"
)

LARGE = 1.0
"""Size of a file, MB, from which on its world takes many seconds to read and to check."""

_PICTURES = (".png", ".pgm", ".jpg", ".jpeg", ".bmp")
_DRAWINGS = (".svg", ".dxf")
_USES = {"metres_per_pixel": _PICTURES, "metres_per_unit": _DRAWINGS, "layers": _DRAWINGS}

WorldSource: TypeAlias = str | os.PathLike[str] | World


def load_world(
    source: WorldSource,
    *,
    metres_per_pixel: float | None = None,
    metres_per_unit: float | None = None,
    layers: Sequence[str] | None = None,
) -> World:
    """A world by the name of a shipped one, by the path of a file, or as it is.

    ``random:17`` is the floor plan that seed 17 draws by the default settings, for a robot of the
    default radius. ``random:17:40x30`` is a floor plan of 40 x 30 m. These are the names of the
    worlds, too.

    Parameters
    ----------
    source
        Name, path or world.
    metres_per_pixel
        Side of a pixel, m, of a picture (``.png``, ``.pgm``, ``.jpg``, ``.bmp``), which needs it.
    metres_per_unit
        Length of a unit, m, of a drawing (``.svg``, ``.dxf``). Not needed where the file says it.
    layers
        Names of the layers of a drawing whose lines are walls. None chooses by the names.

    Raises
    ------
    WorldError
        If there is no such world, or it cannot be used; the message names file and reason.

    Examples
    --------
    >>> from limslam_env import load_world
    >>> load_world("env2").size
    (9.0, 5.3)
    >>> load_world("random:17:40x30").name
    'random:17:40x30'
    """
    scale = _Scale(metres_per_pixel, metres_per_unit, None if layers is None else (*layers,))
    scale.check_use(source)
    if isinstance(source, World):
        return source
    if isinstance(source, str) and source in shipped_worlds():
        text = (
            resources.files("limslam_env.worlds")
            .joinpath(f"{source}.toml")
            .read_text(encoding="utf-8")
        )
        return parse_world(text, source)
    if not isinstance(source, str | os.PathLike):
        raise WorldError(f"a world is a name, the path of a file, or a World, not {source!r}")
    if isinstance(source, str) and source.startswith(RANDOM):
        return _random_world(source)
    path = Path(source)
    try:
        is_there = path.is_file()
    except (OSError, ValueError):  # a name that no file can have
        is_there = False
    if not is_there:
        if path.suffix:
            raise WorldError(f"{path}: no such file")
        raise WorldError(
            f"no world is called {source!r}; there are {', '.join(shipped_worlds())}, random:SEED, "
            "random:SEED:WIDTHxHEIGHT, or give a file"
        )
    return _load_file(path, scale)


@dataclass(frozen=True)
class _Scale:
    """The arguments of :func:`load_world` for pictures and drawings."""

    metres_per_pixel: float | None
    metres_per_unit: float | None
    layers: tuple[str, ...] | None

    def check_use(self, source: object) -> None:
        """Refuse an argument that a world of this kind does not use."""
        suffix = Path(source).suffix.lower() if isinstance(source, str | os.PathLike) else ""
        for name, suffixes in _USES.items():
            if getattr(self, name) is not None and suffix not in suffixes:
                raise WorldError(f"{source}: {name!r} is for files of {', '.join(suffixes)}")


def _random_world(name: str) -> World:
    # Worlds that are read do without what draws floor plans.
    from limslam_env.interface import RobotSpec
    from limslam_env.worlds.generation.floor_plans import FloorPlanConfig, floor_plan

    found = _PLAN.fullmatch(name.removeprefix(RANDOM))
    if found is None:
        raise WorldError(
            f"{name[:60]!r} names no floor plan: a seed is needed, as in random:17, or a seed and "
            "a size in metres, as "
            "in random:17:40x30"
        )
    seed, width, height = found.groups()
    try:
        config = (
            FloorPlanConfig()
            if width is None
            else FloorPlanConfig(width=float(width), height=float(height))
        )
    except ValueError as error:
        raise WorldError(f"{name}: {error}") from error
    plan = floor_plan(config, np.random.default_rng(int(seed)), RobotSpec().radius)
    size = "" if width is None else f":{float(width):g}x{float(height):g}"
    return replace(plan, name=f"{RANDOM}{int(seed)}{size}")


def _load_file(path: Path, scale: _Scale) -> World:
    megabytes = path.stat().st_size / 1e6
    if megabytes > LARGE:
        announce(f"{path}: a world of {megabytes:.1f} MB is read and checked, up to half a minute")
    suffix = path.suffix.lower()
    if suffix == ".toml":
        with named(path):
            text = read_text(path, MAX_FILE_BYTES)
        return parse_world(text, str(path))
    if suffix == ".json":
        return read_json(path)
    # The others need OpenCV, YAML and more, which worlds in TOML and JSON do without.
    if suffix in {".yaml", ".yml"}:
        from limslam_env.worlds.formats.map_server import read_map_server

        return read_map_server(path)
    if suffix in _PICTURES:
        from limslam_env.worlds.formats.pictures import read_plan

        return read_plan(path, scale.metres_per_pixel)
    if suffix in _DRAWINGS:
        return _load_drawing(path, scale)
    known = ", ".join((".toml", ".yaml", ".json", *_PICTURES, *_DRAWINGS))
    raise WorldError(f"{path}: not a world file that can be read ({known})")


def _load_drawing(path: Path, scale: _Scale) -> World:
    if path.suffix.lower() == ".svg":
        from limslam_env.worlds.formats.svg import read_svg

        return read_svg(path, scale.metres_per_unit, scale.layers)
    from limslam_env.worlds.formats.dxf import read_dxf

    return read_dxf(path, scale.metres_per_unit, scale.layers)


def shipped_worlds() -> list[str]:
    """Names of the worlds that come with the package."""
    files = resources.files("limslam_env.worlds").iterdir()
    return sorted(Path(file.name).stem for file in files if file.name.endswith(".toml"))


def write_world(world: World, path: str | os.PathLike[str], resolution: float = 0.05) -> None:
    """Write a world as ``.toml``, or as ``.yaml`` for map_server with a ``.pgm`` beside it.

    A map holds walls and obstacles only: doors, starts and the loop are not written. Walls are one
    cell of a side ``resolution``, m, thick; enclosed cells are free, and cells outside are unknown.
    A file that is there already is replaced, and stays as it was if the new one cannot be written.

    Raises
    ------
    WorldError
        If the suffix is neither, the map would have too many cells, or nothing can be written
        there.
    """
    path = Path(path)
    if path.suffix == ".toml":
        replace_file(path, world_toml(world).encode())
    elif path.suffix in {".yaml", ".yml"}:
        # Needs YAML, which worlds in TOML do without.
        from limslam_env.worlds.formats.map_server import write_map

        write_map(world, path, resolution)
    else:
        raise WorldError(f"{path}: a world is written as .toml or .yaml, not {path.suffix!r}")
