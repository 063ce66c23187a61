"""Maps of the exploration work of the MARMot Lab: grey PNG files, as their code reads them.

The format is that of ``env.py`` in the repositories ARiADNE (MIT licence) and large-scale-DRL-exploration (commit
``8aabb0d``). The maps were made by F. Chen, S. Bai, T. Shan and B. Englot, "Self-learning exploration and mapping for
mobile robots via deep reinforcement learning", AIAA SciTech Forum, 2019. No map and no code of theirs is part of
LimSLAM.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.worlds.formats.outlines import outlines_of
from limslam_env.worlds.formats.pictures import read_picture
from limslam_env.worlds.world import World, WorldError, named

START_GREY, FREE_ABOVE = 208, 150
"""The level of the pixels where robots start, and the level above which a pixel is free."""

START_PIXEL = 127
"""Number of the pixel among those of the start, row by row, at which the robot starts."""

_GREY = np.array([0.2125, 0.7154, 0.0721])  # of red, green and blue, as scikit-image weighs them
_ROUNDING = 1e-6
_BORDER = 2  # pixels of wall around the picture, so that no robot leaves it
_SPARE = 1.5  # pixels between the body and the nearest wall pixel at the start


@dataclass(frozen=True, eq=False)
class PeerMap:
    """A map.

    Attributes
    ----------
    name
        Name of the file.
    free
        Free pixels (rows, columns), uppermost row first. Numbers of rows and columns are even.
    start
        Row and column of the pixel at which the robot starts.
    """

    name: str
    free: BoolArray
    start: tuple[int, int]

    @cached_property
    def digest(self) -> str:
        """A digest of the content: 16 hexadecimal digits."""
        content = repr((self.free.shape, self.start)).encode() + np.packbits(self.free).tobytes()
        return hashlib.sha256(content).hexdigest()[:16]

    def place(self, pixel: tuple[int, int], scale: float) -> FloatArray:
        """The middle (2,), m, of a pixel given as row and column. A pixel has a side of ``scale`` (m); y is up."""
        return np.array([pixel[1] + 0.5, len(self.free) - pixel[0] - 0.5]) * scale

    def pixel(self, place: FloatArray, scale: float) -> tuple[int, int]:
        """Row and column of the pixel in which a place (2,), m, lies."""
        return len(self.free) - 1 - int(np.floor(place[1] / scale)), int(np.floor(place[0] / scale))


def read_maps(folder: Path, count: int) -> list[PeerMap]:
    """The first maps of a folder, in the order in which the code of the peers takes them: by name, backwards.

    Raises
    ------
    ValueError
        If there is no such folder, it holds no PNG file, or one of the maps cannot be used.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder of maps")
    paths = sorted(folder.glob("*.png"), key=lambda path: path.name, reverse=True)
    if not paths:
        raise ValueError(f"{folder}: holds no .png file")
    return [read_map(path) for path in paths[:count]]


def read_map(path: Path) -> PeerMap:
    """The map in a PNG file.

    Raises
    ------
    WorldError
        If the file is no picture, or the start or all walls are missing; the message names the file.
    """
    with named(path):
        grey = _with_start(read_picture(path, _grey))
        starts = np.argwhere(grey == START_GREY)
        if len(starts) <= START_PIXEL:
            raise WorldError(
                f"no start: {len(starts)} pixels have the grey level {START_GREY}, and {START_PIXEL + 1} are needed"
            )
        free = grey > FREE_ABOVE
        if free.all():
            raise WorldError(f"no walls: all pixels have grey levels above {FREE_ABOVE}")
        row, column = starts[START_PIXEL]
        return PeerMap(path.name, _even(free), (int(row), int(column)))


def _grey(image: Image.Image) -> FloatArray:
    """Grey levels (rows, columns), whole numbers from 0 to 255."""
    if image.mode.startswith("I"):
        raise WorldError("has 16 or more bits for a pixel, and the maps have eight")
    if image.mode == "L":
        return np.asarray(image).astype(float)
    # The weights sum to 1 up to rounding, which must not take 208 for 207.
    return np.asarray(np.floor(np.asarray(image.convert("RGB")) @ _GREY + _ROUNDING))


def _with_start(grey: FloatArray) -> FloatArray:
    """The levels in which the start is found.

    Readers of the peers multiply all levels by 255. In pictures with one channel that is 256 minus the level, because
    their numbers have eight bits.
    """
    return grey if np.count_nonzero(grey == START_GREY) > START_PIXEL else _flipped(grey)


def _flipped(grey: FloatArray) -> FloatArray:
    flipped = (grey * 255) % 256
    return flipped if np.count_nonzero(flipped == START_GREY) > START_PIXEL else grey


def _even(free: BoolArray) -> BoolArray:
    """The pixels with a row and a column of wall added where the number is odd."""
    rows, columns = free.shape
    return np.pad(free, ((0, rows % 2), (0, columns % 2)))


def world_of(found: PeerMap, scale: float, radius: float) -> World:
    """The map as a world for a robot with a body of ``radius``, m. The robot starts where its body fits.

    Walls run along the outlines of the wall pixels and are straightened by up to a pixel, so jagged outlines do not
    make a wall of each pixel. Free pixels that cannot be reached count as wall. What is solid is no floor: patches
    inside are obstacles, and the solid ground around the rooms is open to the outside.

    Parameters
    ----------
    found
        The map.
    scale
        Side of a pixel, m.
    radius
        Radius of the body, m.

    Raises
    ------
    WorldError
        If the body fits nowhere.
    """
    with named(found.name):
        pixel = start_with_body(found, radius / scale)
        regions, _ = ndimage.label(found.free)
        polygons, walls = outlines_of(np.pad(regions != regions[pixel], _BORDER, constant_values=True))
        rows, columns = found.free.shape
        walls, start = walls - _BORDER, found.place(pixel, scale)
        # The outline of the border around the picture has its corners out there.
        corners = walls.reshape(-1, 2, 2)
        is_outside = np.any((corners < -1.0) | (corners > np.array([columns, rows]) + 1.0), axis=2)
        return World(
            found.name,
            (columns * scale, rows * scale),
            walls[~np.all(is_outside, axis=1)] * scale,
            tuple((polygon - _BORDER) * scale for polygon in polygons),
            starts=np.array([[*start, 0.0]]),
        )


def start_with_body(found: PeerMap, radius: float) -> tuple[int, int]:
    """The pixel nearest to the start, as row and column, at which a body of ``radius``, in pixels, touches no wall.

    Raises
    ------
    WorldError
        If there is none.
    """
    gaps = ndimage.distance_transform_edt(np.pad(found.free, 1))[1:-1, 1:-1]
    fits = np.argwhere(gaps >= radius + _SPARE)
    if not len(fits):
        raise WorldError(f"a robot with a radius of {radius:.1f} pixels fits nowhere: choose a larger scale")
    row, column = fits[np.argmin(((fits - found.start) ** 2).sum(axis=1))]
    return int(row), int(column)
