"""From where to where walls go: `wall_extent` and `wall_map` once more, for kernels, in a fixed number of bins."""

import math

import numpy as np

from limslam_agent.batch_compile import compiled
from limslam_agent.batch_filter import cov
from limslam_agent.batch_state import (
    GROUPS,
    HITS,
    LEAST,
    LENGTH,
    LINES,
    LOW,
    MISSES,
    MOST,
    NO_PLACE,
    POSE,
    READINGS,
    Minds,
    Settings,
)
from limslam_agent.batch_update import GRAZING
from limslam_env.geometry import BoolArray, FloatArray

BIN = 0.05


@compiled
def forget_wall(mind: Minds, index: int) -> None:
    """Nothing is known of this wall."""
    mind.walls[index] = 0
    mind.counted[index] = 0
    mind.reached[index, LEAST] = np.inf
    mind.reached[index, MOST] = -np.inf


@compiled
def ends_of(mind: Minds, index: int) -> tuple[float, float]:
    """The outermost hits, m along the line."""
    length = mind.walls[index, LENGTH]
    if not length:
        return np.inf, -np.inf
    return mind.reached[index, LEAST, :length].min(), mind.reached[index, MOST, :length].max()


@compiled
def along_of(mind: Minds, index: int, x: float, y: float) -> float:
    """Where a point falls along a line, m from its anchor."""
    theta = mind.x[POSE + 2 * index + 1]
    return (x - mind.anchors[index, 0]) * -math.sin(theta) + (y - mind.anchors[index, 1]) * math.cos(theta)


@compiled
def reach(mind: Minds, index: int, place: int) -> int:
    """Make room for a bin, and say which it is; -1 if there is no room."""
    wall, counted, reached = mind.walls[index], mind.counted[index], mind.reached[index]
    length = wall[LENGTH]
    if not length:
        wall[LOW], length = place, 1
    before, most = max(0, wall[LOW] - place), counted.shape[1]
    length = max(length + before, place - wall[LOW] + 1)
    if length > most:
        mind.counts[NO_PLACE] += 1
        return -1
    if before:
        wall[LOW] -= before
        for row in range(2):
            counted[row, before:length] = counted[row, : length - before].copy()
            counted[row, :before] = 0
            reached[row, before:length] = reached[row, : length - before].copy()
            reached[row, :before] = np.inf if row == LEAST else -np.inf
    wall[LENGTH] = length
    return place - wall[LOW]


@compiled
def hit(mind: Minds, index: int, along: float) -> None:
    """A beam ended at this place, m along the line."""
    place = reach(mind, index, math.floor(along / BIN))
    if place >= 0:
        mind.counted[index, HITS, place] += 1
        mind.reached[index, LEAST, place] = min(mind.reached[index, LEAST, place], along)
        mind.reached[index, MOST, place] = max(mind.reached[index, MOST, place], along)


@compiled
def absorb(mind: Minds, older: int, younger: int, factor: float, shift: float) -> None:
    """Take over another wall's counts: its place s is ``factor`` (1 or -1) times s plus ``shift`` (m) here."""
    for row in (GROUPS, READINGS):
        mind.walls[older, row] += mind.walls[younger, row]
    for other in range(mind.walls[younger, LENGTH]):
        middle = factor * BIN * (mind.walls[younger, LOW] + other + 0.5) + shift
        place = reach(mind, older, math.floor(middle / BIN))
        if place < 0:
            continue
        for row in range(2):
            mind.counted[older, row, place] += mind.counted[younger, row, other]
        if mind.counted[younger, HITS, other]:
            first = factor * mind.reached[younger, LEAST, other] + shift
            last = factor * mind.reached[younger, MOST, other] + shift
            mind.reached[older, LEAST, place] = min(mind.reached[older, LEAST, place], first, last)
            mind.reached[older, MOST, place] = max(mind.reached[older, MOST, place], first, last)


@compiled
def remove_wall(mind: Minds, index: int) -> None:
    """Close the gap that a wall leaves; the filter still counts it."""
    for place in range(index, mind.counts[LINES] - 1):
        mind.walls[place] = mind.walls[place + 1]
        mind.counted[place] = mind.counted[place + 1]
        mind.reached[place] = mind.reached[place + 1]


@compiled
def see_through(mind: Minds, ranges: FloatArray, measured: BoolArray, settings: Settings) -> None:
    """Take back what beams have gone through: `consistent._see_through`."""
    x, y, heading = mind.x[0], mind.x[1], mind.x[2]
    cos, sin = math.cos(heading), math.sin(heading)
    shift, turn = cov(mind, 0, 0) + cov(mind, 1, 1), cov(mind, 2, 2)
    for beam in range(len(ranges)):
        if not (measured[beam] and ranges[beam] > settings.too_near[beam]) or not mind.counts[LINES]:
            continue
        far = min(ranges[beam], settings.max_ranges[beam])
        from_x = x + cos * settings.origins[beam, 0] - sin * settings.origins[beam, 1]
        from_y = y + sin * settings.origins[beam, 0] + cos * settings.origins[beam, 1]
        ux, uy = math.cos(heading + settings.angles[beam]), math.sin(heading + settings.angles[beam])
        unsure = settings.through_sigmas * math.sqrt(settings.std**2 + shift + turn * far**2)
        for index in range(mind.counts[LINES]):
            d, theta = mind.x[POSE + 2 * index], mind.x[POSE + 2 * index + 1]
            nx, ny = math.cos(theta), math.sin(theta)
            cosine = ux * nx + uy * ny
            if abs(cosine) <= GRAZING:
                continue
            anchor = mind.anchors[index]
            ahead = (d + (anchor[0] - from_x) * nx + (anchor[1] - from_y) * ny) / cosine
            if ahead > 0.0 and ahead + unsure / abs(cosine) + settings.through_slack < far:
                pass_at(mind, index, along_of(mind, index, from_x + ahead * ux, from_y + ahead * uy))


@compiled
def pass_at(mind: Minds, index: int, along: float) -> None:
    """A beam went through at a place, m; between the wall's ends that says something."""
    low, high = ends_of(mind, index)
    if low < along < high:
        place = math.floor(along / BIN) - mind.walls[index, LOW]
        mind.counted[index, MISSES, min(max(place, 0), mind.walls[index, LENGTH] - 1)] += 1
