"""Pictures of a world and of the robots in it, drawn with OpenCV, without a display."""

import functools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.shapes import ellipse, thinned
from limslam_env.interface import RobotSpec
from limslam_env.rendering.overlay import Overlay
from limslam_env.simulation.coverage import CELL
from limslam_env.worlds.world import World

HEIGHT = 640
"""Height of a picture in pixels; the width follows the world."""

_MARGIN = 30
_FONT = cv2.FONT_HERSHEY_SIMPLEX, 0.42
_NARROWEST = 420
_WIDEST = 1600
_SHIFT = 4  # OpenCV draws at 1/16 pixel
_FAR = 100_000  # pixels
_OUTSIDE_GAP = 0.30  # m; what is narrower does not let the outside in
_TRAIL_POINTS = 2000

Image: TypeAlias = NDArray[np.uint8]
Colour: TypeAlias = tuple[int, int, int]

_PAPER = (250, 250, 249)
_UNSEEN = (222, 227, 233)
_SEEN = (252, 248, 238)
_WALL = (47, 55, 69)
_OBSTACLE = (174, 183, 195)
_WALL_HIT = (226, 138, 40)
_ROBOT_HIT = (190, 40, 140)
_NO_HIT = (158, 184, 212)
_BELIEF = (205, 48, 66)
_FRONTIER = (20, 150, 140)
_TEXT = (86, 94, 108)
_BAR = (208, 213, 220)
_ROBOTS = (
    (38, 103, 178),
    (40, 140, 92),
    (132, 84, 170),
    (176, 88, 60),
    (20, 128, 142),
    (168, 62, 110),
)

_SHARPER = np.clip((np.arange(256) - 96) * 4, 0, 255).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class RenderState:
    """Everything that a picture shows."""

    # world, robot: what is drawn
    world: World
    robot: RobotSpec
    poses: FloatArray  # (n, 3), m and rad
    # hits, ranges: (n, n_beams): the wall that a beam hit, -1 for nothing and -2 for a robot; and
    # the readings, m
    hits: IntArray
    ranges: NDArray[np.floating]
    paths: Sequence[FloatArray]  # for each robot its past positions (k, 2), m
    # time, coverage: s, and 0 to 1
    time: float
    coverage: float
    # seen, seen_low: which cells (rows, columns) of the coverage grid have been seen; its lower
    # left corner (2,), m
    seen: BoolArray
    seen_low: FloatArray
    overlay: Sequence[
        Overlay
    ] = ()  # the agents' estimates; each has the colour of the robot with the same number


@dataclass(frozen=True, eq=False)
class _Canvas:
    """A picture with the world's coordinates: x right, y up, metres.

    ``origin`` (2,) is the pixel that the world's lower left corner ``low`` (2,) falls on, ``scale``
    is in pixels per metre.
    """

    image: Image
    low: FloatArray
    origin: FloatArray
    scale: float

    def on(self, image: Image) -> "_Canvas":
        return _Canvas(image, self.low, self.origin, self.scale)

    def width(self, metres: float, most: int) -> int:
        """Width of a line in pixels: at least one, however large the world."""
        return min(max(round(metres * self.scale), 1), most)

    def pixels(self, points: FloatArray) -> NDArray[np.int32]:
        scaled = (np.asarray(points, dtype=float) - self.low) * (
            self.scale,
            -self.scale,
        ) + self.origin
        # What an agent believes may lie anywhere; OpenCV counts in 32 bits.
        return np.asarray(np.round(np.clip(scaled, -_FAR, _FAR) * (1 << _SHIFT)), dtype=np.int32)

    def lines(self, segments: FloatArray, colour: Colour, width: int) -> None:
        chains = self.pixels(segments.reshape(-1, 2)).reshape(-1, 2, 2)
        cv2.polylines(self.image, list(chains), False, colour, width, cv2.LINE_AA, _SHIFT)

    def path(self, points: FloatArray, colour: Colour, width: int, *, closed: bool = False) -> None:
        cv2.polylines(self.image, [self.pixels(points)], closed, colour, width, cv2.LINE_AA, _SHIFT)

    def polygon(self, points: FloatArray, colour: Colour) -> None:
        cv2.fillPoly(self.image, [self.pixels(points)], colour, cv2.LINE_AA, _SHIFT)

    def disc(self, centre: FloatArray, radius: float, colour: Colour, width: int = -1) -> None:
        """A disc, or a ring of a width in pixels; radius in pixels too."""
        (x, y), size = self.pixels(centre[None])[0].tolist(), round(radius * (1 << _SHIFT))
        cv2.circle(self.image, (x, y), size, colour, width, cv2.LINE_AA, _SHIFT)

    def dots(self, centres: Iterable[FloatArray], colour: Colour) -> None:
        for centre in centres:
            self.disc(centre, max(0.03 * self.scale, 1.5), colour)

    def arrow(self, pose: FloatArray, length: float, colour: Colour) -> None:
        """A small arrow head around a pose (3,), as long as a number of pixels."""
        corners = np.array([(0.55, 0.0), (-0.45, 0.4), (-0.25, 0.0), (-0.45, -0.4)]) * (
            length / self.scale
        )
        cos = math.cos(pose[2])
        sin = math.sin(pose[2])
        self.polygon(pose[:2] + corners @ np.array([[cos, sin], [-sin, cos]]), colour)


