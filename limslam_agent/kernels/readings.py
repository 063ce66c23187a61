"""What the ranges of one step mean: ``limslam_agent.readings``, the front end's masks, and missed walls."""

import math

from limslam_agent.kernels.compilation import lean_entry
from limslam_agent.kernels.tables import FARTHEST, TOO_FAR, TOO_NEAR
from limslam_env.geometry import BoolArray, FloatArray, IntArray

_SAME_WALL = 0.1
"""Two readings of a beam whose difference is smaller than this, m, ended at one wall."""

_WELL_WITHIN = 0.9
"""Share of a beam's longest range up to which a wall is not near the end of the range."""


@lean_entry
def sort_readings(
    values: FloatArray, lowest: FloatArray, highest: FloatArray, too_near: FloatArray, too_far: FloatArray,
    readings: FloatArray, measured: BoolArray, hits: BoolArray,
) -> int:  # fmt: skip
    """Turn what a sensor reports into readings; the number of values that are no readings.

    Parameters
    ----------
    values
        What the sensor reports (b,), m.
    lowest, highest, too_near, too_far
        Those of the robot's beams (b,), m.
    readings
        Set to the readings (b,), m, as ``limslam_agent.readings.as_readings`` does.
    measured, hits
        Beams that take a new measurement in this step (b,). Those without a reading are removed; ``hits`` is set to
        those that show a wall.
    """
    refused = 0
    for beam in range(len(values)):
        value = values[beam]
        is_reading = value >= 0.0
        readings[beam] = min(max(value, lowest[beam]), highest[beam]) if is_reading else math.nan
        refused += not is_reading
        measured[beam] = measured[beam] and is_reading
        hits[beam] = measured[beam] and too_near[beam] < readings[beam] < too_far[beam]
    return refused


@lean_entry
def count_misses(
    ranges: FloatArray, measured: BoolArray, beams: FloatArray, last: FloatArray, in_a_row: IntArray, counts: IntArray
) -> None:
    """Count readings that saw nothing, and among them those between two readings of the same wall.

    Parameters
    ----------
    ranges, measured, beams
        Readings (b,), m, which of them are new, and ``RobotSpec.beam_table``.
    last
        The last two new readings of each beam (2, b), m, changed; NaN where there is none.
    in_a_row
        How many new readings of each beam (b,) in a row saw nothing, changed.
    counts
        Number of readings between two of the same wall, and of those among them that saw nothing (2,), changed.
    """
    for beam in range(len(ranges)):
        if not measured[beam]:
            continue
        before, between, reading = last[0, beam], last[1, beam], ranges[beam]
        near, far, limit = beams[beam, TOO_NEAR], beams[beam, TOO_FAR], _WELL_WITHIN * beams[beam, FARTHEST]
        if near < before < limit and near < reading < limit and abs(before - reading) < _SAME_WALL:
            counts[0] += 1
            counts[1] += between >= far
        in_a_row[beam] = in_a_row[beam] + 1 if reading >= far else 0
        last[0, beam], last[1, beam] = between, reading
