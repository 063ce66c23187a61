"""Extent of a wall along its line, in a fixed number of bins: compiled counterpart of ``consistent.wall_extent``."""

import math

import numpy as np

from limslam_agent.slam.batch.compilation import compiled
from limslam_agent.slam.batch.state import HITS, LEAST, LENGTH, LOW, MISSES, MOST, OVERFLOWS, Walls
from limslam_agent.slam.consistent.wall_extent import BIN
from limslam_env.geometry import IntArray


@compiled
def ends_of(walls: Walls, index: int) -> tuple[float, float]:
    """Positions of the outermost hits, m along the line."""
    low, high, reached = np.inf, -np.inf, walls.reached
    for place in range(walls.table[index, LENGTH]):
        low, high = min(low, reached[index, LEAST, place]), max(high, reached[index, MOST, place])
    return low, high


@compiled
def hit(walls: Walls, counts: IntArray, index: int, along: float) -> None:
    """Count a beam that ended at a position, m along the line."""
    place = reach(walls, counts, index, math.floor(along / BIN))
    if place >= 0:
        walls.counted[index, HITS, place] += 1
        walls.reached[index, LEAST, place] = min(walls.reached[index, LEAST, place], along)
        walls.reached[index, MOST, place] = max(walls.reached[index, MOST, place], along)


@compiled
def pass_at(walls: Walls, index: int, along: float) -> None:
    """Count a beam that passed at a position, m; only positions between the ends count."""
    low, high = ends_of(walls, index)
    if low < along < high:
        place = math.floor(along / BIN) - walls.table[index, LOW]
        walls.counted[index, MISSES, min(max(place, 0), walls.table[index, LENGTH] - 1)] += 1


@compiled
def absorb(walls: Walls, counts: IntArray, older: int, younger: int, factor: float, shift: float) -> None:
    """Add another wall's counts. Its position s is ``factor`` (1 or -1) times s plus ``shift`` (m) here."""
    for other in range(walls.table[younger, LENGTH]):
        middle = factor * BIN * (walls.table[younger, LOW] + other + 0.5) + shift
        place = reach(walls, counts, older, math.floor(middle / BIN))
        if place < 0:
            continue
        for row in range(2):
            walls.counted[older, row, place] += walls.counted[younger, row, other]
        if walls.counted[younger, HITS, other]:
            first = factor * walls.reached[younger, LEAST, other] + shift
            last = factor * walls.reached[younger, MOST, other] + shift
            walls.reached[older, LEAST, place] = min(walls.reached[older, LEAST, place], first, last)
            walls.reached[older, MOST, place] = max(walls.reached[older, MOST, place], first, last)


@compiled
def reach(walls: Walls, counts: IntArray, index: int, place: int) -> int:
    """Extend the arrays to hold a bin, and return its index; -1 if there is no room."""
    wall, counted, reached = walls.table[index], walls.counted[index], walls.reached[index]
    length = wall[LENGTH]
    if not length:
        wall[LOW], length = place, 1
    before, most = max(0, wall[LOW] - place), counted.shape[1]
    length = max(length + before, place - wall[LOW] + 1)
    if length > most:
        counts[OVERFLOWS] += 1
        return -1
    if before:
        wall[LOW] -= before
        for row in range(2):
            counted[row, before:length] = counted[row, : length - before].copy()
            counted[row, :before] = 0
            reached[row, before:length] = reached[row, : length - before].copy()
            reached[row, :before] = np.inf if row == LEAST else -np.inf
    wall[LENGTH] = length
    return int(place - wall[LOW])
