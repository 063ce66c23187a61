"""The size of the noise of ranges, by the residuals of wall segments, beside a filter that takes it
to be as specified.

The likelihood of residuals about straight walls is that of a normal distribution without its tails,
which hold readings of other objects, and with a share of residuals of any size. It is compared
between the assumed noise, and noise of other sizes that may also grow with the squared range, as
that of triangulating sensors does.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import erf

from limslam_agent.slam.core.range_sensor import RangeSensor
from limslam_env.geometry import FloatArray

LARGEST = 4.0
"""Larger residuals are not counted, in assumed standard deviations."""

FACTORS = 1.2 ** np.arange(-7, 8)
"""Noise of short ranges that is considered, as a share of the assumed one."""

GROWTHS = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
"""Growing part of the noise that is considered: at the longest range, as a share of the specified
noise.
"""

ANY_SIZE = 0.02
"""Share of the counted residuals that may have any size."""


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

    The residuals are given in standard deviations of the ``assumed`` noise; the longest range is
    ``reach``, m. Noise below ``least_std``, m, is not considered, nor noise that differs by less
    than the factor ``least_ratio``, in the mean.
    """

    def __init__(
        self, assumed: RangeSensor, reach: float, least_std: float, least_ratio: float
    ) -> None:
        stds = assumed.std * FACTORS
        # Noise that is already below the least one may stay as it is.
        self._stds = stds[stds >= min(least_std, assumed.std) * (1.0 - 1e-9)]
        self._growths = np.array(GROWTHS) * assumed.std / reach**2
        self._assumed = assumed
        self._least = math.log(least_ratio)
        self._total = 0
        # For each noise that is considered: the likelihood ratio, and the sum of its differences
        # from the assumed one.
        self._likelihoods, self._off = np.zeros((2, len(self._stds), len(self._growths)))

    def count(self, residuals: FloatArray, ranges: FloatArray) -> None:
        """Count the residuals (n,) of a straight wall segment, in standard deviations, after its
        line was fitted.
        """
        # A line has two parameters.
        sizes = np.abs(residuals) * math.sqrt(len(residuals) / (len(residuals) - 2.0))
        is_counted = sizes < LARGEST
        sizes = sizes[is_counted, None, None]
        ranges = ranges[is_counted, None, None]
        ratios = np.hypot(self._stds[:, None], self._growths * ranges**2) / self._assumed.stds(
            ranges
        )
        self._likelihoods += (
            _log_likelihoods(sizes, ratios) - _log_likelihoods(sizes, np.ones(1))
        ).sum(axis=0)
        self._off += np.abs(np.log(ratios)).sum(axis=0)
        self._total += len(sizes)

    @property
    def estimate(self) -> NoiseEstimate:
        """The likeliest noise that is not as assumed."""
        is_other = self._off >= self._least * self._total
        if not (self._total and is_other.any()):
            return NoiseEstimate(float(self._stds[0]), 0.0, 0.0)
        best = np.unravel_index(
            np.argmax(np.where(is_other, self._likelihoods, -np.inf)), is_other.shape
        )
        evidence = 2.0 * float(self._likelihoods[best])
        return NoiseEstimate(float(self._stds[best[0]]), float(self._growths[best[1]]), evidence)


def _log_likelihoods(sizes: FloatArray, ratios: FloatArray) -> FloatArray:
    """Logarithms of the density of residuals of some sizes, if the noise is so many times the
    assumed one.
    """
    share = math.sqrt(0.5 * math.pi) * ratios * erf(LARGEST / (math.sqrt(2.0) * ratios))
    return np.asarray(
        np.log((1.0 - ANY_SIZE) * np.exp(-0.5 * (sizes / ratios) ** 2) / share + ANY_SIZE / LARGEST)
    )
