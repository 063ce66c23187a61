"""The heading by the messages of an inertial measurement unit, at the time of each measurement."""

import math
from collections import deque
from typing import Any

import numpy as np

from limslam_agent.live.ros2.odometer import KEPT
from limslam_agent.logs.ros_messages import yaw_of
from limslam_env.geometry.se2 import wrap_angle

LONGEST_GAP = 0.5
"""Headings are interpolated between messages that are at most this far apart, s."""


class Headings:
    """The latest headings of Imu messages, which count on beyond a full turn.

    A message whose orientation is unknown, with -1 as the first number of its covariance, gives its
    rate of turn, which is summed up. The unit is mounted level.
    """

    def __init__(self) -> None:
        self._known: deque[tuple[float, float]] = deque()
        self._rate = 0.0

    def add(self, time: float, message: Any) -> None:
        """Take a message at a time, s. One that comes after a later one is left out.

        Raises
        ------
        ValueError
            If its orientation or its rate of turn is no finite number.
        """
        last, heading = self._known[-1] if self._known else (-math.inf, 0.0)
        if last - KEPT <= time <= last:
            return
        if not last < time <= last + KEPT:
            self._known.clear()  # the time has begun again, or the unit was silent
        if message.orientation_covariance[0] == -1.0:
            rate = float(message.angular_velocity.z)
            if not math.isfinite(rate):
                raise ValueError(f"the rate of turn is {rate:g}: not finite")
            turn = 0.5 * (self._rate + rate) * (time - last) if self._known else 0.0
            self._rate = rate
        else:
            parts = message.orientation
            yaw = yaw_of((parts.x, parts.y, parts.z, parts.w))
            turn = float(wrap_angle(yaw - heading))
        self._known.append((time, heading + turn))
        while self._known[0][0] < time - KEPT:
            self._known.popleft()

    def at(self, time: float) -> float | None:
        """The heading at a time, s, in rad; None without messages close around it."""
        times, headings = np.array(self._known).reshape(-1, 2).T
        after = int(np.searchsorted(times, time))
        if after == len(times) or (after == 0 and times[0] > time):
            return None
        if after and times[after] - times[after - 1] > LONGEST_GAP:
            return None
        return float(np.interp(time, times, headings))
