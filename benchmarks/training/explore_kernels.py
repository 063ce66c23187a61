"""The inner loops of training, compiled by numba: grids, collision guards and polar views of many robots at once.

Each function does what a part of ``limslam_agent`` does for one robot, and tests compare the results: ``mark_grid``
with `OccupancyGrid.update`, ``note_touch`` and ``soften`` with `CollisionGuard`, ``look`` with `polar_view.observe`.
Grids are squares with the robot's start in the middle, so that they need not grow.
"""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.cells import SKIPPED, change_cells, touched_cells
from limslam_agent.kernels.tables import FROM_X, FROM_Y, TOO_FAR, TOO_NEAR, TOWARDS_X, TOWARDS_Y
from limslam_agent.policies.collision_guard import GHOST, LOOK_AHEAD, MARGIN, MEMORY, SHARES, TOUCH, TOUCHING
from limslam_agent.policies.learned.look_ahead import count_ahead
from limslam_agent.policies.learned.polar_view import (
    AHEAD,
    FAR,
    FREE_COST,
    LARGE_UNKNOWN,
    LEAST_UNKNOWN,
    SMALL_COST,
    TIGHT_COST,
)
from limslam_env.compilation import entry_of
from limslam_env.geometry import BoolArray, FloatArray, IntArray, ReadingArray

compiled = entry_of(
    "benchmarks.training.explore_kernels",
    "limslam_agent.policies",
    "limslam_agent.policies.learned",
    "limslam_agent.kernels",
)

_STOPPING_SHARES = (*SHARES.tolist(), 0.0)
_FAR_AWAY = 1 << 30


@compiled
def mark_grid(
    values: NDArray[np.int8],
    corner: IntArray,
    box: IntArray,
    stamps: NDArray[np.int32],
    stamp: int,
    pose: FloatArray,
    ranges: ReadingArray,
    measured: BoolArray,
    beams: FloatArray,
    radius: float,
    rules: FloatArray,
) -> None:
    """Update one robot's grid with its readings (n_beams,), m.

    Parameters
    ----------
    values
        Cells (side, side), changed: positive is free, negative is occupied, 0 is unknown.
    corner
        Column and row of the lower left cell, counted from the world's origin.
    box
        First row, row after the last, first column, and column after the last of the known cells; changed.
    stamps, stamp
        Working array (side, side), and a number that the array does not contain yet.
    pose
        Pose (3,) at which the readings were taken, m and rad.
    measured
        Mask (n_beams,) of the readings that are used.
    beams
        Origin x, y (m), direction x, y, and least and largest measurable range (m) of each beam (n_beams, 6).
    radius
        Radius of the body, m.
    rules
        Side of a cell (m), increment of a crossed cell, decrement of the cell at the end of a beam, and the limit.
    """
    side = len(values)
    cells = touched_cells(pose, ranges, measured, beams, radius, rules[0])
    for i in range(len(cells)):
        row, column = cells[i, 0] - corner[1], cells[i, 1] - corner[0]
        if 0 <= row < side and 0 <= column < side:
            cells[i, 0], cells[i, 1] = row, column
            box[0], box[1] = min(box[0], row), max(box[1], row + 1)
            box[2], box[3] = min(box[2], column), max(box[3], column + 1)
        else:
            cells[i, 0], cells[i, 1], cells[i, 2] = 0, 0, SKIPPED
    change_cells(values, cells, stamps, stamp, int(rules[1]), int(rules[2]), int(rules[3]))


@compiled
def note_touch(
    points: FloatArray, ages: IntArray, slot: int, pose: FloatArray, ranges: ReadingArray, beams: FloatArray
) -> None:
    """Store the end points of the beams.

    Parameters
    ----------
    points, ages
        End points (MEMORY, n_beams, 2), m, and the step (MEMORY, n_beams) after which each point is forgotten. Row
        ``slot`` modulo MEMORY is overwritten.
    slot
        Number of this step.
    pose, ranges, beams
        As for :func:`mark_grid`.
    """
    place = slot % MEMORY
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for beam in range(len(beams)):
        reading = float(ranges[beam])
        ages[place, beam] = -1
        if reading <= beams[beam, TOO_NEAR]:
            reading = TOUCHING * beams[beam, TOO_NEAR]
            ages[place, beam] = slot + TOUCH
        elif reading < beams[beam, TOO_FAR]:
            ages[place, beam] = slot + MEMORY
        x = beams[beam, FROM_X] + reading * beams[beam, TOWARDS_X]
        y = beams[beam, FROM_Y] + reading * beams[beam, TOWARDS_Y]
        points[place, beam, 0] = pose[0] + cos * x - sin * y
        points[place, beam, 1] = pose[1] + sin * x + cos * y


