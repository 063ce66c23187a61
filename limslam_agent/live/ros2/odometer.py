"""Wheel travel from the poses of ``/odom``, at any time between two of them."""

import math
from bisect import bisect_left
from typing import NamedTuple

import numpy as np

from limslam_agent.live.recording import TOO_FAST
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import arc, between, compose
from limslam_env.interface import RobotSpec

KEPT = 5.0
"""Time for which poses are kept at least, s."""

CLOCK_SET = 1.0
"""A message whose time is earlier than that of the newest one by more than this, s, is no late message: the clock was
set, or a bag begins again.
"""

_MOST_STRAY = 5  # number of such messages in a row after which time begins again


class Sample(NamedTuple):
    """The odometry at one moment.

    Attributes
    ----------
    time
        Time of the header, s.
    left, right
        Wheel travel since the first message, m.
    pose
        Pose (3,) in the frame of the odometry, m, m, rad.
    """

    time: float
    left: float
    right: float
    pose: FloatArray


class Odometer:
    """Sums the wheel travel between the poses of ``/odom``.

    The travel between two poses is that of the arc that connects them, so lost messages lose no travel. A motion to the
    side is left out, since wheels cannot make it.

    Parameters
    ----------
    robot
        Its axle and its largest wheel speed count.

    Attributes
    ----------
    late, doubled
        Numbers of messages that came after a later one, and that came twice. They are not used.
    jumps
        Number of times that the pose has jumped, as it does when a driver starts again. The travel of a jump is zero.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self.late = self.doubled = self.jumps = self._stray = 0
        self._samples = list[Sample]()

    @property
    def newest(self) -> float:
        """Time of the newest message, s. Minus infinity before the first one."""
        return self._samples[-1].time if self._samples else -math.inf

    @property
    def has_begun_again(self) -> bool:
        """Whether the latest messages are all from a time long ago, so that their clock must have been set."""
        return self._stray >= _MOST_STRAY

    def add(self, time: float, pose: FloatArray) -> None:
        """Take a pose (3,), m, m, rad, at a time, s."""
        if not self._samples:
            self._samples.append(Sample(time, 0.0, 0.0, pose))
            return
        last = self._samples[-1]
        elapsed = time - last.time
        self._stray = self._stray + 1 if elapsed < -CLOCK_SET else 0
        if elapsed <= 0.0:
            self.doubled, self.late = self.doubled + (elapsed == 0.0), self.late + (elapsed < 0.0)
            return
        left, right = wheel_travel(between(last.pose, pose), self._robot.axle)
        if max(abs(left), abs(right)) > TOO_FAST * self._robot.max_wheel_speed * (elapsed + self._robot.control_period):
            self.jumps += 1
            left = right = 0.0
        self._samples.append(Sample(time, last.left + left, last.right + right, pose))
        if self._samples[0].time < time - 2.0 * KEPT:
            self._samples = [each for each in self._samples if each.time >= time - KEPT]

    def at(self, time: float) -> Sample | None:
        """The odometry at a time, s, between two messages. None if there is none before, or none after."""
        if not self._samples or not self._samples[0].time <= time <= self.newest:
            return None
        after = bisect_left(self._samples, time, key=lambda each: each.time)
        end = self._samples[after]
        if end.time == time:
            return end
        begin = self._samples[after - 1]
        share = (time - begin.time) / (end.time - begin.time)
        _, _, turn = between(begin.pose, end.pose)
        towards = compose(begin.pose, np.array([0.0, 0.0, share * turn]))
        towards[:2] = begin.pose[:2] + share * (end.pose - begin.pose)[:2]
        left, right = (first + share * (second - first) for first, second in zip(begin[1:3], end[1:3], strict=True))
        return Sample(time, left, right, towards)


def wheel_travel(motion: FloatArray, axle: float) -> tuple[float, float]:
    """Travel of the left and of the right wheel, m, along the arc of a motion (3,) in the robot's frame, m, m, rad."""
    turn = float(motion[2])
    # A travel of 1 m with this turn ends here; the arc is as long as its projection on that direction says.
    end = arc(1.0, turn)[:2]
    distance = float(motion[:2] @ end / (end @ end))
    return distance - 0.5 * axle * turn, distance + 0.5 * axle * turn


def map_to_odom(estimated: FloatArray, odometry: FloatArray) -> FloatArray:
    """Pose (3,) of the odometry's frame in the map, from the robot's pose in both of them."""
    return compose(estimated, between(odometry, np.zeros(3)))
