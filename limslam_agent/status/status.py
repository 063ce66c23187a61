"""The status of an estimate, and its reason in words."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from limslam_env.geometry import FloatArray, IntArray

Level = Literal["ok", "unsure", "lost"]
LEVELS: tuple[Level, ...] = ("ok", "unsure", "lost")
"""The levels of the status, the best one first."""

UNSURE_HEADING = math.radians(4.0)
"""Standard deviation of the heading beyond which an estimate is unsure, rad."""

LARGE_CORRECTION = 0.3
"""A correction of a pose by more than this, m, moves the map: what was planned or found before means nothing then."""


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
    """The worst status of several robots. If there are several robots, the reason names the robot."""
    number = max(range(len(statuses)), key=lambda each: LEVELS.index(statuses[each].level))
    found = statuses[number]
    if len(statuses) == 1 or not found.reason:
        return found
    return Status(found.level, f"robot {number + 1}: {found.reason}")


def final_status_scores(final: Status, online: Status, note: str) -> dict[str, str]:
    """The status of a smoothed result, by its names in ``docs/metrics.md``, beside that of the filter at the end."""
    return {
        "status": final.level,
        "status_reason": final.reason,
        "status_note": note,
        "status_online": online.level,
        "status_online_reason": online.reason,
    }


def status_scores(time: FloatArray, levels: IntArray, final: Status) -> dict[str, Any]:
    """How long the estimate was ok, unsure and lost, and the status at the end, by their names in ``docs/metrics.md``.

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
