"""The decisions of a step: which wall the pending readings show, which landmarks are new, and which
are one wall.

The functions are plain. The estimator of one team calls them as they are, with a ``CloneEKF``; the
batch compiles the same functions with its own filter (``slam.batch.compiled_steps``). So they use
numbers, arrays and named tuples only. What a listener is told is left out of compiled code, where
the listener is None.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from limslam_agent.kernels.extents import add_wall, count_hits
from limslam_agent.kernels.lines import extract_lines
from limslam_agent.kernels.tables import (
    ANGLE_STD,
    EXTENT,
    GROUPS,
    MIDDLE_X,
    MIDDLE_Y,
    NUMBER,
    OVERFLOWS,
    THETA,
    Filter,
    Walls,
)
from limslam_agent.slam.consistent import limits
from limslam_agent.slam.consistent.clone_filter import (
    add_line,
    compare,
    end_points,
    keep_clones,
    line_of,
    lines_near,
    num_lines,
    observe,
    straight_segments,
)
from limslam_agent.slam.consistent.merging import along_line, close_loops_of
from limslam_agent.slam.consistent.pending_readings import (
    AHEAD,
    CLONE,
    DRIVEN_THEN,
    FRESH,
    SIDES,
    WAITING,
    readings_of,
)
from limslam_agent.slam.consistent.step_settings import StepSettings
from limslam_env.geometry import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from limslam_agent.slam.consistent.reports import StepReports

_NUM_SIDES = len(SIDES)


class Piece(NamedTuple):
    """Readings of one straight piece of wall.

    Attributes
    ----------
    places, readings, variances
        As of ``pending_readings.readings_of``.
    points
        Their end points (n, 2), m, where the clones are estimated to be.
    segment
        The fitted piece (7,), whose columns ``kernels.segments`` names.
    """

    places: IntArray
    readings: FloatArray
    variances: FloatArray
    points: FloatArray
    segment: FloatArray


def process(
    ekf: Filter,
    walls: Walls,
    pending: FloatArray,
    fill: IntArray,
    row: int,
    driven: float,
    settings: StepSettings,
    beams: FloatArray,
    is_over: bool,
    listener: "StepReports | None",
) -> None:
    """Find straight pieces in the pending readings of a side, use them, and drop what is consumed
    or too old.

    ``row`` is the side, of those of all robots, of a robot that has ``driven`` so far, m. ``beams``
    is ``RobotSpec.beam_table``, and ``is_over`` says that no more readings of the side's walls will
    come. The listener is told of each decision.
    """
    count = int(fill[row, WAITING])
    fill[row, FRESH] = 0
    waiting = pending[row, :count]
    places, readings, variances = readings_of(ekf, waiting, beams, settings)
    points = end_points(ekf, places, readings, math.nan)
    # Beams ahead meet a wall at points far apart, with nothing in between.
    max_gap = limits.GAP_AHEAD if row % _NUM_SIDES == AHEAD else settings.segment_gap
    owner, lines, ends = extract_lines(
        points,
        max_gap,
        settings.min_votes,
        settings.r_step,
        settings.theta_step,
        settings.near_line,
        settings.segment_length,
        settings.only_best,
    )
    if listener is not None:
        listener.extracted(row, points, lines, ends)
    is_kept = np.ones(count, dtype=np.bool_)
    for index in range(len(lines)):
        members = np.flatnonzero(owner == index)
        # The lines before this one have updated the filter, so the end points are computed anew.
        now = end_points(ekf, places, readings, lines[index, 1])
        segments, segment_of, residuals = straight_segments(
            ekf, places, readings, now, members, lines[index], settings.std, variances
        )
        for number in range(len(segments)):
            own = segment_of == number
            these = members[own]
            if listener is not None:
                listener.considered(waiting[these], residuals[own])
            is_complete = (
                is_over or driven - waiting[these, DRIVEN_THEN].max() > limits.COMPLETE_AFTER
            )
            piece = Piece(
                places[these], readings[these], variances[these], now[these], segments[number]
            )
            is_kept[these] = not is_used(ekf, walls, piece, settings, is_complete, listener)
    if is_over:
        is_kept[:] = False
    discard(pending, fill, row, is_kept & (waiting[:, DRIVEN_THEN] >= driven - settings.max_age))
    prune(ekf, pending, fill, settings.max_clones)


def discard(pending: FloatArray, fill: IntArray, row: int, is_kept: BoolArray) -> None:
    """Keep only some of the pending readings (n,) of a side."""
    kept = pending[row][np.flatnonzero(is_kept)]
    pending[row, : len(kept)], fill[row, WAITING] = kept, len(kept)


def prune(ekf: Filter, pending: FloatArray, fill: IntArray, most: int) -> None:
    """Marginalise clones without pending readings, and the oldest clones if there are more than
    ``most``.
    """
    every = np.zeros(fill[:, WAITING].sum())
    size = 0
    for row in range(len(fill)):
        every[size : size + fill[row, WAITING]] = pending[row, : fill[row, WAITING], CLONE]
        size += fill[row, WAITING]
    wanted = np.unique(every)
    if len(wanted) > most:
        wanted = wanted[len(wanted) - most :]
        for row in range(len(fill)):
            discard(pending, fill, row, pending[row, : fill[row, WAITING], CLONE] >= wanted[0])
    keep_clones(ekf, wanted)


def is_used(
    ekf: Filter,
    walls: Walls,
    piece: Piece,
    settings: StepSettings,
    is_complete: bool,
    listener: "StepReports | None",
) -> bool:
    """Associate a piece of wall with a known landmark, or add a new one; whether it was used."""
    squared, landmarks = candidates(ekf, walls, piece)
    best = squared[0] if len(squared) else np.inf
    second_best = squared[1] if len(squared) > 1 else np.inf
    segment = piece.segment
    is_enough = len(piece.points) >= settings.new_readings * settings.usual_std
    is_sure = is_enough and segment[ANGLE_STD] <= limits.MAX_ANGLE_STD
    # A filter that is more wrong than it states refuses the right walls, unless nothing else can be
    # meant.
    gate = limits.FAR_GATE if is_sure and second_best >= limits.FAR_GATE else settings.gate
    if listener is not None:
        listener.compared(piece, squared, landmarks, gate)
    if best <= gate:
        update(ekf, walls, piece, int(landmarks[0]), settings, listener)
        return True
    least = limits.LENGTH_IF_COMPLETE if is_complete else settings.new_length
    if best < limits.FAR_GATE or segment[EXTENT] < least or not is_sure:
        return False
    if num_lines(ekf) == len(walls.table):
        walls.tally[OVERFLOWS] += 1
        return False
    index = add_line(ekf, segment[THETA], segment[MIDDLE_X], segment[MIDDLE_Y])
    add_wall(walls, index)
    update(ekf, walls, piece, index, settings, listener)
    return True


def candidates(ekf: Filter, walls: Walls, piece: Piece) -> tuple[FloatArray, IntArray]:
    """Chi-squares (k,) and indices (k,) of the landmarks that a piece may show, best first."""
    segment = piece.segment
    near = lines_near(ekf, segment[THETA], segment[MIDDLE_X], segment[MIDDLE_Y], limits.MAX_OFFSET)
    squared = np.full(len(near), np.inf)
    for place, index in enumerate(near):
        along = along_line(ekf, index, piece.points)
        if (
            max(along.min() - walls.ends[index, 1], walls.ends[index, 0] - along.max())
            <= limits.MAX_END_GAP
        ):
            squared[place] = compare(ekf, piece.places, piece.readings, index, piece.variances)
    order = np.argsort(squared)[: np.count_nonzero(squared < np.inf)]
    return squared[order], near[order]


def update(
    ekf: Filter,
    walls: Walls,
    piece: Piece,
    index: int,
    settings: StepSettings,
    listener: "StepReports | None",
) -> None:
    """Update filter and map by a piece of a landmark, and merge the landmark with others that are
    the same wall.
    """
    observe(
        ekf, piece.places, piece.readings, index, piece.variances, limits.ITERATIONS, limits.HUBER
    )
    points = end_points(ekf, piece.places, piece.readings, line_of(ekf, index)[1])
    count_hits(walls, index, along_line(ekf, index, points))
    if listener is not None:
        listener.updated(walls.table[index, NUMBER], walls.table[index, GROUPS] == 1)
    close_loops_of(ekf, walls, index, settings, listener)
