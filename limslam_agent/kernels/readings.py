"""What the ranges of one step mean: ``limslam_agent.readings`` and the front end's masks, in one pass."""

import math

from limslam_agent.kernels.compilation import lean_entry
from limslam_env.geometry import BoolArray, FloatArray


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
