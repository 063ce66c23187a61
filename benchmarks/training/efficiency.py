"""Sample efficiency of learners over several seeds: interquartile means and probabilities of improvement.

Both follow Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice, NeurIPS 2021, whose
tasks are floor plans here. Its package rliable was last released in 2024 and depends on arch, so that its two
definitions stand here. The seeds are resampled as wholes: the plans of a seed share one trained network. A policy that
does not learn has one row, with 0 steps, and counts as known.
"""

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from scipy import stats

from benchmarks.analysis.figure_style import BAND, COLOURS, DASHES, FAINT, legend_below, plain_axes, sheet_of
from benchmarks.analysis.statistics import LEAST, LEVEL, RESAMPLES, Estimate
from limslam_agent.output.atomic_write import atomic_write
from limslam_agent.safe_files import read_limited
from limslam_env.geometry import FloatArray, IntArray

RESULTS = "trials.jsonl"
MEASURES = ("coverage", "return")

Curve = Mapping[int, FloatArray]
"""Scores (seeds, plans) of a learner after so many steps."""


def read_trials(folder: Path, measure: str) -> dict[str, Curve]:
    """The scores of each learner in a folder. Only seeds that have been tried at all numbers of steps count.

    Raises
    ------
    ValueError
        If there are no trials, or a line is none.
    """
    path, found = folder / RESULTS, dict[str, dict[int, dict[int, list[float]]]]()
    try:
        for line in read_limited(path).splitlines():
            row = json.loads(line)
            found.setdefault(row["learner"], {}).setdefault(row["seed"], {})[int(row["steps"])] = row[measure]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path}: holds no trials of learners: {error}") from error
    if not found:
        raise ValueError(f"{path}: holds no trials of learners yet")
    return {learner: _curve(by_seed) for learner, by_seed in found.items()}


def _curve(by_seed: Mapping[int, Mapping[int, Sequence[float]]]) -> Curve:
    steps = max(by_seed.values(), key=len)
    whole = [tried for tried in by_seed.values() if tried.keys() == steps.keys()]
    return {step: np.array([tried[step] for tried in whole], dtype=float) for step in sorted(steps)}


def interquartile_mean(scores: FloatArray) -> Estimate:
    """The mean of all scores (seeds, plans) without the lowest and the highest quarter, with its interval."""

    def statistic(seeds: IntArray, axis: int = -1) -> FloatArray:
        del axis  # always the last one, which the plans join here
        drawn = scores[seeds]
        return np.asarray(stats.trim_mean(drawn.reshape(*seeds.shape[:-1], -1), 0.25, axis=-1))

    return _estimate(statistic, len(scores))


def probability_of_improvement(first: FloatArray, second: FloatArray) -> Estimate:
    """The probability that the first learner is better than the second, of scores (seeds, plans), with its interval.

    The mean over plans of the Mann-Whitney statistic, in which a tie counts as one half. A second learner of one seed
    is not resampled.
    """

    def statistic(mine: IntArray, other: IntArray, axis: int = -1) -> FloatArray:
        del axis
        pairs = first[mine][..., :, None, :] - second[other][..., None, :, :]
        return np.asarray(((pairs > 0.0) + 0.5 * (pairs == 0.0)).mean(axis=(-3, -2, -1)))

    if len(second) == 1:
        return _estimate(lambda mine, axis=-1: statistic(mine, np.zeros_like(mine[..., :1]), axis), len(first))
    return _estimate(statistic, len(first), len(second))


def _estimate(statistic: Callable[..., FloatArray], *counts: int) -> Estimate:
    """A statistic of seeds, and its percentile bootstrap interval. Few seeds have none."""
    seeds = [np.arange(count) for count in counts]
    value = float(statistic(*seeds))
    if min(counts) < LEAST:
        return Estimate(value, None, None, min(counts))
    with warnings.catch_warnings():
        # Equal scores of all seeds have an interval of no width.
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        found = stats.bootstrap(
            seeds, statistic, vectorized=True, n_resamples=RESAMPLES, confidence_level=LEVEL, method="percentile",
            rng=np.random.default_rng(0),
        ).confidence_interval  # fmt: skip
    return Estimate(value, float(found.low), float(found.high), min(counts))


