"""The latest events of a robot that reports poses of odometry: those that the next window may need."""

import math
from bisect import bisect_left

import numpy as np

from limslam_agent.slam.graph.key_poses import LogData
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import between, wrap_angle


class RecentEvents:
    """The latest events, with their numbers since the beginning.

    Attributes
    ----------
    first
        Number of the first event that is still known.
    travel, turned
        Distance driven, m, and angle turned, rad, by odometry up to the last event.
    """

    def __init__(self) -> None:
        self.first, self.travel, self.turned = 0, 0.0, 0.0
        self._times, self._travels = list[float](), list[float]()
        self._odometry, self._ranges, self._hits = list[FloatArray](), list[FloatArray](), list[BoolArray]()

    @property
    def last(self) -> int:
        """Number of the last event."""
        return self.first + len(self._times) - 1

    def append(self, time: float, odometry: FloatArray, ranges: FloatArray, hit: BoolArray) -> None:
        """Note an event: its time, s, pose of odometry (3,), ranges (b,), m, and whether each saw a wall (b,)."""
        if self._times:
            x, y, turn = between(self._odometry[-1], odometry).tolist()
            self.travel, self.turned = self.travel + math.hypot(x, y), self.turned + abs(turn)
        self._times.append(time)
        self._travels.append(self.travel)
        for events, each in ((self._odometry, odometry), (self._ranges, ranges), (self._hits, hit)):
            events.append(np.array(each))

    def at(self, travel: float) -> int:
        """Number of the first event at which this distance was driven, m, or of the last event."""
        return min(self.first + bisect_left(self._travels, travel), self.last)

    def travel_at(self, event: int) -> float:
        """Distance driven up to an event, m."""
        return self._travels[event - self.first]

    def forget_before(self, event: int) -> None:
        """Forget the events before an event."""
        old = slice(0, event - self.first)
        for events in (self._times, self._travels, self._odometry, self._ranges, self._hits):
            del events[old]
        self.first = event

    def last_motion(self, delay: float) -> FloatArray:
        """Motion (3,) by odometry of the last event, ``delay`` s before its time and that of the event before."""
        if len(self._times) < 2:
            return np.zeros(3)
        return np.asarray(between(self._odometry_at(-2, delay), self._odometry_at(-1, delay)))

    def data(self, origins: FloatArray, angles: FloatArray, max_range: float, range_std: float) -> LogData:
        """The events as a log, of beams with origins (b, 2) and directions (b,)."""
        times, odometry, hits = np.array(self._times), np.array(self._odometry), np.array(self._hits)
        return LogData(times, odometry, np.array(self._ranges), hits, origins, angles, max_range, range_std)

    def _odometry_at(self, place: int, delay: float) -> FloatArray:
        """Pose of odometry (3,) a delay before an event, by linear interpolation."""
        place += len(self._times)
        if not delay:
            return self._odometry[place]
        time = self._times[place] - delay
        after = place if delay > 0.0 else len(self._times) - 1
        while after > 1 and self._times[after - 1] >= time:
            after -= 1
        if after < 1:
            return self._odometry[place]
        begin, end = self._times[after - 1], self._times[after]
        share = min(max((time - begin) / (end - begin), 0.0), 1.0) if end > begin else 1.0
        first, second = self._odometry[after - 1], self._odometry[after]
        change = second - first
        change[2] = wrap_angle(change[2])
        return np.asarray(first + share * change)
