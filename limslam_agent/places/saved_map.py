"""The map of an earlier run, in which a later run begins at an unknown place."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from limslam_agent.grid.occupancy import GridView
from limslam_agent.map_file import read_map_file
from limslam_agent.safe_files import read_limited
from limslam_agent.slam.core.line_map import Landmark
from limslam_env.geometry import FloatArray
from limslam_env.messages import one_line

# grey values of map.pgm: up to the first is wall, the second is unknown
_WALL = 100
_UNKNOWN = 205
_KNOWN = 4  # value of a known cell of the grid: as sure as a few beams make it


class SavedMapError(ValueError):
    """A folder holds no map, or a file of it cannot be used. The message says which and why."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


@dataclass(frozen=True, eq=False)
class SavedMap:
    """The map of an earlier run.

    Attributes
    ----------
    segments
        Walls (k, 4), m.
    landmarks
        The lines that the walls lie on, with covariances.
    grid
        Occupancy grid.
    """

    segments: FloatArray
    landmarks: list[Landmark]
    grid: GridView


def read_saved_map(folder: Path) -> SavedMap:
    """Read ``map.json``, ``map.yaml`` and ``map.pgm`` of the folder of a run, a replay or a live
    robot.

    Raises
    ------
    SavedMapError
        If a file is missing or damaged, or the map has no walls or too many.
    """
    if not folder.is_dir():
        raise SavedMapError(f"{folder}: is not a folder with a map")
    path = folder / "map.json"
    try:
        content, segments = read_map_file(path)
    except ValueError as error:
        raise SavedMapError(str(error)) from error
    try:
        landmarks = [
            _landmark(number, each, len(segments))
            for number, each in enumerate(content["landmarks"])
        ]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise SavedMapError(f"{path}: is no map of limslam: {error}") from error
    if not len(segments) or np.abs(segments).max() > 1e6:
        raise SavedMapError(f"{path}: has no walls, or walls beyond 1e6 m")
    return SavedMap(segments, landmarks, read_grid(folder))


def _landmark(number: int, found: dict[str, Any], walls: int) -> Landmark:
    covariance = np.array(found["cov"], dtype=float)
    ends = np.array(found["ends"], dtype=float)
    segments = tuple(int(each) for each in found["segments"])
    if (
        covariance.shape != (2, 2)
        or ends.shape != (2, 2)
        or not all(0 <= each < walls for each in segments)
    ):
        raise ValueError(f"landmark {number} has wrong covariances, ends or segments")
    numbers = [float(found["r"]), float(found["theta"]), *covariance.ravel(), *ends.ravel()]
    if not np.abs(numbers).max() <= 1e6 or np.linalg.eigvalsh(covariance)[0] < -1e-12:
        raise ValueError(
            f"landmark {number} has numbers that are not finite or above 1e6, or no covariance"
        )
    return Landmark(
        numbers[0], numbers[1], covariance, ends, int(found["observations"]), number, segments
    )


def read_grid(folder: Path) -> GridView:
    """The occupancy grid in ``map.yaml`` and ``map.pgm`` of a folder.

    Raises
    ------
    SavedMapError
        If a file is missing or damaged.
    """
    try:
        words = read_limited(folder / "map.yaml").decode("utf-8")
        cell = float(re.findall(r"^resolution: *(\S+)$", words, re.MULTILINE)[0])
        origin = re.findall(r"^origin: *\[([^,]+),([^,]+),", words, re.MULTILINE)[0]
        low = np.array([float(each) for each in origin])
        pixels = _pixels(read_limited(folder / "map.pgm"))
    except OSError as error:
        raise SavedMapError(
            f"{folder}: its map.yaml or map.pgm cannot be read: {error.strerror or error}"
        ) from error
    except (IndexError, ValueError) as error:
        raise SavedMapError(
            f"{folder}: its map.yaml or map.pgm is not as limslam writes it"
        ) from error
    if not (0.0 < cell < 1e3 and np.isfinite(low).all() and np.abs(low).max() < 1e6):
        raise SavedMapError(f"{folder / 'map.yaml'}: its resolution or its origin is impossible")
    values = np.where(pixels <= _WALL, -_KNOWN, np.where(pixels == _UNKNOWN, 0, _KNOWN)).astype(
        np.int16
    )
    return GridView(low, cell, values)


def _pixels(content: bytes) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    """Grey values (rows, columns) of a binary PGM file, row 0 at the bottom."""
    header = re.match(rb"P5\s+(\d{1,6})\s+(\d{1,6})\s+255\s", content)
    if header is None:
        raise ValueError("no PGM file")
    columns = int(header[1])
    rows = int(header[2])
    if len(content) - header.end() != rows * columns:
        raise ValueError("a PGM file of another length")
    return np.frombuffer(content, dtype=np.uint8, offset=header.end()).reshape(rows, columns)[::-1]