@dataclass(frozen=True, eq=False)
class Background:
    """What of a picture does not change: a canvas with the unseen world, and how much lighter it is
    where seen.
    """

    canvas: _Canvas
    light: Image


def square_background(world: World) -> Background:
    """The background of a picture that is as wide as high whatever the world."""
    return _background(world, HEIGHT, HEIGHT, HEIGHT)


def render(state: RenderState, *, background: Background | None = None) -> Image:
    """The state as a picture (height, width, 3), RGB. The same state gives the same picture.

    Parameters
    ----------
    state
        What is drawn.
    background
        Of the same world, by :func:`square_background`. None makes a picture as wide as its world
        needs it.
    """
    background = background or _background(state.world, _NARROWEST, _WIDEST)
    canvas = background.canvas.on(background.canvas.image.copy())
    mask = _seen_mask(canvas, state.seen, state.seen_low)
    cv2.add(
        canvas.image,
        cv2.multiply(background.light, cv2.merge((mask, mask, mask)), scale=1 / 255),
        canvas.image,
    )
    for number, path in enumerate(state.paths):
        if len(path) > 1:
            canvas.path(
                thinned(path, _TRAIL_POINTS),
                _mixed(_robot_colour(number), _SEEN, 0.45),
                canvas.width(0.02, 2),
            )
    for number in range(len(state.poses)):
        _draw_beams(canvas, state, number)
    for number, pose in enumerate(state.poses):
        _draw_robot(canvas, pose, state.robot.radius, _robot_colour(number))
    for number, overlay in enumerate(state.overlay):
        _draw_overlay(
            canvas, overlay, state.robot.radius, _mixed(_robot_colour(number), _WALL, 0.3)
        )
    _draw_caption(canvas.image, state.time, state.coverage)
    return canvas.image


# Nothing else in a picture takes as long.
@functools.lru_cache(maxsize=16)
def _background(
    world: World, least_width: int, most_width: int, least_height: int = 0
) -> Background:
    canvas = _new_canvas(world, least_width, most_width, least_height)
    everything_seen = canvas.on(canvas.image.copy())
    for layer, floor in ((canvas, _UNSEEN), (everything_seen, _SEEN)):
        _draw_floor(layer, world, floor)
        _draw_walls(layer, world)
        _draw_scale(layer)
    light = np.asarray(cv2.subtract(everything_seen.image, canvas.image), dtype=np.uint8)
    return Background(canvas, light)


