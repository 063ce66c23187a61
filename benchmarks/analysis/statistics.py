"""Medians and interquartile means with bootstrap intervals, shares, and settings compared in pairs.

Intervals are percentile bootstrap intervals (Efron & Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13),
not BCa. BCa takes its acceleration from the jackknife; the jackknife of a median takes two or three values only and is
known to be inconsistent (chapter 11), and on values that are mostly alike, such as doors open, BCa is 0 / 0. Percentile
intervals of a median lie between measured values, whatever their scale. All resampling is seeded: the same results
give the same tables.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from limslam_env.geometry import FloatArray, IntArray

LEVEL = 0.95
"""Of confidence."""

LEAST = 3
"""Values from which on an interval is given."""

ENOUGH = 6
"""Values from which on an interval of a median can hold what it says: the range of n values holds the true median with
probability 1 - 2 ** (1 - n), which is 75 % of three and 97 % of six, and no percentile interval is wider."""

RESAMPLES = 2000
# Large samples have intervals that are narrow and need fewer resamples.
_DRAWS, _FEWEST = 4_000_000, 400
_BLOCK = 1000

_Key = TypeVar("_Key", bound=Hashable)


@dataclass(frozen=True)
class Estimate:
    """A statistic of some runs.

    Attributes
    ----------
    value
        Of all of them.
    low, high
        Its 95 % interval; None where there are fewer than three.
    count
        How many values it was made from.
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
        Values (n,) of the jobs that have one under both.
    left_out
        Jobs under both settings that failed, or have no value, under one of them.
    unpaired
        Jobs that were done under one setting only.
    """

    first: FloatArray
    second: FloatArray
    left_out: int
    unpaired: int

    @property
    def differences(self) -> FloatArray:
        """Second minus first, (n,)."""
        return np.asarray(self.second - self.first)

    @property
    def ratios(self) -> FloatArray:
        """Second over first (k,), of the pairs whose first value is not 0."""
        usable = self.first != 0.0
        return np.asarray(self.second[usable] / self.first[usable])


@dataclass(frozen=True)
class Comparison:
    """A second setting against a first one, pair by pair.

    Attributes
    ----------
    difference, ratio
        Medians of second minus first and of second over first; None where no pair has one.
    pairs, left_out, unpaired
        How many pairs there are, and what is missing (see :class:`Pairs`).
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
    """As :func:`median`, of many samples at once: those of one size share their resamples."""
    return _estimates(samples, _middle)


def interquartile_mean(values: ArrayLike) -> Estimate | None:
    """Mean of values (n,) without the lowest and the highest quarter, with its interval; None if there are none."""
    return interquartile_means([np.asarray(values, dtype=float)])[0]


def interquartile_means(samples: Sequence[FloatArray]) -> list[Estimate | None]:
    """As :func:`interquartile_mean`, of many samples at once."""
    return _estimates(samples, _inner_half)


def share(hits: int, count: int) -> Estimate | None:
    """A share with its exact interval (Clopper & Pearson 1934); None if there was nothing to count.

    Raises
    ------
    ValueError
        If there are more hits than there could be, or fewer than none.
    """
    if not 0 <= hits <= count:
        raise ValueError(f"{hits} of {count} is no share")
    if count == 0:
        return None
    interval = stats.binomtest(hits, count).proportion_ci(LEVEL)
    return Estimate(hits / count, float(interval.low), float(interval.high), count)


def paired(first: Mapping[_Key, float | None], second: Mapping[_Key, float | None]) -> Pairs:
    """The jobs that two settings have in common.

    Parameters
    ----------
    first, second
        The value of each job, by what makes it comparable: world, noise, seed. None where it failed or has none.
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
    """Order statistics whose mean is the median."""
    return slice((count - 1) // 2, count // 2 + 1)


def _inner_half(count: int) -> slice:
    """Order statistics whose mean is the interquartile mean, as scipy.stats.trim_mean cuts them."""
    cut = int(0.25 * count)
    return slice(cut, count - cut)


def _estimates(samples: Sequence[FloatArray], kept: Callable[[int], slice]) -> list[Estimate | None]:
    """Means of the order statistics that ``kept`` names for a size, with their intervals."""
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
    """Intervals of means of order statistics, of sorted samples (m, n)."""
    size = table.shape[1]
    if size < LEAST:
        return [(None, None)] * len(table)

    # Resampling the ranks instead of the values lets one set of resamples, sorted once, serve all samples of a size.
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
