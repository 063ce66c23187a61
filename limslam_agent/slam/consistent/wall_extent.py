"""Extent of a wall along its line: counts of beams that ended on it, and of beams that passed through it."""

import copy
import math
from typing import Any, Self, TypeVar

import numpy as np

from limslam_env.geometry import FloatArray, IntArray

Numbers = TypeVar("Numbers", FloatArray, IntArray)

BIN = 0.05
"""Length of wall that one count stands for, m."""


class WallExtent:
    """Counts along a line, in bins of ``BIN``: of beams that ended there, and of beams that passed.

    A bin where more beams passed than ended is no longer drawn as wall. So a doorway that was drawn as wall by
    mistake is removed again, and so is a wall that never existed.

    Attributes
    ----------
    ends
        Positions of the outermost hits, m along the line. Every step asks for them.
    """

    def __init__(self) -> None:
        self._low = 0
        self._hits = np.zeros(0, dtype=np.int64)
        self._misses = np.zeros(0, dtype=np.int64)
        self._least = np.zeros(0)
        self._most = np.zeros(0)
        self.ends = (math.inf, -math.inf)
        self._intervals: tuple[float, float, FloatArray] | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        # A lost robot goes back to an earlier map, of which copies are made all the time. Intervals never change.
        other = copy.copy(self)
        for name in ("_hits", "_misses", "_least", "_most"):
            setattr(other, name, getattr(self, name).copy())
        return other

    @classmethod
    def counted(cls, low: int, counts: IntArray, reached: FloatArray) -> Self:
        """Extent from given counts.

        Parameters
        ----------
        low
            Number of the first bin.
        counts
            Hits and misses of each bin (2, n).
        reached
            Least and largest position of a hit in each bin (2, n), m.
        """
        extent = cls()
        extent._low = low
        extent._hits, extent._misses = np.array(counts, dtype=np.int64)
        extent._least, extent._most = np.array(reached)
        extent._find_ends()
        return extent

    def hit(self, along: FloatArray) -> None:
        """Count beams that ended at positions (n,), m along the line."""
        self._intervals, places = None, np.floor(along / BIN).astype(np.int64)
        self._reach(int(places.min()), int(places.max()))
        np.add.at(self._hits, places - self._low, 1)
        np.minimum.at(self._least, places - self._low, along)
        np.maximum.at(self._most, places - self._low, along)
        self._find_ends()

    def pass_at(self, along: float) -> bool:
        """Count a beam that passed at a position, m. Only positions between the ends count; returns whether it did."""
        low, high = self.ends
        is_between = low < along < high
        if is_between:
            self._intervals = None
            # Bins that were taken over from another wall may lie up to half a bin outside the exact ends.
            place = math.floor(along / BIN) - self._low
            self._misses[min(max(place, 0), len(self._misses) - 1)] += 1
        return is_between

    def intervals(self, max_gap: float, tolerance: float) -> FloatArray:
        """Intervals (k, 2), m, in which there is wall.

        Parameters
        ----------
        max_gap
            Longest gap between two hits that is drawn as wall if no beam has passed through it, m.
        tolerance
            Number of beams that may pass through a bin for each beam that ended in it.
        """
        if self._intervals is None or self._intervals[:2] != (max_gap, tolerance):
            self._intervals = max_gap, tolerance, self._found_intervals(max_gap, tolerance)
        return self._intervals[2]

    def _found_intervals(self, max_gap: float, tolerance: float) -> FloatArray:
        is_wall = (self._hits > 0) & (self._misses <= tolerance * self._hits)
        bins = np.nonzero(is_wall)[0]
        if not len(bins):
            return np.zeros((0, 2))
        passed = np.concatenate(([0], np.cumsum((self._misses > 0) & ~is_wall)))
        between = passed[bins[1:]] - passed[bins[:-1] + 1]
        gaps = self._least[bins[1:]] - self._most[bins[:-1]]
        cuts = np.nonzero((between > 0) | (gaps > max_gap))[0] + 1
        parts = np.split(bins, cuts)
        return np.array([(self._least[part[0]], self._most[part[-1]]) for part in parts])

    def absorb(self, other: Self, factor: float, shift: float) -> None:
        """Add another extent's counts. Its position s is ``factor`` (1 or -1) times s plus ``shift`` (m) here."""
        self._intervals = None
        middles = factor * BIN * (other._low + np.arange(len(other._hits)) + 0.5) + shift
        bins, was_hit = np.floor(middles / BIN).astype(np.int64), other._hits > 0
        self._reach(int(bins.min()), int(bins.max()))
        places = bins - self._low
        np.add.at(self._hits, places, other._hits)
        np.add.at(self._misses, places, other._misses)
        ends = np.sort(factor * np.stack((other._least, other._most))[:, was_hit] + shift, axis=0)
        np.minimum.at(self._least, places[was_hit], ends[0])
        np.maximum.at(self._most, places[was_hit], ends[1])
        self._find_ends()

    def _find_ends(self) -> None:
        self.ends = float(self._least.min()), float(self._most.max())

    def _reach(self, low: int, high: int) -> None:
        """Extend the arrays to hold the bins from ``low`` to ``high``."""
        if not len(self._hits):
            self._low = low
        before, after = max(0, self._low - low), max(0, high - (self._low + len(self._hits) - 1))
        if before or after:
            self._low -= before
            self._hits, self._misses = padded(self._hits, before, after, 0), padded(self._misses, before, after, 0)
            self._least = padded(self._least, before, after, math.inf)
            self._most = padded(self._most, before, after, -math.inf)


def padded(values: Numbers, before: int, after: int, value: float) -> Numbers:
    """The values (n,) with so many others before and after them. ``np.pad`` takes ten times as long."""
    found = np.full(before + len(values) + after, value, dtype=values.dtype)
    found[before : before + len(values)] = values
    return found
