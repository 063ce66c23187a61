"""From where to where a wall goes along its line: where beams hit it, and where they passed through."""

import math
from typing import Self

import numpy as np

from limslam_env.geometry import FloatArray, IntArray

BIN = 0.05
"""Length of wall that one count stands for, m."""


class WallExtent:
    """Counts along a line, a bin each 5 cm: of beams that ended there, and of beams that went on.

    What was once a wall is taken back where enough beams go through: a door that was closed by mistake opens again, and
    a wall that never was vanishes.
    """

    def __init__(self) -> None:
        self._low = 0
        self._hits = np.zeros(0, dtype=np.int64)
        self._misses = np.zeros(0, dtype=np.int64)
        self._least = np.zeros(0)
        self._most = np.zeros(0)

    @classmethod
    def counted(cls, low: int, counts: IntArray, reached: FloatArray) -> Self:
        """What was counted elsewhere: hits and misses (2, n) from bin ``low`` on, least and most places (2, n), m."""
        extent = cls()
        extent._low = low
        extent._hits, extent._misses = np.array(counts, dtype=np.int64)
        extent._least, extent._most = np.array(reached)
        return extent

    @property
    def ends(self) -> tuple[float, float]:
        """The outermost hits, m along the line."""
        return float(self._least.min()), float(self._most.max())

    def hit(self, along: FloatArray) -> None:
        """Beams ended at these places (n,), m along the line."""
        places = np.floor(along / BIN).astype(np.int64)
        self._reach(int(places.min()), int(places.max()))
        np.add.at(self._hits, places - self._low, 1)
        np.minimum.at(self._least, places - self._low, along)
        np.maximum.at(self._most, places - self._low, along)

    def pass_at(self, along: float) -> bool:
        """A beam went through at a place, m; whether that is between the wall's ends, where alone it says something."""
        low, high = self.ends
        is_between = low < along < high
        if is_between:
            # Bins that were taken over from another wall lie up to half a bin off its exact ends.
            place = math.floor(along / BIN) - self._low
            self._misses[min(max(place, 0), len(self._misses) - 1)] += 1
        return is_between

    def pieces(self, max_gap: float, tolerance: float) -> FloatArray:
        """Where the wall is (k, 2), m: where no more than ``tolerance`` beams passed for each that ended there.

        What nobody has looked at between two of them belongs to it up to ``max_gap`` (m).
        """
        is_wall = (self._hits > 0) & (self._misses <= tolerance * self._hits)
        bins = np.nonzero(is_wall)[0]
        if not len(bins):
            return np.zeros((0, 2))
        seen_through = np.concatenate(([0], np.cumsum((self._misses > 0) & ~is_wall)))
        between = seen_through[bins[1:]] - seen_through[bins[:-1] + 1]
        gaps = self._least[bins[1:]] - self._most[bins[:-1]]
        cuts = np.nonzero((between > 0) | (gaps > max_gap))[0] + 1
        parts = np.split(bins, cuts)
        return np.array([(self._least[part[0]], self._most[part[-1]]) for part in parts])

    def absorb(self, other: Self, factor: float, shift: float) -> None:
        """Take over another's counts: its place s is ``factor`` (1 or -1) times s plus ``shift`` (m) here."""
        middles = factor * BIN * (other._low + np.arange(len(other._hits)) + 0.5) + shift
        bins, was_hit = np.floor(middles / BIN).astype(np.int64), other._hits > 0
        self._reach(int(bins.min()), int(bins.max()))
        places = bins - self._low
        np.add.at(self._hits, places, other._hits)
        np.add.at(self._misses, places, other._misses)
        ends = np.sort(factor * np.stack((other._least, other._most))[:, was_hit] + shift, axis=0)
        np.minimum.at(self._least, places[was_hit], ends[0])
        np.maximum.at(self._most, places[was_hit], ends[1])

    def _reach(self, low: int, high: int) -> None:
        """Make room for bins from ``low`` to ``high``."""
        if not len(self._hits):
            self._low = low
        before, after = max(0, self._low - low), max(0, high - (self._low + len(self._hits) - 1))
        if before or after:
            self._low -= before
            pad: IntArray = np.array([before, after])
            self._hits, self._misses = np.pad(self._hits, pad), np.pad(self._misses, pad)
            self._least = np.pad(self._least, pad, constant_values=np.inf)
            self._most = np.pad(self._most, pad, constant_values=-np.inf)