def efficiency_table(folder: Path) -> str:
    """Markdown: interquartile means of coverage and return after so many steps, and probabilities of improvement.

    Raises
    ------
    ValueError
        If there are no trials in the folder.
    """
    curves = {measure: read_trials(folder, measure) for measure in MEASURES}
    lines = ["| learner | steps | coverage | return | seeds |", "|---|---:|---:|---:|---:|"]
    for learner, curve in curves["coverage"].items():
        for step, scores in curve.items():
            others = curves["return"][learner][step]
            cells = [
                learner, f"{step}", _words(interquartile_mean(scores), 2), _words(interquartile_mean(others), 1),
                str(len(scores)),
            ]  # fmt: skip
            lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "Interquartile means over seeds and plans, with 95 % bootstrap intervals over seeds.", ""]
    return "\n".join([*lines, *_improvements(curves["coverage"]), ""])


def _improvements(curves: Mapping[str, Curve]) -> list[str]:
    return [
        f"P({first} sees more than {second} after training) = {_words(estimate, 2)}"
        for first, second, estimate in _pairs(curves)
    ]


def _pairs(curves: Mapping[str, Curve]) -> list[tuple[str, str, Estimate]]:
    """Each learner with the learners after it and with the policies that do not learn: how probably it sees more."""
    last = {learner: curve[max(curve)] for learner, curve in curves.items()}
    learners = [name for name in curves if not _is_reference(curves[name])]
    others = [name for name in curves if name not in learners]
    return [
        (first, second, probability_of_improvement(last[first], last[second]))
        for number, first in enumerate(learners)
        for second in [*learners[number + 1 :], *others]
    ]


def _is_reference(curve: Curve) -> bool:
    return max(curve) == 0


def _words(estimate: Estimate, digits: int) -> str:
    if estimate.low is None or estimate.high is None:
        return f"{estimate.value:.{digits}f}"
    return f"{estimate.value:.{digits}f} [{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"


def draw_efficiency(folder: Path, path: Path) -> None:
    """Write a figure: the interquartile mean of the coverage over the steps, with the interval as a band, and the
    probabilities of improvement after training. Policies that do not learn are dashed lines.
    """
    figure, [[left, right]] = sheet_of(1, 2, (5.2, 3.6))
    curves = read_trials(folder, "coverage")
    learners_first = sorted(curves.items(), key=lambda each: _is_reference(each[1]))
    handles = [_draw_curve(left, number, *each) for number, each in enumerate(learners_first)]
    left.set(xlabel="decisions of training", ylabel="coverage after a minute, IQM", ylim=(0.0, None))
    left.ticklabel_format(axis="x", style="sci", scilimits=(3, 3), useMathText=True)
    _draw_improvements(right, _pairs(curves))
    for axes in (left, right):
        plain_axes(axes)
    legend_below(figure, handles, 5)
    with atomic_write(path) as beside:
        figure.savefig(beside, dpi=110)


def _draw_curve(axes: Axes, number: int, learner: str, curve: Curve) -> Line2D:
    estimates, colour = [interquartile_mean(scores) for scores in curve.values()], COLOURS[number % len(COLOURS)]
    if _is_reference(curve):
        return axes.axhline(estimates[0].value, color=colour, linewidth=1.4, linestyle=DASHES[1], label=learner)
    bounds = [(each.low, each.high) for each in estimates if each.low is not None and each.high is not None]
    if len(bounds) == len(curve):
        axes.fill_between(list(curve), *np.array(bounds).T, color=colour, alpha=BAND, linewidth=0.0)
    label = f"{learner} ({estimates[0].count} seeds)"
    (line,) = axes.plot(list(curve), [each.value for each in estimates], color=colour, linewidth=1.8, label=label)
    return line


def _draw_improvements(axes: Axes, pairs: Sequence[tuple[str, str, Estimate]]) -> None:
    for row, (_, _, estimate) in enumerate(pairs):
        if estimate.low is not None and estimate.high is not None:
            axes.barh(row, estimate.high - estimate.low, 0.5, estimate.low, color=COLOURS[0], alpha=2.0 * BAND)
        axes.plot([estimate.value] * 2, [row - 0.25, row + 0.25], color=COLOURS[0], linewidth=2.0)
    axes.axvline(0.5, color=FAINT, linewidth=1.0)
    axes.set(xlim=(0.0, 1.0), xlabel="P(the first sees more than the second)", ylim=(len(pairs) - 0.5, -0.5))
    axes.set_yticks(range(len(pairs)), [f"{first} / {second}" for first, second, _ in pairs])
