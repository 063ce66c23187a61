"""Wheel travel from the poses of ``/odom``, and the odometry at the time of each measurement."""

import math
from typing import NamedTuple

import numpy as np

from limslam_agent.live.ros2.sensors import Ranges, Reading
from limslam_agent.logs.pose_log import LARGEST_STEP_BACK
from limslam_agent.logs.table_options import TOO_FAST
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import arc, between, compose
from limslam_env.interface import RobotSpec

KEPT = 5.0
"""Time for which poses and readings are kept, s."""

_JITTER = 0.7  # share of the period that must at least have passed between two measurements


class Sample(NamedTuple):
    """The odometry at one moment."""

    time: float  # Time of the header, s
    # Wheel travel since the first message, m
    left: float
    right: float
    pose: FloatArray  # Pose (3,) in the frame of the odometry, m, m, rad


class Measurement(NamedTuple):
    """Readings, and the odometry at the time of their measurement."""

    sample: Sample
    ranges: Ranges


class Odometer:
    """Sums the wheel travel between the poses of ``/odom``, and gives each reading the odometry of
    its own time.

    The travel between two poses is that of the arc that connects them, so lost messages lose no
    travel. A motion to the side is left out, since wheels cannot make it. Readings wait until a
    later pose has arrived. Those that follow each other faster than the period, s, are left out.

    Attributes
    ----------
    late
        Number of messages that came after a later one, or twice, or that no odometry fits. They are
        not used.
    jumps
        Number of times that the pose has jumped, as it does when a driver starts again. The travel
        of a jump is zero.
    begun
        Number of times that the time has begun again.
    """

    def __init__(self, robot: RobotSpec, period: float) -> None:
        self._robot = robot
        self._period = period
        self.late = self.jumps = self.begun = 0
        self._forget()

    def _forget(self) -> None:
        self._samples = list[Sample]()
        self._waiting = list[Reading]()
        self._last = -math.inf

    def add_pose(self, time: float, pose: FloatArray) -> list[Measurement]:
        """Take a pose (3,), m, m, rad, at a time, s. The measurements that are complete with it."""
        if self._samples and time < self._samples[-1].time - LARGEST_STEP_BACK:
            self.begun += 1
            self._forget()
        if not self._samples:
            self._samples.append(Sample(time, 0.0, 0.0, pose))
            return self._complete()
        last = self._samples[-1]
        elapsed = time - last.time
        if elapsed <= 0.0:
            self.late += 1
            return []
        left, right = wheel_travel(between(last.pose, pose), self._robot.axle)
        if max(abs(left), abs(right)) > TOO_FAST * self._robot.max_wheel_speed * (
            elapsed + self._robot.control_period
        ):
            self.jumps += 1
            left = right = 0.0
        self._samples.append(Sample(time, last.left + left, last.right + right, pose))
        self._samples = [each for each in self._samples if each.time >= time - KEPT]
        return self._complete()

    def add_reading(self, reading: Reading) -> list[Measurement]:
        """Take readings. The measurements that are complete with them."""
        if reading.time <= self._last:
            self.late += 1
            return []
        self._waiting = sorted([*self._waiting, reading], key=lambda each: each.time)
        return self._complete()

    def at(self, time: float) -> Sample | None:
        """The odometry at a time, s, between two messages. None if there is none before, or none
        after.
        """
        samples = self._samples
        if not samples or not samples[0].time <= time <= samples[-1].time:
            return None
        times = [each.time for each in samples]
        after = int(np.searchsorted(times, time))
        begin = samples[max(after - 1, 0)]
        end = samples[after]
        share = (time - begin.time) / (end.time - begin.time) if end is not begin else 0.0
        _, _, turn = between(begin.pose, end.pose)
        towards = compose(begin.pose, np.array([0.0, 0.0, share * turn]))
        towards[:2] = begin.pose[:2] + share * (end.pose - begin.pose)[:2]
        left, right = (
            first + share * (second - first)
            for first, second in zip(begin[1:3], end[1:3], strict=True)
        )
        return Sample(time, left, right, towards)

    def _complete(self) -> list[Measurement]:
        complete = []
        while self._waiting and self._samples and self._waiting[0].time <= self._samples[-1].time:
            reading = self._waiting.pop(0)
            if reading.time - self._last < _JITTER * self._period:
                continue
            sample = self.at(reading.time)
            if sample is None:  # from before the first odometry
                self.late += 1
                continue
            self._last = reading.time
            complete.append(Measurement(sample, reading.ranges))
        if self._waiting:  # the odometry may be silent
            self._waiting = [
                each for each in self._waiting if each.time >= self._waiting[-1].time - KEPT
            ]
        return complete


def wheel_travel(motion: FloatArray, axle: float) -> tuple[float, float]:
    """Travel of the left and of the right wheel, m, along the arc of a motion (3,) in the robot's
    frame, m, m, rad.
    """
    turn = float(motion[2])
    # A travel of 1 m with this turn ends here; the arc is as long as its projection on that
    # direction says.
    end = arc(1.0, turn)[:2]
    distance = float(motion[:2] @ end / (end @ end))
    return distance - 0.5 * axle * turn, distance + 0.5 * axle * turn


def map_to_odom(estimated: FloatArray, odometry: FloatArray) -> FloatArray:
    """Pose (3,) of the odometry's frame in the map, from the robot's pose in both of them."""
    return compose(estimated, between(odometry, np.zeros(3)))
