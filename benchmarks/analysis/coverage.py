"""Coverage over time of exploration policies on the same floor plans: a table with intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.analysis.groups import metric
from benchmarks.suite.store import Row, read_rows, series_path
from limslam_agent.measurements.statistics import MISSING, Estimate, median
from limslam_agent.safe_files import load_arrays
from limslam_env.geometry import FloatArray

LABELS = {
    "random": "random",
    "wall_follower": "wall follower",
    "frontier": "frontier, 0.2 m/s",
    "frontier_fast": "frontier, 0.3 m/s",
    "learned": "PPO on belief",
}
"""The displayed names of the policies, in the order of the table."""

GOAL = 0.8
MOMENTS = (30.0, 60.0, 90.0, 120.0, 180.0, 240.0)
_BASE = "frontier_fast"


@dataclass(frozen=True, eq=False)
class Curves:
    """Coverage over time of one policy.

    Attributes
    ----------
    plans
        Names of the floor plans (n,).
    time
        Times (k,), s.
    coverage
        Coverage (n, k), 0 to 1. A run that ended earlier keeps its last coverage.
    collisions
        Number of contacts in each run (n,).
    """

    plans: tuple[str, ...]
    time: FloatArray
    coverage: FloatArray
    collisions: FloatArray

    @property
    def times(self) -> FloatArray:
        """The time (n,) at which the coverage of each plan reached the goal, s; the last time if it never did."""
        reached = self.coverage >= GOAL
        return np.asarray(np.where(reached.any(axis=1), self.time[reached.argmax(axis=1)], self.time[-1]))


def read_curves(folders: Sequence[Path]) -> dict[str, Curves]:
    """The curves of each policy in folders of results, in the table's order. Of repeated plans, the first is used.

    Raises
    ------
    ValueError
        If there are no curves, or those of a run cannot be read.
    """
    found: dict[str, dict[str, tuple[FloatArray, FloatArray, float]]] = {}
    for folder in folders:
        for row in read_rows(folder):
            if row.policy in LABELS and row.robots == 1 and row.series is not None:
                touches = metric("collisions")(row)
                course = *_course(folder, row), np.nan if touches is None else touches
                found.setdefault(row.policy, {}).setdefault(f"{row.world}, {row.noise:g}, {row.seed}", course)
    if not found:
        raise ValueError("there are no explorations with their course in these folders")
    last = min(max(time[-1] for time, _, _ in runs.values()) for runs in found.values())
    time = np.arange(0.0, last + 1e-9)
    return {
        policy: Curves(
            tuple(found[policy]),
            time,
            np.array([np.interp(time, *run[:2]) for run in found[policy].values()]),
            np.array([run[2] for run in found[policy].values()]),
        )
        for policy in LABELS
        if policy in found
    }


def _course(folder: Path, row: Row) -> tuple[FloatArray, FloatArray]:
    """Times (k,), s, and coverage (k,) of a run."""
    path = series_path(folder, str(row.series))
    try:
        arrays = load_arrays(path, ("time", "coverage"))
        return arrays["time"], arrays["coverage"]
    except (OSError, ValueError, KeyError) as error:
        raise ValueError(f"{path}: is missing or damaged: {error}") from error


def curve_table(curves: Mapping[str, Curves]) -> str:
    """Markdown table of medians with 95 % bootstrap intervals, and of the time saved relative to the fast explorer.

    The time saved is compared plan by plan.
    """
    last = next(iter(curves.values())).time[-1]
    moments = [moment for moment in MOMENTS if moment <= last]
    head = ["policy", "n", *(f"{moment:g} s" for moment in moments), "80 % after, s", "got there"]
    head += ["minus fast frontier's, s", "touched"]
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    for policy, curve in curves.items():
        places = np.searchsorted(curve.time, np.array(moments) - 1e-9)
        got_there = float((curve.coverage[:, -1] >= GOAL).mean())
        cells = [
            LABELS[policy], str(len(curve.plans)), *(_text(median(curve.coverage[:, place]), 2) for place in places),
            _text(median(curve.times), 0), f"{got_there:.0%}", _gain(curve, curves.get(_BASE)),
            f"{np.nanmean(curve.collisions):.2f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    note = (
        "Medians of coverage after so many seconds, with 95 % bootstrap intervals; runs that did not see 80 % count as"
        f" {last:g} s. Minus the fast frontier explorer's: median over plans that both explored, with their number."
        " Touched: mean per run."
    )
    return "\n".join([*lines, "", note, ""])


def _gain(curve: Curves, base: Curves | None) -> str:
    if base is None or curve is base:
        return MISSING
    known = dict(zip(base.plans, base.times.tolist(), strict=True))
    saved = [time - known[plan] for plan, time in zip(curve.plans, curve.times.tolist(), strict=True) if plan in known]
    return f"{_text(median(saved), 0)} ({len(saved)})" if saved else MISSING


def _text(found: Estimate | None, decimals: int) -> str:
    return MISSING if found is None else found.text(decimals)
