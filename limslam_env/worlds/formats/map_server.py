"""Worlds from and as maps of ROS's map_server: a picture of cells (PGM or PNG) and a description of
it (YAML).

The outlines of the occupied cells become straight walls and polygons. Maps keep the walls and the
obstacles only.
"""

import io
import math
import os
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError
from scipy import ndimage

from limslam_env.geometry import BoolArray, FloatArray, IntArray, no_rows
from limslam_env.geometry.segment import polygon_edges, sample
from limslam_env.worlds.formats.tables import read_bytes, read_text, replace_file
from limslam_env.worlds.free_space import clear
from limslam_env.worlds.world import World, WorldError, named

FINEST, COARSEST = 0.001, 10.0
"""Smallest and largest side of a cell, m."""

_YAML_BYTES = 100_000  # a map's YAML has six lines, and PyYAML takes its time
_YAML_DEPTH = 2  # a table, and the origin's three numbers in it
_KEYS = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
# YAML 1.1 as PyYAML knows it takes 5e-2 for a text; map_server and YAML 1.2 take it for a number.
_EXPONENT = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")

MAX_PIXELS = 36_000_000

_FORMATS = {".pgm": "PPM", ".png": "PNG"}  # Pillow's name of a family of formats, PGM among them
_MAX_FILE_BYTES = 256_000_000
_GREY_16_BIT = ("I;16", "I;16B", "I")

# Noise has a patch or a corner at every other cell, and would take minutes; floor plans stay far
# below.
_MAX_OUTLINES, _MAX_CORNERS = 20_000, 1_000_000
_PILLAR_CORNERS = 100

OCCUPIED, FREE, UNKNOWN = 0, 254, 205
"""Levels of a map's cells, as map_server's own saver writes them."""

_MARGIN = 4  # cells around the walls
_BATCH = 100  # walls drawn in one go


@dataclass(frozen=True)
class MapInfo:
    """What the YAML says of the picture.

    ``image`` is relative to the YAML's folder, ``resolution`` the side of a cell, m, and ``origin``
    x, y (m) and yaw (rad, counter-clockwise) of the lower left corner. With ``negate`` white is
    occupied, instead of black. A cell is a wall if it is more occupied than ``occupied_thresh``, 0
    to 1.
    """

    image: str
    resolution: float
    origin: tuple[float, float, float]
    negate: bool
    occupied_thresh: float


def read_map_server(path: str | os.PathLike[str]) -> World:
    """The world in a map of map_server: a ``.yaml`` file and the ``.pgm`` or ``.png`` picture that
    it names.

    Walls run along the outlines of the occupied cells, a quarter of a cell within them, and are
    straightened by up to one cell. A solid patch is an obstacle. Cells that are unknown are not
    walls. A WorldError says which file cannot be used, and why.
    """
    path = Path(path)
    with named(path):
        info = _info(read_text(path, _YAML_BYTES))
        with named(f"image {info.image!r}"):
            samples, largest = read_levels(path.parent / info.image)
        # The shade of each level: 0 for white, which is free, and 1 for black.
        shade = (
            np.arange(largest + 1) / largest
            if info.negate
            else np.arange(largest, -1, -1) / largest
        )
        # A file's name may hold bytes that are no text.
        name = path.stem.encode("utf-8", "replace").decode()
        return _world(name, (shade > info.occupied_thresh)[samples], info)


def _info(text: str) -> MapInfo:
    table = _yaml_table(text)
    missing = [key for key in _KEYS if key not in table]
    if missing:
        raise WorldError(f"the key {missing[0]!r} is missing")
    if not isinstance(table["image"], str):
        raise WorldError("image must be a file's name")
    if table.get("mode", "trinary") not in ("trinary", "scale"):
        # Raw levels are costs, of which map_server itself does not say what a wall is.
        raise WorldError("mode must be trinary or scale: others do not say which cells are walls")
    if not isinstance(table["origin"], list) or len(table["origin"]) != 3:
        raise WorldError("origin must be three numbers: x, y, yaw")
    x, y, yaw = (_number(value, "origin", -1e6, 1e6) for value in table["origin"])
    negate = (
        table["negate"]
        if isinstance(table["negate"], bool)
        else _number(table["negate"], "negate", 0.0, 1.0)
    )
    if negate not in (0, 1):
        raise WorldError("negate must be 0 or 1")
    occupied = _number(table["occupied_thresh"], "occupied_thresh", 0.0, 1.0)
    _number(table["free_thresh"], "free_thresh", 0.0, occupied)
    resolution = _number(table["resolution"], "resolution", FINEST, COARSEST)
    return MapInfo(table["image"], resolution, (x, y, yaw), bool(negate), occupied)


def _yaml_table(text: str) -> dict[Any, Any]:
    try:
        _check_plain(text)
        table = yaml.safe_load(text)
    # PyYAML lets through what Python says of impossible dates and of numbers with thousands of
    # digits.
    except (yaml.YAMLError, ValueError, ArithmeticError, RecursionError) as error:
        raise WorldError(f"not a map's YAML: {' '.join(str(error).split())}") from error
    if not isinstance(table, dict):
        raise WorldError("not a map's YAML: no table of keys and values")
    return table


