"""Colours and text for pictures and videos, in a typeface that is readable at small sizes."""

import functools
import math
from pathlib import Path
from typing import Literal

import cv2
import matplotlib as mpl
import numpy as np
from PIL import Image as Pictures
from PIL import ImageDraw, ImageFont

from limslam_env.canvas import (
    BEAM,
    BELIEF,
    FRONTIER,
    PAPER,
    ROBOTS,
    RULE,
    SEEN,
    TEXT,
    UNSEEN,
    Colour,
    Image,
)

Anchor = Literal["left", "centre", "right"]

OCCUPIED = (167, 174, 186)
GLOW = (240, 170, 30)
INK = (36, 43, 55)
FAINT = (150, 157, 168)
LEFT = (222, 126, 20)
RIGHT = (150, 62, 168)
PEAKS = ((36, 178, 205), (240, 170, 30), (238, 96, 142), (120, 200, 90), (190, 150, 250))
HEAT = ((245, 246, 248), (188, 205, 226), (92, 128, 178), (52, 60, 120), (38, 20, 62))
PALETTE = (
    PAPER,
    UNSEEN,
    SEEN,
    OCCUPIED,
    BELIEF,
    FRONTIER,
    GLOW,
    INK,
    TEXT,
    FAINT,
    RULE,
    LEFT,
    RIGHT,
    BEAM,
    *PEAKS,
    *ROBOTS,
    *HEAT,
)
"""All colours, for formats with a limited number of colours."""


def side_colour(side: str) -> Colour:
    """Colour of a scan buffer, ``"left"`` or ``"right"``."""
    return LEFT if side == "left" else RIGHT


def hexadecimal(colour: Colour) -> str:
    """A colour in the notation of Matplotlib."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


@functools.lru_cache(maxsize=2048)
def width_of(words: str, size: int, *, bold: bool = False) -> int:
    """Width of a line of text, pixels."""
    return math.ceil(_font(size, bold).getlength(words))


def write(
    image: Image,
    words: str,
    place: tuple[int, int],
    size: int,
    colour: Colour = TEXT,
    *,
    bold: bool = False,
    anchor: Anchor = "left",
) -> None:
    """Write a line of text into an RGB image (height, width, 3), in place. Text outside of the
    image is cut off.

    ``place`` is the pixel (x, y) of the line's left end, middle or right end, as ``anchor`` says,
    on the base line. The size of the letters is in pixels.
    """
    mask, above = _mask(words, size, bold)
    height, width = mask.shape
    left = place[0] - {"left": 0, "centre": width // 2, "right": width}[anchor]
    top = place[1] - above
    rows = slice(max(top, 0), max(min(top + height, image.shape[0]), 0))
    columns = slice(max(left, 0), max(min(left + width, image.shape[1]), 0))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        return
    cover = mask[
        rows.start - top : rows.stop - top, columns.start - left : columns.stop - left, None
    ]
    image[rows, columns] = blended(image[rows, columns], colour, cover)


def disc(
    image: Image, centre: tuple[int, int], radius: int, colour: Colour, width: int = -1
) -> None:
    """Draw a disc, or a ring of a width. All sizes are in pixels."""
    cv2.circle(image, centre, radius, colour, width, cv2.LINE_AA)


def box(
    image: Image, low: tuple[int, int], high: tuple[int, int], colour: Colour, width: int = -1
) -> None:
    """Fill a box between two corners, or draw its frame of a width. All sizes are in pixels."""
    cv2.rectangle(image, low, high, colour, width)


def blended(pixels: Image, colour: Colour, cover: Image) -> Image:
    """Pixels (..., 3) blended with a colour. ``cover`` (..., 1) is the strength of the colour, 0 to
    255.
    """
    old = pixels.astype(np.int16)
    step = (np.array(colour, dtype=np.int16) - old).astype(np.int32) * cover
    # One multiplication and one shift are faster than a division by 255.
    return np.asarray(old + ((step * 257 + 32768) >> 16), dtype=np.uint8)


@functools.lru_cache(maxsize=32)
def plain(width: int, height: int, colour: Colour = PAPER) -> Image:
    """A sheet (height, width, 3) of one colour. Read-only."""
    sheet = np.full((height, width, 3), colour, dtype=np.uint8)
    sheet.setflags(write=False)
    return sheet


def fitted(words: str, size: int, width: int) -> str:
    """The text, shortened with an ellipsis if it does not fit into a width in pixels."""
    if width_of(words, size) <= width:
        return words
    while words and width_of(words + "…", size) > width:
        words = words[:-1]
    return words.rstrip() + "…"


@functools.lru_cache(maxsize=32)
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    # Matplotlib ships this typeface. The typefaces of OpenCV are hard to read at small sizes.
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    path = Path(mpl.get_data_path()) / "fonts" / "ttf" / name
    return ImageFont.truetype(str(path), size, layout_engine=ImageFont.Layout.BASIC)


@functools.lru_cache(maxsize=2048)
def _mask(words: str, size: int, bold: bool) -> tuple[Image, int]:
    """Share of each pixel that the text covers, 0 to 255, and the number of rows above the base
    line.
    """
    font = _font(size, bold)
    above, below = font.getmetrics()
    sheet = Pictures.new("L", (width_of(words, size, bold=bold) + 2, above + below))
    ImageDraw.Draw(sheet).text((0, above), words, fill=255, font=font, anchor="ls")
    return np.asarray(sheet, dtype=np.uint8), above
