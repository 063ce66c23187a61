"""Prepared floor plans on disk, so that later processes need not draw and prepare them again.

The folder may be shared between processes and users. An entry is written under another name first, and then renamed, so
that no reader sees half of it. Its name depends on all that the plan depends on, the code included. Its content begins
with a digest of the rest: an entry that is damaged or cannot be read counts as missing, and is written again. An entry
holds walls, cells and runs of cells alone, and all are checked, so that none leads outside of the simulation's arrays.
"""

import hashlib
import os
import platform
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import numpy as np

from limslam_env.batch.worlds import Site, StartCells, from_tiles, to_tiles
from limslam_env.compilation import ENV_SOURCES, source_stamp
from limslam_env.geometry import IntArray, no_rows
from limslam_env.interface import RobotSpec
from limslam_env.simulation.coverage import CELL, grid_over
from limslam_env.simulation.sensors import build_wall_index
from limslam_env.worlds.free_space import cell_for, grid_around
from limslam_env.worlds.generation.floor_plans import FloorPlanConfig
from limslam_env.worlds.world import MAX_EDGES, MAX_SIDE

FOLDER = "LIMSLAM_CACHE"
"""Name of the environment variable for the folder of the cache; ``off`` switches the cache off."""

MOST_BYTES = 500_000_000
"""Largest size of all entries. Beyond it, the oldest entries are removed."""

_FORMAT = b"limslam plan 1\n"
_LARGEST_ENTRY = 64_000_000
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
            with path.open("rb") as file:
                data = file.read(_LARGEST_ENTRY)
            begin = len(_FORMAT) + 32
            if data[: len(_FORMAT)] != _FORMAT or data[len(_FORMAT) : begin] != _digest(data[begin:]):
                return None
            return _unpacked(data[begin:], self._robot)
        except (OSError, ValueError):
            return None

    def write(self, seed: int, site: Site) -> None:
        """Keep the prepared plan of a seed. Nothing is kept where nothing can be written."""
        path = self.path(seed)
        if path is None:
            return
        content = _packed(site)
        with suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            number, name = tempfile.mkstemp(prefix=".", suffix=".part", dir=path.parent)
            try:
                with os.fdopen(number, "wb") as file:
                    file.write(_FORMAT + _digest(content) + content)
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


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def _packed(site: Site) -> bytes:
    """What cannot be computed quickly: edges, runs of cells, and coverable cells."""
    edges, runs = site.walls.edges, site.starts.runs
    counts = np.array([len(edges), len(runs), site.starts.count], dtype="<i8")
    cells = np.packbits(from_tiles(site.tiles, site.shape))
    return b"".join((counts.tobytes(), edges.astype("<f8").tobytes(), runs.astype("<i4").tobytes(), cells.tobytes()))


def _unpacked(content: bytes, robot: RobotSpec) -> Site:
    """The site that :func:`_packed` took apart.

    Raises
    ------
    ValueError
        If it is none.
    """
    num_edges, num_runs, count = np.frombuffer(content, "<i8", 3).tolist()
    if not (0 < num_edges <= MAX_EDGES and 0 < num_runs <= len(content) // 8):
        raise ValueError("counts that no plan has")
    edges = np.frombuffer(content, "<f8", 4 * num_edges, 24).astype(float).reshape(-1, 4)
    if not np.isfinite(edges).all() or np.abs(edges).max() > MAX_SIDE:
        raise ValueError("walls that no plan has")
    runs = np.frombuffer(content, "<i4", 2 * num_runs, 24 + 32 * num_edges).astype(np.int32).reshape(-1, 2)
    cell, (low, shape) = cell_for(edges, robot.radius), grid_over(edges)
    origin, (rows, columns) = grid_around(edges, robot.radius, cell)
    _check_runs(runs, count, rows * columns)
    bits = np.frombuffer(content, np.uint8, -1, 24 + 32 * num_edges + 8 * num_runs)
    if len(bits) != -(-shape[0] * shape[1] // 8):
        raise ValueError("cells that no plan has")
    cells = np.unpackbits(bits, count=shape[0] * shape[1]).astype(bool).reshape(shape)
    starts = StartCells(no_rows(3), runs, count, np.array([*origin, cell, columns]))
    return Site(build_wall_index(edges), robot.reach, np.array([*low, CELL]), shape, to_tiles(cells), starts)


def _check_runs(runs: IntArray, count: int, num_cells: int) -> None:
    """Make sure that runs (r, 2) of ``count`` cells lie in a grid of so many cells."""
    befores = np.append(runs[:, 1].astype(np.int64), count)
    lengths = befores[1:] - befores[:-1]
    ends = runs[:, 0] + lengths
    if runs[0, 1] != 0 or (lengths <= 0).any() or (runs[:, 0] < 0).any() or (ends > num_cells).any():
        raise ValueError("places to start that no plan has")
