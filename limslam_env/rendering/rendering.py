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
from limslam_env.worlds.picture import (
    HEIGHT,
    MARGIN,
    NARROWEST,
    WALL,
    WIDEST,
    draw_floor,
    draw_scale,
    draw_walls,
    line_width,
    new_canvas,
    write,
)
from limslam_env.worlds.world import World

_TRAIL_POINTS = 2000

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
    background = background or _background(state.world, NARROWEST, WIDEST)
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
                line_width(canvas, 0.02, 2),
            )
    for number in range(len(state.poses)):
        _draw_beams(canvas, state, number)
    for number, pose in enumerate(state.poses):
        _draw_robot(canvas, pose, state.robot.radius, robot_colour(number))
    for number, overlay in enumerate(state.overlay):
        _draw_overlay(canvas, overlay, state.robot.radius, mixed(robot_colour(number), WALL, 0.3))
    _draw_caption(canvas.image, state.time, state.coverage)
    return canvas.image


# Nothing else in a picture takes as long.
@functools.lru_cache(maxsize=16)
def _background(
    world: World, least_width: int, most_width: int, least_height: int = 0
) -> Background:
    canvas = new_canvas(world.edges, least_width, most_width, least_height)
    everything_seen = canvas.on(canvas.image.copy())
    for layer, floor in ((canvas, UNSEEN), (everything_seen, SEEN)):
        draw_floor(layer, np.vstack((world.edges, world.doors)), floor)
        draw_walls(layer, world.edges, world.obstacles)
        draw_scale(layer)
    light = np.asarray(cv2.subtract(everything_seen.image, canvas.image), dtype=np.uint8)
    return Background(canvas, light)


def _draw_dots(canvas: Canvas, centres: FloatArray, colour: Colour) -> None:
    canvas.discs(centres, max(0.03 * canvas.scale, 1.5), colour)


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
    canvas.discs(pose[:2], size, mixed(colour, WALL, 0.4), 1)
    canvas.polygon(canvas.arrow(pose, 1.25 * size), PAPER)


def _draw_overlay(canvas: Canvas, overlay: Overlay, radius: float, colour: Colour) -> None:
    _draw_dots(canvas, overlay.frontier, FRONTIER)
    if len(overlay.segments):
        canvas.lines(overlay.segments, BELIEF, line_width(canvas, 0.025, 2))
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
    write(image, f"{time:.1f} s", MARGIN, 24)
    left = MARGIN + 76
    right = MARGIN + 146
    cv2.rectangle(image, (left, 18), (right, 22), RULE, -1)
    if coverage > 0.0:
        cv2.rectangle(
            image,
            (left, 18),
            (left + round((right - left) * min(coverage, 1.0)), 22),
            ROBOTS[1],
            -1,
        )
    write(image, f"{100.0 * coverage:.1f} %", right + 8, 24)
