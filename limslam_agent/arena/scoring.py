"""Scores of a plan, and the rule that decides whether an entry has lost it.

**Correct coverage** is the share of the coverable cells (0.10 m, those that some beam could see
from a place that the robot can reach) that count as explored. A cell counts if a true beam has
crossed it, and if the final map calls the floor free there: the centre of a free cell of the map
lies within 0.10 m of the cell's centre in the true frame. So neither a wrong map nor a map of what
was never seen raises it.

**A plan is lost** if the correct coverage is below 95 % at the end of the run: when the entry says
that it is done, or when the time is over. The time of a lost plan is the longest time of the plan.
"""

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

_TIMES = (80, 95)


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
        **{f"plan_time_to_{share}_s": plan.max_time for share in _TIMES},
    }


def _first(time: FloatArray, reached: BoolArray) -> float | None:
    """The first time (s) at which something was reached; None if never."""
    at = np.flatnonzero(reached)
    return float(time[at[0]]) if at.size else None