@compiled
def soften(
    points: FloatArray,
    ages: IntArray,
    slot: int,
    pose: FloatArray,
    speed: float,
    turn: float,
    radius: float,
) -> float:
    """The largest safe speed (m/s) when ``speed`` and ``turn`` (rad/s) are requested."""
    heading = pose[2] + 0.5 * turn * LOOK_AHEAD
    way_x, way_y = speed * LOOK_AHEAD * math.cos(heading), speed * LOOK_AHEAD * math.sin(heading)
    for share in _STOPPING_SHARES:
        is_clear = True
        for place in range(len(points)):
            for beam in range(points.shape[1]):
                if ages[place, beam] <= slot:
                    continue
                x, y = points[place, beam, 0] - pose[0], points[place, beam, 1] - pose[1]
                before = math.hypot(x, y)
                if before <= radius - GHOST:
                    continue
                if math.hypot(x - share * way_x, y - share * way_y) < min(before, radius + MARGIN):
                    is_clear = False
                    break
            if not is_clear:
                break
        if is_clear:
            return float(share * speed)
    return 0.0


@compiled
def frontier_steps(
    values: NDArray[np.int8],
    box: IntArray,
    steps: NDArray[np.int32],
    tolls: NDArray[np.int32],
    queue: NDArray[np.int32],
) -> int:
    """Fill ``steps`` (side, side) within the box with the path cost to the nearest frontier; return the frontier count.

    The unit is half a cell, as in `polar_view.frontier_distance`. Cells without a path have a very large cost.
    ``tolls`` (side, side) and ``queue`` (more than side * side,) are working arrays.
    """
    side = len(values)
    head, tail, size = 0, 0, len(queue)
    for row in range(box[0], box[1]):
        for column in range(box[2], box[3]):
            steps[row, column], tolls[row, column] = _FAR_AWAY, 0
            if values[row, column] <= 0:
                continue
            is_tight = False
            for down in range(-1, 2):
                for right in range(-1, 2):
                    r, c = row + down, column + right
                    if 0 <= r < side and 0 <= c < side and values[r, c] < 0:
                        is_tight = True
            tolls[row, column] = TIGHT_COST if is_tight else FREE_COST
            if is_tight or not _is_frontier(values, row, column):
                continue
            steps[row, column] = SMALL_COST * max(LARGE_UNKNOWN - _unknown_around(values, row, column, 4), 0)
            queue[tail] = row * side + column
            tail += 1
    sources = tail
    # Labels are corrected until nothing changes. With three prices, this is as fast as a heap.
    while head != tail:
        cell = queue[head]
        head = (head + 1) % size
        row, column = cell // side, cell % side
        here, toll = steps[row, column], tolls[row, column]
        for way in range(4):
            r, c = row + (way == 0) - (way == 1), column + (way == 2) - (way == 3)
            if not (box[0] <= r < box[1] and box[2] <= c < box[3]) or tolls[r, c] == 0:
                continue
            price = here + toll + tolls[r, c]
            if price < steps[r, c]:
                steps[r, c] = price
                queue[tail] = r * side + c
                tail = (tail + 1) % size
    return sources


@compiled
def _is_frontier(values: NDArray[np.int8], row: int, column: int) -> bool:
    side = len(values)
    is_beside = False
    for way in range(4):
        r, c = row + (way == 0) - (way == 1), column + (way == 2) - (way == 3)
        if not (0 <= r < side and 0 <= c < side) or values[r, c] == 0:
            is_beside = True
    if not is_beside:
        return False
    return _unknown_around(values, row, column, 2) >= LEAST_UNKNOWN


@compiled
def _unknown_around(values: NDArray[np.int8], row: int, column: int, reach: int) -> int:
    """Number of unknown cells in the square of ``reach`` cells to all sides of a cell."""
    side, unknown = len(values), 0
    for r in range(row - reach, row + reach + 1):
        for c in range(column - reach, column + reach + 1):
            if not (0 <= r < side and 0 <= c < side) or values[r, c] == 0:
                unknown += 1
    return unknown


