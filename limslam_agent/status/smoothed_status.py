"""The status of a finished run, by what the line smoother found. That of the graph is in ``replay.trust``."""

import math

import numpy as np

from limslam_agent.status.status import LARGE_CORRECTION, LEVELS, UNSURE_HEADING, Level, Status
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle

# The result is unsure or lost if this share of the readings contradicts the smoothed map. From a smaller share on, a
# robot that was unsure or lost while it drove remains so.
_UNSURE_SHARE, _LOST_SHARE, _DOUBTED_SHARE = 0.01, 0.03, 0.0025
# It is unsure if the smoother made a large correction, and the mean NEES / 3 of the filter against the smoothed path
# exceeds this.
_MOVED_NEES = 5.0

_LEAST_VARIANCES = np.diag([1e-3**2, 1e-3**2, 1e-3**2])
"""Added to the covariances of the filter, m^2 and rad^2: the start is known exactly."""


def smoothed_status(
    contradictions: float,
    filtered: tuple[FloatArray, FloatArray],
    smoothed: tuple[FloatArray, FloatArray],
    *,
    while_driving: Level,
    lost_since: float | None = None,
) -> Status:
    """Whether the smoothed path and map can be trusted.

    A smoothed path far away from that of a filter which was certain means that one of them is wrong, and the readings
    of both fit their maps. A filter that said that it was lost was not certain.

    Parameters
    ----------
    contradictions
        Share of the readings that passed through walls of the smoothed map.
    filtered, smoothed
        Poses (t, n, 3), m and rad, and their covariances (t, n, 3, 3): of the filter, as it reported them, and of the
        smoother.
    while_driving
        The worst level of the status while the robots drove.
    lost_since
        Time after the start, s, from which on the filter did not know the robot's place, or was wrong about it; None if
        it was not.
    """
    share = f"{100.0 * contradictions:.2g} % of the readings contradict the smoothed map"
    if lost_since is not None or contradictions >= _LOST_SHARE:
        unknown = "" if lost_since is None else f"the place of the robot is unknown from {lost_since:.0f} s on"
        return Status("lost", unknown or share)
    if contradictions >= _DOUBTED_SHARE and while_driving != "ok":
        return Status(while_driving, f"{share}, and the robot was {while_driving} while it drove")
    if contradictions >= _UNSURE_SHARE:
        return Status("unsure", share)
    moved, excess = _moved(filtered, smoothed)
    if moved > LARGE_CORRECTION and excess > _MOVED_NEES:
        return Status("unsure", f"smoothing moved poses by up to {moved:.2f} m, of which the filter was too certain")
    heading = math.sqrt(max(float(smoothed[1][..., 2, 2].max()), 0.0))
    if heading > UNSURE_HEADING:
        return Status("unsure", f"the smoothed heading's standard deviation reaches {math.degrees(heading):.1f} deg")
    return Status()


def lost_since(time: FloatArray, unplaced: int | None) -> float | None:
    """The time of a step after the first one of the steps (t,), s; None if there is no such step."""
    return None if unplaced is None else float(time[min(unplaced, len(time) - 1)] - time[0])


def _moved(filtered: tuple[FloatArray, FloatArray], smoothed: tuple[FloatArray, FloatArray]) -> tuple[float, float]:
    """The largest distance between the paths, m, and the mean NEES / 3 of the filter against the smoothed path.

    The mean is that of the worst robot.
    """
    off = smoothed[0] - filtered[0]
    off[..., 2] = wrap_angle(off[..., 2])
    solved = np.linalg.solve(filtered[1] + _LEAST_VARIANCES, off[..., None])[..., 0]
    excess = np.sum(off * solved, axis=-1).mean(axis=0) / 3.0
    return float(np.hypot(off[..., 0], off[..., 1]).max()), float(excess.max())


def lost_note(time: FloatArray, levels: IntArray) -> str:
    """When the robots were lost while they drove, in words; empty if they never were.

    Parameters
    ----------
    time
        Times of the steps (t,), s.
    levels
        Level of each robot (t, n), as an index into ``LEVELS``. The worst robot counts.
    """
    lost = np.flatnonzero(levels.max(axis=1) == LEVELS.index("lost"))
    if not len(lost):
        return ""
    first, last = float(time[lost[0]] - time[0]), float(time[min(lost[-1] + 1, len(time) - 1)] - time[0])
    end = "the end" if lost[-1] == len(time) - 1 else f"{last:.0f} s"
    return f"lost while driving, from {first:.0f} s to {end}"
