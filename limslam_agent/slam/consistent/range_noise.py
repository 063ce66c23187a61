"""The size of the noise of ranges, by the residuals of wall segments, beside a filter that takes it to be as specified.

Residuals about straight walls, in assumed standard deviations, are counted in bins, apart for each bin of ranges. The
likelihood of these counts is that of a normal distribution without its tails, which hold readings of other objects,
and with a share of residuals of any size. It is compared between the assumed noise, and noise of other sizes that may
also grow with the squared range, as that of triangulating sensors does.
"""

import copy
import math
from typing import Any, NamedTuple, Self

import numpy as np
from scipy.special import ndtr

from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray

EDGES = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0, 4.0])
"""Limits of the bins of residuals, in assumed standard deviations. Larger residuals are not counted."""

NEAREST, RANGE_STEP, NUM_RANGES = 0.05, 1.25, 32
"""Bins of ranges: the upper limit of the first, m, the factor between two of them, and their number."""

FACTORS = 1.1 ** np.arange(-14, 15)
"""Noise of short ranges that is considered, as a share of the assumed one."""

GROWTHS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Growing part of the noise that is considered: at the longest range, as a share of the specified noise."""

ANY_SIZE = 0.02
"""Share of the counted residuals that may have any size."""

_LINE = 2  # parameters that are fitted to the readings of a segment
_RATIOS = 1.05 ** np.arange(-40, 61)


class NoiseEstimate(NamedTuple):
    """Noise that explains the residuals better than the assumed one does.

    Attributes
    ----------
    std, growth
        Standard deviation of short ranges, m, and the part that grows with the squared range, 1/m.
    evidence
        Twice the logarithm of the likelihood ratio to the assumed noise.
    """

    std: float
    growth: float
    evidence: float


class RangeNoise:
    """Counts residuals, and says how large the noise of ranges is.

    Parameters
    ----------
    assumed
        The noise in whose standard deviations the residuals are given.
    reach
        Longest range, m.
    least_std, least_ratio
        Least noise that is considered, m, and the factor by which noise differs from the assumed one, in the mean, if
        it is not as assumed.
    """

    def __init__(self, assumed: RangeSensor, reach: float, least_std: float, least_ratio: float) -> None:
        shares = np.diff(ndtr(EDGES / _RATIOS[:, None]), axis=1)
        shares /= shares.sum(axis=1, keepdims=True)
        by_chance = np.diff(EDGES) / EDGES[-1]
        logs = np.log((1.0 - ANY_SIZE) * shares + ANY_SIZE * by_chance)
        middles = np.asarray(NEAREST * RANGE_STEP ** (np.arange(NUM_RANGES) - 0.5), dtype=float)
        stds = assumed.std * FACTORS
        # Noise that is already below the least one may stay as it is.
        self._stds = stds[stds >= min(least_std, assumed.std) * (1.0 - 1e-9)]
        self._growths = np.array(GROWTHS) * assumed.std / reach**2
        variances = self._stds[:, None, None] ** 2 + (self._growths[:, None] * middles**2) ** 2
        self._ratios = np.log(np.sqrt(variances) / assumed.stds(middles))
        rows = np.rint((self._ratios - math.log(_RATIOS[0])) / math.log(_RATIOS[1] / _RATIOS[0])).astype(int)
        logs_as_assumed = logs[np.argmin(np.abs(np.log(_RATIOS)))]
        gains = logs[np.clip(rows, 0, len(_RATIOS) - 1)] - logs_as_assumed
        # By bin of ranges and of residuals, and by bin of ranges: what one residual adds to the sums below.
        self._gains = np.ascontiguousarray(gains.transpose(2, 3, 0, 1))
        self._differences = np.ascontiguousarray(np.abs(self._ratios).transpose(2, 0, 1))
        self._least, self._total = math.log(least_ratio), 0
        # For each noise that is considered: the likelihood ratio, and the sum of its differences from the assumed one.
        self._likelihoods, self._off = np.zeros(self._ratios.shape[:2]), np.zeros(self._ratios.shape[:2])

    def count(self, residuals: FloatArray, ranges: FloatArray) -> None:
        """Count the residuals (n,) of a straight wall segment, in standard deviations, after its line was fitted."""
        freedom = (len(residuals) - _LINE) / len(residuals)
        places = np.searchsorted(EDGES, np.abs(residuals) / math.sqrt(freedom), side="right") - 1
        rows = np.ceil(np.log(np.maximum(ranges, NEAREST) / NEAREST) / math.log(RANGE_STEP)).astype(int)
        is_counted = places < len(EDGES) - 1
        rows, places = np.minimum(rows, NUM_RANGES - 1)[is_counted], places[is_counted]
        self._total += len(rows)
        self._likelihoods += self._gains[rows, places].sum(axis=0)
        self._off += self._differences[rows].sum(axis=0)

    @property
    def estimate(self) -> NoiseEstimate:
        """The likeliest noise that is not as assumed."""
        is_other = self._off >= self._least * self._total
        if not (self._total and is_other.any()):
            return NoiseEstimate(float(self._stds[0]), 0.0, 0.0)
        best = np.unravel_index(np.argmax(np.where(is_other, self._likelihoods, -np.inf)), is_other.shape)
        evidence = 2.0 * float(self._likelihoods[best])
        return NoiseEstimate(float(self._stds[best[0]]), float(self._growths[best[1]]), evidence)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # A lost robot goes back to an earlier estimate, of which copies are made all the time. The tables never change.
        other = copy.copy(self)
        for name in ("_likelihoods", "_off"):
            setattr(other, name, getattr(self, name).copy())
        return other
