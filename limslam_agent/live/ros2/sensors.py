"""Readings of a robot's beams from LaserScan messages, or from Range messages of several topics."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from limslam_agent.live.protocol import NOTHING_SEEN
from limslam_agent.live.ros2.odometer import CLOCK_SET
from limslam_agent.logs.pose_log import nearest_beams
from limslam_agent.logs.ros_messages import beam_on_body, rotation_of, scan_angles, scan_readings, sensor_limits
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec, SensorSpec

Ranges = tuple[int | None, ...]
"""The reading of each beam, mm, as telemetry has it: None where there is none, ``NOTHING_SEEN`` where nothing is."""


_TOGETHER = 0.75  # share of the time between two messages of a topic
_SPACINGS = 50  # number of latest times between messages whose median counts
_SILENT = 3.0  # times between messages after which a topic is not waited for


class Reading(NamedTuple):
    """The readings of all beams, and the time of the measurement, s."""

    time: float
    ranges: Ranges


class ScanSensors:
    """Picks the beams of a robot from LaserScans, by their directions.

    Parameters
    ----------
    robot
        The robot, whose beams say which directions are wanted, and how far to look.
    mount
        Pose (3,) of the laser on the robot, m, m, rad. The beams begin there.

    Attributes
    ----------
    robot
        The robot, with the beams as the messages describe them. None until there was a scan.
    """

    def __init__(self, robot: RobotSpec, mount: FloatArray) -> None:
        self.robot: RobotSpec | None = None
        self.late = self.doubled = 0  # those of scans are found where they meet the odometry
        self._wanted, self._mount = robot, mount
        self._angles: FloatArray = np.zeros(0)
        self._columns: IntArray = np.zeros(0, dtype=np.int64)

    def add(self, number: int, time: float, message: Any) -> list[Reading]:
        """The readings of a scan.

        Raises
        ------
        ValueError
            If the scan has no beam in a wanted direction.
        """
        del number
        if self.robot is None:
            self.robot = self._chosen(message)
        readings = scan_readings(message, self._angles)
        # The beams of a turning laser are measured one after the other.
        late = float(message.time_increment) * float(self._columns.mean())
        limits = float(message.range_min), float(message.range_max)
        return [Reading(time + (late if math.isfinite(late) else 0.0), in_mm(readings, *limits))]

    def _chosen(self, message: Any) -> RobotSpec:
        angles = scan_angles(message)
        on_body = np.degrees(wrap_angle(angles + self._mount[2]))
        wanted = np.degrees(self._wanted.beam_angles)
        self._columns = np.array(nearest_beams(on_body, wanted.tolist()))
        self._angles = angles[self._columns]
        half = 0.5 * float(self._mount[2])
        place = np.array([*self._mount[:2], 0.0])
        turned = rotation_of((0.0, 0.0, math.sin(half), math.cos(half)))
        beams = []
        for angle, beam in zip(self._angles.tolist(), self._wanted.beams, strict=True):
            limits = _limits(message.range_min, message.range_max, beam)
            found = beam_on_body((turned, place), angle, limits)
            assert found is not None  # noqa: S101 (the laser lies flat)
            beams.append(replace(found, side=beam.side))
        return replace(self._wanted, beams=tuple(beams))


class _Moment:
    """Ranges of several topics that are collected, with their times."""

    def __init__(self) -> None:
        self.times, self.ranges = dict[int, float](), dict[int, int | None]()

    @property
    def time(self) -> float:
        """Median of the times, s."""
        return float(np.median([*self.times.values()]))

    @property
    def newest(self) -> float:
        """Latest of the times, s."""
        return max(self.times.values())

    def takes(self, number: int, time: float, window: float) -> bool:
        """Whether a message of the topic with a number belongs here: all times lie within ``window`` s."""
        times = [*self.times.values(), time]
        return number not in self.times and max(times) - min(times) < window


class RangeSensors:
    """Collects the Range messages of several topics, one for each beam of a robot.

    Messages belong together if their times lie within three quarters of the time between two messages of a topic.
    Topics may overtake each other. So readings are complete when each topic has had its message or a later one, which
    says that its message is lost. A topic that has been silent for a while is not waited for. Beams without a message
    have no reading. The time of the readings is the median of those of the messages.

    Parameters
    ----------
    robot
        The robot. Its beams are in the order of the topics.

    Attributes
    ----------
    robot
        The robot, with the beams as the messages describe them. None until each topic has had a message.
    late, doubled
        Numbers of messages that came after a later one, and that came twice. They are not used.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self.robot: RobotSpec | None = None
        self.late = self.doubled = 0
        self._wanted, self._beams = robot, dict[int, SensorSpec]()
        self._latest, self._last = dict[int, float](), -math.inf
        self._spacings: deque[float] = deque(maxlen=_SPACINGS)
        self._open = list[_Moment]()

    def add(self, number: int, time: float, message: Any) -> list[Reading]:
        """Take the message of the topic with a number. The readings that are complete now."""
        limits = float(message.min_range), float(message.max_range)
        self._describe(number, limits)
        before = self._latest.get(number, time)
        if number in self._latest and -CLOCK_SET <= time - before <= 0.0:
            self.doubled, self.late = self.doubled + (time == before), self.late + (time < before)
            return []
        self._latest[number] = time
        if time < before:  # the clock was set
            self._open, self._last = [], -math.inf
        if time > before:
            self._spacings.append(time - before)
        if self._spacings:
            (reading,) = in_mm([float(message.range)], *limits)
            self._collect(number, time, reading)
        return self._complete()

    def _describe(self, number: int, limits: tuple[float, float]) -> None:
        """Learn from the first message of each topic how far its beam sees."""
        if self.robot is not None or number in self._beams:
            return
        wanted = self._wanted.beams[number]
        low, high = _limits(*limits, wanted)
        self._beams[number] = replace(wanted, min_range=low, max_range=high)
        if len(self._beams) == len(self._wanted.beams):
            self.robot = replace(self._wanted, beams=tuple(self._beams[each] for each in sorted(self._beams)))

    def _collect(self, number: int, time: float, reading: int | None) -> None:
        """Put a reading to those of its moment."""
        window = _TOGETHER * self._spacing
        moment = next((each for each in self._open if each.takes(number, time, window)), None)
        if moment is None and time <= self._last:
            self.late += 1
            return
        if moment is None:
            moment = _Moment()
            self._open.append(moment)
        moment.times[number], moment.ranges[number] = time, reading

    @property
    def _spacing(self) -> float:
        """Time between two messages of a topic, s."""
        return float(np.median(self._spacings))

    def _complete(self) -> list[Reading]:
        done = []
        self._open.sort(key=lambda each: each.time)
        while self._open and not any(self._is_awaited(number, self._open[0]) for number in self._numbers):
            moment = self._open.pop(0)
            self._last = moment.newest
            done.append(Reading(moment.time, tuple(moment.ranges.get(number) for number in self._numbers)))
        return done

    @property
    def _numbers(self) -> range:
        return range(len(self._wanted.beams))

    def _is_awaited(self, number: int, moment: _Moment) -> bool:
        """Whether the message of a topic may still come."""
        latest = self._latest.get(number, -math.inf)
        if number in moment.times or latest > moment.newest:
            return False
        return max(self._latest.values()) - latest < _SILENT * self._spacing


def in_mm(readings: Sequence[float] | FloatArray, least: float, largest: float) -> Ranges:
    """Readings, m, of a sensor with a shortest and a longest range, m, as telemetry has them.

    As in REP 117, infinity means that nothing was seen, minus infinity that something is too near, and NaN that there
    is no reading. Readings outside of the sensor's limits mean the same as the infinities. Limits that are not set do
    not count.
    """
    top = largest if largest > max(least, 0.0) else math.inf
    return tuple(_in_mm(float(each), least, top) for each in readings)


def _in_mm(reading: float, least: float, top: float) -> int | None:
    if math.isnan(reading) or -math.inf < reading < 0.0:
        return None
    if reading >= top:
        return NOTHING_SEEN
    # The longest reading has its own number, whatever the unit of the sensor.
    return 0 if reading < least else min(round(1e3 * reading), NOTHING_SEEN - 1)


def _limits(least: float, largest: float, wanted: SensorSpec) -> tuple[float, float]:
    """Shortest and longest range of a beam, m: as wanted, within the limits of the sensor."""
    low, high = sensor_limits(float(least), float(largest), wanted.max_range)
    return max(low, wanted.min_range), high
