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
_TIMES_FASTER, _LEAST_JUMP = np.array([6.0, 10.0]), np.array([0.25, 0.5 * math.pi])
_USUAL = 0.75  # quantile of the rates of a robot that drives that counts as usual
_FEWEST = 20  # motions, without which nothing is known to be usual
_NEAR = 3  # motions before and after one that show how fast the robot is at that time
_LONGEST_EXCURSION = 1.0  # s; poses that are off the path for longer are in another frame
# A gap between two events is so many times as long as usual, and longer than this, s
_TIMES_LONGER, _LEAST_GAP = 5.0, 1.0
# In a gap, odometry has stopped counting if the robot drove before and after it, and reports less
# than this share of the distance.
_COUNTED = 0.2
# Standard deviations of the motion across a break, beside what the robot can do in its time, and
# the largest ones: m, rad
_STDS, _MOST_STDS = np.array([1.0, 0.5]), np.array([30.0, math.pi])
_MOST_NAMED = 5  # breaks in a line


@dataclass(frozen=True)
class OdometryBreak:
    """A motion between two events that odometry does not tell.

    Attributes
    ----------
    row
        The event after the break.
    begin, end
        Times of the events before and after it, s.
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
        moves, seconds = se2.between(poses[:-1], poses[1:]), np.diff(time)
        sizes = np.column_stack((np.hypot(moves[:, 0], moves[:, 1]), np.abs(moves[:, 2])))
        driving = sizes[:, 0] > 0.0
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
        large = np.flatnonzero((self.sizes > _LEAST_JUMP).any(axis=1)).tolist()
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
            if self.sizes[step, 0] < _COUNTED * speed * self.seconds[step]:
                found.append(step)
        return found

    def break_at(self, step: int, *, is_jump: bool) -> OdometryBreak:
        """The break at a motion."""
        distance, turn = self.sizes[step].tolist()
        stds = np.minimum(_STDS + self.usual * self.seconds[step], _MOST_STDS).tolist()
        ends = self.time[step : step + 2].tolist()
        return OdometryBreak(step + 1, *ends, distance, turn, is_jump, *stds)


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
    off, used = np.zeros(len(time), dtype=np.bool_), set[int]()
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


def times_without(times: FloatArray, wanted: FloatArray) -> BoolArray:
    """Which times (k,), s, lie in a gap of the times (n,) of odometry, or outside of them."""
    steps = np.diff(times)
    usual = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else math.inf
    before = np.searchsorted(times, wanted, side="right") - 1
    inside = (wanted >= times[0]) & (wanted <= times[-1])
    after = np.clip(np.searchsorted(times, wanted), 0, len(times) - 1)
    width = times[after] - times[np.maximum(before, 0)]
    return ~inside | (width > max(_LEAST_GAP, _TIMES_LONGER * usual))


def breaks_in_words(breaks: Sequence[OdometryBreak]) -> str:
    """What is known of the breaks of a log, in a sentence."""
    named = ", ".join(each.words for each in breaks[:_MOST_NAMED])
    more = f", and {counted(len(breaks) - _MOST_NAMED, 'more break')}"
    named += more if len(breaks) > _MOST_NAMED else ""
    return f"the odometry {named}: how the robot moved there is not known"
