"""A video of a run: the truth on the left, the belief on the right, and what happens in words."""

import functools
from dataclasses import replace

import cv2
import numpy as np

from limslam_agent.output.style import (
    BEAM,
    FAINT,
    FREE,
    FRONTIER,
    INK,
    OCCUPIED,
    PAPER,
    ROBOTS,
    RULE,
    TEXT,
    UNKNOWN,
    WALL,
    Image,
    fitted,
    mixed,
    plain,
    side_colour,
    width_of,
    write,
)
from limslam_agent.video.belief_picture import BeliefFrame, draw_belief
from limslam_agent.video.narration import LESSONS, SPEED, Narrator
from limslam_agent.video.video import VideoWriter
from limslam_env.geometry import FloatArray

WIDTH, HEIGHT = 1280, 720
FPS = 25
"""Frames per second of the video."""

_GAP, _TOP, _FOOT = 16, 80, 96
_LAST_FRAME = 3.0  # s of the video

# Margin around the world and largest size of the simulator's pictures (limslam_env.rendering.rendering), pixels.
_TRUTH_MARGIN, _TRUTH_MOST = 30, (1600, 640)
_KEPT_MARGIN = 5
_ADDED_MARGIN = 0.04  # share of the world's size at each side, so that a map that has drifted stays visible

_LEGEND = (
    "possible position (95 %)", "wall, 2 sigma", "free", "occupied", "unknown", "frontier", "path and goal",
    "points, left", "points, right", "beam that hits",
)  # fmt: skip


class Film:
    """Makes the frames of a run and gives them to a writer.

    Parameters
    ----------
    writer
        Gets the frames.
    low, high
        Corners (2,), m, of the smallest box around all walls of the world. Both pictures show this region.
    title
        Title of the run.
    """

    def __init__(self, writer: VideoWriter, low: FloatArray, high: FloatArray, title: str) -> None:
        self._writer, self._corners, self._title = writer, (low, high), title
        self._narrator = Narrator()
        self._next, self._shown = 0.0, 0
        self._last: Image | None = None

    def is_due(self, time: float) -> bool:
        """Whether a frame has to be added at a simulated time, s."""
        return time >= self._next - 1e-6

    def add(self, truth: Image, frame: BeliefFrame, coverage: float) -> None:
        """Add a frame.

        Parameters
        ----------
        truth
            Picture of the simulation (h, w, 3), RGB, as ``limslam_env.rendering.rendering.render`` draws it.
        frame
            What is believed.
        coverage
            True coverage, 0 to 1.
        """
        # The next frame is due a period after the last one was, whenever that was drawn: steps need not fit the period.
        self._next = max(self._next, frame.time - SPEED / FPS) + SPEED / FPS
        cropped, window = cropped_truth(truth, *self._corners)
        kind, event = self._narrator.hear(frame)
        # Only the walls of the current caption are highlighted.
        shown = replace(frame, events=() if event is None else (event,))
        self._last = _page(cropped, shown, window)
        _draw_header(self._last, self._title, frame.time, coverage)
        page = self._last.copy()
        _draw_caption(page, *LESSONS[kind])
        self._writer.write(page, self._hold(frame.time))

    def _hold(self, time: float) -> float:
        """How long the frame of a simulated time is shown, s of the video. 0 is the time of one frame."""
        frames = max(round(time / SPEED * FPS) + 1 - self._shown, 1)
        self._shown += frames
        return frames / FPS if frames > 1 else 0.0

    def finish(self, words: str) -> None:
        """Show the last frame for a while, with the reason why the run ended."""
        if self._last is not None:
            _draw_caption(self._last, f"{words[:1].upper()}{words[1:]}.", "")
            self._writer.write(self._last, _LAST_FRAME)


def _page(truth: Image, frame: BeliefFrame, window: tuple[FloatArray, FloatArray]) -> Image:
    """A frame (HEIGHT, WIDTH, 3), RGB, with both pictures and the legend, but no header and no caption."""
    page = plain(WIDTH, HEIGHT).copy()
    room, wide = HEIGHT - _TOP - _FOOT, (WIDTH - 3 * _GAP) // 2
    scale = min(wide / truth.shape[1], room / truth.shape[0])
    size = max(int(truth.shape[1] * scale), 1), max(int(truth.shape[0] * scale), 1)
    top = _TOP + (room - size[1]) // 2
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    resized = np.asarray(cv2.resize(truth, size, interpolation=way), dtype=np.uint8)
    several = len(frame.poses) > 1
    parts = (
        ("Truth", "unknown to the robots" if several else "unknown to the robot", resized),
        ("Belief", "one map for all robots" if several else "the robot's map", draw_belief(frame, size, window)),
    )
    for number, (words, remark, picture) in enumerate(parts):
        left = _GAP + number * (wide + _GAP) + (wide - size[0]) // 2
        write(page, words, (left, top - 9), 15, INK, bold=True)
        write(page, remark, (left + width_of(words, 15, bold=True) + 10, top - 9), 12, FAINT)
        cv2.rectangle(page, (left - 1, top - 1), (left + size[0], top + size[1]), RULE, 1)
        page[top : top + size[1], left : left + size[0]] = picture
    page[HEIGHT - 27 : HEIGHT - 5, _GAP : WIDTH - _GAP] = _legend()
    return page


