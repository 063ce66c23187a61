"""Pictures of a floor: their levels, a plan that is only a picture, and the world in cells that are
free, occupied or unknown.
"""

import io
import math
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.segment import inside_polygon
from limslam_env.worlds.formats.outlines import outlines_of, pieces_of
from limslam_env.worlds.formats.tables import read_bytes
from limslam_env.worlds.world import World, WorldError, named

FINEST = 0.001
COARSEST = 10.0
"""Smallest and largest side of a cell, m."""

MAX_PIXELS = 36_000_000

FREE_BELOW = 0.196
OCCUPIED_ABOVE = 0.65
"""Usual thresholds of map_server for the shade of a cell, 0 for white to 1 for black."""

# Pillow's name of a family of formats, PGM among them
_FORMATS = {".pgm": "PPM", ".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG", ".bmp": "BMP"}
SUFFIXES = tuple(_FORMATS)
_MAX_FILE_BYTES = 256_000_000
_GREY_16_BIT = ("I;16", "I;16B", "I")
# Levels of the walls, the floor and the block of the start in the maps of exploration papers, whose
# coloured pixels are the sums of three colours.
_EXPLORED = ((127, 195, 208), (381, 584, 471))
_DEEP = 0.1  # m; between this depth and the outline of a thick wall no robot fits
_BESIDE = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.uint8)  # a cell and its four sides


@dataclass(frozen=True, eq=False)
class Picture:
    """The pixels of a picture, the uppermost row first.

    Attributes
    ----------
    levels, white
        (rows, columns), and the level that stands for white. The level of a coloured pixel is the
        sum of its three colours.
    opacity
        (rows, columns), 0 for transparent to 255. None if all pixels are opaque.
    """

    levels: NDArray[np.integer[Any]]
    white: int
    opacity: NDArray[np.uint8] | None = None


def read_picture(path: Path) -> Picture:
    """The pixels of a PGM, PNG, JPEG or BMP file.

    A WorldError says that it is no such file, is damaged, or has too many pixels.
    """
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise WorldError(f"not a picture that can be read ({', '.join(SUFFIXES)})")
    content = read_bytes(path, _MAX_FILE_BYTES)
    try:
        # Pillow warns about very large pictures, which are refused here.
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(io.BytesIO(content), formats=[_FORMATS[suffix]]) as image,
        ):
            return _pixels(image)
    except Image.DecompressionBombError as error:
        raise WorldError(f"more than the {MAX_PIXELS} pixels that can be read") from error
    # Damaged pictures raise errors of many types: SyntaxError, struct.error, zlib.error and others.
    except Exception as error:
        if isinstance(error, WorldError):
            raise
        is_other = isinstance(error, UnidentifiedImageError)
        reason = f"it is no {suffix[1:].upper()} file" if is_other else " ".join(str(error).split())
        raise WorldError(f"cannot be read: {reason}") from error


def _pixels(image: Image.Image) -> Picture:
    columns, rows = image.size
    if rows * columns > MAX_PIXELS:
        raise WorldError(f"{columns} x {rows} pixels; 1 to {MAX_PIXELS} can be read")
    if image.mode in _GREY_16_BIT:
        return Picture(np.asarray(image).astype(np.uint16), 65_535)
    opacity = None
    if image.mode in {"LA", "PA", "RGBA"} or "transparency" in image.info:
        opacity = np.asarray(image.convert("RGBA"))[:, :, 3].copy()
    if image.mode in {"1", "L", "LA"}:
        return Picture(np.asarray(image.convert("L")), 255, opacity)
    levels = np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16)
    return Picture(levels, 3 * 255, opacity)


def read_plan(path: Path, metres_per_pixel: float | None) -> World:
    """The world in a picture of a plan, whose pixels have a side of ``metres_per_pixel``, m.

    Pixels darker than half are walls, and transparent pixels are white. A picture of exactly three
    levels is read as a map of map_server with the usual thresholds: its middle level is unknown
    unless it is almost white. The maps of exploration papers (ARiADNE, DARE) have three levels of
    their own, by which they are known: robots start in the middle of their block, heading along x.
    A WorldError says what is wrong with the file.
    """
    with named(path):
        if metres_per_pixel is None:
            raise WorldError(
                "a picture does not say how large it is: give the side of a pixel, m, as in "
                "--metres-per-pixel 0.02 (in Python metres_per_pixel=0.02)"
            )
        if not FINEST <= metres_per_pixel <= COARSEST:
            raise WorldError(
                f"metres per pixel must be {FINEST:g} to {COARSEST:g}, not {metres_per_pixel:g}"
            )
        picture = read_picture(path)
        for wall, floor, start in _EXPLORED:
            if np.unique(picture.levels).tolist() == sorted((wall, floor, start)):
                return _explored(
                    path, picture.levels == wall, picture.levels == start, metres_per_pixel
                )
        shade = shade_of(picture)
        if len(np.unique(shade)) == 3:
            occupied = shade > OCCUPIED_ABOVE
            unknown = ~occupied & (shade >= FREE_BELOW)
        else:
            occupied = shade > 0.5
            unknown = np.zeros(shade.shape, dtype=bool)
        return world_of_cells(path_name(path), occupied, unknown, metres_per_pixel)


