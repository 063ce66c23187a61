"""Drop-outs: readings that saw nothing because the sensor missed what was there.

Such a reading looks like free ground up to the longest range. A single reading cannot show whether
it is a drop-out. But drop-outs come one by one: a beam that saw a wall before and after, at nearly
the same range, cannot have looked past the wall in between. The share of such readings is an
estimate of the probability of a drop-out. Sensors that never miss have a share below 0.2 % in all
worlds that were tried, infrared sensors like Sharp's 0.6 %. The row "drop-out 10 %" of the
scoreboard feels the numbers below.
"""

import math

import numpy as np

from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

_RARE = 1e-4
"""A series of readings that saw nothing is believed if the sensor makes such a series with less
than this chance.
"""

_LEAST_MISSES = 5
_LEAST_SHARE = 0.02
"""Number and share of drop-outs from which on a sensor counts as one that misses walls."""


class Dropouts:
    """How frequent the drop-outs of one robot's beams are, and for how long each beam has seen
    nothing.

    Parameters
    ----------
    robot
        Its beams.

    Attributes
    ----------
    in_a_row
        How many new readings of each beam (n_beams,) in a row saw nothing.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._beams = robot.beam_table
        count = len(robot.beams)
        self._last = np.full((2, count), math.nan)
        self.in_a_row = np.zeros(count, dtype=np.int64)
        # Number of readings between two of the same wall, and how many of them saw nothing.
        self._counts = np.zeros(2, dtype=np.int64)

    def note(self, ranges: FloatArray, measured: BoolArray) -> None:
        """Take the readings (n_beams,), m, of the next step, and which of them are new."""
        from limslam_agent.kernels.readings import count_misses

        count_misses(ranges, measured, self._beams, self._last, self.in_a_row, self._counts)

    @property
    def share(self) -> float:
        """Estimated probability that a beam misses a wall; 0 while too few readings have missed
        one.
        """
        between, missed = self._counts.tolist()
        return (
            missed / between if missed >= _LEAST_MISSES and missed > _LEAST_SHARE * between else 0.0
        )

    @property
    def enough(self) -> int:
        """Number of readings in a row that saw nothing from which on there is nothing: 1 without
        drop-outs.
        """
        share = self.share
        return math.ceil(math.log(_RARE) / math.log(min(share, 0.5))) if share else 1


def short_series(nothing: BoolArray, lasting: int) -> BoolArray:
    """Which of the readings (m, n_beams) of successive steps saw nothing, but not in ``lasting``
    steps in succession.

    ``nothing`` says which of them saw nothing.
    """
    rows = np.arange(len(nothing))[:, None]
    count = len(nothing)
    last_seen = np.maximum.accumulate(np.where(nothing, -1, rows), axis=0)
    next_seen = np.minimum.accumulate(np.where(nothing, count, rows)[::-1], axis=0)[::-1]
    return nothing & (next_seen - last_seen <= lasting)


def without_dropouts(robot: RobotSpec, ranges: FloatArray, measured: BoolArray) -> BoolArray:
    """The new readings (t, n_beams) of a finished stretch that are no drop-outs.

    Parameters
    ----------
    ranges, measured
        Readings (t, n_beams), m, and which of them are new.
    """
    dropouts = Dropouts(robot)
    for row, new in zip(np.array(ranges, dtype=float), np.array(measured), strict=True):
        dropouts.note(row, new)
    kept = np.array(measured)
    for beam in range(ranges.shape[1]):
        rows = np.flatnonzero(measured[:, beam])
        nothing = (ranges[rows, beam] >= robot.too_far[beam])[:, None]
        kept[rows, beam] = ~short_series(nothing, dropouts.enough)[:, 0]
    return kept