def cropped_truth(truth: Image, low: FloatArray, high: FloatArray) -> tuple[Image, tuple[FloatArray, FloatArray]]:
    """The part of a simulation's picture that shows the world, and the corners (2,), m, of the region that it shows.

    ``low`` and ``high`` (2,), m, are the corners of the box around all walls. The caption above the world is cut off,
    because the video has its own.
    """
    rows, columns = truth.shape[:2]
    extent = np.maximum(high - low, 1e-3)
    most = np.array(_TRUTH_MOST) - 2 * _TRUTH_MARGIN
    scale = float((most / extent).min())
    origin = np.array([0.5 * (columns - extent[0] * scale), rows - _TRUTH_MARGIN])
    # The part goes from pixel (left, top) to pixel (right, bottom), rounded outwards.
    start = np.floor(origin - np.array([_KEPT_MARGIN, extent[1] * scale + _KEPT_MARGIN])).astype(int)
    end = np.ceil(origin + np.array([extent[0] * scale + _KEPT_MARGIN, _KEPT_MARGIN])).astype(int)
    left, top = np.maximum(start, 0).tolist()
    right, bottom = np.minimum(end, (columns, rows)).tolist()
    window_low = low + np.array([left - origin[0], origin[1] - bottom]) / scale
    window_high = low + np.array([right - origin[0], origin[1] - top]) / scale
    more = round(_ADDED_MARGIN * float(extent.max()) * scale)
    kept = truth[top:bottom, left:right]
    padded = cv2.copyMakeBorder(kept, more, more, more, more, cv2.BORDER_CONSTANT, value=PAPER)
    return np.asarray(padded, dtype=np.uint8), (window_low - more / scale, window_high + more / scale)


def _draw_header(page: Image, title: str, time: float, coverage: float) -> None:
    write(page, "LimSLAM", (_GAP, 33), 21, INK, bold=True)
    write(page, fitted(title, 14, 680), (_GAP + width_of("LimSLAM", 21, bold=True) + 14, 33), 14)
    right = WIDTH - _GAP
    minutes, seconds = divmod(round(time, 1), 60.0)
    write(page, f"{int(minutes)}:{seconds:04.1f}", (right, 33), 18, INK, bold=True, anchor="right")
    write(page, f"seen {100.0 * coverage:.0f} %", (right - 150, 33), 14, TEXT, anchor="right")
    cv2.rectangle(page, (right - 142, 24), (right - 82, 30), RULE, -1)
    if coverage > 0.0:
        cv2.rectangle(page, (right - 142, 24), (right - 142 + round(60 * min(coverage, 1.0)), 30), TEXT, -1)
    write(page, f"{SPEED:g} x", (right - 270, 33), 14, FAINT, anchor="right")
    cv2.line(page, (0, 46), (WIDTH, 46), RULE, 1)


def _draw_caption(page: Image, headline: str, explanation: str) -> None:
    write(page, headline, (_GAP, HEIGHT - 66), 18, INK, bold=True)
    write(page, explanation, (_GAP, HEIGHT - 42), 15)


@functools.cache
def _legend() -> Image:
    """The meaning of the map's colours, in one row."""
    panel = plain(WIDTH - 2 * _GAP, 22).copy()
    symbol, gap = 26, 14
    x, middle = 0, 11
    for number, name in enumerate(_LEGEND):
        _draw_symbol(panel, number, x, middle)
        write(panel, name, (x + symbol, middle + 4), 12, TEXT)
        x += symbol + width_of(name, 12) + gap
    return panel


def _draw_symbol(panel: Image, number: int, x: int, y: int) -> None:
    """The symbol of a legend entry in a box of 20 pixels that begins at x."""
    blue = ROBOTS[0]
    if number == 0:
        cv2.ellipse(panel, (x + 10, y), (10, 7), 0, 0, 360, mixed(blue, PAPER, 0.65), -1, cv2.LINE_AA)
        cv2.circle(panel, (x + 10, y), 4, blue, -1, cv2.LINE_AA)
    elif number == 1:
        bow = np.array([(x, y - 6), (x + 10, y - 2), (x + 20, y - 6), (x + 20, y + 6), (x + 10, y + 2), (x, y + 6)])
        cv2.fillPoly(panel, [bow.astype(np.int32)], mixed(WALL, PAPER, 0.75), cv2.LINE_AA)
        cv2.line(panel, (x, y), (x + 20, y), WALL, 2)
    elif number in {2, 3, 4, 5}:
        colour = (FREE, OCCUPIED, UNKNOWN, mixed(FRONTIER, FREE, 0.4))[number - 2]
        cv2.rectangle(panel, (x + 5, y - 6), (x + 18, y + 6), colour, -1)
        cv2.rectangle(panel, (x + 5, y - 6), (x + 18, y + 6), RULE, 1)
    elif number == 6:
        cv2.line(panel, (x, y), (x + 9, y), blue, 2)
        cv2.circle(panel, (x + 15, y), 5, blue, 2, cv2.LINE_AA)
    elif number == 9:
        cv2.line(panel, (x + 2, y + 3), (x + 18, y - 2), BEAM, 1, cv2.LINE_AA)
        cv2.circle(panel, (x + 18, y - 2), 2, BEAM, -1, cv2.LINE_AA)
    else:
        for dx, dy in ((5, 2), (11, -1), (17, 1)):
            cv2.circle(panel, (x + dx, y + dy), 2, side_colour("left" if number == 7 else "right"), -1, cv2.LINE_AA)
