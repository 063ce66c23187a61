"""Says in words how a recorded log was read: its columns, its extent, and its first rows."""

import numpy as np

from limslam_agent.logs.recorded_log import RecordedLog
from limslam_env.messages import counted

_ROWS = 2  # first rows that are shown
_MOST_RANGES = 16  # in a row


def description(log: RecordedLog) -> list[str]:
    """Lines about a log: how each column of a table was read, its events, its beams, its odometry,
    and the first two rows in m, s and deg.
    """
    return [
        *(f"column      {words}" for words in log.columns),
        f"events      {_extent(log)}",
        f"beams       {_beams(log)}",
        f"odometry    {_odometry(log)}",
        *(f"row {row + 1}       {_row(log, row)}" for row in range(min(_ROWS, len(log)))),
    ]


def _extent(log: RecordedLog) -> str:
    lasted = float(np.ptp(log.time))
    rate = f", {1.0 / log.robot.control_period:.3g} a second" if lasted > 0.0 else ""
    return f"{len(log)} in {lasted:.1f} s{rate}, {int(log.has_scan.sum())} with ranges"


def _beams(log: RecordedLog) -> str:
    angles = np.round(np.degrees(log.robot.beam_angles), 1) + 0.0
    directions = ", ".join(f"{angle:g}" for angle in angles[:_MOST_RANGES])
    reach = ", ".join(sorted({f"{beam.max_range:g}" for beam in log.robot.beams}))
    return f"{counted(len(angles), 'beam')} at {directions} deg, up to {reach} m"


def _odometry(log: RecordedLog) -> str:
    yaw = "" if log.yaw is None else ", and the heading of an inertial measurement unit"
    if log.wheels is not None:
        left, right = np.abs(log.wheels).sum(axis=0).tolist()
        travel = f"the left one travels {left:.2f} m, the right one {right:.2f} m"
        return f"wheels with an axle of {log.robot.axle:g} m: {travel}{yaw}"
    poses = np.zeros((0, 3)) if log.odometry is None else log.odometry
    driven = float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum())
    return f"poses over {driven:.2f} m{yaw}"


def _row(log: RecordedLog, row: int) -> str:
    """The numbers of a row with their units."""
    parts = [f"{log.time[row]:.3f} s"]
    if log.wheels is not None:
        left, right = log.wheels[row].tolist()
        parts.append(f"left {left:.4f} m, right {right:.4f} m since the row before")
    if log.odometry is not None:
        x, y, heading = log.odometry[row].tolist()
        parts.append(f"x {x:.3f} m, y {y:.3f} m, heading {np.degrees(heading):.1f} deg")
    if log.yaw is not None:
        parts.append(f"heading of the measurement unit {np.degrees(log.yaw[row]):.1f} deg")
    if log.has_scan[row]:
        ranges = ", ".join(f"{value:.3f}" for value in log.ranges[row, :_MOST_RANGES].tolist())
        parts.append(f"ranges {ranges} m")
    else:
        parts.append("no ranges")
    return "; ".join(parts)