def _check_plain(text: str) -> None:
    """Refuse what no map needs: tags, nesting, and aliases, of which a few lines can stand for
    gigabytes.
    """
    depth = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent) or getattr(event, "tag", None) is not None:
            raise yaml.YAMLError("a map has neither aliases nor tags")
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(
            event, yaml.CollectionEndEvent
        )
        if depth > _YAML_DEPTH:
            raise yaml.YAMLError("nested deeper than a map is")


def _number(value: Any, key: str, low: float, high: float) -> float:
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        value = float(value)
    if type(value) not in (int, float) or not low <= value <= high:
        raise WorldError(f"{key} must be a number from {low:g} to {high:g}")
    return float(value)


def _world(name: str, occupied: BoolArray, info: MapInfo) -> World:
    polygons, walls = outlines_of(occupied)
    x, y, yaw = info.origin
    turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    width, height = np.abs(turn.T) @ (np.array(occupied.shape[::-1]) * info.resolution)

    def placed(points: FloatArray) -> FloatArray:
        return np.asarray(points * info.resolution @ turn + (x, y))

    return World(
        name,
        (float(width), float(height)),
        placed(walls.reshape(-1, 2)).reshape(-1, 4),
        tuple(placed(polygon) for polygon in polygons),
    )


def write_map(world: World, path: Path, resolution: float) -> None:
    """Write a world as a ``.yaml`` and a ``.pgm`` beside it, with cells of ``resolution``, m."""
    if not FINEST <= resolution <= COARSEST:
        raise WorldError(
            f"{path}: cells must measure {FINEST:g} to {COARSEST:g} m, not {resolution:g}"
        )
    corners = world.edges.reshape(-1, 2)
    # The grid is shifted by half a cell, so that walls on round numbers run through the middle of
    # cells.
    low = corners.min(axis=0) - (_MARGIN + 0.5) * resolution
    columns, rows = (np.floor((corners.max(axis=0) - low) / resolution)).astype(int) + 1 + _MARGIN
    if rows * columns > MAX_PIXELS:
        raise WorldError(
            f"{path}: {columns} x {rows} cells of {resolution:g} m; a map has up to {MAX_PIXELS}"
        )
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
    replace_file(image, f"P5\n{columns} {rows}\n255\n".encode() + levels.tobytes())
    replace_file(
        path,
        yaml.safe_dump(
            about, sort_keys=False, allow_unicode=True, default_flow_style=None
        ).encode(),
    )


def _levels(
    world: World, low: FloatArray, cell: float, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """The map's cells (rows, columns), row 0 at the bottom."""
    free = np.ones(shape, dtype=bool)
    # A cell is a wall if the wall goes through it: points no further apart than a cell skip none.
    for walls in np.array_split(world.edges, math.ceil(len(world.edges) / _BATCH)):
        points, _ = sample(walls, cell)
        columns, rows = np.floor((points - low) / cell).astype(int).T
        free[rows, columns] = False
    clear(free, no_rows(4), world.obstacles, 0.0, low, cell)
    # Steps to four sides: a slanting wall's cells touch at corners, and must not let the outside
    # in.
    regions, _ = ndimage.label(free)
    levels = np.where(regions == regions[0, 0], UNKNOWN, FREE)
    return np.where(free, levels, OCCUPIED).astype(np.uint8)


def read_levels(path: Path) -> tuple[NDArray[np.integer[Any]], int]:
    """The levels (rows, columns) of a picture, the uppermost row first, and the one that stands for
    white.

    The level of a coloured pixel is the sum of its three colours; transparency is not used. A
    WorldError says that it is no PGM or PNG file, is damaged, or has too many pixels.
    """
    suffix = path.suffix.lower()
    if suffix not in _FORMATS:
        raise WorldError("not a .pgm or .png file")
    content = read_bytes(path, _MAX_FILE_BYTES)
    try:
        # Pillow warns about very large pictures, which are refused here.
        with (
            warnings.catch_warnings(action="ignore"),
            Image.open(io.BytesIO(content), formats=[_FORMATS[suffix]]) as image,
        ):
            return _picture_levels(image)
    # Damaged pictures raise errors of many types: SyntaxError, struct.error, zlib.error and others.
    except Exception as error:
        if isinstance(error, WorldError):
            raise
        is_other = isinstance(error, UnidentifiedImageError)
        reason = f"it is no {suffix[1:].upper()} file" if is_other else " ".join(str(error).split())
        raise WorldError(f"cannot be read: {reason}") from error


def _picture_levels(image: Image.Image) -> tuple[NDArray[np.integer[Any]], int]:
    columns, rows = image.size
    if rows * columns > MAX_PIXELS:
        raise WorldError(f"{columns} x {rows} pixels; 1 to {MAX_PIXELS} can be read")
    if image.mode in _GREY_16_BIT:
        return np.asarray(image).astype(np.uint16), 65_535
    if image.mode in {"1", "L", "LA"}:
        return np.asarray(image.convert("L")), 255
    return np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16), 3 * 255


