"""Coverage over time of exploration policies on the same floor plans: a table with intervals, and a figure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D

from benchmarks.analysis.figure_style import BAND, COLOURS, DASHES, INK, legend_below, plain_axes, sheet_of
from benchmarks.analysis.series import read_series
from benchmarks.analysis.statistics import Estimate, median, medians
from benchmarks.suite.store import Row, read_rows
from limslam_agent.output.atomic_write import atomic_write
from limslam_env.geometry import FloatArray

LABELS = {
    "random": "random",
    "wall_follower": "wall follower",
    "frontier": "frontier, 0.2 m/s",
    "frontier_fast": "frontier, 0.3 m/s",
    "learned": "PPO on belief",
    "learned_true_pose": "PPO on true pose (oracle)",
}
"""The displayed names of the policies, in the order of the table."""

GOAL, NOTHING = 0.8, "\N{EN DASH}"
MOMENTS = (30.0, 60.0, 90.0, 120.0, 180.0, 240.0)
_BASES = {"frontier": "minus frontier's, s", "frontier_fast": "minus fast frontier's, s"}
_PERIOD = 2.0


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
        If there are no curves.
    """
    found: dict[str, dict[str, tuple[FloatArray, FloatArray, float]]] = {}
    for folder in folders:
        for row in read_rows(folder):
            if row.policy in LABELS and row.error is None and row.robots == 1:
                plan, course = f"{row.world}, {row.noise:g}, {row.seed}", _course(folder, row)
                if course is not None:
                    found.setdefault(row.policy, {}).setdefault(plan, course)
    if not found:
        raise ValueError("there are no explorations with their course in these folders")
    last = min(max(time[-1] for time, _, _ in runs.values()) for runs in found.values())
    time = np.arange(0.0, last + 1e-9, _PERIOD / 2.0)
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


def _course(folder: Path, row: Row) -> tuple[FloatArray, FloatArray, float] | None:
    series = read_series(folder, row)
    if series is None or series.coverage is None:
        return None
    collisions = row.metrics.get("collisions")
    return series.time, series.coverage, float(collisions) if isinstance(collisions, int | float) else math.nan


def curve_table(curves: Mapping[str, Curves]) -> str:
    """Markdown table of medians with 95 % bootstrap intervals, and of the time saved relative to frontier exploration.

    The time saved is compared plan by plan.
    """
    last = next(iter(curves.values())).time[-1]
    moments = [moment for moment in MOMENTS if moment <= last]
    head = [
        "policy",
        "n",
        *(f"{moment:g} s" for moment in moments),
        "80 % after, s",
        "got there",
        *_BASES.values(),
        "touched",
    ]
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    for policy, curve in curves.items():
        columns = [_at(curve, moment) for moment in moments]
        shares = [_words(estimate, 2) for estimate in medians(columns)]
        got_there = float((curve.coverage[:, -1] >= GOAL).mean())
        cells = [
            LABELS[policy], str(len(curve.plans)), *shares, _words(median(curve.times), 0, last), f"{got_there:.0%}",
            *(_gain(curve, curves.get(base)) for base in _BASES), f"{np.nanmean(curve.collisions):.2f}",
        ]  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    note = (
        "Medians of coverage after so many seconds, with 95 % bootstrap intervals; runs that did not see 80 % within"
        f" {last:g} s count as later. Minus another's: median over plans that both explored. Touched: mean per run."
    )
    return "\n".join([*lines, "", note, ""])


def _at(curve: Curves, moment: float) -> FloatArray:
    return np.asarray(curve.coverage[:, int(np.searchsorted(curve.time, moment - 1e-9))])


def _gain(curve: Curves, base: Curves | None) -> str:
    if base is None or curve is base:
        return NOTHING
    known = dict(zip(base.plans, base.times.tolist(), strict=True))
    both = [(time, known[plan]) for plan, time in zip(curve.plans, curve.times.tolist(), strict=True) if plan in known]
    return _words(median([time - other for time, other in both]), 0) + f" ({len(both)})" if both else NOTHING


def _words(estimate: Estimate | None, digits: int, last: float = math.inf) -> str:
    if estimate is None:
        return NOTHING

    def said(value: float) -> str:
        return f"> {last:g}" if value >= last else f"{value:.{digits}f}"

    if estimate.low is None or estimate.high is None or estimate.low == estimate.high:
        return said(estimate.value)
    return f"{said(estimate.value)} [{said(estimate.low)}, {said(estimate.high)}]"


def draw_curves(curves: Mapping[str, Curves], path: Path) -> None:
    """Write a figure with the median coverage over time, and a band that contains half of the plans."""
    figure, [[axes]] = sheet_of(1, 1, (6.4, 3.8))
    handles: list[Line2D] = []
    for number, (policy, curve) in enumerate(curves.items()):
        colour, dash = COLOURS[number % len(COLOURS)], DASHES[0 if policy.startswith("learned") else 1]
        low, middle, high = np.quantile(curve.coverage, (0.25, 0.5, 0.75), axis=0)
        axes.fill_between(curve.time, low, high, color=colour, alpha=BAND, linewidth=0.0)
        label = f"{LABELS[policy]} (n = {len(curve.plans)})"
        handles += axes.plot(curve.time, middle, color=colour, linestyle=dash, linewidth=1.8, label=label)
    axes.axhline(GOAL, color=INK, linewidth=0.6)
    axes.set(
        xlabel="time, s", ylabel="coverage, true", xlim=(0.0, next(iter(curves.values())).time[-1]), ylim=(0.0, 1.0)
    )
    plain_axes(axes)
    legend_below(figure, handles, 2)
    with atomic_write(path) as beside:
        figure.savefig(beside, dpi=110)
