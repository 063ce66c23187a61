"""Pending readings of one robot, by side: compiled counterpart of ``consistent.pending_readings``.

``travel`` (7,) and ``pending`` (3, most, 4) are those of :class:`~limslam_agent.slam.batch.state.States`.
"""

import numpy as np

from limslam_agent.slam.batch.compilation import algebra
from limslam_agent.slam.batch.state import (
    ANGLE,
    BEAM,
    CLONE,
    DRIVEN,
    DRIVEN_AT,
    DRIVEN_THEN,
    FRESH,
    FROM_X,
    FROM_Y,
    LAST_HIT,
    PENDING,
    RANGE,
    SIDE,
    TURNED,
    TURNED_AT,
    Settings,
)
from limslam_env.geometry import BoolArray, FloatArray, IntArray


@algebra
def is_due(travel: FloatArray, hits: BoolArray, settings: Settings, beams: FloatArray) -> bool:
    """Whether there are new hits (b,), and the robot has moved far enough since the last collection."""
    any_hit = False
    for beam in range(len(hits)):
        side = int(beams[beam, SIDE])
        if hits[beam] and side >= 0:
            travel[LAST_HIT + side] = travel[DRIVEN]
            any_hit = True
    has_moved = (
        travel[DRIVEN] - travel[DRIVEN_AT] >= settings.min_distance
        or travel[TURNED] - travel[TURNED_AT] >= settings.min_turn
    )
    return has_moved and any_hit


@algebra
def collect(
    counts: IntArray, travel: FloatArray, pending: FloatArray, ranges: FloatArray, hits: BoolArray, beams: FloatArray,
    clone: int,
) -> None:  # fmt: skip
    """Add the new hits (b,), which were taken from the pose of a clone."""
    travel[DRIVEN_AT], travel[TURNED_AT] = travel[DRIVEN], travel[TURNED]
    for beam in range(len(hits)):
        side = int(beams[beam, SIDE])
        if hits[beam] and side >= 0:
            reading = pending[side, counts[PENDING + side]]
            reading[CLONE], reading[BEAM] = clone, beam
            reading[RANGE], reading[DRIVEN_THEN] = ranges[beam], travel[DRIVEN]
            counts[PENDING + side] += 1
            counts[FRESH + side] += 1


@algebra
def has_ended(counts: IntArray, travel: FloatArray, side: int, gap: float) -> bool:
    """Whether a side has pending readings but no hit within the last ``gap`` (m): the wall there has ended."""
    return bool(counts[PENDING + side] > 0 and travel[DRIVEN] - travel[LAST_HIT + side] > gap)


@algebra
def readings_of(pending: FloatArray, clones: IntArray, beams: FloatArray, cone: float) -> tuple[IntArray, FloatArray]:
    """The pending readings of a side: the places of their clones (n,), and beams and ranges (n, 5)."""
    count = len(pending)
    places, readings = np.empty(count, dtype=np.int64), np.empty((count, 5))
    for i in range(count):
        beam, places[i] = int(pending[i, BEAM]), place_of(clones, pending[i, CLONE])
        readings[i, 0], readings[i, 1] = beams[beam, FROM_X], beams[beam, FROM_Y]
        readings[i, 2], readings[i, 3], readings[i, 4] = beams[beam, ANGLE], pending[i, RANGE], cone
    return places, readings


@algebra
def place_of(clones: IntArray, number: float) -> int:
    """Place of a clone among those in the state."""
    return int(np.searchsorted(clones, int(number)))