@compiled
def look(
    values: NDArray[np.int8],
    corner: IntArray,
    box: IntArray,
    steps: NDArray[np.int32],
    pose: FloatArray,
    samples: FloatArray,
    radii: FloatArray,
    cell: float,
    view: NDArray[np.float32],
) -> None:
    """Fill ``view`` with the polar view (3 * rings * directions,), followed by the way to a frontier (2,).

    ``samples`` (rings * directions * 6, 2), m, are in the robot's frame. ``radii`` (rings,) are the radii of the rings,
    m. ``steps`` is the result of :func:`frontier_steps`.
    """
    rings = len(radii)
    directions = len(samples) // (6 * rings)
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    half = 0.5 * cell
    row, column = math.floor(pose[1] / cell) - corner[1], math.floor(pose[0] / cell) - corner[0]
    here = _FAR_AWAY
    if box[0] <= row < box[1] and box[2] <= column < box[3]:
        here = steps[row, column]
    if here == _FAR_AWAY:
        for r in range(max(row - 1, box[0]), min(row + 2, box[1])):
            for c in range(max(column - 1, box[2]), min(column + 2, box[3])):
                here = min(here, steps[r, c])
    size = rings * directions
    for polar in range(size):
        unknown, occupied, best = 0, 0, _FAR_AWAY
        for number in range(6 * polar, 6 * polar + 6):
            x, y = samples[number, 0], samples[number, 1]
            c = math.floor((pose[0] + cos * x - sin * y) / cell) - corner[0]
            r = math.floor((pose[1] + sin * x + cos * y) / cell) - corner[1]
            if not (box[0] <= r < box[1] and box[2] <= c < box[3]) or values[r, c] == 0:
                unknown += 1
                continue
            occupied += values[r, c] < 0
            best = min(best, steps[r, c])
        gain = -1.0
        if here < _FAR_AWAY and best < _FAR_AWAY:
            gain = min(max((here - best) * half / radii[polar // directions], -1.0), 1.0)
        view[polar], view[size + polar], view[2 * size + polar] = unknown / 6.0, occupied / 6.0, gain
    has_way = here < _FAR_AWAY
    view[-2] = min(here * half / FAR, 1.0) if has_way else 1.0
    view[-1] = 1.0 if has_way else 0.0


@compiled
def take_in(
    which: BoolArray,
    poses: FloatArray,
    ranges: ReadingArray,
    values: NDArray[np.int8],
    corners: IntArray,
    boxes: IntArray,
    stamps: NDArray[np.int32],
    stamp: int,
    points: FloatArray,
    ages: IntArray,
    slots: IntArray,
    beams: FloatArray,
    radius: float,
    rules: FloatArray,
) -> None:
    """Add a step's readings (n, n_beams) at poses (n, 3) to grids and collision guards of the robots ``which`` (n,).

    ``stamps`` (side, side) is a working array of all robots: robot i uses ``stamp + i``.
    """
    measured = np.ones(ranges.shape[1], dtype=np.bool_)
    for robot in range(len(poses)):
        if which[robot]:
            slots[robot] += 1
            mark_grid(
                values[robot], corners[robot], boxes[robot], stamps, stamp + robot, poses[robot], ranges[robot],
                measured, beams, radius, rules,
            )  # fmt: skip
            note_touch(points[robot], ages[robot], slots[robot], poses[robot], ranges[robot], beams)


@compiled
def steer(
    headings: FloatArray,
    poses: FloatArray,
    points: FloatArray,
    ages: IntArray,
    slots: IntArray,
    drive: FloatArray,
    wheels: NDArray[np.float32],
) -> None:
    """Fill ``wheels`` (n, 2), shares of the maximum speed, of robots at poses (n, 3) that drive towards ``headings``.

    ``headings`` (n,) are in rad. ``drive`` contains the gain of the turn (1/s), the fastest turn (rad/s), the top wheel
    speed (m/s), the axle (m) and the radius (m).
    """
    top, axle = drive[2], drive[3]
    for robot in range(len(poses)):
        error = headings[robot] - poses[robot, 2]
        error -= 2.0 * math.pi * math.floor(error / (2.0 * math.pi) + 0.5)
        turn = min(max(drive[0] * error, -drive[1]), drive[1])
        across = min(max(0.5 * turn * axle, -top), top)
        speed = min(top * max(math.cos(error), 0.0), top - abs(across))
        speed = soften(points[robot], ages[robot], slots[robot], poses[robot], speed, 2.0 * across / axle, drive[4])
        wheels[robot, 0], wheels[robot, 1] = (speed - across) / top, (speed + across) / top


@compiled
def look_round(
    which: BoolArray,
    poses: FloatArray,
    ranges: ReadingArray,
    values: NDArray[np.int8],
    corners: IntArray,
    boxes: IntArray,
    steps: NDArray[np.int32],
    tolls: NDArray[np.int32],
    queue: NDArray[np.int32],
    samples: FloatArray,
    radii: FloatArray,
    cell: float,
    beams: FloatArray,
    radius: float,
    max_ranges: FloatArray,
    views: NDArray[np.float32],
) -> None:
    """Fill ``views`` (n, size) of the robots ``which`` (n,), with the layout of `polar_view.observe`."""
    cells = len(samples) // 6
    directions = cells // len(radii)
    first = 3 * cells + AHEAD * directions
    for robot in range(len(poses)):
        if which[robot]:
            frontier_steps(values[robot], boxes[robot], steps, tolls, queue)
            look(
                values[robot], corners[robot], boxes[robot], steps, poses[robot], samples, radii, cell, views[robot]
            )  # fmt: skip
            count_ahead(
                values[robot], corners[robot], poses[robot], beams, radius, cell, directions,
                views[robot][3 * cells : first],
            )  # fmt: skip
            for beam in range(len(max_ranges)):
                views[robot, first + beam] = min(max(ranges[robot, beam] / max_ranges[beam], 0.0), 1.0)
