"""Statistics of runs: estimates with bootstrap intervals, values in pairs, and tests of
differences.

Intervals are percentile bootstrap intervals (Efron & Tibshirani, An Introduction to the Bootstrap,
1993, chapter 13), not BCa, whose acceleration the jackknife of a median cannot give (chapter 11).
Percentile intervals of a median lie between measured values, whatever their scale. All resampling
is seeded: the same results give the same tables.
"""

import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from limslam_env.geometry import FloatArray

LEVEL = 0.95
"""Confidence level of all bootstrap intervals."""

LEAST = 3
"""Least number of values for an interval. The range of n values contains the true median with
probability 1 - 2 ** (1 - n), and no percentile interval is wider: below six values an interval does
not reach its level.
"""

MISSING = "\N{EN DASH}"
"""The text of a number that is not known."""

# large samples have narrow intervals and need fewer resamples
_RESAMPLES = 2000
_DRAWS = 4_000_000
_FEWEST = 400

_Key = TypeVar("_Key", bound=Hashable)

Statistic: TypeAlias = Callable[..., FloatArray]
"""Turns samples (k, n, ...), which are k drawings of n values, into k numbers."""


@dataclass(frozen=True)
class Estimate:
    """A statistic of ``count`` values, and its interval, which is None where there are too few
    values.
    """

    value: float
    low: float | None
    high: float | None
    count: int

    def text(self, decimals: int) -> str:
        """The value with its interval in brackets. An interval without a width is left out."""
        words = number(self.value, decimals)
        if self.low is None or self.high is None:
            return words
        low = number(self.low, decimals)
        high = number(self.high, decimals)
        return words if low == high == words else f"{words} [{low}, {high}]"


def number(value: float | None, decimals: int) -> str:
    """A number as text; never "-0.0". A very large one has no decimals."""
    if value is None:
        return MISSING
    words = f"{value:.{decimals}f}" if abs(value) < 1e5 else f"{value:.3g}"
    return words.removeprefix("-") if float(words) == 0.0 else words


def estimate(statistic: Statistic, values: ArrayLike) -> Estimate | None:
    """A statistic of values (n, ...) with its interval; None if there are none. The first axis is
    resampled.
    """
    array = np.asarray(values, dtype=float)
    count = len(array)
    if not count:
        return None
    value = float(statistic(array[None])[0])
    if count < LEAST:
        return Estimate(value, None, None, count)
    draws = max(_FEWEST, min(_RESAMPLES, _DRAWS // array.size))
    drawn = statistic(array[np.random.default_rng(0).integers(count, size=(draws, count))])
    low, high = np.quantile(drawn, [0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL)])
    return Estimate(value, float(low), float(high), count)


def median(values: ArrayLike) -> Estimate | None:
    """The median of values (n,) with its interval; None if there are none."""
    return estimate(lambda drawn: np.median(drawn, axis=1), np.sort(values))


def mean(values: ArrayLike) -> Estimate | None:
    """The mean of values (n,) with its interval; None if there are none.

    The mean of times that are bounded by a longest time is the restricted mean of survival
    analysis: it exists although not every run came to its end.
    """
    return estimate(lambda drawn: drawn.mean(axis=1), np.sort(values))


@dataclass(frozen=True, eq=False)
class Pairs:
    """The values (n,) of the jobs that have one under both settings.

    Of the jobs that are left out, one of both runs failed or has no value. Those that are unpaired
    exist under one setting only.
    """

    first: FloatArray
    second: FloatArray
    left_out: int
    unpaired: int

    @property
    def difference(self) -> Estimate | None:
        """The median of second minus first."""
        return median(self.second - self.first)

    @property
    def ratio(self) -> Estimate | None:
        """The median of second over first, of the pairs whose first value is not 0."""
        usable = self.first != 0.0
        return median(self.second[usable] / self.first[usable])


def paired(first: Mapping[_Key, float | None], second: Mapping[_Key, float | None]) -> Pairs:
    """Pair the jobs that two settings have in common.

    Parameters
    ----------
    first, second
        The value of each job; None if the job failed or has no value.
    """
    common = [key for key in first if key in second]
    both = [
        (a, b)
        for a, b in ((first[key], second[key]) for key in common)
        if a is not None and b is not None
    ]
    values = np.array(both, dtype=float).reshape(-1, 2)
    unpaired = len(first) + len(second) - 2 * len(common)
    return Pairs(values[:, 0], values[:, 1], len(common) - len(both), unpaired)


def geometric_ratio(first: ArrayLike, second: ArrayLike, least: float) -> Estimate | None:
    """The geometric mean of positive values (n,) second over first, with an interval of two
    standard errors.

    ``least`` is the least standard deviation of the logarithm of one ratio, so that a single pair
    has an interval, too. None if there are no pairs.
    """
    logs = np.log(np.asarray(second, dtype=float)) - np.log(np.asarray(first, dtype=float))
    if not len(logs):
        return None
    middle = float(logs.mean())
    error = two_errors(logs, least)
    return Estimate(math.exp(middle), math.exp(middle - error), math.exp(middle + error), len(logs))


def two_errors(values: FloatArray, least: float) -> float:
    """Two standard errors of the mean of values (n,), n > 0, whose standard deviation is at least
    ``least``.
    """
    scatter = float(values.std(ddof=1)) if len(values) > 1 else 0.0
    return 2.0 * max(scatter, least) / math.sqrt(len(values))


def signed_rank(differences: FloatArray) -> float | None:
    """The p-value of Wilcoxon's signed-rank test, two-sided; None if all differences (n,) are
    zero.
    """
    if not np.any(differences != 0.0):
        return None
    # A difference of zero counts half for each side.
    return float(stats.wilcoxon(differences, zero_method="zsplit").pvalue)


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """P-values corrected for several tests by the method of Holm (1979). None stays None and counts
    as no test.
    """
    known = sorted((value, index) for index, value in enumerate(p_values) if value is not None)
    corrected = list(p_values)
    largest = 0.0
    for rank, (value, index) in enumerate(known):
        largest = max(largest, min(1.0, (len(known) - rank) * value))
        corrected[index] = largest
    return corrected
