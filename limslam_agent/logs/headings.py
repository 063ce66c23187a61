"""Whether the heading of a log turns as its wheels do."""

from dataclasses import replace

import numpy as np

from limslam_agent.logs.recorded_log import RecordedLog
from limslam_env.geometry.se2 import wrap_angle

_LEAST_TURN, _LARGEST_STEP = 2.0, 1.0  # rad: of all turns, and of a turn between two headings
_LEAST_SHARE, _LARGEST_SHARE = 0.5, 2.0  # of the wheels' turns: slip and a wrong axle explain that


def with_believable_heading(log: RecordedLog) -> RecordedLog:
    """The log, without its heading and with a note where that does not turn as the wheels do."""
    if log.yaw is None or log.wheels is None:
        return log
    rows = np.flatnonzero(~np.isnan(log.yaw))
    by_wheels = np.cumsum((log.wheels[:, 1] - log.wheels[:, 0]) / log.robot.axle)
    turns, own = np.diff(by_wheels[rows]), wrap_angle(np.diff(log.yaw[rows]))
    is_small = np.abs(turns) < _LARGEST_STEP
    if np.abs(turns[is_small]).sum() < _LEAST_TURN:
        return log
    share = float(turns[is_small] @ own[is_small] / (turns[is_small] @ turns[is_small]))
    if _LEAST_SHARE <= share <= _LARGEST_SHARE:
        return log
    cause = (
        "one of the two counts the other way"
        if -_LARGEST_SHARE <= share <= -_LEAST_SHARE
        else "it may have another unit, or not work"
    )
    note = (
        f"the heading is not used: it turns {share:.2f} times as far as the wheels turn the robot, "
        f"so {cause}"
    )
    return replace(log, ranges=log.reported, yaw=None, notes=(*log.notes, note))
