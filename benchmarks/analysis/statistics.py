"""Medians and interquartile means with bootstrap intervals, shares, and paired comparisons of settings.

Intervals are percentile bootstrap intervals (Efron & Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13),
not BCa. BCa computes its acceleration with the jackknife. The jackknife of a median takes only two or three values and
is known to be inconsistent (chapter 11). If most values are equal, such as the number of open doors, BCa gives 0 / 0.
Percentile intervals of a median lie between measured values, whatever their scale. All resampling is seeded: the same
results give the same tables.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from limslam_env.geometry import FloatArray, IntArray

LEVEL = 0.95
"""Confidence level of all intervals."""

LEAST = 3
"""Least number of values for an interval."""

ENOUGH = 6
"""Least number of values for which an interval of a median can reach its confidence level. The range of n values
contains the true median with probability 1 - 2 ** (1 - n), which is 75 % for three values and 97 % for six. No
percentile interval is wider."""

RESAMPLES = 2000
# Large samples have narrow intervals and need fewer resamples.
_DRAWS, _FEWEST = 4_000_000, 400
_BLOCK = 1000

_Key = TypeVar("_Key", bound=Hashable)


@dataclass(frozen=True)
class Estimate:
    """A statistic of some runs.

    Attributes
    ----------
    value
        The statistic of all runs.
    low, high
        The 95 % interval; None for fewer than three values.
    count
        Number of values.
    """

    value: float
    low: float | None
    high: float | None
    count: int


@dataclass(frozen=True, eq=False)
class Pairs:
    """The same jobs under two settings.

    Attributes
    ----------
    first, second
        Values (n,) of the jobs that have a value under both settings.
    left_out
        Number of jobs under both settings that failed, or have no value, under one of the settings.
    unpaired
        Number of jobs that exist under one setting only.
    """

    first: FloatArray
    second: FloatArray
    left_out: int
    unpaired: int

    @property
    def differences(self) -> FloatArray:
        """Differences (n,), second minus first."""
        return np.asarray(self.second - self.first)

    @property
    def ratios(self) -> FloatArray:
        """Ratios (k,), second over first, of the pairs whose first value is not 0."""
        usable = self.first != 0.0
        return np.asarray(self.second[usable] / self.first[usable])


@dataclass(frozen=True)
class Comparison:
    """A comparison of a second setting with a first setting, in pairs of runs.

    Attributes
    ----------
    difference, ratio
        Medians of second minus first and of second over first; None if no pair has a value.
    pairs, left_out, unpaired
        Number of pairs, and numbers of jobs that are not compared (see :class:`Pairs`).
    """

    difference: Estimate | None
    ratio: Estimate | None
    pairs: int
    left_out: int
    unpaired: int


def median(values: ArrayLike) -> Estimate | None:
    """The median of values (n,) with its interval; None if there are none."""
    return medians([np.asarray(values, dtype=float)])[0]


def medians(samples: Sequence[FloatArray]) -> list[Estimate | None]:
    """Like :func:`median`, for many samples at once. Samples of the same size share their resamples."""
    return _estimates(samples, _middle)


def interquartile_mean(values: ArrayLike) -> Estimate | None:
    """Mean of values (n,) without the lowest and the highest quarter, with its interval; None if there are none."""
    return interquartile_means([np.asarray(values, dtype=float)])[0]


def interquartile_means(samples: Sequence[FloatArray]) -> list[Estimate | None]:
    """Like :func:`interquartile_mean`, for many samples at once."""
    return _estimates(samples, _inner_half)


def share(hits: int, count: int) -> Estimate | None:
    """A share with its exact interval (Clopper & Pearson 1934); None if the count is 0.

    Raises
    ------
    ValueError
        If the number of hits is negative or exceeds the count.
    """
    if not 0 <= hits <= count:
        raise ValueError(f"{hits} of {count} is no share")
    if count == 0:
        return None
    interval = stats.binomtest(hits, count).proportion_ci(LEVEL)
    return Estimate(hits / count, float(interval.low), float(interval.high), count)


def paired(first: Mapping[_Key, float | None], second: Mapping[_Key, float | None]) -> Pairs:
    """Pair the jobs that two settings have in common.

    Parameters
    ----------
    first, second
        The value of each job, with world, noise and seed as key; None if the job failed or has no value.
    """
    common = [key for key in first if key in second]
    both = [(a, b) for a, b in ((first[key], second[key]) for key in common) if a is not None and b is not None]
    values = np.array(both, dtype=float).reshape(-1, 2)
    unpaired = len(first) + len(second) - 2 * len(common)
    return Pairs(values[:, 0], values[:, 1], len(common) - len(both), unpaired)


def compare(first: Mapping[_Key, float | None], second: Mapping[_Key, float | None]) -> Comparison:
    """Compare two settings job by job; parameters as for :func:`paired`."""
    return comparisons([paired(first, second)])[0]


def comparisons(pairs: Sequence[Pairs]) -> list[Comparison]:
    """Compare many pairs of settings at once."""
    differences = medians([each.differences for each in pairs])
    ratios = medians([each.ratios for each in pairs])
    return [
        Comparison(difference, ratio, len(each.first), each.left_out, each.unpaired)
        for each, difference, ratio in zip(pairs, differences, ratios, strict=True)
    ]


def _middle(count: int) -> slice:
    """The order statistics whose mean is the median."""
    return slice((count - 1) // 2, count // 2 + 1)


def _inner_half(count: int) -> slice:
    """The order statistics whose mean is the interquartile mean, with the same cut as scipy.stats.trim_mean."""
    cut = int(0.25 * count)
    return slice(cut, count - cut)


def _estimates(samples: Sequence[FloatArray], kept: Callable[[int], slice]) -> list[Estimate | None]:
    """Means of the order statistics that ``kept`` selects for a sample size, with their intervals."""
    of_size: dict[int, list[int]] = {}
    for number, sample in enumerate(samples):
        of_size.setdefault(len(sample), []).append(number)
    found: list[Estimate | None] = [None] * len(samples)
    for size, numbers in of_size.items():
        for first in range(0, len(numbers) if size else 0, _BLOCK):
            block = numbers[first : first + _BLOCK]
            table = np.sort(np.array([samples[number] for number in block]), axis=1)
            values = table[:, kept(size)].mean(axis=1).tolist()
            for number, value, (low, high) in zip(block, values, _intervals(table, kept(size)), strict=True):
                found[number] = Estimate(value, low, high, size)
    return found


def _intervals(table: FloatArray, kept: slice) -> list[tuple[float | None, float | None]]:
    """Intervals of means of order statistics, for sorted samples (m, n)."""
    size = table.shape[1]
    if size < LEAST:
        return [(None, None)] * len(table)

    # The ranks are resampled instead of the values. One sorted set of resamples then serves all samples of a size.
    def statistic(ranks: IntArray, axis: int = -1) -> FloatArray:
        ordered = np.sort(ranks, axis=axis)[..., kept]
        total = np.zeros((len(table), *ordered.shape[:-1]))
        for position in range(ordered.shape[-1]):
            total += table[:, ordered[..., position]]
        return np.asarray(total / ordered.shape[-1])

    result = stats.bootstrap(
        (np.arange(size),), statistic, n_resamples=max(_FEWEST, min(RESAMPLES, _DRAWS // size)), vectorized=True,
        confidence_level=LEVEL, method="percentile", rng=np.random.default_rng(0),
    )  # fmt: skip
    low, high = (np.asarray(end).tolist() for end in result.confidence_interval)
    return list(zip(low, high, strict=True))
