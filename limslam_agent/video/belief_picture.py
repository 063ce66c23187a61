"""The right half of a video: the belief of the robots, drawn as a map."""

import math

import cv2
import numpy as np

from limslam_agent.output.style import (
    GLOW,
    INK,
    OCCUPIED,
    PEAKS,
    blended,
    plain,
    side_colour,
    width_of,
    write,
)
from limslam_agent.video.belief_frame import BeliefFrame, HoughView, wall_bands
from limslam_env.canvas import (
    BELIEF,
    FRONTIER,
    PAPER,
    SEEN,
    SHIFT,
    UNSEEN,
    Canvas,
    Colour,
    Image,
    mixed,
    robot_colour,
)
from limslam_env.geometry import FloatArray
from limslam_env.geometry.shapes import ellipse, thinned

EXTRACTION_SHOWN = 1.0
"""Simulated time for which the points and lines of an extraction stay visible in the map, s."""

_WIDEST_BAND = 1.5  # m
_SURE = 8  # value of a cell from which it has its full colour
_RADIUS = 0.10  # m
_APART = 150  # pixels
_TRAIL_POINTS = 1500


class Sheet(Canvas):
    """A picture of a belief."""

    def wash(self, outlines: FloatArray, colour: Colour, strength: float = 1.0) -> None:
        """Fill polygons (n, k, 2), m, with a transparent colour. Overlaps are not darker."""
        if not len(outlines):
            return
        corners = self.pixels(outlines.reshape(-1, 2)).reshape(outlines.shape)
        height, width = self.image.shape[:2]
        # Only the bounding box is blended, because most polygons are small.
        left, top = np.maximum((corners.min(axis=(0, 1)) >> SHIFT) - 2, 0).tolist()
        right, bottom = np.minimum(
            (corners.max(axis=(0, 1)) >> SHIFT) + 3, (width, height)
        ).tolist()
        if left >= right or top >= bottom:
            return
        cover = np.zeros((bottom - top, right - left), dtype=np.uint8)
        corners -= np.array([left, top], dtype=np.int32) << SHIFT
        for outline in corners:
            cv2.fillPoly(cover, [outline], (round(255 * strength),), cv2.LINE_AA, SHIFT)
        touched = np.nonzero(cover)
        part = self.image[top:bottom, left:right]
        part[touched] = blended(part[touched], colour, cover[touched][:, None])

    def label(self, words: str, place: FloatArray, size: int, ink: Colour, paper: Colour) -> None:
        """Write a text on a small plate at a position (2,), m."""
        x, y = (self.pixels(np.asarray(place)[None])[0] >> SHIFT).tolist()
        half = width_of(words, size, bold=True) // 2 + 3
        above = round(0.36 * size) + 3
        cv2.rectangle(self.image, (x - half, y - above), (x + half, y + above), paper, -1)
        write(self.image, words, (x, y + above - 3), size, ink, bold=True, anchor="centre")


def draw_belief(
    frame: BeliefFrame, size: tuple[int, int], window: tuple[FloatArray, FloatArray]
) -> Image:
    """What is believed, as an RGB image (height, width, 3) of a size (width, height). Walls of
    events are highlighted.

    ``window`` has the lower left and the upper right corner (2,), m, of the visible region.
    """
    (width, height), (low, high) = size, window
    extent = np.maximum(high - low, 1e-3)
    scale = float(min(width / extent[0], height / extent[1]))
    # The window is centred. Both directions have the same scale.
    corner = 0.5 * (low + high) - 0.5 * np.array([width, height]) / scale
    origin = np.array([-0.5, height - 0.5])
    sheet = Sheet(plain(width, height, UNSEEN).copy(), corner, origin, scale)
    _draw_grid(sheet, frame)
    for number, path in enumerate(frame.paths):
        sheet.path(thinned(path, _TRAIL_POINTS), mixed(robot_colour(number), SEEN, 0.5), 2)
    _draw_walls(sheet, frame)
    for buffer in frame.buffers:
        sheet.discs(buffer.points, 2.2, side_colour(buffer.side))
    if frame.hough is not None and frame.time - frame.hough.time < EXTRACTION_SHOWN:
        _draw_extraction(sheet, frame.hough)
    _draw_plans(sheet, frame)
    for number, (pose, covariance) in enumerate(zip(frame.poses, frame.covariances, strict=True)):
        _draw_robot(sheet, pose, covariance, robot_colour(number))
    _draw_names(sheet, frame)
    return sheet.image


