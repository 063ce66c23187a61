"""Readings of a robot's beams from LaserScan messages, or from Range messages of several topics."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from limslam_agent.live.protocol import NOTHING_SEEN
from limslam_agent.logs.pose_log import LARGEST_STEP_BACK, nearest_beams
from limslam_agent.logs.ros_messages import (
    beam_on_body,
    rotation_of,
    scan_angles,
    scan_readings,
    sensor_limits,
)
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.geometry.se2 import wrap_angle
from limslam_env.interface import RobotSpec, SensorSpec

Ranges = tuple[int | None, ...]
"""The reading of each beam, mm, as telemetry has it: None where there is none, ``NOTHING_SEEN``
where nothing is.
"""

_TOGETHER = 0.75  # share of a period


class Reading(NamedTuple):
    """The readings of all beams, and the time of the measurement, s."""

    time: float
    ranges: Ranges


class ScanSensors:
    """Picks the beams of a robot from LaserScans, by their directions.

    The beams of the robot say which directions are wanted, and how far to look. They begin at the
    laser's pose (3,) on the robot, m, m, rad. ``robot`` then has the beams as the messages describe
    them. It is None until there was a scan.
    """

    def __init__(self, robot: RobotSpec, mount: FloatArray) -> None:
        self.robot: RobotSpec | None = None
        self._wanted = robot
        self._mount = mount
        self._angles: FloatArray = np.zeros(0)
        self._columns: IntArray = np.zeros(0, dtype=np.int64)

    def add(self, number: int, time: float, message: Any) -> list[Reading]:
        """The readings of a scan. Raises a ValueError if the scan has no beam in a wanted
        direction.
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


class RangeSensors:
    """Collects the Range messages of several topics, one for each beam of a robot.

    Messages belong together if their times lie within three quarters of a period. Readings are
    complete when each topic has had its message, or when a message comes that does not belong to
    them. Beams without a message have no reading. The time of the readings is the median of those
    of the messages. The robot's beams are in the order of the topics. ``robot`` then has the beams
    as the messages describe them. It is None until each topic has had a message.
    """

    def __init__(self, robot: RobotSpec, period: float) -> None:
        self.robot: RobotSpec | None = None
        self._wanted = robot
        self._period = period
        self._beams = dict[int, SensorSpec]()
        self._times = dict[int, float]()
        self._ranges = dict[int, int | None]()
        self._latest = dict[int, float]()

    def add(self, number: int, time: float, message: Any) -> list[Reading]:
        """Take the message of the topic with a number. The readings that are complete now."""
        limits = float(message.min_range), float(message.max_range)
        self._describe(number, limits)
        before = self._latest.get(number, -math.inf)
        if before - LARGEST_STEP_BACK <= time <= before:  # late, or twice
            return []
        self._latest[number] = time
        times = [*self._times.values(), time]
        is_other = number in self._times or max(times) - min(times) > _TOGETHER * self._period
        done = self._collected() if is_other else []
        self._times[number], (self._ranges[number],) = time, in_mm([float(message.range)], *limits)
        return done + (self._collected() if len(self._times) == len(self._wanted.beams) else [])

    def _describe(self, number: int, limits: tuple[float, float]) -> None:
        """Learn from the first message of each topic how far its beam sees."""
        if self.robot is not None or number in self._beams:
            return
        wanted = self._wanted.beams[number]
        low, high = _limits(*limits, wanted)
        self._beams[number] = replace(wanted, min_range=low, max_range=high)
        if len(self._beams) == len(self._wanted.beams):
            self.robot = replace(
                self._wanted, beams=tuple(self._beams[each] for each in sorted(self._beams))
            )

    def _collected(self) -> list[Reading]:
        """The readings that were collected, which begin anew."""
        ranges = tuple(self._ranges.get(number) for number in range(len(self._wanted.beams)))
        reading = Reading(float(np.median([*self._times.values()])), ranges)
        self._times = {}
        self._ranges = {}
        return [reading]


def in_mm(readings: Sequence[float] | FloatArray, least: float, largest: float) -> Ranges:
    """Readings, m, of a sensor with a shortest and a longest range, m, as telemetry has them.

    As in REP 117, infinity means that nothing was seen, minus infinity that something is too near,
    and NaN that there is no reading. Readings outside of the sensor's limits mean the same as the
    infinities. Limits that are not set do not count.
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
