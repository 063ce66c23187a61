"""A video of a run: the truth on the left, the belief on the right, and captions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeAlias

import cv2
import numpy as np

from limslam_agent.output.style import FAINT, GLOW, INK, box, fitted, width_of, write
from limslam_agent.video.belief_frame import BeliefFrame
from limslam_agent.video.belief_panels import (
    blank,
    buffers_height,
    draw_buffers,
    draw_hough,
    draw_legend,
    draw_log,
    draw_stages,
)
from limslam_agent.video.belief_picture import draw_belief
from limslam_agent.video.narration import SPEED, Caption, Narrator
from limslam_env.canvas import PAPER, RULE, TEXT, Image, mixed
from limslam_env.geometry import FloatArray

WIDTH = 1280
HEIGHT = 720
FPS = 25
"""Frames per second of the video."""

_GAP = 16
_TOP = 80
_FOOT = 134
# width of the panels beside the pictures, and their height below them
_SIDE = 268
_STRIP = 176
_LAST_FRAME = 3.0  # s of the video

# Margin around the world and largest size of the simulator's pictures
# (limslam_env.rendering.rendering), pixels.
_TRUTH_MARGIN = 30
_TRUTH_MOST = (1600, 640)
_KEPT_MARGIN = 5
_ADDED_MARGIN = (
    0.04  # share of the world's size at each side, so that a map that has drifted stays visible
)


@dataclass(frozen=True, eq=False)
class Scene:
    """The content of a frame besides truth and belief."""

    caption: Caption
    title: str
    log: Sequence[
        tuple[float, str, str]
    ]  # Past events, with the latest first: time (s), kind and text
    coverage: float  # True coverage, 0 to 1
    window: tuple[
        FloatArray, FloatArray
    ]  # Corners (2,), m, of the region that the picture of the belief shows
    is_paused: bool = False  # Whether the video is paused for the caption
    speed: float = SPEED  # How much faster the video is than the run


Box: TypeAlias = tuple[int, int, int, int]
"""Left, top, width and height of a part of a frame, pixels."""


@dataclass(frozen=True)
class Layout:
    """Positions of the parts of a frame."""

    truth: Box
    belief: Box
    buffers: Box
    hough: Box
    log: Box


class Writer(Protocol):
    """Takes the frames of a film, such as a `VideoWriter`."""

    def write(self, image: Image, hold: float = 0.0) -> None:
        """Take a frame that is shown for a time, s; 0 is the time of one frame."""
        ...


class Film:
    """Makes the frames of a run and gives them to a writer.

    Both pictures show the smallest box around all walls of the world, with the corners ``low`` and
    ``high`` (2,), m. The film is ``speed`` times faster than the run.
    """

    def __init__(
        self,
        writer: Writer,
        low: FloatArray,
        high: FloatArray,
        title: str,
        speed: float = SPEED,
    ) -> None:
        self._writer = writer
        self._corners = (low, high)
        self._title = title
        self._speed = speed
        self._narrator = Narrator(speed)
        self._next = 0.0
        self._shown = 0
        self._last: tuple[Image, BeliefFrame, Scene] | None = None

    def is_due(self, time: float) -> bool:
        """Whether a frame has to be added at a simulated time, s."""
        return time >= self._next - 1e-6

    def add(self, truth: Image, frame: BeliefFrame, coverage: float) -> None:
        """Add a frame: the picture (h, w, 3), RGB, that ``limslam_env.rendering.rendering.render``
        draws of the simulation, what is believed, and the true coverage, 0 to 1.
        """
        # The next frame is due a period after the last one was, whenever that was drawn: steps need
        # not fit the period.
        period = self._speed / FPS
        self._next = max(self._next, frame.time - period) + period
        cropped, window = cropped_truth(truth, *self._corners)
        for caption, pause in self._narrator.hear(frame):
            log = self._narrator.log
            scene = Scene(caption, self._title, log, coverage, window, pause > 0.0, self._speed)
            # Only the walls of the current caption are highlighted, and the votes are those that it
            # speaks of.
            events = () if caption.event is None else (caption.event,)
            shown = replace(frame, events=events, hough=caption.hough or frame.hough)
            self._last = (cropped, shown, scene)
            self._writer.write(compose(*self._last), pause or self._hold(frame.time))

    def _hold(self, time: float) -> float:
        """How long the frame of a simulated time is shown, s of the video. 0 is the time of one
        frame.
        """
        frames = max(round(time / self._speed * FPS) + 1 - self._shown, 1)
        self._shown += frames
        return frames / FPS if frames > 1 else 0.0

    def finish(self, words: str) -> None:
        """Show the last frame for a while, with the reason why the run ended."""
        if self._last is not None:
            truth, frame, scene = self._last
            caption = Caption(
                (),
                f"{words[:1].upper()}{words[1:]}.",
                "The truth is on the left and the map is on the right.",
            )
            scene = replace(scene, caption=caption, is_paused=False)
            self._writer.write(compose(truth, replace(frame, events=()), scene), _LAST_FRAME)


def compose(truth: Image, frame: BeliefFrame, scene: Scene) -> Image:
    """One frame of a video (HEIGHT, WIDTH, 3), RGB. The belief is drawn at the size of the truth
    (h, w, 3).
    """
    page = blank(WIDTH, HEIGHT)
    height, width = truth.shape[:2]
    layout = layout_for(width / height, len(frame.poses))
    several = len(frame.poses) > 1
    _draw_header(page, frame.time, scene)
    robots = "robots" if several else "robot"
    _headed(page, layout.truth, "Truth", f"unknown to the {robots}")
    whose = "one map for all robots" if several else "the robot's map"
    _headed(page, layout.belief, "Belief", whose)
    size = layout.truth[2:]
    way = cv2.INTER_AREA if width > size[0] else cv2.INTER_LINEAR
    _put(page, np.asarray(cv2.resize(truth, size, interpolation=way), dtype=np.uint8), layout.truth)
    _put(page, draw_belief(frame, layout.belief[2:], scene.window), layout.belief)
    _put(page, draw_buffers(frame.buffers, *layout.buffers[2:]), layout.buffers)
    _put(page, draw_hough(frame.hough, *layout.hough[2:], several=several), layout.hough)
    _put(page, draw_log(scene.log, *layout.log[2:]), layout.log)
    _draw_foot(page, scene)
    return page


def layout_for(aspect: float, robots: int = 1) -> Layout:
    """The layout with the largest pictures of an aspect ratio (width over height)."""
    room = HEIGHT - _TOP - _FOOT
    width = (WIDTH - _SIDE - 4 * _GAP) // 2
    beside = min(width / aspect, room)
    wide = (WIDTH - 3 * _GAP) // 2
    below = min(wide / aspect, room - _STRIP - _GAP)
    if beside >= below:
        size = _even(beside * aspect, beside)
        right = 2 * _GAP + width
        left = WIDTH - _GAP - _SIDE
        buffers = buffers_height(robots) + _GAP
        hough = 268
        return Layout(
            (_GAP + (width - size[0]) // 2, _TOP, *size),
            (right + (width - size[0]) // 2, _TOP, *size),
            (left, _TOP - 22, _SIDE, buffers),
            (left, _TOP - 22 + buffers, _SIDE, hough),
            (left, _TOP - 22 + buffers + hough + 14, _SIDE, room + 22 - buffers - hough - 14),
        )
    size = _even(below * aspect, below)
    top = _TOP + size[1] + _GAP
    strip = HEIGHT - _FOOT - top
    third = (WIDTH - 4 * _GAP) // 3
    return Layout(
        (_GAP + (wide - size[0]) // 2, _TOP, *size),
        (2 * _GAP + wide + (wide - size[0]) // 2, _TOP, *size),
        (_GAP, top, third, strip),
        (2 * _GAP + third, top, third, strip),
        (3 * _GAP + 2 * third, top, third, strip),
    )


def cropped_truth(
    truth: Image, low: FloatArray, high: FloatArray
) -> tuple[Image, tuple[FloatArray, FloatArray]]:
    """The part of a simulation's picture that shows the world, and the corners (2,), m, of the
    region that it shows.

    ``low`` and ``high`` (2,), m, are the corners of the box around all walls. The caption above the
    world is cut off, because the video has its own.
    """
    rows, columns = truth.shape[:2]
    extent = np.maximum(high - low, 1e-3)
    most = np.array(_TRUTH_MOST) - 2 * _TRUTH_MARGIN
    scale = float((most / extent).min())
    origin = np.array([0.5 * (columns - extent[0] * scale), rows - _TRUTH_MARGIN])
    # The part goes from pixel (left, top) to pixel (right, bottom), rounded outwards.
    start = np.floor(origin - np.array([_KEPT_MARGIN, extent[1] * scale + _KEPT_MARGIN])).astype(
        int
    )
    end = np.ceil(origin + np.array([extent[0] * scale + _KEPT_MARGIN, _KEPT_MARGIN])).astype(int)
    left, top = np.maximum(start, 0).tolist()
    right, bottom = np.minimum(end, (columns, rows)).tolist()
    window_low = low + np.array([left - origin[0], origin[1] - bottom]) / scale
    window_high = low + np.array([right - origin[0], origin[1] - top]) / scale
    more = round(_ADDED_MARGIN * float(extent.max()) * scale)
    kept = truth[top:bottom, left:right]
    padded = cv2.copyMakeBorder(kept, more, more, more, more, cv2.BORDER_CONSTANT, value=PAPER)
    return np.asarray(padded, dtype=np.uint8), (
        window_low - more / scale,
        window_high + more / scale,
    )


def _draw_header(page: Image, time: float, scene: Scene) -> None:
    write(page, "LimSLAM", (_GAP, 33), 21, INK, bold=True)
    write(
        page, fitted(scene.title, 14, 680), (_GAP + width_of("LimSLAM", 21, bold=True) + 14, 33), 14
    )
    right = WIDTH - _GAP
    minutes, seconds = divmod(round(time, 1), 60.0)
    write(page, f"{int(minutes)}:{seconds:04.1f}", (right, 33), 18, INK, bold=True, anchor="right")
    write(page, f"seen {100.0 * scene.coverage:.0f} %", (right - 150, 33), 14, anchor="right")
    bar = right - 142
    box(page, (bar, 24), (bar + 60, 30), RULE)
    if scene.coverage > 0.0:
        box(page, (bar, 24), (bar + round(60 * min(scene.coverage, 1.0)), 30), TEXT)
    speed = "paused" if scene.is_paused else f"{scene.speed:g} x"
    write(page, speed, (right - 270, 33), 14, FAINT, anchor="right")
    cv2.line(page, (0, 46), (WIDTH, 46), RULE, 1)


def _draw_foot(page: Image, scene: Scene) -> None:
    top = HEIGHT - _FOOT + 12
    width = WIDTH - 2 * _GAP
    _put(page, draw_stages(scene.caption.stages, width, 26), (_GAP, top, width, 26))
    if scene.is_paused:
        box(page, (0, top + 34), (WIDTH, top + 90), mixed(GLOW, PAPER, 0.82))
    headline = fitted(scene.caption.headline, 18, round(0.92 * width))  # bold letters are wider
    write(page, headline, (_GAP, top + 58), 18, INK, bold=True)
    write(page, scene.caption.explanation, (_GAP, top + 81), 15, INK if scene.is_paused else TEXT)
    _put(page, draw_legend(width, 22), (_GAP, HEIGHT - 27, width, 22))


def _headed(page: Image, place: Box, words: str, more: str) -> None:
    left, top, width, height = place
    write(page, words, (left, top - 9), 15, INK, bold=True)
    write(page, more, (left + width_of(words, 15, bold=True) + 10, top - 9), 12, FAINT)
    box(page, (left - 1, top - 1), (left + width, top + height), RULE, 1)


def _put(page: Image, part: Image, place: Box) -> None:
    left, top, width, height = place
    page[top : top + height, left : left + width] = part


def _even(width: float, height: float) -> tuple[int, int]:
    return 2 * max(int(width / 2), 1), 2 * max(int(height / 2), 1)
