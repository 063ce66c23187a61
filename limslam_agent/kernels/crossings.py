"""Readings beside the ranges that the walls of a map predict, for many poses at once."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from limslam_agent.kernels.algebra import wrapped
from limslam_agent.kernels.compilation import compiled, lean_entry
from limslam_agent.kernels.measurement import reading_of
from limslam_agent.kernels.tables import ANGLE, FARTHEST, FROM_X, FROM_Y, TOO_FAR, TOO_NEAR, TOWARDS_X, TOWARDS_Y
from limslam_env.geometry import BoolArray, FloatArray, IntArray

LEAST_COSINE = 0.2
"""A beam that meets a wall at a smaller cosine to its normal grazes the wall."""

_START_X, _START_Y, _TANGENT_X, _TANGENT_Y, _LENGTH = range(5)
WALL_COLUMNS = 5
"""Number of columns of a table of walls."""


Sensor = tuple[float, float, float, float]


class Predicted(NamedTuple):
    """The readings of n steps and b beams (n, b), and what the map predicts for their poses.

    Attributes
    ----------
    ranges, usable, ended
        Readings, m, those that count, and those that ended at anything.
    predicted, known, stds
        Distance to the wall at which the beam should end, m, whether there is such a wall, and the standard deviation
        of the difference, m.
    misfit
        Squared residual of the reading against the present pose, in variances, at most the clip. It is 0 if nothing can
        be said.
    """

    ranges: FloatArray
    usable: BoolArray
    ended: BoolArray
    predicted: FloatArray
    known: BoolArray
    stds: FloatArray
    misfit: FloatArray

    @classmethod
    def of(cls, ranges: FloatArray, usable: BoolArray) -> "Predicted":
        """The readings, with room for what a map predicts."""
        shape = ranges.shape
        return cls(
            ranges, usable, np.empty(shape, dtype=np.bool_), np.empty(shape), np.empty(shape, dtype=np.bool_),
            np.empty(shape), np.empty(shape),
        )  # fmt: skip


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


@lean_entry
def compare_steps(
    poses: FloatArray, variances: FloatArray, segments: FloatArray, beams: FloatArray, sensor: Sensor,
    rules: FloatArray, walls: FloatArray, seen: Predicted,
) -> None:  # fmt: skip
    """Compare the readings of some steps with a map.

    Parameters
    ----------
    poses, variances
        Poses (n, 3), m and rad, and the variances of position and heading (n, 2).
    segments, beams, sensor, walls
        As of :func:`predict_ranges`.
    rules
        Inset and least cosine of :func:`predict_ranges`; number of standard deviations within which a reading fits;
        clip, the largest squared residual that counts; and how far walls may go on beyond their known ends, m; (5,).
    seen
        The readings, of which all that the map predicts is set.
    """
    inset, least_cosine, sigmas, clip, beyond_end = rules[0], rules[1], rules[2], rules[3], rules[4]
    ranges, ended, predicted, known, stds, misfit = (
        seen.ranges, seen.ended, seen.predicted, seen.known, seen.stds, seen.misfit
    )  # fmt: skip
    fill_table(segments, walls)
    for i in range(ranges.shape[0]):
        for beam in range(ranges.shape[1]):
            predicted[i, beam], stds[i, beam], misfit[i, beam] = 0.0, 1.0, 0.0
            ray, reading = beam_ray(poses[i], beams, beam), ranges[i, beam]
            distance, cosine, _ = first_wall(ray, walls, inset)
            is_wall, is_steep = distance < beams[beam, FARTHEST], cosine > least_cosine
            ended[i, beam], known[i, beam] = reading < beams[beam, TOO_FAR], is_wall and is_steep
            expected = distance
            if known[i, beam]:
                expected, noise = reading_of(sensor, distance, cosine)
                predicted[i, beam] = expected
                stds[i, beam] = math.sqrt(noise + variances[i, 0] + variances[i, 1] * distance**2) / cosine
            if not ended[i, beam]:
                is_short = reading - expected < sigmas * stds[i, beam]
                misfit[i, beam] = clip if known[i, beam] and not is_short else 0.0
                continue
            if is_wall and not is_steep:
                continue
            misfit[i, beam] = clip
            for wall in range(len(walls)):
                distance, beyond, cosine = crossing(ray, walls, wall)
                if distance > 0.0 and beyond < beyond_end:
                    expected, noise = reading_of(sensor, distance, cosine)
                    variance = noise + variances[i, 0] + variances[i, 1] * distance**2
                    residual = (reading - expected) * max(cosine, LEAST_COSINE)
                    misfit[i, beam] = min(misfit[i, beam], residual**2 / variance)


@lean_entry
def last_correction(poses: FloatArray, increments: FloatArray, most: float, most_turn: float) -> int:
    """The last of the poses (n, 3) that was corrected by much beyond its reported increment (n, 3); 0 if none was.

    ``most``, m, and ``most_turn``, rad, are the largest corrections that count as small.
    """
    for i in range(len(poses) - 1, 0, -1):
        cos, sin = math.cos(poses[i - 1, 2]), math.sin(poses[i - 1, 2])
        x = poses[i, 0] - (poses[i - 1, 0] + cos * increments[i, 0] - sin * increments[i, 1])
        y = poses[i, 1] - (poses[i - 1, 1] + sin * increments[i, 0] + cos * increments[i, 1])
        turn = wrapped(poses[i, 2] - wrapped(poses[i - 1, 2] + increments[i, 2]))
        if math.hypot(x, y) > most or abs(turn) > most_turn:
            return i
    return 0


@compiled
def gain(seen: Predicted, step: int, beam: int, lag: int, sigmas: float, clip: float) -> float:
    """By how much a reading fits the prediction of ``lag`` steps before better than the present one, in variances."""
    then = step - lag
    if not seen.usable[step, beam]:
        return 0.0
    misfit, ended = float(seen.misfit[step, beam]), seen.ended[step, beam]
    if not seen.known[then, beam]:
        # A reading where the earlier beam should have met no known wall only counts if the present prediction fits.
        return misfit if not ended else misfit - clip if seen.known[step, beam] and misfit < clip else 0.0
    excess, std = seen.ranges[step, beam] - seen.predicted[then, beam], seen.stds[then, beam]
    if ended:
        return misfit - float(min((excess / std) ** 2, clip))
    return misfit if excess < sigmas * std else misfit - clip


@lean_entry
def sum_gains(seen: Predicted, beam: int, lag: int, last: int, sigmas: float, clip: float) -> float:
    """The sum of the gains of the ``last`` readings of a beam, or of all of them if there are fewer."""
    total = 0.0
    for step in range(max(len(seen.ranges) - last, lag), len(seen.ranges)):
        total += gain(seen, step, beam, lag, sigmas, clip)
    return total


@lean_entry
def evidence_of_delays(
    seen: Predicted, lags: IntArray, sigmas: float, clip: float, both_signs: float, evidence: FloatArray
) -> None:  # fmt: skip
    """Find the evidence (k, b) that each beam has been late by each of k lags since some moment.

    It is Page's cumulative sum of the gains. It counts at most ``both_signs`` times as much as its smaller part, by
    readings that are too long, or too short.
    """
    count, beams = seen.ranges.shape
    for row in range(len(lags)):
        lag = lags[row]
        for beam in range(beams):
            total = least = long = short = 0.0
            for step in range(lag, count):
                gained = gain(seen, step, beam, lag, sigmas, clip)
                is_long = seen.known[step, beam] and seen.ranges[step, beam] > seen.predicted[step, beam]
                long, short = long + (gained if is_long else 0.0), short + (0.0 if is_long else gained)
                total += gained
                if total < least:
                    # The sum has not been smaller, so the beam may be late from the next step on.
                    least, long, short = total, 0.0, 0.0
            evidence[row, beam] = min(long + short, both_signs * min(long, short))
