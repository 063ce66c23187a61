"""Prepared floor plans on disk, so that later processes need not draw and prepare them again.

An entry is written under another name first, and then renamed, so that no reader sees half of it. Its name depends on
all that the plan depends on, the code included. One that is damaged or cannot be read counts as missing, and is written
again.
"""

import hashlib
import io
import os
import platform
import sys
import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from limslam_env.batch.worlds import Site, StartCells, from_tiles, to_tiles
from limslam_env.compilation import ENV_SOURCES, source_stamp
from limslam_env.geometry import no_rows
from limslam_env.interface import RobotSpec
from limslam_env.simulation.sensors import build_wall_index
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig

FOLDER = "LIMSLAM_CACHE"
"""Name of the environment variable for the folder of the cache; ``off`` switches the cache off."""

MOST_BYTES = 500_000_000
"""Largest size of all entries. Beyond it, the oldest entries are removed."""

_SOURCES = (
    *ENV_SOURCES, "limslam_env.config", "limslam_env.worlds", "limslam_env.worlds.generation",
    "limslam_env.simulation", "limslam_env.batch",
)  # fmt: skip


def cache_folder() -> Path | None:
    """The folder of the cache: that of ``LIMSLAM_CACHE``, or one in the user's folder for caches; None without any."""
    chosen = os.environ.get(FOLDER)
    if chosen:
        return None if chosen.lower() == "off" else Path(chosen)
    named = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
    with suppress(RuntimeError):  # a user without a home
        return (Path(named) if named else Path.home() / ".cache") / "limslam" / "plans"
    return None


class PlanCache:
    """The prepared floor plans of one setting, by their seeds.

    Parameters
    ----------
    config, robot
        Settings of the floor plans, and the robots that drive in them.
    folder
        Where the entries lie; None keeps nothing.
    """

    def __init__(self, config: FloorPlanConfig, robot: RobotSpec, folder: Path | None) -> None:
        self._robot, self._folder = robot, folder
        parts = config, robot.radius, robot.reach, np.__version__, platform.machine(), source_stamp(*_SOURCES)
        self._key = repr(parts).encode()

    def path(self, seed: int) -> Path | None:
        """The file of a seed's entry."""
        name = hashlib.sha256(self._key + b" %d" % seed).hexdigest()[:32]
        return None if self._folder is None else self._folder / f"{name}.plan"

    def read(self, seed: int) -> Site | None:
        """The prepared plan of a seed; None if there is no usable entry."""
        path = self.path(seed)
        if path is None:
            return None
        try:
            # numpy checks the sums of the archive, and makes no objects.
            with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as kept:
                walls, starts = build_wall_index(kept["edges"]), (kept["runs"], int(kept["count"]), kept["space"])
                cells, area = kept["cells"], kept["area"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        return Site(walls, self._robot.reach, area, cells.shape, to_tiles(cells), StartCells(no_rows(3), *starts))

    def write(self, seed: int, site: Site) -> None:
        """Keep the prepared plan of a seed. Nothing is kept where nothing can be written."""
        path = self.path(seed)
        if path is None:
            return
        arrays: dict[str, Any] = {
            "edges": site.walls.edges, "runs": site.starts.runs, "count": site.starts.count,
            "space": site.starts.space, "cells": from_tiles(site.tiles, site.shape), "area": site.area,
        }  # fmt: skip
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            number, name = tempfile.mkstemp(prefix=".", suffix=".part", dir=path.parent)
            try:
                with os.fdopen(number, "wb") as file:
                    np.savez(file, **arrays)
                # Other users read it, too, if the folder lets them.
                Path(name).chmod(0o644)
                Path(name).replace(path)
            except OSError:
                Path(name).unlink(missing_ok=True)
                raise

    def prune(self, most_bytes: int = MOST_BYTES) -> None:
        """Remove the oldest entries until all take at most so many bytes."""
        if self._folder is None:
            return
        found = []
        with suppress(OSError), os.scandir(self._folder) as entries:
            for entry in entries:
                if entry.name.endswith((".plan", ".part")):
                    with suppress(OSError):  # another process has removed it
                        found.append((entry.stat().st_mtime, entry.stat().st_size, entry.path))
        total = sum(size for _, size, _ in found)
        for _, size, path in sorted(found):
            if total <= most_bytes:
                return
            with suppress(OSError):
                Path(path).unlink()
            total -= size
