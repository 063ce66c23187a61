"""Readings beside the ranges that the walls of a map predict, for many poses at once."""

import math

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.range_sensor import reading_of
from limslam_agent.kernels.tables import ANGLE, FARTHEST, FROM_X, FROM_Y, TOO_FAR, TOO_NEAR, TOWARDS_X, TOWARDS_Y
from limslam_env.geometry import BoolArray, FloatArray, IntArray

LEAST_COSINE = 0.2
"""A beam that meets a wall at a smaller cosine to its normal grazes the wall."""

_START_X, _START_Y, _TANGENT_X, _TANGENT_Y, _LENGTH = range(5)
WALL_COLUMNS = 5
"""Number of columns of a table of walls."""


Sensor = tuple[float, float, float, float]


@compiled
def fill_table(segments: FloatArray, table: FloatArray) -> None:
    """Set rows (k, 5) to walls (k, 4), m: start, m, unit vector along the wall, and length, m."""
    for wall in range(len(segments)):
        x, y = segments[wall, 2] - segments[wall, 0], segments[wall, 3] - segments[wall, 1]
        length = math.hypot(x, y)
        table[wall, _START_X], table[wall, _START_Y] = segments[wall, 0], segments[wall, 1]
        table[wall, _LENGTH] = length
        table[wall, _TANGENT_X], table[wall, _TANGENT_Y] = x / max(length, 1e-9), y / max(length, 1e-9)


@compiled
def beam_ray(pose: FloatArray, beams: FloatArray, beam: int) -> tuple[float, float, float, float]:
    """Origin, m, and direction of a beam in the world, from a pose (3,)."""
    cos, sin, heading = math.cos(pose[2]), math.sin(pose[2]), pose[2] + beams[beam, ANGLE]
    x = beams[beam, FROM_X] * cos - beams[beam, FROM_Y] * sin + pose[0]
    y = beams[beam, FROM_X] * sin + beams[beam, FROM_Y] * cos + pose[1]
    return x, y, math.cos(heading), math.sin(heading)


@compiled
def crossing(ray: tuple[float, float, float, float], walls: FloatArray, wall: int) -> tuple[float, float, float]:
    """Where a beam meets the line of a wall: how far along the beam, m, how far beyond the wall's ends, m, and cosine.

    The distance is negative if the beam meets the line behind it, or at a grazing angle. The position is negative
    between the ends. The cosine, without sign, is that of the angle between the beam and the wall's normal.
    """
    x, y, ux, uy = ray
    tx, ty = walls[wall, _TANGENT_X], walls[wall, _TANGENT_Y]
    cosine, away_x, away_y = uy * tx - ux * ty, x - walls[wall, _START_X], y - walls[wall, _START_Y]
    distance = -1.0
    if abs(cosine) > LEAST_COSINE:
        distance = (away_x * ty - away_y * tx) / cosine
    along = away_x * tx + away_y * ty + distance * (ux * tx + uy * ty)
    return distance, max(-along, along - walls[wall, _LENGTH]), abs(cosine)


@compiled
def first_wall(ray: tuple[float, float, float, float], walls: FloatArray, inset: float) -> tuple[float, float, int]:
    """Distance, m, to the first wall that a beam meets at least ``inset`` inside its ends, the cosine there, and which.

    The distance is infinite if there is no such wall, and the number of the wall is then 0.
    """
    nearest, steepness, first = math.inf, 1.0, 0
    for wall in range(len(walls)):
        distance, beyond, cosine = crossing(ray, walls, wall)
        if 0.0 < distance < nearest and beyond < -inset:
            nearest, steepness, first = distance, cosine, wall
    return nearest, steepness, first


@lean_entry
def predict_ranges(
    poses: FloatArray, covariance: FloatArray, segments: FloatArray, beams: FloatArray, sensor: Sensor, inset: float,
    least_cosine: float, walls: FloatArray, ranges: FloatArray, stds: FloatArray, first: IntArray,
) -> None:  # fmt: skip
    """Find the ranges that walls predict.

    Parameters
    ----------
    poses, covariance
        Poses (m, 3), m and rad, and the covariance of each of them (3, 3).
    segments, beams
        Walls (k, 4), m, and ``RobotSpec.beam_table``.
    sensor
        ``RangeSensor.numbers``.
    inset
        Distance from a wall's ends up to which no beam should end there, m.
    least_cosine
        A beam that meets the wall at a smaller cosine nearly grazes it. Its range is infinite, as that of a beam that
        meets no wall.
    walls
        Scratch (k, 5).
    ranges, stds
        Set to the ranges (m, b), and to their standard deviations (m, b), m.
    first
        Set to the numbers (m, b) of the walls that the beams meet first; 0 where there is none.
    """
    fill_table(segments, walls)
    for i in range(len(poses)):
        for beam in range(len(beams)):
            distance, cosine, first[i, beam] = first_wall(beam_ray(poses[i], beams, beam), walls, inset)
            is_met = cosine > least_cosine and distance < beams[beam, FARTHEST]
            lever = distance if is_met else 0.0
            reading, noise = reading_of(sensor, lever, cosine)
            variance = noise + covariance[0, 0] + covariance[1, 1] + covariance[2, 2] * lever**2
            ranges[i, beam] = reading if is_met else math.inf
            stds[i, beam] = math.sqrt(variance) / max(cosine, LEAST_COSINE)


