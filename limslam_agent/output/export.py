"""Writes trajectories, maps and the folder of a run, which is either complete or does not exist."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray

RESULT_FILE = "result.json"


class OutputError(ValueError):
    """Results cannot be written to a folder. The message says which folder and why."""


@contextmanager
def new_folder(target: Path, *, force: bool = False) -> Iterator[Path]:
    """A folder to write to, which is moved to ``target`` only when everything has been written.

    Parameters
    ----------
    target
        Final place of the results. An empty folder may exist there.
    force
        Replace the results of an earlier run there.

    Yields
    ------
    Path
        The folder beside ``target`` to write to.

    Raises
    ------
    OutputError
        If something else is there, or the folder cannot be written.
    """
    target = target.absolute()
    _check_target(target, force=force)
    missing = [parent for parent in target.parents if not parent.exists()]
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        beside = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise OutputError(f"{target}: cannot be written: {error.strerror or error}") from error
    try:
        yield beside
        # mkdtemp makes private folders. Results get the permissions of the user's other files.
        mask = os.umask(0)
        os.umask(mask)
        beside.chmod(0o777 & ~mask)
        _put_in_place(beside, target)
    finally:
        shutil.rmtree(beside, ignore_errors=True)
        for parent in missing:
            if parent.is_dir() and not any(parent.iterdir()):
                parent.rmdir()


def _check_target(target: Path, *, force: bool) -> None:
    if target.is_dir():
        if not any(target.iterdir()):
            return
        if not (target / RESULT_FILE).is_file():
            raise OutputError(f"{target}: is not empty and does not hold the results of a run")
        if not force:
            raise OutputError(f"{target}: already holds the results of a run; --force replaces them")
    elif target.exists() or target.is_symlink():
        raise OutputError(f"{target}: is not a folder")


def _put_in_place(beside: Path, target: Path) -> None:
    if not target.is_dir():
        beside.rename(target)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{target.name}-old-", dir=target.parent)) / "run"
    target.rename(old)
    try:
        beside.rename(target)
    except BaseException:  # an interrupt must not destroy the old results, either
        old.rename(target)
        raise
    finally:
        if target.is_dir():
            shutil.rmtree(old.parent, ignore_errors=True)


def write_tum(path: Path, time: FloatArray, poses: FloatArray) -> None:
    """Write a trajectory (n, 3) as TUM lines ``t x y z qx qy qz qw``, s and m."""
    half = 0.5 * poses[:, 2]
    zero = np.zeros(len(poses))
    table = np.column_stack((time, poses[:, 0], poses[:, 1], zero, zero, zero, np.sin(half), np.cos(half)))
    np.savetxt(path, table, fmt="%.6f %.6f %.6f %.0f %.0f %.0f %.9f %.9f")


def write_json(path: Path, content: Any) -> None:
    """Write readable JSON. NaN and infinity are errors. Values that do not apply are ``null``."""
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")


def map_content(landmarks: list[Landmark]) -> dict[str, Any]:
    """The content of ``map.json`` in the world frame, m and rad."""
    return {
        "frame": "world",
        "segments": [[round(float(value), 6) for value in mark.ends.ravel()] for mark in landmarks],
        "landmarks": [
            {
                "r": mark.r,
                "theta": mark.theta,
                "cov": mark.covariance.tolist(),
                "ends": mark.ends.tolist(),
                "observations": mark.observations,
            }
            for mark in landmarks
        ],
    }


def write_grid(folder: Path, grid: GridView) -> None:
    """Write ``map.pgm`` and ``map.yaml`` in the format of ROS's map_server."""
    # A log without a scan leaves an empty grid. A picture needs at least one pixel.
    values = grid.values if grid.values.size else np.zeros((1, 1))
    pixels = np.where(values > 0, 254, np.where(values < 0, 0, 205)).astype(np.uint8)[::-1]
    header = f"P5\n{pixels.shape[1]} {pixels.shape[0]}\n255\n".encode()
    (folder / "map.pgm").write_bytes(header + pixels.tobytes())
    x, y = grid.low
    (folder / "map.yaml").write_text(
        f"image: map.pgm\nresolution: {grid.cell:g}\norigin: [{x:.6f}, {y:.6f}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        encoding="utf-8",
    )
