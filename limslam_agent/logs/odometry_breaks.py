"""Where the odometry poses of a log do not say how the robot moved: jumps, gaps, and poses off the
path.

A robot that is switched on again counts from zero, and a pose that a mapping program has corrected
does not follow from the pose before. What a robot can do between two events is judged by the time
between them, and by how it moves in the rest of the log.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from limslam_agent.logs.wording import listed, was
from limslam_env.geometry import BoolArray, FloatArray, IntArray, se2
from limslam_env.messages import counted

# A motion is a jump if it is so many times as fast as usual, and longer than this (m, rad). On
# ``csail``, up to 3.8 times the usual distance and 12 times the usual turn lie between two scans.
_TIMES_FASTER = np.array([6.0, 10.0])
_LEAST_JUMP = np.array([0.25, 0.5 * math.pi])
_USUAL = 0.75  # quantile of the rates of a robot that drives that counts as usual
_FEWEST = 20  # motions, without which nothing is known to be usual
_ROUNDING = 1e-6  # m; a robot that stands moves by less
_NEAR = 3  # motions before and after one that show how fast the robot is at that time
_LONGEST_EXCURSION = 1.0  # s; poses that are off the path for longer are in another frame
# A gap between two events is so many times as long as usual, and longer than this, s
_TIMES_LONGER = 5.0
_LEAST_GAP = 1.0
# In a gap, odometry has stopped counting if the robot drove before and after it, and reports less
# than this share of the distance.
_COUNTED = 0.2
# A robot stands where its pose changes by less (m, m, rad), and its readings by less (m).
_STANDING = np.array([0.01, 0.01, math.radians(1.0)])
_SAME_RANGE = 0.1
# Standard deviations of the motion across a break, beside what the robot can do in its time, and
# the largest ones: m, rad
_STDS = np.array([1.0, 0.5])
_MOST_STDS = np.array([30.0, math.pi])
_MOST_NAMED = 5  # breaks in a line

Numbers = FloatArray | IntArray


@dataclass(frozen=True, eq=False)
class OdometryBreak:
    """A motion between two events that odometry does not tell.

    Attributes
    ----------
    row
        The event after the break.
    begin, end
        Times of the events before and after it, s from the beginning of the log.
    distance, turn
        Size of the motion that odometry reports, m and rad.
    is_jump
        Whether the robot cannot have moved so. Otherwise the motion is possible, and nothing
        confirms it.
    stds
        Standard deviations (3,) of the motion across the break: along, across, and of the heading,
        m and rad.
    """

    row: int
    begin: float
    end: float
    distance: float
    turn: float
    is_jump: bool
    stds: FloatArray

    @property
    def words(self) -> str:
        """The break in words, such as ``jumps by 5.53 m at 45.0 s``."""
        size = f"{self.distance:.2f} m and {math.degrees(self.turn):.0f} deg"
        if self.is_jump:
            return f"jumps by {size} at {self.end:.1f} s"
        return f"has a gap of {self.end - self.begin:.1f} s at {self.begin:.1f} s, over {size}"


class _Motions:
    """The motions between successive events at times (n,), s, with poses (n, 3).

    ``sizes`` (n - 1, 2) are m and rad. ``period`` is the usual time between two events, s, and
    ``usual`` (2,) the usual speed, m/s, and turn rate, rad/s, of the robot while it drives:
    infinite where there are too few motions to show it.
    """

    def __init__(self, time: FloatArray, poses: FloatArray) -> None:
        moves = se2.between(poses[:-1], poses[1:])
        self.time = time
        self.sizes = np.column_stack((np.hypot(moves[:, 0], moves[:, 1]), np.abs(moves[:, 2])))
        self.seconds = np.diff(time)
        steps = self.seconds[self.seconds > 0.0]
        self.period = float(np.median(steps)) if len(steps) else math.inf
        self.rates = self.sizes / np.maximum(self.seconds, self.period)[:, None]
        driving = self.sizes[:, 0] > _ROUNDING
        self.usual: FloatArray = np.full(2, math.inf)
        if np.count_nonzero(driving) >= _FEWEST and len(steps):
            self.usual = np.quantile(self.rates[driving], _USUAL, axis=0)

    def rates_near(self, step: int) -> FloatArray:
        """Speed, m/s, and turn rate, rad/s, (2,) shortly before and after a motion: medians."""
        near = np.r_[max(step - _NEAR, 0) : step, step + 1 : step + 1 + _NEAR]
        return np.asarray(np.median(self.rates[near[near < len(self.rates)]], axis=0))

    def is_jump(self, size: FloatArray, seconds: float, near: FloatArray) -> bool:
        """Whether the robot cannot have moved by a size (2,) in a time, by the rates at that
        time (2,).
        """
        most = _TIMES_FASTER * np.maximum(self.usual, near) * max(seconds, self.period)
        return bool(((size > most) & (size > _LEAST_JUMP)).any())

    def jumps(self) -> list[int]:
        """The motions that the robot cannot have made."""
        lasted = np.maximum(self.seconds, self.period)[:, None]
        most = np.maximum(_TIMES_FASTER * self.usual * lasted, _LEAST_JUMP)
        return [
            step
            for step in np.flatnonzero((self.sizes > most).any(axis=1)).tolist()
            if self.is_jump(self.sizes[step], float(self.seconds[step]), self.rates_near(step))
        ]

    def long(self) -> list[int]:
        """The motions that last much longer than usual."""
        return np.flatnonzero(self.seconds > max(_LEAST_GAP, _TIMES_LONGER * self.period)).tolist()

    def is_uncounted(self, step: int) -> bool:
        """Whether the robot drove in a long motion, and odometry did not count."""
        speed = min(self.rates_near(step)[0], self.usual[0])
        reported = self.sizes[step, 0] / self.seconds[step]
        return bool(reported < _COUNTED * speed and speed > _COUNTED * self.usual[0])

    def break_at(self, step: int, *, is_jump: bool) -> OdometryBreak:
        """The break at a motion."""
        stds = np.minimum(_STDS + self.usual * self.seconds[step], _MOST_STDS)[[0, 0, 1]]
        begin, end = (self.time[step : step + 2] - self.time[0]).tolist()
        distance, turn = self.sizes[step].tolist()
        return OdometryBreak(step + 1, begin, end, distance, turn, is_jump, stds)


def odometry_breaks(
    time: FloatArray, poses: FloatArray, gaps: Sequence[int] = ()
) -> tuple[OdometryBreak, ...]:
    """The breaks of odometry poses (n, 3), m and rad, at times (n,), s.

    ``gaps`` are events before which there was no odometry for a while, by a reader that knows more
    than the times of the events.
    """
    motions = _Motions(time, poses)
    if np.isinf(motions.usual).any():
        return ()
    jumps = set(motions.jumps())
    uncounted = (step for step in motions.long() if motions.is_uncounted(step))
    steps = jumps.union(uncounted, (row - 1 for row in gaps))
    return tuple(motions.break_at(step, is_jump=step in jumps) for step in sorted(steps))


def without_excursions(time: FloatArray, poses: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Odometry poses (n, 3) without those that are off the path for a moment, and what was
    replaced, in a line.

    A pose of another program that is mixed in jumps away, and the next pose of odometry jumps back
    to the path. Such poses are interpolated.
    """
    motions = _Motions(time, poses)
    off = np.zeros(len(time), dtype=np.bool_)
    used = set[int]()
    # The shortest excursions first: what lies between two of them is the path.
    for first, last in sorted(pairwise(motions.jumps()), key=lambda ends: ends[1] - ends[0]):
        seconds = float(time[last + 1] - time[first])
        if used & {first, last} or seconds > _LONGEST_EXCURSION:
            continue
        across = se2.between(poses[first], poses[last + 1])
        size = np.array([math.hypot(across[0], across[1]), abs(float(across[2]))])
        if not motions.is_jump(size, seconds, motions.usual):
            off[first + 1 : last + 1] = True
            used |= {first, last}
    rows = np.flatnonzero(off)
    if not len(rows):
        return poses, ()
    mended = poses.copy()
    mended[off] = _interpolated(np.flatnonzero(~off), poses[~off], rows)
    mended[:, 2] = se2.wrap_angle(mended[:, 2])
    replaced = counted(len(rows), "odometry pose")
    note = (
        f"{replaced}, the first one at {time[rows[0]] - time[0]:.1f} s, {was(len(rows))} off the "
        "path for a moment, and replaced: are poses of two programs mixed?"
    )
    return mended, (note,)


