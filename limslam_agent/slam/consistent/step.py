"""The step of the consistent estimator after its prediction: collect, extract, associate, update,
and close loops.

The functions are plain. The estimator of one team calls them as they are, and the batch compiles
them (``slam.batch.compiled_steps``). So they use numbers, arrays and named tuples only. What a
listener is told is left out of compiled code, where the listener is None.
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from limslam_agent.kernels.extents import Looks, add_wall, clear_along_beams, count_hits
from limslam_agent.kernels.lines import extract_lines
from limslam_agent.kernels.segments import cut_at_bends
from limslam_agent.kernels.tables import (
    ANGLE_STD,
    CLONES,
    EXTENT,
    GROUPS,
    LEAST,
    LINES,
    MIDDLE_X,
    MIDDLE_Y,
    MOST,
    NUMBER,
    OVERFLOWS,
    POSE,
    THETA,
    LineRules,
    select,
)
from limslam_agent.kernels.updates import compare_readings
from limslam_agent.slam.consistent import limits
from limslam_agent.slam.consistent.clone_filter import (
    add_line,
    clone,
    end_points,
    keep_clones,
    line_of,
    lines_near,
    num_lines,
    observe,
)
from limslam_agent.slam.consistent.merging import along_line, close_loops_of
from limslam_agent.slam.consistent.pending_readings import (
    AHEAD,
    CLONE,
    DRIVEN,
    DRIVEN_THEN,
    FRESH,
    SIDES,
    WAITING,
    Belief,
    Piece,
    Scan,
    Setup,
    collect,
    discard,
    has_ended,
    is_due,
    readings_of,
)
from limslam_agent.slam.consistent.step_settings import StepSettings
from limslam_env.geometry import FloatArray, IntArray

if TYPE_CHECKING:
    from limslam_agent.slam.consistent.reports import StepReports

_NUM_SIDES = len(SIDES)

NEW = -1
WAIT = -2
"""What :func:`associate` says of a piece of no known wall: it becomes a landmark, or waits for
further readings.
"""


def measure(
    belief: Belief, robot: int, scan: Scan, setup: Setup, listener: "StepReports | None"
) -> None:
    """Collect the new readings of a robot whose motion is predicted, and use each side that has
    enough of them. The listener is told of each decision.
    """
    pending = belief.pending
    if is_due(pending, robot, scan, setup):
        # A robot that stands sees nothing new: neither what beams end on nor what they pass.
        clear_passed(belief, robot, scan, setup)
        number = new_clone(belief, robot, scan, listener)
        collect(pending, robot, scan, setup.sides, number)
    for side in range(_NUM_SIDES):
        is_over = has_ended(pending, robot, side)
        fresh = pending.fill[robot * _NUM_SIDES + side, FRESH]
        if is_over or fresh >= setup.settings.batch:
            use_side(belief, robot, side, is_over, setup, listener)


def use_side(
    belief: Belief,
    robot: int,
    side: int,
    is_over: bool,
    setup: Setup,
    listener: "StepReports | None",
) -> None:
    """Extract straight pieces from the pending readings of a side of a robot, associate them with
    landmarks, update these, and close loops.

    Readings that are used or too old go; all of them, if ``is_over`` says that no more readings of
    the side's walls will come.
    """
    ekf = belief.ekf
    pending = belief.pending
    settings = setup.settings
    row = robot * _NUM_SIDES + side
    driven = pending.travel[robot, DRIVEN]
    pending.fill[row, FRESH] = 0
    waiting = pending.rows[row, : pending.fill[row, WAITING]]
    readings = readings_of(ekf, waiting, setup)
    points = end_points(ekf, readings, math.nan)
    owner, lines, ends = extract_lines(points, line_rules(settings, side))
    if listener is not None:
        listener.extracted(side, points, lines, ends)
    is_kept = np.ones(len(waiting), dtype=np.bool_)
    for index in range(len(lines)):
        members = np.flatnonzero(owner == index)
        own = select(readings, members)
        # The lines before this one have updated the filter, so the end points are computed anew.
        now = end_points(ekf, own, lines[index, 1])
        segments, segment_of, residuals = cut_at_bends(ekf, own, now, lines[index], settings.std)
        for number in range(len(segments)):
            part = np.flatnonzero(segment_of == number)
            these = members[part]
            since = driven - waiting[these, DRIVEN_THEN].max()
            is_complete = is_over or since > limits.COMPLETE_AFTER
            piece = Piece(select(own, part), now[part], segments[number], is_complete)
            if listener is not None:
                listener.considered(waiting[these], residuals[part])
            landmark = associate(belief, piece, settings, listener)
            if landmark == NEW:
                landmark = add_landmark(belief, piece)
            is_kept[these] = landmark == WAIT
            if landmark != WAIT:
                update(belief, piece, landmark, listener)
                close_loops_of(belief, landmark, settings, listener)
    if is_over:
        is_kept[:] = False
    discard(pending, row, is_kept & (waiting[:, DRIVEN_THEN] >= driven - settings.max_age))
    prune(belief, settings.max_clones)


def clear_passed(belief: Belief, robot: int, scan: Scan, setup: Setup) -> None:
    """Count the places of landmarks that a robot's new beams have passed through."""
    ekf = belief.ekf
    if ekf.counts[LINES]:
        clear_along_beams(
            belief.walls,
            ekf,
            POSE * robot,
            Looks(
                scan.ranges,
                scan.measured,
                setup.table,
                setup.settings.std,
                setup.settings.growth,
            ),
        )


