"""Sample efficiency of learners over several seeds: interquartile means and probabilities of improvement.

Both follow Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice, NeurIPS 2021, whose
tasks are floor plans here. Its package rliable was last released in 2024 and depends on arch, so that its two
definitions stand here. The seeds are resampled as wholes: the plans of a seed share one trained network.
"""

import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.analysis.figure_style import BAND, COLOURS, legend_below, plain_axes, sheet_of
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

    The mean over plans of the Mann-Whitney statistic, in which a tie counts as one half.
    """

    def statistic(mine: IntArray, other: IntArray, axis: int = -1) -> FloatArray:
        del axis
        pairs = first[mine][..., :, None, :] - second[other][..., None, :, :]
        return np.asarray(((pairs > 0.0) + 0.5 * (pairs == 0.0)).mean(axis=(-3, -2, -1)))

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
    last = {learner: curve[max(curve)] for learner, curve in curves.items()}
    names = list(last)
    return [
        f"P({first} sees more than {second} after training) = "
        f"{_words(probability_of_improvement(last[first], last[second]), 2)}"
        for number, first in enumerate(names)
        for second in names[number + 1 :]
    ]


def _words(estimate: Estimate, digits: int) -> str:
    if estimate.low is None or estimate.high is None:
        return f"{estimate.value:.{digits}f}"
    return f"{estimate.value:.{digits}f} [{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"


def draw_efficiency(folder: Path, path: Path) -> None:
    """Write a figure: the interquartile mean of the coverage over the steps, with the interval as a band."""
    figure, [[axes]] = sheet_of(1, 1, (6.4, 3.8))
    handles: list[Any] = []
    for number, (learner, curve) in enumerate(read_trials(folder, "coverage").items()):
        estimates = [interquartile_mean(scores) for scores in curve.values()]
        colour, steps = COLOURS[number % len(COLOURS)], list(curve)
        label = f"{learner} ({estimates[0].count} seeds)"
        handles += axes.plot(steps, [each.value for each in estimates], color=colour, linewidth=1.8, label=label)
        bounds = [(each.low, each.high) for each in estimates if each.low is not None and each.high is not None]
        if len(bounds) == len(steps):
            axes.fill_between(steps, *np.array(bounds).T, color=colour, alpha=BAND, linewidth=0.0)
    axes.set(xlabel="steps of training", ylabel="coverage, true", ylim=(0.0, None))
    plain_axes(axes)
    legend_below(figure, handles, 2)
    with atomic_write(path) as beside:
        figure.savefig(beside, dpi=110)
