"""The status of an estimate, and its reason in words: while a robot drives, and of a finished run
by its line smoother.

That of a log that the graph has smoothed is in ``replay.trust``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle

Level = Literal["ok", "unsure", "lost"]
LEVELS: tuple[Level, ...] = ("ok", "unsure", "lost")
"""The levels of the status, the best one first."""

UNSURE_HEADING = math.radians(4.0)
"""Standard deviation of the heading beyond which an estimate is unsure, rad."""

LARGE_CORRECTION = 0.3
"""A correction of a pose by more than this, m, moves the map: what was planned or found before
means nothing then.
"""

# The result is unsure or lost if this share of the readings contradicts the smoothed map. From a
# smaller share on, a robot that was unsure or lost while it drove remains so.
_UNSURE_SHARE, _LOST_SHARE, _DOUBTED_SHARE = 0.01, 0.03, 0.0025
# It is unsure if the smoother made a large correction, and the mean NEES / 3 of the filter against
# the smoothed path exceeds this.
_MOVED_NEES = 5.0

_LEAST_VARIANCES = np.diag([1e-3**2, 1e-3**2, 1e-3**2])
"""Added to the covariances of the filter, m^2 and rad^2: the start is known exactly."""


@dataclass(frozen=True)
class Status:
    """Whether an estimate can be trusted.

    Attributes
    ----------
    level
        ``"ok"``, ``"unsure"`` or ``"lost"``.
    reason
        Why the level is not ``"ok"``, in words. Empty if it is.
    """

    level: Level = "ok"
    reason: str = ""

    @property
    def words(self) -> str:
        """Level and reason in one line."""
        return self.remark or self.level

    @property
    def remark(self) -> str:
        """Level and reason in one line; empty if there is no reason."""
        return f"{self.level}: {self.reason}" if self.reason else ""


def worst(statuses: Sequence[Status]) -> Status:
    """The worst status of several robots. If there are several robots, the reason names the
    robot.
    """
    number = max(range(len(statuses)), key=lambda each: LEVELS.index(statuses[each].level))
    found = statuses[number]
    if len(statuses) == 1 or not found.reason:
        return found
    return Status(found.level, f"robot {number + 1}: {found.reason}")


def status_scores(time: FloatArray, levels: IntArray, final: Status) -> dict[str, Any]:
    """How long the estimate was ok, unsure and lost, and the status at the end, by their names in
    ``docs/metrics.md``.

    Parameters
    ----------
    time
        Times of the steps (t,), s.
    levels
        Level of each robot (t, n), as an index into ``LEVELS``. The worst robot counts.
    final
        Status at the end.
    """
    worst_levels = levels.max(axis=1)
    lasts = np.append(np.diff(time), 0.0)
    lost = np.flatnonzero(worst_levels == LEVELS.index("lost"))
    return {
        "status": final.level,
        "status_reason": final.reason,
        "ok_s": float(lasts[worst_levels == LEVELS.index("ok")].sum()),
        "unsure_s": float(lasts[worst_levels == LEVELS.index("unsure")].sum()),
        "lost_s": float(lasts[lost].sum()),
        "first_lost_s": float(time[lost[0]] - time[0]) if len(lost) else None,
    }


def smoothed_status(
    contradictions: float,
    filtered: tuple[FloatArray, FloatArray],
    smoothed: tuple[FloatArray, FloatArray],
    *,
    while_driving: Level,
    lost_since: float | None = None,
) -> Status:
    """Whether the smoothed path and map can be trusted.

    A smoothed path far away from that of a filter which was certain means that one of them is
    wrong, and the readings of both fit their maps. A filter that said that it was lost was not
    certain.

    Parameters
    ----------
    contradictions
        Share of the readings that passed through walls of the smoothed map.
    filtered, smoothed
        Poses (t, n, 3), m and rad, and their covariances (t, n, 3, 3): of the filter, as it
        reported them, and of the smoother.
    while_driving
        The worst level of the status while the robots drove.
    lost_since
        Time after the start, s, from which on the filter did not know the robot's place, or was
        wrong about it; None if it was not.
    """
    share = f"{100.0 * contradictions:.2g} % of the readings contradict the smoothed map"
    if lost_since is not None or contradictions >= _LOST_SHARE:
        unknown = (
            ""
            if lost_since is None
            else f"the place of the robot is unknown from {lost_since:.0f} s on"
        )
        return Status("lost", unknown or share)
    if contradictions >= _DOUBTED_SHARE and while_driving != "ok":
        return Status(while_driving, f"{share}, and the robot was {while_driving} while it drove")
    if contradictions >= _UNSURE_SHARE:
        return Status("unsure", share)
    moved, excess = _moved(filtered, smoothed)
    if moved > LARGE_CORRECTION and excess > _MOVED_NEES:
        return Status(
            "unsure",
            f"smoothing moved poses by up to {moved:.2f} m, of which the filter was too certain",
        )
    heading = math.sqrt(max(float(smoothed[1][..., 2, 2].max()), 0.0))
    if heading > UNSURE_HEADING:
        return Status(
            "unsure",
            f"the smoothed heading's standard deviation reaches {math.degrees(heading):.1f} deg",
        )
    return Status()


def lost_since(time: FloatArray, unplaced: int | None) -> float | None:
    """The time of a step after the first one of the steps (t,), s; None if there is no such
    step.
    """
    return None if unplaced is None else float(time[min(unplaced, len(time) - 1)] - time[0])


def _moved(
    filtered: tuple[FloatArray, FloatArray], smoothed: tuple[FloatArray, FloatArray]
) -> tuple[float, float]:
    """The largest distance between the paths, m, and the mean NEES / 3 of the filter against the
    smoothed path.

    The mean is that of the worst robot.
    """
    off = smoothed[0] - filtered[0]
    off[..., 2] = wrap_angle(off[..., 2])
    solved = np.linalg.solve(filtered[1] + _LEAST_VARIANCES, off[..., None])[..., 0]
    excess = np.sum(off * solved, axis=-1).mean(axis=0) / 3.0
    return float(np.hypot(off[..., 0], off[..., 1]).max()), float(excess.max())


def final_status_scores(
    final: Status, online: Status, time: FloatArray, levels: IntArray
) -> dict[str, str]:
    """The status of a smoothed result, by its names in ``docs/metrics.md``, beside that of the
    filter at the end.

    ``time`` and ``levels`` are those of :func:`status_scores`, by which a note says when the robots
    were lost.
    """
    lost, note = np.flatnonzero(levels.max(axis=1) == LEVELS.index("lost")), ""
    if len(lost):
        first, last = (
            float(time[lost[0]] - time[0]),
            float(time[min(lost[-1] + 1, len(time) - 1)] - time[0]),
        )
        end = "the end" if lost[-1] == len(time) - 1 else f"{last:.0f} s"
        note = f"lost while driving, from {first:.0f} s to {end}"
    return {
        "status": final.level,
        "status_reason": final.reason,
        "status_note": note,
        "status_online": online.level,
        "status_online_reason": online.reason,
    }
