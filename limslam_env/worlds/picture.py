"""The picture of a world: what does not change in the pictures of the robots in it."""

from collections.abc import Sequence

import cv2
import numpy as np

from limslam_env.canvas import PAPER, SEEN, TEXT, Canvas, Colour, Image, robot_colour
from limslam_env.geometry import FloatArray

HEIGHT = 640
"""Height of a picture in pixels; the width follows the world."""

MARGIN = 30
NARROWEST = 420
WIDEST = 1600
WALL = (47, 55, 69)
_OBSTACLE = (174, 183, 195)
_OUTSIDE_GAP = 0.30  # m; what is narrower does not let the outside in
_FONT = cv2.FONT_HERSHEY_SIMPLEX, 0.42


def world_png(
    edges: FloatArray, doors: FloatArray, obstacles: Sequence[FloatArray], starts: FloatArray
) -> bytes:
    """A PNG file of walls and doors (k, 4), m, obstacles, and starts (s, 3) with their headings."""
    canvas = new_canvas(edges, NARROWEST, WIDEST)
    draw_floor(canvas, np.vstack((edges, doors)), SEEN)
    draw_walls(canvas, edges, obstacles)
    draw_scale(canvas)
    for number, start in enumerate(starts):
        canvas.polygon(canvas.arrow(start, 22.0), robot_colour(number))
    return cv2.imencode(".png", canvas.image[..., ::-1])[1].tobytes()


def new_canvas(
    edges: FloatArray, least_width: int, most_width: int, least_height: int = 0
) -> Canvas:
    """A canvas around walls (k, 4), m; the sizes are in pixels."""
    corners = edges.reshape(-1, 2)
    low = corners.min(axis=0)
    extent = np.maximum(np.ptp(corners, axis=0), 1e-3)
    scale = float(((most_width - 2 * MARGIN, HEIGHT - 2 * MARGIN) / extent).min())
    columns, rows = np.ceil(extent * scale).astype(int) + 2 * MARGIN
    # Video codecs want even sides.
    columns = max(columns + columns % 2, least_width + least_width % 2)
    rows = rows + rows % 2
    origin = np.array(
        [0.5 * (columns - extent[0] * scale), rows - MARGIN + max(least_height - rows, 0) // 2]
    )
    rows = max(rows, least_height)
    return Canvas(np.full((rows, columns, 3), PAPER, dtype=np.uint8), low, origin, scale)


def line_width(canvas: Canvas, metres: float, most: int) -> int:
    """Width of a line in pixels: at least one, however large the world."""
    return min(max(round(metres * canvas.scale), 1), most)


def draw_floor(canvas: Canvas, outline: FloatArray, colour: Colour) -> None:
    """Colour all that the outside of walls and doors (k, 4), m, does not get to. They are a
    drawing, and need not be a closed outline.
    """
    gap = max(round(_OUTSIDE_GAP * canvas.scale), 1)
    walls = canvas.on(np.zeros(canvas.image.shape[:2], dtype=np.uint8))
    walls.lines(outline, (1, 1, 1), gap)
    outside = np.pad(np.where(walls.image, 1, 0).astype(np.uint8), 1)
    cv2.floodFill(outside, None, (0, 0), (2, 2, 2))
    grown = cv2.dilate(
        (outside == 2).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap, gap))
    )
    canvas.image[grown[1:-1, 1:-1] == 0] = colour


def draw_walls(canvas: Canvas, edges: FloatArray, obstacles: Sequence[FloatArray]) -> None:
    """Draw walls (k, 4), m, and filled obstacles."""
    for polygon in obstacles:
        canvas.polygon(polygon, _OBSTACLE)
    canvas.lines(edges, WALL, line_width(canvas, 0.035, 3))


def draw_scale(canvas: Canvas) -> None:
    """A bar of a round length at the upper right."""
    right = canvas.image.shape[1] - MARGIN
    most = 0.2 * canvas.image.shape[1] / canvas.scale
    length = max(
        size
        for size in (0.01, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
        if size <= most
    )
    left = right - round(length * canvas.scale)
    cv2.line(canvas.image, (left, 20), (right, 20), TEXT, 2)
    words = f"{length:g} m"
    write(canvas.image, words, left - _text_width(words) - 8, 24)


def write(image: Image, words: str, x: int, y: int) -> None:
    """Words whose baseline begins at (x, y). Each letter is placed by its own width, so that no
    letters touch.
    """
    for letter in words:
        cv2.putText(image, letter, (x, y), *_FONT, TEXT, 1, cv2.LINE_AA)
        x += _text_width(letter)


def _text_width(words: str) -> int:
    return sum(cv2.getTextSize(letter, *_FONT, 1)[0][0] for letter in words)
