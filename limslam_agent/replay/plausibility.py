"""Warnings about a replayed log whose numbers are possible but unlikely, such as ranges in another unit."""

import math

import numpy as np

from limslam_agent.logs.recorded_log import RecordedLog
from limslam_agent.replay.replay import Replay
from limslam_env.geometry import FloatArray

MOSTLY_NOTHING = 0.95
"""Above this share of readings that saw nothing, the ranges are probably not in metres."""

SHORTEST_PERIOD, LONGEST_PERIOD = 1e-3, 10.0
"""Median time between two events, s, beyond which the times are probably not in seconds."""

CLEARLY_BELOW = 0.85
"""A largest reading below this share of the longest range was probably cut off by the sensor itself."""

SOME_NOTHING = 0.01
"""Up to this share of readings that saw nothing, the sensor's own maximum does not matter."""

LEAST_DRIVEN = 1.0
"""Walls cannot be expected in a log over less driving than this, m."""


def log_warnings(log: RecordedLog) -> list[str]:
    """What is unlikely about the times and the ranges of a log, one sentence for each finding."""
    return [*_about_times(log), *_about_ranges(log)]


def map_warnings(replay: Replay) -> list[str]:
    """Why the map of a replay has no walls, in one sentence. Empty if the map has walls."""
    if len(replay.segments):
        return []
    return [f"the map has 0 walls: {_why_no_walls(replay)}"]


def _about_times(log: RecordedLog) -> list[str]:
    steps = np.diff(log.time)
    steps = steps[steps > 0.0]
    if not len(steps) or SHORTEST_PERIOD <= (period := float(np.median(steps))) <= LONGEST_PERIOD:
        return []
    return [f"the median time between two events is {period:.3g} s: are the times in seconds? --time-unit converts"]


def _about_ranges(log: RecordedLog) -> list[str]:
    near, share = _seen(log)
    if math.isnan(share):
        return []
    reach = float(log.robot.max_ranges.max())
    if share > MOSTLY_NOTHING:
        text = f"{share:.1%} of the readings saw nothing up to {reach:g} m: are the ranges in metres?"
        return [f"{text} --range-unit converts"]
    farthest = float(near.max(initial=0.0))
    if share > SOME_NOTHING and farthest < CLEARLY_BELOW * reach:
        numbers = f"the longest range is {reach:g} m, but the largest reading of a wall is {farthest:.2f} m"
        effect = f"the {share:.0%} of the readings that saw nothing clear space that was not seen"
        option = f"--max-range {math.ceil(10.0 * farthest) / 10.0:g} sets another longest range"
        return [f"{numbers}: if the sensors see no farther, {effect}; {option}"]
    return []


def _seen(log: RecordedLog) -> tuple[FloatArray, float]:
    """Readings of walls (k,), m, and the share of readings that saw nothing. NaN where there are no readings."""
    readings = log.ranges[log.has_scan].astype(np.float64)
    nothing = readings >= log.robot.too_far
    valid = np.isfinite(readings)
    share = float(nothing[valid].mean()) if valid.any() else math.nan
    return readings[valid & ~nothing], share


def _why_no_walls(replay: Replay) -> str:
    log = replay.log
    share = _seen(log)[1]
    driven = float(np.hypot(*np.diff(replay.odometry[:, :2], axis=0).T).sum())
    if math.isnan(share):
        return "the log has no readings"
    if share > MOSTLY_NOTHING:
        return "almost no reading saw anything"
    if all(beam.side == "none" for beam in log.robot.beams):
        return "no beam looks to the left or the right of the robot, and only such beams draw walls"
    if driven < LEAST_DRIVEN:
        return f"the robot drove only {driven:.2f} m by odometry. Is the odometry in metres?"
    return (
        "the readings do not lie on lines. Are odometry and ranges in metres, headings in radians, and the beams' "
        "directions right? A larger --noise accepts more scatter"
    )
