"""Puts readings and odometry together by the times of their headers."""

from bisect import insort
from typing import NamedTuple

from limslam_agent.live.ros2.odometer import Odometer, Sample
from limslam_agent.live.ros2.sensors import Ranges, Reading
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

MOST_WAITING = 50
"""Number of readings that may wait for odometry. Older ones are dropped."""

_JITTER = 0.7  # share of the period that must at least have passed between two measurements


class Measurement(NamedTuple):
    """Readings, and the odometry at the time of their measurement."""

    sample: Sample
    ranges: Ranges


class Synchroniser:
    """Gives each reading the odometry of its own time.

    Readings wait until a later message of the odometry has arrived. They leave in the order of their times.

    Parameters
    ----------
    robot
        The robot.
    period
        Time between two measurements, s. Readings that follow each other faster are left out.

    Attributes
    ----------
    begun
        Number of times that the time of the odometry has begun again.
    """

    def __init__(self, robot: RobotSpec, period: float) -> None:
        self._robot, self._period = robot, period
        self._late = self._doubled = self._jumps = self.begun = 0
        self._begin()

    def _begin(self) -> None:
        self._odometer, self._waiting = Odometer(self._robot), list[Reading]()
        self._last: float | None = None

    @property
    def late(self) -> int:
        """Number of messages that were dropped, because later ones had been used before or no odometry fits them."""
        return self._late + self._odometer.late

    @property
    def doubled(self) -> int:
        """Number of messages that came twice."""
        return self._doubled + self._odometer.doubled

    @property
    def jumps(self) -> int:
        """Number of jumps of the odometry."""
        return self._jumps + self._odometer.jumps

    def add_odometry(self, time: float, pose: FloatArray) -> list[Measurement]:
        """Take a pose (3,) of the odometry. The measurements that are complete with it."""
        self._odometer.add(time, pose)
        if self._odometer.has_begun_again:
            self._late, self._doubled, self._jumps = self.late, self.doubled, self.jumps
            self.begun += 1
            self._begin()
            self._odometer.add(time, pose)
        return self._complete()

    def add_reading(self, reading: Reading) -> list[Measurement]:
        """Take readings. The measurements that are complete with them."""
        is_double = reading.time == self._last or any(each.time == reading.time for each in self._waiting)
        if is_double:
            self._doubled += 1
        elif self._last is not None and reading.time < self._last:
            self._late += 1
        else:
            insort(self._waiting, reading, key=lambda each: each.time)
            self._late += len(self._waiting) > MOST_WAITING
            self._waiting = self._waiting[-MOST_WAITING:]
        return self._complete()

    def _complete(self) -> list[Measurement]:
        complete = []
        while self._waiting and self._waiting[0].time <= self._odometer.newest:
            reading = self._waiting.pop(0)
            if self._last is not None and reading.time - self._last < _JITTER * self._period:
                continue
            sample = self._odometer.at(reading.time)
            if sample is None:  # from before the first odometry
                self._late += 1
                continue
            self._last = reading.time
            complete.append(Measurement(sample, reading.ranges))
        return complete
