"""Pictures of a world and of the robots in it, drawn with OpenCV, without a display."""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

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
    Canvas,
    Colour,
    Image,
    mixed,
    robot_colour,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.geometry.shapes import ellipse, thinned
from limslam_env.interface import RobotSpec
from limslam_env.overlay import Overlay
from limslam_env.simulation.coverage import CELL
from limslam_env.worlds.world import World

HEIGHT = 640
"""Height of a picture in pixels; the width follows the world."""

_MARGIN = 30
_FONT = cv2.FONT_HERSHEY_SIMPLEX, 0.42
_NARROWEST = 420
_WIDEST = 1600
_OUTSIDE_GAP = 0.30  # m; what is narrower does not let the outside in
_TRAIL_POINTS = 2000

_WALL = (47, 55, 69)
_OBSTACLE = (174, 183, 195)
_ROBOT_HIT = (190, 40, 140)
_NO_HIT = (158, 184, 212)

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
class Background:
    """What of a picture does not change: a canvas with the unseen world, and how much lighter it is
    where seen.
    """

    canvas: Canvas
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
                mixed(robot_colour(number), SEEN, 0.45),
                _width(canvas, 0.02, 2),
            )
    for number in range(len(state.poses)):
        _draw_beams(canvas, state, number)
    for number, pose in enumerate(state.poses):
        _draw_robot(canvas, pose, state.robot.radius, robot_colour(number))
    for number, overlay in enumerate(state.overlay):
        _draw_overlay(canvas, overlay, state.robot.radius, mixed(robot_colour(number), _WALL, 0.3))
    _draw_caption(canvas.image, state.time, state.coverage)
    return canvas.image


# Nothing else in a picture takes as long.
@functools.lru_cache(maxsize=16)
def _background(
    world: World, least_width: int, most_width: int, least_height: int = 0
) -> Background:
    canvas = _new_canvas(world, least_width, most_width, least_height)
    everything_seen = canvas.on(canvas.image.copy())
    for layer, floor in ((canvas, UNSEEN), (everything_seen, SEEN)):
        _draw_floor(layer, world, floor)
        _draw_walls(layer, world)
        _draw_scale(layer)
    light = np.asarray(cv2.subtract(everything_seen.image, canvas.image), dtype=np.uint8)
    return Background(canvas, light)


def _new_canvas(world: World, least_width: int, most_width: int, least_height: int) -> Canvas:
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
    return Canvas(np.full((rows, columns, 3), PAPER, dtype=np.uint8), low, origin, scale)


def _width(canvas: Canvas, metres: float, most: int) -> int:
    """Width of a line in pixels: at least one, however large the world."""
    return min(max(round(metres * canvas.scale), 1), most)


def _draw_dots(canvas: Canvas, centres: FloatArray, colour: Colour) -> None:
    canvas.discs(centres, max(0.03 * canvas.scale, 1.5), colour)


def _draw_floor(canvas: Canvas, world: World, colour: Colour) -> None:
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


def _draw_walls(canvas: Canvas, world: World) -> None:
    for polygon in world.obstacles:
        canvas.polygon(polygon, _OBSTACLE)
    canvas.lines(world.edges, _WALL, _width(canvas, 0.035, 3))


def _draw_scale(canvas: Canvas) -> None:
    """A bar of a round length at the upper right."""
    right = canvas.image.shape[1] - _MARGIN
    most = 0.2 * canvas.image.shape[1] / canvas.scale
    length = max(
        size
        for size in (0.01, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
        if size <= most
    )
    left = right - round(length * canvas.scale)
    cv2.line(canvas.image, (left, 20), (right, 20), TEXT, 2)
    words = f"{length:g} m"
    _text(canvas.image, words, left - _text_width(words) - 8, 24)


def _seen_mask(canvas: Canvas, seen: BoolArray, low: FloatArray) -> Image:
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


def _draw_beams(canvas: Canvas, state: RenderState, number: int) -> None:
    x, y, theta = state.poses[number]
    cos = math.cos(theta)
    sin = math.sin(theta)
    to_world = np.array([[cos, sin], [-sin, cos]])
    origins = state.robot.beam_origins @ to_world + (x, y)
    ends = origins + state.ranges[number][:, None] * (state.robot.beam_directions @ to_world)
    hits = np.asarray(state.hits[number])
    for chosen, colour in ((hits == -1, _NO_HIT), (hits >= 0, BEAM), (hits == -2, _ROBOT_HIT)):
        if chosen.any():
            canvas.lines(np.hstack((origins[chosen], ends[chosen])), colour, 1)
            _draw_dots(canvas, ends[chosen & (hits != -1)], colour)


def _draw_robot(canvas: Canvas, pose: FloatArray, radius: float, colour: Colour) -> None:
    size = max(radius * canvas.scale, 4.0)
    canvas.discs(pose[:2], size, colour)
    canvas.discs(pose[:2], size, mixed(colour, _WALL, 0.4), 1)
    canvas.polygon(canvas.arrow(pose, 1.25 * size), PAPER)


def _draw_overlay(canvas: Canvas, overlay: Overlay, radius: float, colour: Colour) -> None:
    _draw_dots(canvas, overlay.frontier, FRONTIER)
    if len(overlay.segments):
        canvas.lines(overlay.segments, BELIEF, _width(canvas, 0.025, 2))
        _draw_dots(canvas, overlay.segments.reshape(-1, 2), BELIEF)
    if len(overlay.plan):
        canvas.path(overlay.plan, colour, 1)
        goal = overlay.plan[-1]
        canvas.discs(goal, max(0.07 * canvas.scale, 4.0), colour, 1)
        _draw_dots(canvas, goal, colour)
    if overlay.pose is not None:
        _draw_ghost(canvas, overlay.pose, overlay.covariance, radius)


def _draw_ghost(
    canvas: Canvas, pose: FloatArray, covariance: FloatArray | None, radius: float
) -> None:
    size = max(radius * canvas.scale, 4.0)
    nose = pose[:2] + 1.6 * size / canvas.scale * np.array([math.cos(pose[2]), math.sin(pose[2])])
    canvas.discs(pose[:2], size, BELIEF, 1)
    canvas.path(np.vstack((pose[:2], nose)), BELIEF, 1)
    if covariance is not None:
        canvas.path(pose[:2] + ellipse(covariance[:2, :2], 48), BELIEF, 1, closed=True)


def _draw_caption(image: Image, time: float, coverage: float) -> None:
    """Time, and the share that is covered as a bar and as a number, above the world."""
    _text(image, f"{time:.1f} s", _MARGIN, 24)
    left = _MARGIN + 76
    right = _MARGIN + 146
    cv2.rectangle(image, (left, 18), (right, 22), RULE, -1)
    if coverage > 0.0:
        cv2.rectangle(
            image,
            (left, 18),
            (left + round((right - left) * min(coverage, 1.0)), 22),
            ROBOTS[1],
            -1,
        )
    _text(image, f"{100.0 * coverage:.1f} %", right + 8, 24)


def _text(image: Image, words: str, x: int, y: int) -> None:
    """Words whose baseline begins at (x, y). Each letter is placed by its own width, so that no
    letters touch.
    """
    for letter in words:
        cv2.putText(image, letter, (x, y), *_FONT, TEXT, 1, cv2.LINE_AA)
        x += _text_width(letter)


def _text_width(words: str) -> int:
    return sum(cv2.getTextSize(letter, *_FONT, 1)[0][0] for letter in words)
