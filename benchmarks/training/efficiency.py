"""Sample efficiency of learners over several seeds: interquartile means and probabilities of improvement.

Both follow Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice, NeurIPS 2021, whose
tasks are floor plans here. The seeds are resampled as wholes: the plans of a seed share one trained network. A policy
that does not learn has one row, with 0 steps, and counts as known.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from scipy import stats

from benchmarks.analysis.style import BAND, COLOURS, DASHES, FAINT, legend_below, plain_axes, save, sheet_of
from limslam_agent.measurements import store
from limslam_agent.measurements.statistics import Estimate, estimate
from limslam_env.geometry import FloatArray

Curve = Mapping[int, FloatArray]
"""Scores (seeds, plans) of a learner after so many steps."""


@dataclass(frozen=True)
class Row:
    """The trials of a learner: coverage and return on each held-out plan, by the steps of training until then."""

    learner: str
    seed: int
    coverage: dict[str, list[float]]
    returns: dict[str, list[float]]


@dataclass(frozen=True)
class Stamp:
    """The settings of a comparison, and the versions and the commit that made it."""

    settings: dict[str, Any]
    versions: dict[str, str]
    commit: str

    @property
    def identity(self) -> Mapping[str, str]:
        """What must be equal for results to go on."""
        return {"other settings": str(sorted(self.settings.items()))}


FORMAT = store.Format("baselines", "baselines.json", Stamp, Row, lambda row: (row.learner, row.seed), "series")


def curves_of(rows: Iterable[Row], measure: str) -> dict[str, Curve]:
    """The scores of each learner by a measure, ``coverage`` or ``returns``.

    Raises
    ------
    ValueError
        If there are no rows.
    """
    found: dict[str, dict[int, list[list[float]]]] = {}
    for row in rows:
        for steps, scores in getattr(row, measure).items():
            found.setdefault(row.learner, {}).setdefault(int(steps), []).append(scores)
    if not found:
        raise ValueError("there are no trials of learners yet")
    return {name: {steps: np.array(scores) for steps, scores in sorted(each.items())} for name, each in found.items()}


def interquartile_mean(scores: FloatArray) -> Estimate:
    """The mean of all scores (seeds, plans) without the lowest and the highest quarter, with its interval."""
    return _known(estimate(lambda drawn: stats.trim_mean(drawn.reshape(len(drawn), -1), 0.25, axis=-1), scores))


def probability_of_improvement(first: FloatArray, second: FloatArray) -> Estimate:
    """The probability that the first learner is better than the second, of scores (seeds, plans), with its interval.

    The mean over plans of the Mann-Whitney statistic, in which a tie counts as one half. A second learner of one seed
    is not resampled.
    """

    def share(mine: FloatArray, other: FloatArray) -> FloatArray:
        pairs = mine[:, :, None] - other[:, None, :]
        return np.asarray(((pairs > 0.0) + 0.5 * (pairs == 0.0)).mean(axis=(1, 2, 3)))

    if len(second) == 1:
        return _known(estimate(lambda mine: share(mine, second[None]), first))
    return _known(estimate(share, first, second))


def _known(found: Estimate | None) -> Estimate:
    assert found is not None  # noqa: S101 (each learner has a seed)
    return found


def efficiency_table(folder: Path) -> str:
    """Markdown: interquartile means of coverage and return after so many steps, and probabilities of improvement.

    Raises
    ------
    ValueError
        If there are no trials in the folder.
    """
    rows = store.read_rows(FORMAT, folder)
    curves, returns = curves_of(rows, "coverage"), curves_of(rows, "returns")
    lines = ["| learner | steps | coverage | return | seeds |", "|---|---:|---:|---:|---:|"]
    for learner, curve in curves.items():
        for step, scores in curve.items():
            means = interquartile_mean(scores).text(2), interquartile_mean(returns[learner][step]).text(1)
            lines.append(f"| {learner} | {step} | {' | '.join(means)} | {len(scores)} |")
    lines += ["", "Interquartile means over seeds and plans, with 95 % bootstrap intervals over seeds.", ""]
    lines += [
        f"P({first} sees more than {second} after training) = {each.text(2)}" for first, second, each in _pairs(curves)
    ]
    return "\n".join([*lines, ""])


def _pairs(curves: Mapping[str, Curve]) -> list[tuple[str, str, Estimate]]:
    """Each learner with the learners after it and with the policies that do not learn: how probably it sees more."""
    names = sorted(curves, key=lambda name: max(curves[name]) == 0)
    last = {name: curves[name][max(curves[name])] for name in names}
    return [
        (first, second, probability_of_improvement(last[first], last[second]))
        for first, second in combinations(names, 2)
        if max(curves[first]) > 0
    ]


def draw_efficiency(folder: Path, path: Path) -> None:
    """Write a figure: the interquartile mean of the coverage over the steps, with the interval as a band, and the
    probabilities of improvement after training. Policies that do not learn are dashed lines.
    """
    figure, [[left, right]] = sheet_of([3.0], 2, 5.2)
    curves = curves_of(store.read_rows(FORMAT, folder), "coverage")
    learners_first = sorted(curves.items(), key=lambda each: max(each[1]) == 0)
    handles = [_draw_curve(left, COLOURS[number], *each) for number, each in enumerate(learners_first)]
    left.set(xlabel="decisions of training", ylabel="coverage after a minute, IQM", ylim=(0.0, None))
    left.ticklabel_format(axis="x", style="sci", scilimits=(3, 3), useMathText=True)
    _draw_improvements(right, _pairs(curves))
    for axes in (left, right):
        plain_axes(axes)
    legend_below(figure, handles, 5)
    save(figure, path)


def _draw_curve(axes: Axes, colour: str, learner: str, curve: Curve) -> Line2D:
    estimates = [interquartile_mean(scores) for scores in curve.values()]
    if max(curve) == 0:
        return axes.axhline(estimates[0].value, color=colour, linewidth=1.4, linestyle=DASHES[1], label=learner)
    bounds = [(each.low, each.high) for each in estimates if each.low is not None and each.high is not None]
    if len(bounds) == len(curve):
        axes.fill_between(list(curve), *np.array(bounds).T, color=colour, alpha=BAND, linewidth=0.0)
    label = f"{learner} ({estimates[0].count} seeds)"
    (line,) = axes.plot(list(curve), [each.value for each in estimates], color=colour, linewidth=1.8, label=label)
    return line


def _draw_improvements(axes: Axes, pairs: Sequence[tuple[str, str, Estimate]]) -> None:
    for row, (_, _, each) in enumerate(pairs):
        if each.low is not None and each.high is not None:
            axes.barh(row, each.high - each.low, 0.5, each.low, color=COLOURS[0], alpha=2.0 * BAND)
        axes.plot([each.value] * 2, [row - 0.25, row + 0.25], color=COLOURS[0], linewidth=2.0)
    axes.axvline(0.5, color=FAINT, linewidth=1.0)
    axes.set(xlim=(0.0, 1.0), xlabel="P(the first sees more than the second)", ylim=(len(pairs) - 0.5, -0.5))
    axes.set_yticks(range(len(pairs)), [f"{first} / {second}" for first, second, _ in pairs])