@compiled
def is_all_free(values: NDArray[np.int16], row: int, column: int, reach: int, least: int) -> bool:
    """Whether a cell and those up to ``reach`` cells away are in the grid and have at least the value ``least``."""
    rows, columns = values.shape
    if not (reach <= row < rows - reach and reach <= column < columns - reach):
        return False
    for down in range(row - reach, row + reach + 1):
        for right in range(column - reach, column + reach + 1):
            if values[down, right] < least:
                return False
    return True


@compiled
def is_near_wall(x: float, y: float, segments: FloatArray, near: float) -> bool:
    """Whether a point, m, is at most ``near`` (m) from one of the walls (k, 4), m."""
    for wall in range(len(segments)):
        span_x, span_y = segments[wall, 2] - segments[wall, 0], segments[wall, 3] - segments[wall, 1]
        away_x, away_y = x - segments[wall, 0], y - segments[wall, 1]
        along = (away_x * span_x + away_y * span_y) / max(span_x * span_x + span_y * span_y, 1e-300)
        along = min(max(along, 0.0), 1.0)
        off_x, off_y = away_x - along * span_x, away_y - along * span_y
        if math.sqrt(off_x * off_x + off_y * off_y) <= near:
            return True
    return False


EXPECTED, FITS, THROUGH, ENDED, IN_FREE = range(5)
"""Rows of a comparison of readings with a map."""


@lean_entry
def compare_readings(
    pose: FloatArray, ranges: FloatArray, usable: BoolArray, predicted: FloatArray, stds: FloatArray,
    beams: FloatArray, sensor: Sensor, sigmas: float, slack: float, segments: FloatArray, values: NDArray[np.int16],
    low: FloatArray, cell: float, reach: int, least: int, found: BoolArray,
) -> None:  # fmt: skip
    """Compare the readings of one step with a map.

    Parameters
    ----------
    pose, ranges, usable
        Pose (3,), m and rad, readings (b,), m, and those that count (b,).
    predicted, stds
        Ranges (b,), m, and standard deviations (b,), m, that :func:`predict_ranges` finds.
    beams, sensor
        ``RobotSpec.beam_table``, and ``RangeSensor.numbers``.
    sigmas, slack
        A reading fits within so many standard deviations and this distance, m.
    segments
        The walls (k, 4), m.
    values, low, cell
        The grid (rows, columns), its lower left corner (2,), m, and the side of a cell, m.
    reach, least
        A reading ends in free space if all cells up to ``reach`` cells away have at least the value ``least``.
    found
        Set to the fields of ``contradictions.Comparison`` (5, b), in the order of ``EXPECTED`` and those after it.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for beam in range(len(ranges)):
        reading = ranges[beam]
        counts = usable[beam] and reading > beams[beam, TOO_NEAR]
        is_expected, has_ended = counts and predicted[beam] < math.inf, counts and reading < beams[beam, TOO_FAR]
        excess, tolerance = 0.0, math.inf
        if is_expected:
            excess = min(reading, beams[beam, FARTHEST]) - predicted[beam]
            tolerance = sigmas * stds[beam] + slack
        found[EXPECTED, beam], found[ENDED, beam] = is_expected, has_ended
        found[FITS, beam] = is_expected and abs(excess) <= tolerance
        found[THROUGH, beam] = is_expected and excess > tolerance
        found[IN_FREE, beam] = False
        if has_ended:
            reached = reading - sensor[3]
            ahead = beams[beam, FROM_X] + reached * beams[beam, TOWARDS_X]
            left = beams[beam, FROM_Y] + reached * beams[beam, TOWARDS_Y]
            x, y = ahead * cos - left * sin + pose[0], ahead * sin + left * cos + pose[1]
            row, column = math.floor((y - low[1]) / cell), math.floor((x - low[0]) / cell)
            # The nearest point inside a wide beam may be anywhere between its borders.
            std = math.sqrt(sensor[0] ** 2 + (sensor[1] * reached**2) ** 2)
            near = sigmas * std + slack + sensor[2] * reached
            is_free = is_all_free(values, int(row), int(column), reach, least)
            found[IN_FREE, beam] = is_free and not is_near_wall(x, y, segments, near)
