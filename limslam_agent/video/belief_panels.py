"""The small panels of a video: Hough votes, scan buffers, list of events, stages of the method, and
legend.
"""

import functools
import math
from collections.abc import Sequence

import cv2
import numpy as np

from limslam_agent.output.style import (
    FAINT,
    GLOW,
    HEAT,
    INK,
    OCCUPIED,
    PEAKS,
    box,
    disc,
    fitted,
    plain,
    side_colour,
    width_of,
    write,
)
from limslam_agent.slam.core.diagnostics import PendingPoints
from limslam_agent.video.belief_frame import HoughView
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
    mixed,
    robot_colour,
)
from limslam_env.messages import counted

STAGES = (
    "predict",
    "collect",
    "find lines",
    "associate",
    "correct or add",
    "close loops",
    "explore",
)
"""Stages of the method in the order of a step."""

_ROW = 19  # pixels from one line of small text to the next
_SHORTEST_BAR = 14  # pixels
# space for the heat map's axes, pixels
_SCALE_WIDTH = 46
_SCALE_HEIGHT = 34
_RAMP = np.array(HEAT, dtype=float)


def blank(width: int, height: int, title: str = "") -> Image:
    """An empty panel with a title."""
    panel = plain(width, height).copy()
    write(panel, title, (0, 13), 13, INK, bold=True)
    return panel


@functools.lru_cache(maxsize=2)
def draw_hough(hough: HoughView | None, width: int, height: int, *, several: bool = False) -> Image:
    """The votes of the latest extraction as a heat map, theta to the right and r upwards, with
    rings around the peaks.

    Without an extraction the axes are empty. With several robots the panel names one.
    """
    panel = blank(width, height, "Hough votes of the last scan")
    if hough is not None:
        who = f"robot {hough.robot + 1}, {hough.side}" if several else f"{hough.side} buffer"
        text = f"{who}: {len(hough.points)} points, {counted(len(hough.peaks), 'line')}"
        write(panel, fitted(text, 12, width), (0, 31), 12)
    left = _SCALE_WIDTH
    top = 40
    right = width - 6
    bottom = height - _SCALE_HEIGHT
    area = panel[top:bottom, left:right]
    if hough is not None:
        area[:] = _heat_map(hough, right - left, bottom - top)
        _ring_peaks(area, hough)
    box(panel, (left - 1, top - 1), (right, bottom), RULE, 1)
    _draw_axes(panel, (left, top, right, bottom), 1.0 if hough is None else hough.r_reach)
    return panel


def _heat_map(hough: HoughView, width: int, height: int) -> Image:
    most = max(int(hough.votes.max()), 1) if hough.votes.size else 1
    # The square root makes the curves of single points visible.
    share = np.sqrt(hough.votes[::-1] / most)
    place = share * (len(_RAMP) - 1)
    below = np.minimum(place.astype(int), len(_RAMP) - 2)
    part = (place - below)[..., None]
    colours = np.round(_RAMP[below] * (1.0 - part) + _RAMP[below + 1] * part).astype(np.uint8)
    return np.asarray(
        cv2.resize(colours, (width, height), interpolation=cv2.INTER_NEAREST), dtype=np.uint8
    )


def _ring_peaks(area: Image, hough: HoughView) -> None:
    height, width = area.shape[:2]
    for number, (r, theta) in enumerate(hough.peaks):
        x = theta / math.pi * width
        y = (0.5 - 0.5 * r / hough.r_reach) * height
        # A line near 0 or 180 degrees appears at both edges. The ring is moved so that all of it is
        # visible.
        centre = (
            round(16 * float(np.clip(x, 6, width - 7))),
            round(16 * float(np.clip(y, 6, height - 7))),
        )
        cv2.circle(area, centre, 16 * 9, INK, 4, cv2.LINE_AA, 4)
        cv2.circle(area, centre, 16 * 9, PEAKS[number % len(PEAKS)], 2, cv2.LINE_AA, 4)


