"""Means with bootstrap intervals, and paired tests between entries.

The time of a plan is bounded by the longest time, which lost plans have. The mean of bounded times is the restricted
mean of survival analysis: it exists although not every plan was solved.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from limslam_env.geometry import FloatArray

LEVEL, RESAMPLES, LEAST = 0.95, 2000, 3
"""Confidence level of intervals, number of resamples, and least number of values for an interval."""


@dataclass(frozen=True)
class Mean:
    """A mean of plans.

    Attributes
    ----------
    value
        The mean.
    low, high
        Its 95 % percentile bootstrap interval; None for fewer than three plans.
    """

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Comparison:
    """Two entries on the plans that both have run.

    Attributes
    ----------
    difference
        Mean of second minus first.
    p_value
        Of Wilcoxon's signed-rank test, two-sided; None if all values are equal.
    plans
        Number of plans.
    """

    difference: Mean
    p_value: float | None
    plans: int


def mean(values: FloatArray) -> Mean:
    """The mean of values (n,), n > 0, with its interval. The resamples are seeded."""
    middle = float(np.mean(values))
    if len(values) < LEAST:
        return Mean(middle, None, None)
    found = stats.bootstrap(
        (values,), np.mean, n_resamples=RESAMPLES, confidence_level=LEVEL, method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval  # fmt: skip
    return Mean(middle, float(found.low), float(found.high))


def compare(first: Mapping[int, float], second: Mapping[int, float]) -> Comparison:
    """Compare two entries by the values of the plans that both have.

    Raises
    ------
    ValueError
        If they have no plan in common.
    """
    common = sorted(first.keys() & second.keys())
    if not common:
        raise ValueError("the entries have no plan in common")
    # Differences by rounding only are none, and equal ones have equal ranks.
    differences = np.round([second[plan] - first[plan] for plan in common], 9)
    p_value = None
    if np.any(differences != 0.0):
        # Plans on which both entries got lost have the difference zero, which counts half for each side.
        p_value = float(stats.wilcoxon(differences, zero_method="zsplit").pvalue)
    return Comparison(mean(differences), p_value, len(common))


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """P-values corrected for several tests by the method of Holm (1979). None stays None and counts as no test."""
    known = sorted((value, index) for index, value in enumerate(p_values) if value is not None)
    corrected, largest = list(p_values), 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * value))
        corrected[index] = largest
    return corrected