def _draw_grid(sheet: Sheet, frame: BeliefFrame) -> None:
    """Draw the cells: light where free, grey where occupied, with a stronger colour for a larger
    value.
    """
    grid = frame.grid
    if grid is None or not grid.values.size:
        return
    values = np.clip(grid.values.astype(np.float32) / _SURE, -1.0, 1.0)[..., None]
    # A cell that was seen once must look different from a cell that was never seen.
    strength = np.where(values == 0.0, 0.0, 0.5 + 0.5 * np.abs(values))
    known = np.where(values > 0.0, np.array(SEEN), np.array(OCCUPIED))
    cells = np.round(np.array(UNSEEN) + strength * (known - np.array(UNSEEN))).astype(np.uint8)
    step = 1.0 / (sheet.scale * grid.cell)
    column, row = (sheet.low - grid.low) / grid.cell
    height, width = sheet.image.shape[:2]
    to_cells = np.array(
        [[step, 0.0, column + 0.5 * step - 0.5], [0.0, -step, row + (height - 0.5) * step - 0.5]]
    )
    cv2.warpAffine(
        cells,
        to_cells,
        (width, height),
        dst=sheet.image,
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_TRANSPARENT,
    )
    half = 0.42 * grid.cell * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    sheet.wash(frame.frontier[:, None] + half, FRONTIER, 0.55)


def _draw_walls(sheet: Sheet, frame: BeliefFrame) -> None:
    """Draw the walls over their uncertainty, which is shown up to a distance from each wall."""
    ends = np.array([wall.ends for wall in frame.walls]).reshape(-1, 2, 2)
    low = ends.min(axis=1, keepdims=True) - _WIDEST_BAND
    high = ends.max(axis=1, keepdims=True) + _WIDEST_BAND
    sheet.wash(np.clip(wall_bands(frame.walls), low, high), BELIEF, 0.22)
    glowing = {wall for event in frame.events for wall in event.walls}
    for wall in frame.walls:
        if wall.number + 1 in glowing:
            sheet.path(wall.ends, GLOW, 7)
        is_sure = wall.number + 1 not in frame.unsure
        sheet.path(
            wall.ends, BELIEF if is_sure else mixed(BELIEF, UNSEEN, 0.3), 2 if is_sure else 1
        )
        if is_sure:
            sheet.discs(wall.ends, 2.5, BELIEF)


def _draw_names(sheet: Sheet, frame: BeliefFrame) -> None:
    """Draw the walls' numbers. Walls of events are highlighted, and the two walls of a loop are
    connected.
    """
    middles = {wall.number + 1: wall.ends.mean(axis=0) for wall in frame.walls}
    glowing = {wall for event in frame.events for wall in event.walls}
    for name, middle in middles.items():
        if name not in frame.unsure and name not in glowing:
            sheet.label(str(name), middle, 10, BELIEF, mixed(PAPER, BELIEF, 0.06))
    for event in frame.events:
        known = [wall for wall in event.walls if wall in middles]
        ends = np.array([middles[wall] for wall in known]).reshape(-1, 2)
        if len(ends) == 2:
            sheet.path(ends, GLOW, 2)
            sheet.label(f"{event.wall} = {event.other}", ends.mean(axis=0), 14, INK, GLOW)
        # Overlapping labels would be unreadable.
        if len(ends) < 2 or np.hypot(*(ends[1] - ends[0])) * sheet.scale > _APART:
            for wall, end in zip(known, ends, strict=True):
                sheet.label(str(wall), end, 14, INK, GLOW)


def _draw_extraction(sheet: Sheet, hough: HoughView) -> None:
    """Draw rings around the points that voted, and each extracted line in the colour of its
    peak.
    """
    for number, segment in enumerate(hough.segments.reshape(-1, 2, 2)):
        colour = mixed(PEAKS[number % len(PEAKS)], INK, 0.15)
        beyond = 0.25 * (segment[1] - segment[0])
        sheet.path(np.vstack((segment[0] - beyond, segment[1] + beyond)), colour, 2)
    sheet.discs(hough.points, 3.2, side_colour(hough.side))
    sheet.discs(hough.points, 3.2, INK, 1)


def _draw_plans(sheet: Sheet, frame: BeliefFrame) -> None:
    for number, plan in enumerate(frame.plans):
        sheet.path(plan, robot_colour(number), 2)
    for number, goal in enumerate(frame.goals):
        if goal is not None:
            sheet.discs(goal, 7.0, robot_colour(number), 2)
            sheet.discs(goal, 2.5, robot_colour(number))


def _draw_robot(sheet: Sheet, pose: FloatArray, covariance: FloatArray, colour: Colour) -> None:
    """Draw the body, the 95 % ellipse of its position, and the 95 % sector of its heading."""
    heading = float(pose[2])
    spread = min(2.0 * math.sqrt(max(float(covariance[2, 2]), 0.0)), math.pi)
    angles = heading + np.linspace(-spread, spread, 13)
    arc = pose[:2] + 0.55 * np.column_stack((np.cos(angles), np.sin(angles)))
    sheet.wash(np.vstack((pose[:2], arc))[None], colour, 0.30)
    outline = pose[:2] + ellipse(covariance[:2, :2], 40)
    sheet.wash(outline[None], colour, 0.30)
    size = max(_RADIUS * sheet.scale, 4.0)
    sheet.discs(pose[:2], size, colour)
    sheet.discs(pose[:2], size, mixed(colour, INK, 0.4), 1)
    sheet.wash(sheet.arrow(pose, 1.25 * size)[None], PAPER)
    sheet.path(outline, mixed(colour, INK, 0.4), 1, closed=True)