def _draw_axes(panel: Image, box: tuple[int, int, int, int], reach: float) -> None:
    left, top, right, bottom = box
    for degrees in (0, 45, 90, 135, 180):
        x = left + round((right - left) * degrees / 180)
        cv2.line(panel, (x, bottom), (x, bottom + 3), FAINT, 1)
        write(panel, f"{degrees}°", (min(x, right - 9), bottom + 15), 11, anchor="centre")
    step = max(
        size for size in (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if size <= max(reach, 0.05)
    )
    for r in (-step, 0.0, step):
        y = round(0.5 * (top + bottom) - 0.5 * (bottom - top) * r / reach)
        cv2.line(panel, (left - 4, y), (left - 2, y), FAINT, 1)
        write(panel, f"{r:g}", (left - 7, y + 4), 11, anchor="right")
    middle = (left + right) // 2
    write(panel, "theta, direction of the normal", (middle, bottom + 31), 11, anchor="centre")
    height = bottom - top
    upright = blank(height, 14)
    words = "r, distance of the line, m"
    label = words if width_of(words, 11) < height else "r, m"
    write(upright, label, (height // 2, 11), 11, anchor="centre")
    panel[top:bottom, :14] = np.rot90(upright)


def buffers_height(robots: int) -> int:
    """Height of the panel with the scan buffers, pixels."""
    return 24 + 19 * max(robots, 2)


def draw_buffers(buffers: Sequence[PendingPoints], width: int, height: int) -> Image:
    """How full the buffers are, as bars one below the other. For several robots one row per
    robot.
    """
    has_kept = any(buffer.new is not None for buffer in buffers)
    title = "Scan buffers" if has_kept else "Points in the scan buffers"
    panel = blank(width, height, title)
    if has_kept:
        begin = width_of(title, 13, bold=True) + 10
        write(panel, fitted("new/needed + kept unused", 11, width - begin), (begin, 13), 11, FAINT)
    robots = sorted({buffer.robot for buffer in buffers})
    row = min(19, (height - 24) // max(len(robots), 2))
    if len(robots) <= 1:
        for line, buffer in enumerate(buffers):
            _draw_bar(panel, buffer, 0, 24 + line * row, width)
        return panel
    for line, robot in enumerate(robots):
        y = 24 + line * row
        disc(panel, (8, y + 5), 5, robot_colour(robot))
        for buffer in (one for one in buffers if one.robot == robot):
            x = 20 if buffer.side == "left" else width // 2 + 14
            _draw_bar(panel, buffer, x, y, width // 2 - 14)
    return panel


def _draw_bar(panel: Image, buffer: PendingPoints, x: int, y: int, width: int) -> None:
    count = len(buffer.points) if buffer.new is None else buffer.new
    kept = len(buffer.points) - count
    colour = side_colour(buffer.side)
    words = f"{buffer.side} {count}/{buffer.enough}"
    words += f" + {kept} kept" if kept > 0 else ""
    # All bars have one length, with or without points that are kept.
    length = max(width - (80 if buffer.new is None else 124), _SHORTEST_BAR)
    filled = round(length * min(count / max(buffer.enough, 1), 1.0))
    box(panel, (x, y), (x + length, y + 9), mixed(colour, PAPER, 0.8))
    if filled:
        box(panel, (x, y), (x + filled, y + 9), colour)
    room = width - length - 6
    # A narrow column has no room for the word beside the number of kept points.
    words = words if width_of(words, 11) <= room else words.removesuffix(" kept")
    write(panel, fitted(words, 11, room), (x + length + 6, y + 9), 11)


def draw_log(lines: Sequence[tuple[float, str, str]], width: int, height: int) -> Image:
    """The list of events, with the latest on top: rows of time (s), kind and text."""
    panel = blank(width, height, "Events")
    marks = {"new": BELIEF, "again": FAINT, "loop": GLOW, "goal": FRONTIER}
    for row, (time, kind, words) in enumerate(lines[: max((height - 20) // _ROW, 0)]):
        y = 34 + row * _ROW
        colour = mixed(INK, PAPER, min(0.12 * row, 0.6))
        write(panel, f"{time:.1f} s", (50, y), 12, mixed(colour, PAPER, 0.3), anchor="right")
        mark = mixed(marks.get(kind, FAINT), PAPER, min(0.1 * row, 0.5))
        disc(panel, (61, y - 4), 4, mark)
        write(panel, fitted(words, 12, width - 72), (72, y), 12, colour, bold=kind == "loop")
    return panel


@functools.lru_cache(maxsize=16)
def draw_stages(active: tuple[int, ...], width: int, height: int) -> Image:
    """The stages of the method in a row. The stages that the caption is about are highlighted."""
    panel = blank(width, height)
    gap = 22
    room = (width - gap * (len(STAGES) - 1)) / len(STAGES)
    for number, name in enumerate(STAGES):
        left = round(number * (room + gap))
        right = round(number * (room + gap) + room)
        is_on = number in active
        fill, ink = (INK, PAPER) if is_on else (mixed(RULE, PAPER, 0.45), TEXT)
        _rounded(panel, left, right, height, fill)
        write(
            panel,
            f"{number + 1}  {name}",
            ((left + right) // 2, height // 2 + 5),
            13,
            ink,
            bold=is_on,
            anchor="centre",
        )
        if number:
            tip = (left - 5, height // 2)
            cv2.line(panel, (left - gap + 4, tip[1]), tip, FAINT, 1, cv2.LINE_AA)
            head = np.add(tip, [(-4, -4), (0, 0), (-4, 4)]).astype(np.int32)
            cv2.polylines(panel, [head], False, FAINT, 1, cv2.LINE_AA)  # noqa: FBT003 (it is not closed)
    return panel


def _rounded(panel: Image, left: int, right: int, height: int, colour: Colour) -> None:
    radius = (height - 1) // 2
    box(panel, (left + radius, 0), (right - radius, 2 * radius), colour)
    for x in (left + radius, right - radius):
        disc(panel, (x, radius), radius, colour)


@functools.lru_cache(maxsize=2)
def draw_legend(width: int, height: int) -> Image:
    """The meaning of the map's colours, in one row."""
    panel = blank(width, height)
    names = (
        "possible position (95 %)",
        "wall, 2 sigma",
        "free",
        "occupied",
        "unknown",
        "frontier",
        "path and goal",
        "points, left",
        "points, right",
        "beam that hits",
    )
    symbol = 26
    gap = 14
    x = 0
    middle = height // 2
    for number, name in enumerate(names):
        _draw_symbol(panel, number, x, middle)
        write(panel, name, (x + symbol, middle + 4), 12)
        x += symbol + width_of(name, 12) + gap
    return panel


def _draw_symbol(panel: Image, number: int, x: int, y: int) -> None:
    """The symbol of a legend entry in a box of 20 pixels that begins at x."""
    blue = ROBOTS[0]
    if number == 0:
        middle = (x + 10, y)
        cv2.ellipse(panel, middle, (10, 7), 0, 0, 360, mixed(blue, PAPER, 0.65), -1, cv2.LINE_AA)
        disc(panel, middle, 4, blue)
    elif number == 1:
        upper = [(0, -6), (10, -2), (20, -6)]
        lower = [(across, -up) for across, up in reversed(upper)]
        bow = np.add((x, y), upper + lower)
        cv2.fillPoly(panel, [bow.astype(np.int32)], mixed(BELIEF, PAPER, 0.75), cv2.LINE_AA)
        cv2.line(panel, (x, y), (x + 20, y), BELIEF, 2)
    elif number in {2, 3, 4, 5}:
        colour = (SEEN, OCCUPIED, UNSEEN, mixed(FRONTIER, SEEN, 0.4))[number - 2]
        box(panel, (x + 5, y - 6), (x + 18, y + 6), colour)
        box(panel, (x + 5, y - 6), (x + 18, y + 6), RULE, 1)
    elif number == 6:
        cv2.line(panel, (x, y), (x + 9, y), blue, 2)
        disc(panel, (x + 15, y), 5, blue, 2)
    elif number == 9:
        cv2.line(panel, (x + 2, y + 3), (x + 18, y - 2), BEAM, 1, cv2.LINE_AA)
        disc(panel, (x + 18, y - 2), 2, BEAM)
    else:
        for dx, dy in ((5, 2), (11, -1), (17, 1)):
            disc(panel, (x + dx, y + dy), 2, side_colour("left" if number == 7 else "right"))
