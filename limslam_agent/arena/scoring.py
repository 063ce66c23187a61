"""Scores of a plan, and the rule that decides whether an entry has lost it.

**Correct coverage** is the share of the coverable cells (0.10 m, those that some beam could see
from a place that the robot can reach) that count as explored. A cell counts if a true beam has
crossed it, and if the final map calls the floor free there: the centre of a free cell of the map
lies within 0.10 m of the cell's centre in the true frame. So neither a wrong map nor a map of what
was never seen raises it.

**A plan is lost** if the correct coverage is below 95 % at the end of the run: when the entry says
that it is done, or when the time is over. The time of a lost plan is the longest time of the plan.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from limslam_agent.arena.tracks import Plan
from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.simulation.coverage import CELL, CoverageGrid

ENOUGH = 0.95
"""Correct coverage at which a plan is explored."""

NEAR = 0.10
"""Largest distance between the centre of a cell and the centre of a free cell of the map, m."""

BOUNDS = {
    "plan_time_to_80_s": 30.0,
    "plan_time_to_95_s": 30.0,
    "time_to_80_s": 30.0,
    "time_to_95_s": 30.0,
    "end_time_s": 30.0,
    "since_new_s": 30.0,
    "correct_coverage": 0.05,
    "ate_final_m": 0.05,
    "anees_final": 1.0,
    "wall_f1_5cm": 0.1,
    "touches": 3.0,
    "claims_done": 0.0,
    "lost": 0.0,
}
"""Metrics of an entry that runs in a process of its own, and the largest differences of two runs of
the same plan, since its answers may depend on time. Such an entry has no other metrics, because
nobody could verify them.
"""

_TIMES = (80, 95)
_SHARES = ("correct_coverage", "wall_f1_5cm")


def correct_coverage(covered: CoverageGrid, seen: BoolArray, grid: GridView) -> float:
    """The correct coverage, 0 to 1, of cells that were truly ``seen`` (rows, columns) by the grid
    of the final map.
    """
    rows, columns = np.nonzero(covered.coverable)
    if not len(rows):
        return 0.0
    centres = covered.low + CELL * (np.column_stack((columns, rows)) + 0.5)
    free = grid.centres(np.argwhere(grid.free))
    if not len(free):
        return 0.0
    # Distances on a grid of 0.10 m are exactly 0.10 m up to rounding.
    distance, _ = cKDTree(free).query(centres, distance_upper_bound=NEAR + 1e-6)
    return float(np.mean(np.isfinite(distance) & seen[rows, columns]))


def exploration_scores(
    plan: Plan, time: FloatArray, coverage: FloatArray, correct: float, *, is_finished: bool
) -> dict[str, Any]:
    """Scores of an exploration that only the arena has.

    They are made from times (t,), s, true coverage (t,), 0 to 1, and the correct coverage at the
    end. ``is_finished`` says whether the entry itself has said that it is done.
    """
    times = {f"time_to_{share}_s": _first(time, coverage >= share / 100.0) for share in _TIMES}
    return {
        **times,
        "correct_coverage": correct,
        "claims_done": is_finished,
        "end_time_s": float(time[-1]),
        "since_new_s": float(time[-1] - time[np.argmax(coverage)]),
        "lost": loss(correct, is_finished=is_finished),
        **{
            f"plan_{name}": value if correct >= ENOUGH and value is not None else plan.max_time
            for name, value in times.items()
        },
    }


def loss(correct: float, *, is_finished: bool) -> str:
    """Why a plan is lost, in words. Empty if it is not."""
    if correct >= ENOUGH:
        return ""
    return "claims to be done and is not" if is_finished else "not explored in time"


def lost_scores(plan: Plan, reason: str) -> dict[str, Any]:
    """Scores of a plan that an entry has lost without a run."""
    return {
        "lost": reason,
        "correct_coverage": 0.0,
        "claims_done": False,
        **dict.fromkeys(_plan_times(), plan.max_time),
    }


def check_scores(scores: Mapping[str, Any], longest: float, error: str | None) -> None:
    """Refuse scores of a plan that no run can have.

    ``longest`` is the longest time of the plan, s, and ``error`` is the reason of an entry that has
    failed, which has only the scores of :func:`lost_scores`.

    Raises
    ------
    ValueError
        If a score is missing, is out of its bounds, or contradicts another one.
    """
    needed = {"lost", "correct_coverage", "claims_done", *_plan_times()}
    missing = sorted((needed if error is not None else set(BOUNDS)) - scores.keys())
    if missing:
        raise ValueError(f"the metric {missing[0]} is missing")
    for name in sorted(BOUNDS.keys() & scores.keys() - {"lost"}):
        highest = 1.0 if name in _SHARES else longest if name.endswith("_s") else math.inf
        value = scores[name]
        is_open = value is None and name not in needed
        if not is_open and not (isinstance(value, int | float) and 0.0 <= value <= highest):
            raise ValueError(f"the metric {name} is {value!r}, and not a number in its bounds")
    wrong = f"failed: {error}"
    if error is None:
        wrong = loss(scores["correct_coverage"], is_finished=bool(scores["claims_done"]))
    if scores["lost"] != wrong:
        raise ValueError(f"the metric lost is {scores['lost']!r}, and the others say {wrong!r}")
    if wrong and any(scores[name] != longest for name in _plan_times()):
        raise ValueError(f"a lost plan takes the longest time, {longest:g} s")


def _plan_times() -> list[str]:
    return [f"plan_time_to_{share}_s" for share in _TIMES]


def _first(time: FloatArray, reached: BoolArray) -> float | None:
    """The first time (s) at which something was reached; None if never."""
    at = np.flatnonzero(reached)
    return float(time[at[0]]) if at.size else None