def _interpolated(times: Numbers, poses: FloatArray, wanted: Numbers) -> FloatArray:
    """The poses (k, 3) at wanted times (k,), of poses (n, 3) at rising times (n,)."""
    columns = (*poses[:, :2].T, np.unwrap(poses[:, 2]))
    return np.column_stack([np.interp(wanted, times, column) for column in columns])


class SilentTimes(NamedTuple):
    """The times in which odometry does not tell where the robot was: begin and end (g, 2) of each,
    s.
    """

    spans: FloatArray

    def hold(self, wanted: FloatArray) -> BoolArray:
        """Which times (k,), s, are silent."""
        begin, end = self.spans.T[:, :, None]
        return np.asarray(((wanted > begin) & (wanted < end)).any(axis=0))

    def events_after(self, time: FloatArray) -> list[int]:
        """The first event after each silent time, of events at times (n,), s."""
        rows = [int(np.argmax(time >= end)) for end in self.spans[:, 1] if time[-1] >= end]
        return sorted({row for row in rows if row > 0})

    def notes(self, wanted: FloatArray) -> tuple[str, ...]:
        """How many scans at times (k,), s, are left out, in a line."""
        count = int(self.hold(wanted).sum())
        if not count:
            return ()
        spans = (self.spans - wanted[0]).tolist()
        where = listed([f"{begin:.1f} to {end:.1f} s" for begin, end in spans], _MOST_NAMED)
        scans = counted(count, "scan")
        return (f"{scans} without odometry {was(count)} left out, from {where}",)


