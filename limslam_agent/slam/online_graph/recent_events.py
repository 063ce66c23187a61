"""The latest events of a robot that reports poses of odometry: those that the next window may need."""

import math
from bisect import bisect_left

import numpy as np

from limslam_agent.slam.graph.key_poses import LogData, integrate
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.geometry.se2 import between


class RecentEvents:
    """The latest events, with their numbers since the beginning.

    Attributes
    ----------
    first
        Number of the first event that is still known.
    travel, turned, backwards
        Distance driven, m, angle turned, rad, and distance driven backwards, m, by odometry up to the last event.
    """

    def __init__(self) -> None:
        self.first, self.travel, self.turned, self.backwards = 0, 0.0, 0.0, 0.0
        self._odometry: FloatArray | None = None
        self._times, self._travels = list[float](), list[float]()
        self._moves, self._ranges, self._hits = list[FloatArray](), list[FloatArray](), list[BoolArray]()

    @property
    def last(self) -> int:
        """Number of the last event."""
        return self.first + len(self._times) - 1

    def append(self, time: float, odometry: FloatArray, ranges: FloatArray, hit: BoolArray) -> None:
        """Note an event: its time, s, pose of odometry (3,), ranges (b,), m, and whether each saw a wall (b,)."""
        move = np.zeros(3) if self._odometry is None else between(self._odometry, odometry)
        self._odometry = np.array(odometry)
        self.travel += math.hypot(move[0], move[1])
        self.turned += abs(float(move[2]))
        self.backwards -= min(float(move[0]), 0.0)
        self._times.append(time)
        self._travels.append(self.travel)
        for events, each in ((self._moves, move), (self._ranges, ranges), (self._hits, hit)):
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
        for events in (self._times, self._travels, self._moves, self._ranges, self._hits):
            del events[old]
        self.first = event

    @property
    def last_motion(self) -> FloatArray:
        """Motion (3,) by odometry from the event before to the last event."""
        return self._moves[-1]

    def turn_round(self, begin: int, end: int) -> None:
        """Take the motions between two events as driven backwards."""
        for move in self._moves[begin + 1 - self.first : end + 1 - self.first]:
            move[:2] *= -1.0

    def data(self, origins: FloatArray, angles: FloatArray, max_range: float, range_std: float) -> LogData:
        """The events as a log, of beams with origins (b, 2) and directions (b,)."""
        times, hits = np.array(self._times), np.array(self._hits)
        odometry = integrate(np.zeros(3), np.array(self._moves[1:]).reshape(-1, 3))
        return LogData(times, odometry, np.array(self._ranges), hits, origins, angles, max_range, range_std)
