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

import numpy as np

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


@dataclass(frozen=True)
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
    position_std, heading_std
        Standard deviations of the motion across the break, m and rad.
    """

    row: int
    begin: float
    end: float
    distance: float
    turn: float
    is_jump: bool
    position_std: float
    heading_std: float

    @property
    def stds(self) -> FloatArray:
        """Standard deviations (3,) of the motion: along, across, and of the heading, m and rad."""
        return np.array([self.position_std, self.position_std, self.heading_std])

    @property
    def words(self) -> str:
        """The break in words, such as ``jumps by 5.53 m at 45.0 s``."""
        size = f"{self.distance:.2f} m and {math.degrees(self.turn):.0f} deg"
        if self.is_jump:
            return f"jumps by {size} at {self.end:.1f} s"
        return f"has a gap of {self.end - self.begin:.1f} s at {self.begin:.1f} s, over {size}"


@dataclass(frozen=True, eq=False)
class _Motions:
    """The motions between successive events of a log."""

    time: FloatArray  # (n,), s
    sizes: FloatArray  # (n - 1, 2), m and rad
    seconds: FloatArray  # (n - 1,)
    period: float  # usual time between two events, s
    usual: FloatArray  # (2,): usual speed, m/s, and turn rate, rad/s, of the robot while it drives

    @classmethod
    def of(cls, time: FloatArray, poses: FloatArray) -> "_Motions | None":
        """The motions of poses (n, 3); None if they are too few to show what is usual."""
        moves = se2.between(poses[:-1], poses[1:])
        seconds = np.diff(time)
        sizes = np.column_stack((np.hypot(moves[:, 0], moves[:, 1]), np.abs(moves[:, 2])))
        driving = sizes[:, 0] > _ROUNDING
        if np.count_nonzero(driving) < _FEWEST or not (seconds > 0.0).any():
            return None
        period = float(np.median(seconds[seconds > 0.0]))
        rates = sizes[driving] / np.maximum(seconds[driving], period)[:, None]
        return cls(time, sizes, seconds, period, np.quantile(rates, _USUAL, axis=0))

    def rates_near(self, step: int) -> FloatArray:
        """Speed, m/s, and turn rate, rad/s, (2,) shortly before and after a motion: medians."""
        near = np.r_[max(step - _NEAR, 0) : step, step + 1 : step + 1 + _NEAR]
        near = near[near < len(self.sizes)]
        rates = self.sizes[near] / np.maximum(self.seconds[near], self.period)[:, None]
        return np.asarray(np.median(rates, axis=0))

    def is_jump(self, size: FloatArray, seconds: float, near: FloatArray) -> bool:
        """Whether the robot cannot have moved by a size (2,) in a time, by the rates at that
        time (2,).
        """
        most = _TIMES_FASTER * np.maximum(self.usual, near) * max(seconds, self.period)
        return bool(((size > most) & (size > _LEAST_JUMP)).any())

    def jumps(self) -> list[int]:
        """The motions that the robot cannot have made."""
        lasted = np.maximum(self.seconds, self.period)[:, None]
        is_fast = self.sizes > _TIMES_FASTER * self.usual * lasted
        large = np.flatnonzero((is_fast & (self.sizes > _LEAST_JUMP)).any(axis=1)).tolist()
        return [
            step
            for step in large
            if self.is_jump(self.sizes[step], float(self.seconds[step]), self.rates_near(step))
        ]

    def uncounted(self) -> list[int]:
        """The gaps in which the robot drove and odometry did not count."""
        least = max(_LEAST_GAP, _TIMES_LONGER * self.period)
        found = []
        for step in np.flatnonzero(self.seconds > least).tolist():
            speed = float(min(self.rates_near(step)[0], self.usual[0]))
            reported = self.sizes[step, 0] / self.seconds[step]
            if reported < _COUNTED * speed and speed > _COUNTED * self.usual[0]:
                found.append(step)
        return found

    def break_at(self, step: int, *, is_jump: bool) -> OdometryBreak:
        """The break at a motion."""
        distance, turn = self.sizes[step].tolist()
        position_std, heading_std = np.minimum(
            _STDS + self.usual * self.seconds[step], _MOST_STDS
        ).tolist()
        begin, end = (self.time[step : step + 2] - self.time[0]).tolist()
        return OdometryBreak(
            step + 1, begin, end, distance, turn, is_jump, position_std, heading_std
        )


def odometry_breaks(
    time: FloatArray, poses: FloatArray, gaps: Sequence[int] = ()
) -> tuple[OdometryBreak, ...]:
    """The breaks of odometry poses (n, 3), m and rad, at times (n,), s.

    ``gaps`` are events before which there was no odometry for a while, by a reader that knows more
    than the times of the events.
    """
    motions = _Motions.of(time, poses)
    if motions is None:
        return ()
    jumps = set(motions.jumps())
    steps = jumps.union(motions.uncounted(), (row - 1 for row in gaps))
    return tuple(motions.break_at(step, is_jump=step in jumps) for step in sorted(steps))


def without_excursions(time: FloatArray, poses: FloatArray) -> tuple[FloatArray, IntArray]:
    """Odometry poses (n, 3) without those that are off the path for a moment, and their events.

    A pose of another program that is mixed in jumps away, and the next pose of odometry jumps back
    to the path. Such poses are interpolated.
    """
    motions = _Motions.of(time, poses)
    jumps = [] if motions is None else motions.jumps()
    off = np.zeros(len(time), dtype=np.bool_)
    used = set[int]()
    # The shortest excursions first: what lies between two of them is the path.
    for first, last in sorted(pairwise(jumps), key=lambda ends: ends[1] - ends[0]):
        seconds = float(time[last + 1] - time[first])
        if motions is None or used & {first, last} or seconds > _LONGEST_EXCURSION:
            continue
        across = se2.between(poses[first], poses[last + 1])
        size = np.array([math.hypot(across[0], across[1]), abs(float(across[2]))])
        if not motions.is_jump(size, seconds, motions.usual):
            off[first + 1 : last + 1] = True
            used |= {first, last}
    rows = np.flatnonzero(off)
    if not len(rows):
        return poses, rows
    mended = poses.copy()
    turns = np.unwrap(poses[~off, 2])
    for column, values in enumerate((*poses[~off, :2].T, turns)):
        mended[off, column] = np.interp(rows, np.flatnonzero(~off), values)
    mended[:, 2] = se2.wrap_angle(mended[:, 2])
    return mended, rows


@dataclass(frozen=True, eq=False)
class SilentTimes:
    """The times in which odometry does not tell where the robot was.

    Attributes
    ----------
    spans
        Begin and end (g, 2) of each, s.
    """

    spans: FloatArray

    def hold(self, wanted: FloatArray) -> BoolArray:
        """Which times (k,), s, are silent."""
        found: BoolArray = np.zeros(len(wanted), dtype=np.bool_)
        for begin, end in self.spans.tolist():
            found |= (wanted > begin) & (wanted < end)
        return found

    def events_after(self, time: FloatArray) -> list[int]:
        """The first event after each silent time, of events at times (n,), s."""
        rows = [int(np.argmax(time >= end)) for end in self.spans[:, 1] if time[-1] >= end]
        return sorted({row for row in rows if row > 0})

    def notes(self, wanted: FloatArray) -> tuple[str, ...]:
        """How many scans at times (k,), s, are left out, in a line."""
        count = int(self.hold(wanted).sum())
        if not count:
            return ()
        spans = (self.spans[:_MOST_NAMED] - wanted[0]).tolist()
        where = ", ".join(f"{begin:.1f} to {end:.1f} s" for begin, end in spans)
        were = "were" if count > 1 else "was"
        return (f"{counted(count, 'scan')} without odometry {were} left out, from {where}",)


@dataclass(frozen=True, eq=False)
class OdometryStream:
    """Odometry poses (n, 3), m and rad, at rising times (n,), s, of their own."""

    times: FloatArray
    poses: FloatArray
    notes: tuple[str, ...]

    @classmethod
    def of(cls, times: FloatArray, poses: FloatArray) -> "OdometryStream":
        """The stream without poses that are off the path."""
        poses, off = without_excursions(times, poses)
        return cls(times, poses, excursions_in_words(times, off))

    def at(self, wanted: FloatArray) -> FloatArray:
        """The poses (k, 3) at times (k,), s, by linear interpolation."""
        columns = (*self.poses[:, :2].T, np.unwrap(self.poses[:, 2]))
        return np.column_stack([np.interp(wanted, self.times, column) for column in columns])

    def silent_times(self, scan_times: FloatArray, ranges: FloatArray) -> SilentTimes:
        """The times between poses that do not follow from each other, beside scans (k, n_beams), m,
        at times (k,), s.

        Some drivers send no pose while the robot stands. Then neither pose nor readings change.
        """
        steps = np.diff(self.times)
        motions = _Motions.of(self.times, self.poses)
        period = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else math.inf
        long = np.flatnonzero(steps > max(_LEAST_GAP, _TIMES_LONGER * period))
        gaps = [step for step in long.tolist() if self._may_move_in(step, scan_times, ranges)]
        found = sorted({*gaps, *([] if motions is None else motions.jumps())})
        spans = np.array([self.times[step : step + 2] for step in found])
        return SilentTimes(spans.reshape(-1, 2))

    def _may_move_in(self, step: int, scan_times: FloatArray, ranges: FloatArray) -> bool:
        """Whether the robot may have moved between a pose and the next one, by both and by the
        scans.
        """
        begin, end = self.times[step : step + 2]
        moved = np.abs(se2.between(self.poses[step], self.poses[step + 1]))
        during = ranges[(scan_times >= begin) & (scan_times <= end)]
        during = during[:, np.isfinite(during).all(axis=0)]
        changed = float(np.median(np.ptp(during, axis=0))) if during.size else 0.0
        return bool((moved > _STANDING).any() or changed > _SAME_RANGE)


def excursions_in_words(time: FloatArray, off: IntArray) -> tuple[str, ...]:
    """Which events (k,) at times (n,), s, had poses off the path, in a line."""
    if not len(off):
        return ()
    poses = f"{counted(len(off), 'odometry pose')}, the first one at {time[off[0]] - time[0]:.1f} s"
    were = "were" if len(off) > 1 else "was"
    question = "are poses of two programs mixed?"
    return (f"{poses}, {were} off the path for a moment, and replaced: {question}",)


def breaks_in_words(breaks: Sequence[OdometryBreak]) -> str:
    """What is known of the breaks of a log, in a sentence."""
    named = ", ".join(each.words for each in breaks[:_MOST_NAMED])
    more = f", and {counted(len(breaks) - _MOST_NAMED, 'more break')}"
    named += more if len(breaks) > _MOST_NAMED else ""
    return f"the odometry {named}: how the robot moved there is not known"