def _explored(path: Path, solid: BoolArray, block: BoolArray, side: float) -> World:
    """The world of an exploration paper, from its walls and the block of the start, both (rows,
    columns) with sides of ``side``, m.
    """
    world = world_of_cells(path_name(path), solid, np.zeros_like(solid), side)
    row, column = np.argwhere(block).mean(axis=0) + 0.5
    return replace(world, starts=np.array([[column * side, (len(solid) - row) * side, 0.0]]))


def shade_of(picture: Picture) -> FloatArray:
    """The shade of each pixel on white paper, 0 for white to 1 for black."""
    shade: FloatArray = shades(picture).astype(np.float32)[picture.levels]
    if picture.opacity is not None:
        shade *= picture.opacity
        shade /= 255.0
    return shade


def shades(picture: Picture) -> FloatArray:
    """The shade of each level from 0 to white (white + 1,), 0 for white to 1 for black."""
    return np.asarray(np.arange(picture.white, -1, -1) / picture.white)


def path_name(path: Path) -> str:
    """A world's name by its file, whose name may hold bytes that are no text."""
    return path.stem.encode("utf-8", "replace").decode()


def world_of_cells(
    name: str,
    occupied: BoolArray,
    unknown: BoolArray,
    side: float,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> World:
    """The world in cells (rows, columns), the uppermost row first, with sides of ``side``, m.

    Robots stay on free cells. An unknown cell beside a free one holds robots and beams like a wall,
    and so do unknown cells that do not reach the border of the picture. Other unknown cells are
    outside. ``origin`` is the pose (m, rad) of the lower left corner.
    """
    enclosed, rim = _solid_unknown(occupied, unknown)
    solid = occupied | enclosed | rim
    walls, obstacles = outlines_of(solid)
    # Obstacles have no floor inside. What is thick and has holes has outlines only.
    depth = cv2.distanceTransform(solid.astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    insides = [
        piece
        for piece in pieces_of(depth >= max(_DEEP / side, 2.0))
        if not any(inside_polygon(piece[:1], obstacle)[0] for obstacle in obstacles)
    ]
    x, y, yaw = origin
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    width, height = np.abs(turn.T) @ (np.array(occupied.shape[::-1]) * side)

    def placed(points: FloatArray) -> FloatArray:
        return np.asarray(points * side @ turn + (x, y))

    return World(
        name,
        (float(width), float(height)),
        placed(walls.reshape(-1, 2)).reshape(-1, 4),
        tuple(placed(polygon) for polygon in (*obstacles, *insides)),
        notes=_notes(enclosed, rim, side),
    )


def _solid_unknown(occupied: BoolArray, unknown: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Unknown cells (rows, columns) that do not reach the border, and the others beside free ones.

    Cells that touch at a corner only are not connected, since thin slanting walls are cells that
    touch at corners.
    """
    _, labels = cv2.connectedComponents(unknown.astype(np.uint8), connectivity=4, ltype=cv2.CV_32S)
    is_outside = np.zeros(int(labels.max()) + 1, dtype=bool)
    for border in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        is_outside[border] = True
    outside = unknown & is_outside[labels]
    free = ~(occupied | unknown)
    beside_free = cv2.dilate(free.astype(np.uint8), _BESIDE).astype(bool)
    return unknown & ~outside, outside & beside_free


def _notes(enclosed: BoolArray, rim: BoolArray, side: float) -> tuple[str, ...]:
    notes = []
    if rim.any():
        notes.append(
            f"the map does not know what ends its free ground along "
            f"{np.count_nonzero(rim) * side:.1f} m: walls stand there"
        )
    if enclosed.any():
        notes.append(
            f"{np.count_nonzero(enclosed) * side**2:.1f} m^2 within the map are unknown, and are "
            "no floor"
        )
    return tuple(notes)
