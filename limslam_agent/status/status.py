"""The status of an estimate, and its reason in words: while a robot drives, and of a finished run
by its line smoother.

That of a log that the graph has smoothed is in ``replay.trust``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from limslam_agent.status.chance import (
    LIMIT,
    chance_mistaken,
    chance_off,
    either,
    in_words,
    rate_evidence,
)
from limslam_env.geometry import FloatArray, IntArray

Level = Literal["ok", "unsure", "lost"]
LEVELS: tuple[Level, ...] = ("ok", "unsure", "lost")
"""The levels of the status, the best one first."""

LARGE_CORRECTION = 0.3
"""A correction of a pose by more than this, m, moves the map: what was planned or found before
means nothing then.
"""

# Shares of the looks that pass through walls of a right map, and of a wrong one
_RIGHT = 0.005
_WRONG = 0.12
# Number of looks that count: those at one place have one cause. Felt by "late beam 1 s" and "slips"
_LOOKS = 225


@dataclass(frozen=True)
class Status:
    """Whether an estimate can be trusted.

    Attributes
    ----------
    level
        ``"ok"``, ``"unsure"`` or ``"lost"``.
    reason
        Why the level is not ``"ok"``, in words. Empty if it is.
    chance
        The chance that the estimate is off (:mod:`~limslam_agent.status.chance`). A place that was
        found and is not confirmed is as likely wrong as right.
    """

    level: Level = "ok"
    reason: str = ""
    chance: float = field(default=math.nan, compare=False)

    def __post_init__(self) -> None:
        if math.isnan(self.chance):
            object.__setattr__(self, "chance", 0.5 * LEVELS.index(self.level))

    @property
    def words(self) -> str:
        """Level and reason in one line."""
        return self.remark or self.level

    @property
    def remark(self) -> str:
        """Level and reason in one line; empty if there is no reason."""
        return f"{self.level}: {self.reason}" if self.reason else ""


def judged(chance: float, reason: str) -> Status:
    """The status of an estimate that nothing refutes, by the chance that it is off."""
    return Status("ok", "", chance) if chance < LIMIT else Status("unsure", reason, chance)


def worst(statuses: Sequence[Status]) -> Status:
    """The worst status of several robots. If there are several robots, the reason names the
    robot.
    """
    number = max(range(len(statuses)), key=lambda each: LEVELS.index(statuses[each].level))
    found = statuses[number]
    if len(statuses) == 1 or not found.reason:
        return found
    return replace(found, reason=f"robot {number + 1}: {found.reason}")


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
        "status_chance": final.chance,
        "ok_s": float(lasts[worst_levels == LEVELS.index("ok")].sum()),
        "unsure_s": float(lasts[worst_levels == LEVELS.index("unsure")].sum()),
        "lost_s": float(lasts[lost].sum()),
        "first_lost_s": float(time[lost[0]] - time[0]) if len(lost) else None,
    }


def smoothed_status(
    contradictions: float, covariances: FloatArray, *, lost_since: float | None = None
) -> Status:
    """Whether the smoothed path and map can be trusted, by the pose that is off most likely.

    Parameters
    ----------
    contradictions
        Share of the readings that passed through walls of the smoothed map.
    covariances
        Covariances (t, n, 3, 3) of the smoothed poses.
    lost_since
        Time after the start, s, from which on the filter did not know the robot's place, or was
        wrong about it; None if it was not.
    """
    if lost_since is not None:
        return Status("lost", f"the place of the robot is unknown from {lost_since:.0f} s on")
    mistaken = chance_mistaken(rate_evidence(contradictions * _LOOKS, _LOOKS, _RIGHT, _WRONG))
    share = f"{100.0 * contradictions:.2g} % of the readings contradict the smoothed map"
    if mistaken > 1.0 - LIMIT:
        return Status("lost", share, mistaken)
    chances = chance_off(covariances)
    far = float(chances.max())
    worst = covariances[np.unravel_index(chances.argmax(), chances.shape)]
    words = share if mistaken > far else in_words(far, worst, "a pose of the path")
    return judged(either(far, mistaken), words)


def lost_since(time: FloatArray, unplaced: int | None) -> float | None:
    """The time of a step after the first one of the steps (t,), s; None if there is no such
    step.
    """
    return None if unplaced is None else float(time[min(unplaced, len(time) - 1)] - time[0])


def final_status_scores(
    final: Status, online: Status, time: FloatArray, levels: IntArray
) -> dict[str, Any]:
    """The status of a smoothed result, by its names in ``docs/metrics.md``, beside that of the
    filter at the end.

    ``time`` and ``levels`` are those of :func:`status_scores`, by which a note says when the robots
    were lost.
    """
    lost = np.flatnonzero(levels.max(axis=1) == LEVELS.index("lost"))
    note = ""
    if len(lost):
        first = float(time[lost[0]] - time[0])
        last = float(time[min(lost[-1] + 1, len(time) - 1)] - time[0])
        end = "the end" if lost[-1] == len(time) - 1 else f"{last:.0f} s"
        note = f"lost while driving, from {first:.0f} s to {end}"
    return {
        "status": final.level,
        "status_reason": final.reason,
        "status_chance": final.chance,
        "status_note": note,
        "status_online": online.level,
        "status_online_reason": online.reason,
    }