def outlines_of(occupied: BoolArray) -> tuple[list[FloatArray], FloatArray]:
    """Polygons around the solid patches, each (k, 2), and the walls (n, 4) that make up the others'
    outlines.

    Lengths are in cells, from the lower left corner of ``occupied`` (rows, columns), uppermost row
    first; y is up.
    """
    rows, columns = (np.nonzero(occupied.any(axis=axis))[0] for axis in (1, 0))
    if not rows.size:
        raise WorldError("no cell is occupied")
    part = occupied[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    if _corner_count(part) > _MAX_CORNERS:
        raise WorldError(
            f"its walls have more than {_MAX_CORNERS} corners: noise, or no floor plan"
        )
    # Twice as fine: the outline of a wall of one cell would otherwise run forth and back on one
    # line.
    doubled = part.astype(np.uint8).repeat(2, axis=0).repeat(2, axis=1)
    contours, hierarchy = cv2.findContours(doubled, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    if len(contours) > _MAX_OUTLINES:
        raise WorldError(
            f"{len(contours)} separate outlines: noise, or no floor plan; up to {_MAX_OUTLINES} "
            "can be used"
        )
    polygons, walls = [], [np.zeros((0, 4))]
    for contour, (_, _, hole, around) in zip(contours, hierarchy[0], strict=True):
        is_solid = hole < 0 and around < 0
        corners = _corners_of(contour[:, 0].astype(np.int32), doubled, is_solid=is_solid)
        placed = (corners + 0.5) / 2.0 + (columns[0], rows[0])
        placed[:, 1] = len(occupied) - placed[:, 1]
        if is_solid and _is_simple(corners):
            polygons.append(placed)
        elif len(corners) > 1:
            # The outline of a thin wall is one line, there and back.
            walls.append(polygon_edges(placed)[: None if len(corners) > 2 else 1])
    return polygons, np.vstack(walls)


def _corners_of(contour: IntArray, occupied: NDArray[np.uint8], *, is_solid: bool) -> IntArray:
    """The corners (n, 2) of a contour (k, 2) of columns and rows, without the steps of slanted
    walls.
    """
    outline = _with_corners(contour, occupied)
    corners = cv2.approxPolyDP(outline[:, None], 2.0, closed=True)[:, 0].astype(np.int64)
    # A patch of a cell or so is still in the way.
    return outline if is_solid and len(corners) == 1 else corners


def _corner_count(occupied: BoolArray) -> int:
    """How often the outlines of the occupied cells (rows, columns) turn, those along the border
    left out.
    """
    change = occupied[1:] ^ occupied[:-1]
    # Along an outline that runs straight on, two cells beside each other differ from those below
    # alike.
    turns = change[:, 1:] ^ change[:, :-1]
    touching = change[:, 1:] & change[:, :-1] & (occupied[1:, 1:] ^ occupied[1:, :-1])
    return int(np.count_nonzero(turns) + 2 * np.count_nonzero(touching))


def _with_corners(outline: IntArray, occupied: NDArray[np.uint8]) -> IntArray:
    """An outline (k, 2) of columns and rows with the inner corners, which OpenCV cuts off by a
    diagonal step.
    """
    step = np.roll(outline, -1, axis=0) - outline
    at = np.nonzero(np.abs(step).min(axis=1) == 1)[0]
    ahead, aside = outline[at] + step[at] * (1, 0), outline[at] + step[at] * (0, 1)
    # One side of the step is open, and the corner is on the other; where two patches touch, both
    # are open.
    corner = np.where(occupied[ahead[:, 1], ahead[:, 0], None] > 0, ahead, aside)
    inner = occupied[corner[:, 1], corner[:, 0]] > 0
    return np.insert(outline, at[inner] + 1, corner[inner], axis=0)


def _is_simple(corners: IntArray) -> bool:
    """Whether a polygon (k, 2) of whole numbers has an area and touches itself nowhere."""
    if not 3 <= len(corners) <= _PILLAR_CORNERS:
        return False
    a, b = corners, np.roll(corners, -1, axis=0)
    span, after = b - a, np.roll(b - a, -1, axis=0)
    turns = span[:, 0] * after[:, 1] - span[:, 1] * after[:, 0]
    if ((turns == 0) & ((span * after).sum(axis=1) < 0)).any():  # it runs back on itself
        return False

    def side(points: IntArray) -> IntArray:
        """On which side of edge i point j lies: -1, 0, 1."""
        offset = points[None] - a[:, None]
        return np.asarray(
            np.sign(span[:, None, 0] * offset[..., 1] - span[:, None, 1] * offset[..., 0])
        )

    straddles = side(a) * side(b) <= 0
    low, high = np.minimum(a, b), np.maximum(a, b)
    overlap = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=-1)
    index = np.arange(len(corners))
    apart = (index[:, None] - index[None]) % len(corners)
    strangers = (apart != 0) & (apart != 1) & (apart != len(corners) - 1)
    return not (straddles & straddles.T & overlap & strangers).any()