def new_clone(belief: Belief, robot: int, scan: Scan, listener: "StepReports | None") -> int:
    """Clone a robot's pose, and return the clone's number. Where there is no room, the oldest clone
    goes.
    """
    ekf = belief.ekf
    if ekf.counts[CLONES] == len(ekf.clones):
        belief.walls.tally[OVERFLOWS] += 1
        prune(belief, len(ekf.clones) - 1)
    number = clone(ekf, robot, scan.jitter)
    if listener is not None:
        listener.cloned(robot)
    return number


def prune(belief: Belief, most: int) -> None:
    """Marginalise clones without pending readings, and the oldest clones if there are more than
    ``most``.
    """
    pending = belief.pending
    fill = pending.fill
    every = np.zeros(fill[:, WAITING].sum())
    size = 0
    for row in range(len(fill)):
        every[size : size + fill[row, WAITING]] = pending.rows[row, : fill[row, WAITING], CLONE]
        size += fill[row, WAITING]
    wanted = np.unique(every)
    if len(wanted) > most:
        wanted = wanted[len(wanted) - most :]
        for row in range(len(fill)):
            discard(pending, row, pending.rows[row, : fill[row, WAITING], CLONE] >= wanted[0])
    keep_clones(belief.ekf, wanted)


def line_rules(settings: StepSettings, side: int) -> LineRules:
    """Which lines are extracted from the readings of a side."""
    return LineRules(
        # Beams ahead meet a wall at points far apart, with nothing in between.
        limits.GAP_AHEAD if side == AHEAD else settings.segment_gap,
        settings.near_line,
        settings.segment_length,
        settings.min_votes,
        settings.r_step,
        settings.theta_step,
        settings.only_best,
    )


def associate(
    belief: Belief, piece: Piece, settings: StepSettings, listener: "StepReports | None"
) -> int:
    """The landmark that a piece of wall shows, by its index, ``NEW`` or ``WAIT``."""
    squared, landmarks = candidates(belief, piece)
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
        return int(landmarks[0])
    least = limits.LENGTH_IF_COMPLETE if piece.is_complete else settings.new_length
    return NEW if is_sure and best >= limits.FAR_GATE and segment[EXTENT] >= least else WAIT


def candidates(belief: Belief, piece: Piece) -> tuple[FloatArray, IntArray]:
    """Chi-squares (k,) and indices (k,) of the landmarks that a piece may show, best first."""
    ekf = belief.ekf
    segment = piece.segment
    near = lines_near(ekf, segment[THETA], segment[MIDDLE_X], segment[MIDDLE_Y], limits.MAX_OFFSET)
    squared = np.full(len(near), np.inf)
    for place, index in enumerate(near):
        along = along_line(ekf, index, piece.points)
        ends = belief.walls.ends[index]
        if max(along.min() - ends[MOST], ends[LEAST] - along.max()) <= limits.MAX_END_GAP:
            squared[place] = compare_readings(ekf, piece.readings, index)
    order = np.argsort(squared)[: np.count_nonzero(squared < np.inf)]
    return squared[order], near[order]


def add_landmark(belief: Belief, piece: Piece) -> int:
    """Add the line of a piece as a landmark; its index, or ``WAIT`` if there is no room."""
    ekf = belief.ekf
    walls = belief.walls
    if num_lines(ekf) == len(walls.table):
        walls.tally[OVERFLOWS] += 1
        return WAIT
    segment = piece.segment
    index = add_line(ekf, segment[THETA], segment[MIDDLE_X], segment[MIDDLE_Y])
    add_wall(walls, index)
    return index


def update(belief: Belief, piece: Piece, index: int, listener: "StepReports | None") -> None:
    """Update filter and map by a piece of a landmark."""
    ekf = belief.ekf
    walls = belief.walls
    observe(ekf, piece.readings, index, listener)
    points = end_points(ekf, piece.readings, line_of(ekf, index)[1])
    count_hits(walls, index, along_line(ekf, index, points))
    if listener is not None:
        listener.updated(walls.table[index, NUMBER], walls.table[index, GROUPS] == 1)
