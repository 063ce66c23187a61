"""The latest events of a robot that reports poses of odometry: those that the next window may need."""

import math
from bisect import bisect_left

import numpy as np

from limslam_agent.slam.graph.key_poses import LogData
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import between


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

    @property
    def last_motion(self) -> FloatArray:
        """Motion (3,) by odometry of the last event."""
        return between(*self._odometry[-2:]) if len(self._odometry) > 1 else np.zeros(3)

    def data(self, origins: FloatArray, angles: FloatArray, max_range: float, range_std: float) -> LogData:
        """The events as a log, of beams with origins (b, 2) and directions (b,)."""
        times, odometry, hits = np.array(self._times), np.array(self._odometry), np.array(self._hits)
        return LogData(times, odometry, np.array(self._ranges), hits, origins, angles, max_range, range_std)
