"""The connection of a session to a robot of ROS 2: messages of topics in, speeds out."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np

from limslam_agent.live.link import POLL, Connection, NoRobotError
from limslam_agent.live.protocol import (
    VERSION,
    Command,
    Heartbeat,
    Hello,
    Message,
    Speeds,
    Stop,
    Telemetry,
)
from limslam_agent.live.recording import MM
from limslam_agent.live.ros2.headings import Headings
from limslam_agent.live.ros2.node import IMU, ODOMETRY, Event, Parameters, RosNode
from limslam_agent.live.ros2.odometer import Measurement, Odometer, Sample
from limslam_agent.live.ros2.sensors import RangeSensors, ScanSensors
from limslam_agent.logs.ros_messages import pose_of
from limslam_env.geometry.se2 import wheels_to_arc
from limslam_env.interface import RobotSpec

_MICROMETRE = 1e-6
_FIRST = 5  # number of measurements that show the period


class RosLink(Connection):
    """Makes telemetry of the messages of ROS, and speeds of commands. No message says which command
    was obeyed.

    ``robot`` describes the robot, with the beams that are wanted.

    Attributes
    ----------
    newest
        The odometry at the newest measurement. None before the first one.
    frames
        Names of the frames of the odometry and of the robot, from the messages of the odometry.
    """

    def __init__(
        self,
        ports: RosNode,
        robot: RobotSpec,
        parameters: Parameters,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(clock)
        self.newest: Sample | None = None
        self.frames = ("odom", "base_link")
        self._ports = ports
        self._robot = robot
        self._parameters = parameters
        self._sensors: RangeSensors | ScanSensors = (
            RangeSensors(robot, parameters.period)
            if parameters.range_topics
            else ScanSensors(robot, parameters.mount)
        )
        self._odometer = Odometer(robot, parameters.period)
        self._headings = Headings()
        self._row = self._stops = 0
        self._hello: Hello | None = None
        self._ready = list[Message]()
        self._heard = set[int]()
        self._trouble = ""

    @property
    def late(self) -> int:
        """Number of messages that came too late to be used, or twice."""
        return self._odometer.late

    @property
    def jumps(self) -> int:
        """Number of jumps of the odometry."""
        return self._odometer.jumps

    @property
    def robot(self) -> RobotSpec:
        """The robot, with the beams as the messages describe them. It is known after
        :meth:`first_hello`.
        """
        return self._sensors.robot or self._robot

    def first_hello(self, patience: float) -> Hello:
        """Wait until sensors and odometry have shown the period. Raises a NoRobotError after
        ``patience`` s without a new measurement: topics are found one after the other, and on a
        busy computer the first messages come slowly.
        """
        since = self.clock()
        found = list[Measurement]()
        while len(found) < _FIRST or self._sensors.robot is None:
            if self.clock() - since > patience:
                raise NoRobotError(f"within {patience:g} s {self._missing(found)}")
            for event in self._ports.take(POLL):
                if measurements := self._measurements(event):
                    found += measurements
                    since = self.clock()
        steps = [after.sample.time - before.sample.time for before, after in pairwise(found)]
        period, watchdog = (
            max(1, round(1e3 * each)) for each in (np.median(steps), self._parameters.watchdog)
        )
        self._hello = Hello(VERSION, 0, "ros2", len(self.robot.beams), 1000, period, watchdog)
        self._ready = [self._telemetry(each) for each in found]
        return self._hello

    def receive(self, timeout: float) -> list[Message]:
        """The telemetry that is complete, and a hello where time has begun again."""
        messages = self._ready
        self._ready = []
        for event in self._ports.take(0.0 if messages else timeout):
            begun = self._odometer.begun
            measurements = self._measurements(event)
            if self._odometer.begun > begun and self._hello is not None:
                messages.append(replace(self._hello, boot=self._odometer.begun))
            messages += [self._telemetry(each) for each in measurements]
        return messages

    def send(self, command: Command) -> None:
        """Publish the speeds of a command."""
        if isinstance(command, Heartbeat):
            self._ports.hold()
        if isinstance(command, Speeds | Stop):
            left, right = (command.left, command.right) if isinstance(command, Speeds) else (0, 0)
            self._ports.drive(*wheels_to_arc(MM * np.array([left, right]), self._robot.axle))
            self._stops = self._ports.watchdog_stops

    def greet(self) -> None:
        """Do nothing: topics are found again by ROS itself."""

    def _measurements(self, event: Event) -> list[Measurement]:
        """The measurements that are complete with a message."""
        self._heard.add(event.number)
        try:
            if event.number == ODOMETRY:
                self.frames = (
                    event.message.header.frame_id or "odom",
                    event.message.child_frame_id or "base_link",
                )
                return self._odometer.add_pose(event.time, np.array(pose_of(event.message)))
            if event.number == IMU:
                self._headings.add(event.time, event.message)
                return []
            readings = self._sensors.add(event.number, event.time, event.message)
        except ValueError as error:
            self.bad_lines += 1
            self._trouble = str(error)
            return []
        return [each for reading in readings for each in self._odometer.add_reading(reading)]

    def _telemetry(self, measurement: Measurement) -> Telemetry:
        sample = self.newest = measurement.sample
        self._row += 1
        left, right = (round(travel / _MICROMETRE) for travel in (sample.left, sample.right))
        stopped = int(self._ports.watchdog_stops > self._stops)
        heading = self._headings.at(sample.time)
        return Telemetry(
            self._row,
            round(1e3 * sample.time),
            left,
            right,
            0,
            stopped,
            measurement.ranges,
            None if heading is None else round(1e3 * math.degrees(heading)),
        )

    def _missing(self, found: list[Measurement]) -> str:
        """What has not been heard, in words."""
        topics = dict(enumerate(self._parameters.range_topics or ("scan",))) | {ODOMETRY: "odom"}
        silent = [name for number, name in topics.items() if number not in self._heard]
        if silent:
            return f"there was no message on {', '.join(silent)}"
        if self._trouble:
            return f"no message could be used: {self._trouble}"
        return (
            f"the times of sensors and odometry gave {len(found)} measurements: are both stamped "
            "by the same clock?"
        )
