"""Wheel reports that are missing in a log: the motion across is that of the speeds around.

A wheel that drives at one speed before a gap and at another one after it has changed its speed at
an unknown time in the gap, or several times in a long one.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from limslam_agent.readings import unsteadiness
from limslam_env.geometry import BoolArray, FloatArray, IntArray
from limslam_env.interface import RobotSpec

# A robot that stands for up to so many rows, and before and after them drives at nearly the same
# speed, cannot have done so, if it drives by more than so many ticks of its encoders in a row.
_SHORT = 5
_EQUAL = 0.25
_TICKS = 3.0
_FEWEST = 5  # such reports of 0, and most of the short stops, show that reports are lost


def gaps_in(wheels: FloatArray, time: FloatArray, period: float) -> IntArray:
    """The rows (k,) before which reports of travel (t, 2), m, since the row before are missing, at
    times (t,), s, which are usually ``period`` apart.

    There are none if the travel after a gap is more than that of one row, so that it spans the gap.
    """
    rows = np.flatnonzero(np.diff(time[:-1], prepend=time[0]) > 1.5 * period)
    off = np.abs(wheels[rows] - wheels[rows + 1]).sum()
    return rows[: len(rows) * int(off < 0.5 * np.abs(wheels[rows + 1]).sum())]


def across(
    wheels: FloatArray, time: FloatArray, gaps: Sequence[int], robot: RobotSpec
) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Travel (t, 2), m, of all the time since the row before, its variances (t, 2) beyond the noise
    of encoders, m^2, and what was found, in a line.

    Reports of ``wheels`` (t, 2), at times (t,), s, that are missing are NaN, or missing with their
    rows before ``gaps``.
    """
    missing = np.zeros(len(wheels), dtype=int)
    at = np.array(gaps, dtype=int)
    missing[at] = np.rint((time[at] - time[at - 1]) / robot.control_period) - 1
    wheels = np.where(_are_impossible(wheels)[:, None], np.nan, wheels)
    is_known = np.asarray(np.isfinite(wheels).all(axis=1))
    own = np.where(is_known[:, None], wheels, 0.0)
    counts = missing + ~is_known
    travel = own.copy()
    variances = np.zeros(own.shape)
    lost = list[int]()
    for before, after in pairwise([0, *np.flatnonzero(is_known[1:]) + 1]):
        rows = slice(before + 1, after + 1)
        steps = int(counts[rows].sum())
        change = own[after] - own[before]
        if steps:
            lost.append(steps)
            travel[rows] += counts[rows, None] * 0.5 * (own[before] + own[after])
            variance = steps * (change**2 + steps * unsteadiness(robot)) / 12.0
            variances[rows] = counts[rows, None] * variance
    if not lost:
        return travel, variances, ()
    seconds = " to ".join(
        f"{robot.control_period * each:.1f}" for each in sorted({min(lost), max(lost)})
    )
    are = "s are" if sum(lost) > 1 else " is"
    note = (
        f"{sum(lost)} wheel report{are} missing or impossibly 0, in gaps of {seconds} s: the "
        "motion across them is taken from the speeds around; counters of the wheels, with "
        "--accumulated, count on"
    )
    return travel, variances, (note,)


def _are_impossible(wheels: FloatArray) -> BoolArray:
    """Which reports (t,) of travel (t, 2) are 0 although the wheels cannot have stood."""
    rows = np.flatnonzero(wheels.any(axis=1))
    sizes = np.abs(wheels[rows])
    found = np.zeros(len(wheels), dtype=np.bool_)
    gaps = np.diff(rows) - 1
    speeds = np.maximum(sizes[:-1], sizes[1:]).max(axis=1)
    tick = sizes[sizes > 0.0].min(initial=np.inf)
    short = np.flatnonzero((gaps > 0) & (gaps <= _SHORT) & (speeds > _TICKS * tick))
    changes = np.abs(np.diff(wheels[rows], axis=0)).max(axis=1)
    equal = np.count_nonzero(changes[short] < _EQUAL * speeds[short])
    if equal >= max(_FEWEST, 0.5 * len(short)):
        for each in short.tolist():
            found[rows[each] + 1 : rows[each + 1]] = True
    return found
