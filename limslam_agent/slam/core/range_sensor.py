"""How a range sensor measures: its noise, the opening angle of its beams, and the bias of its ranges."""

from typing import NamedTuple

import numpy as np

from limslam_env.geometry import FloatArray

USUAL_RANGE = 0.7
"""The usual length of a range is this share of the longest one."""


class RangeSensor(NamedTuple):
    """How a range sensor measures.

    Attributes
    ----------
    std
        Standard deviation of short ranges, m.
    growth
        Further noise, 1/m: its standard deviation is this times the squared range.
    cone
        Half the opening angle of the beams, rad; 0 for rays.
    bias
        By what all ranges are too long, m.
    """

    std: float
    growth: float = 0.0
    cone: float = 0.0
    bias: float = 0.0

    @property
    def numbers(self) -> tuple[float, float, float, float]:
        """All of it as plain numbers, for compiled code."""
        return float(self.std), float(self.growth), float(self.cone), float(self.bias)

    def variances(self, ranges: FloatArray) -> FloatArray:
        """Variances of ranges (n,), m^2."""
        return np.asarray(self.std**2 + (self.growth * ranges**2) ** 2)

    def stds(self, ranges: FloatArray) -> FloatArray:
        """Standard deviations of ranges (n,), m."""
        return np.sqrt(self.variances(ranges))

    def usual_std(self, reach: float) -> float:
        """Standard deviation of a range of usual length, m, if the longest one is ``reach``, m."""
        return float(self.stds(np.array([USUAL_RANGE * reach]))[0]) if self.growth else self.std
