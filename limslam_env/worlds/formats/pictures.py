"""Pictures in the formats PGM and PNG, which maps of map_server are made of."""

import io
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from limslam_env.worlds.formats.text_files import read_bytes
from limslam_env.worlds.world import WorldError

MAX_PIXELS = 36_000_000

_FORMATS = {".pgm": "PPM", ".png": "PNG"}  # Pillow's name of a family of formats, PGM among them
_MAX_FILE_BYTES = 256_000_000
_GREY_16_BIT = ("I;16", "I;16B", "I")


def read_levels(path: Path) -> tuple[NDArray[np.integer[Any]], int]:
    """Read a picture. The level of a coloured pixel is the sum of its three colours; transparency is not used.

    Returns
    -------
    samples
        (rows, columns), the uppermost row first.
    largest
        The level that stands for white.

    Raises
    ------
    WorldError
        If it is no PGM or PNG file, is damaged, or has too many pixels.
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
            return _levels(image)
    # Damaged pictures raise errors of many types: SyntaxError, struct.error, zlib.error and others.
    except Exception as error:
        if isinstance(error, WorldError):
            raise
        is_other = isinstance(error, UnidentifiedImageError)
        reason = f"it is no {suffix[1:].upper()} file" if is_other else " ".join(str(error).split())
        raise WorldError(f"cannot be read: {reason}") from error


def _levels(image: Image.Image) -> tuple[NDArray[np.integer[Any]], int]:
    columns, rows = image.size
    if rows * columns > MAX_PIXELS:
        raise WorldError(f"{columns} x {rows} pixels; 1 to {MAX_PIXELS} can be read")
    if image.mode in _GREY_16_BIT:
        return np.asarray(image).astype(np.uint16), 65_535
    if image.mode in {"1", "L", "LA"}:
        return np.asarray(image.convert("L")), 255
    return np.asarray(image.convert("RGB")).sum(axis=2, dtype=np.uint16), 3 * 255