def _new_canvas(world: World, least_width: int, most_width: int, least_height: int) -> _Canvas:
    """A canvas around a world; the sizes are in pixels."""
    corners = world.edges.reshape(-1, 2)
    low = corners.min(axis=0)
    extent = np.maximum(np.ptp(corners, axis=0), 1e-3)
    scale = float(((most_width - 2 * _MARGIN, HEIGHT - 2 * _MARGIN) / extent).min())
    columns, rows = np.ceil(extent * scale).astype(int) + 2 * _MARGIN
    # Video codecs want even sides.
    columns = max(columns + columns % 2, least_width + least_width % 2)
    rows = rows + rows % 2
    origin = np.array(
        [0.5 * (columns - extent[0] * scale), rows - _MARGIN + max(least_height - rows, 0) // 2]
    )
    rows = max(rows, least_height)
    return _Canvas(np.full((rows, columns, 3), _PAPER, dtype=np.uint8), low, origin, scale)


def _draw_floor(canvas: _Canvas, world: World, colour: Colour) -> None:
    """Colour all that the outside does not get to: walls are a drawing, and need not be a closed
    outline.
    """
    gap = max(round(_OUTSIDE_GAP * canvas.scale), 1)
    walls = canvas.on(np.zeros(canvas.image.shape[:2], dtype=np.uint8))
    walls.lines(np.vstack((world.edges, world.doors)), (1, 1, 1), gap)
    outside = np.pad(np.where(walls.image, 1, 0).astype(np.uint8), 1)
    cv2.floodFill(outside, None, (0, 0), (2, 2, 2))
    grown = cv2.dilate(
        (outside == 2).astype(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (gap, gap))
    )
    canvas.image[grown[1:-1, 1:-1] == 0] = colour


def _draw_walls(canvas: _Canvas, world: World) -> None:
    for polygon in world.obstacles:
        canvas.polygon(polygon, _OBSTACLE)
    canvas.lines(world.edges, _WALL, canvas.width(0.035, 3))


def _draw_scale(canvas: _Canvas) -> None:
    """A bar of a round length at the upper right."""
    right = canvas.image.shape[1] - _MARGIN
    most = 0.2 * canvas.image.shape[1] / canvas.scale
    length = max(
        size
        for size in (0.01, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
        if size <= most
    )
    left = right - round(length * canvas.scale)
    cv2.line(canvas.image, (left, 20), (right, 20), _TEXT, 2)
    words = f"{length:g} m"
    _text(canvas.image, words, left - _text_width(words) - 8, 24)


def _seen_mask(canvas: _Canvas, seen: BoolArray, low: FloatArray) -> Image:
    """How far each pixel has been seen, 0 to 255: the corners of the cells are rounded off, and
    their edges soft.
    """
    # From the centre of a pixel to a column and a row; a cell's centre has a whole number.
    step = 1.0 / (canvas.scale * CELL)
    column, row = (canvas.low - low) / CELL - 0.5
    x, y = canvas.origin
    to_cells = np.array([[step, 0.0, column - x * step], [0.0, -step, row + y * step]])
    size = (canvas.image.shape[1], canvas.image.shape[0])
    cells = np.ascontiguousarray(seen).view(np.uint8) * np.uint8(255)
    smooth = cv2.warpAffine(cells, to_cells, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return np.asarray(cv2.LUT(smooth, _SHARPER), dtype=np.uint8)


def _draw_beams(canvas: _Canvas, state: RenderState, number: int) -> None:
    x, y, theta = state.poses[number]
    cos = math.cos(theta)
    sin = math.sin(theta)
    to_world = np.array([[cos, sin], [-sin, cos]])
    origins = state.robot.beam_origins @ to_world + (x, y)
    ends = origins + state.ranges[number][:, None] * (state.robot.beam_directions @ to_world)
    hits = np.asarray(state.hits[number])
    for chosen, colour in ((hits == -1, _NO_HIT), (hits >= 0, _WALL_HIT), (hits == -2, _ROBOT_HIT)):
        if chosen.any():
            canvas.lines(np.hstack((origins[chosen], ends[chosen])), colour, 1)
            canvas.dots(ends[chosen & (hits != -1)], colour)


def _draw_robot(canvas: _Canvas, pose: FloatArray, radius: float, colour: Colour) -> None:
    size = max(radius * canvas.scale, 4.0)
    canvas.disc(pose[:2], size, colour)
    canvas.disc(pose[:2], size, _mixed(colour, _WALL, 0.4), 1)
    canvas.arrow(pose, 1.25 * size, _PAPER)


def _draw_overlay(canvas: _Canvas, overlay: Overlay, radius: float, colour: Colour) -> None:
    canvas.dots(overlay.frontier, _FRONTIER)
    if len(overlay.segments):
        canvas.lines(overlay.segments, _BELIEF, canvas.width(0.025, 2))
        canvas.dots(overlay.segments.reshape(-1, 2), _BELIEF)
    if len(overlay.plan):
        canvas.path(overlay.plan, colour, 1)
        goal = overlay.plan[-1]
        canvas.disc(goal, max(0.07 * canvas.scale, 4.0), colour, 1)
        canvas.dots([goal], colour)
    if overlay.pose is not None:
        _draw_ghost(canvas, overlay.pose, overlay.covariance, radius)


def _draw_ghost(
    canvas: _Canvas, pose: FloatArray, covariance: FloatArray | None, radius: float
) -> None:
    size = max(radius * canvas.scale, 4.0)
    nose = pose[:2] + 1.6 * size / canvas.scale * np.array([math.cos(pose[2]), math.sin(pose[2])])
    canvas.disc(pose[:2], size, _BELIEF, 1)
    canvas.path(np.vstack((pose[:2], nose)), _BELIEF, 1)
    if covariance is not None:
        canvas.path(pose[:2] + ellipse(covariance[:2, :2], 48), _BELIEF, 1, closed=True)


def _draw_caption(image: Image, time: float, coverage: float) -> None:
    """Time, and the share that is covered as a bar and as a number, above the world."""
    _text(image, f"{time:.1f} s", _MARGIN, 24)
    left = _MARGIN + 76
    right = _MARGIN + 146
    cv2.rectangle(image, (left, 18), (right, 22), _BAR, -1)
    if coverage > 0.0:
        cv2.rectangle(
            image,
            (left, 18),
            (left + round((right - left) * min(coverage, 1.0)), 22),
            _ROBOTS[1],
            -1,
        )
    _text(image, f"{100.0 * coverage:.1f} %", right + 8, 24)


def _text(image: Image, words: str, x: int, y: int) -> None:
    """Words whose baseline begins at (x, y). Each letter is placed by its own width, so that no
    letters touch.
    """
    for letter in words:
        cv2.putText(image, letter, (x, y), *_FONT, _TEXT, 1, cv2.LINE_AA)
        x += _text_width(letter)


def _text_width(words: str) -> int:
    return sum(cv2.getTextSize(letter, *_FONT, 1)[0][0] for letter in words)


def _robot_colour(number: int) -> Colour:
    return _ROBOTS[number % len(_ROBOTS)]


def _mixed(first: Colour, second: Colour, share: float) -> Colour:
    """A colour between two; ``share`` is that of the second."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(first, second, strict=True))
    return red, green, blue