class OdometryStream:
    """Odometry poses (n, 3), m and rad, at rising times (n,), s, of their own, without those that
    are off the path.
    """

    def __init__(self, times: FloatArray, poses: FloatArray) -> None:
        self.times = times
        self.poses, self.notes = without_excursions(times, poses)

    def at(self, wanted: FloatArray) -> FloatArray:
        """The poses (k, 3) at times (k,), s, by linear interpolation."""
        return _interpolated(self.times, self.poses, wanted)

    def silent_times(self, scan_times: FloatArray, ranges: FloatArray) -> SilentTimes:
        """The times between poses that do not follow from each other, beside scans (k, n_beams), m,
        at times (k,), s.

        Some drivers send no pose while the robot stands. Then neither pose nor readings change.
        """
        motions = _Motions(self.times, self.poses)
        steps = set(motions.jumps())
        for step in motions.long():
            begin, end = self.times[step : step + 2]
            moved = np.abs(se2.between(self.poses[step], self.poses[step + 1]))
            during = ranges[(scan_times >= begin) & (scan_times <= end)]
            during = during[:, np.isfinite(during).all(axis=0)]
            changed = float(np.median(np.ptp(during, axis=0))) if during.size else 0.0
            if (moved > _STANDING).any() or changed > _SAME_RANGE:
                steps.add(step)
        spans = [self.times[step : step + 2] for step in sorted(steps)]
        return SilentTimes(np.array(spans).reshape(-1, 2))


def breaks_in_words(breaks: Sequence[OdometryBreak]) -> str:
    """What is known of the breaks of a log, in a sentence."""
    words = listed([each.words for each in breaks], _MOST_NAMED)
    return f"the odometry {words}: how the robot moved there is not known"
