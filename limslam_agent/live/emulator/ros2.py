"""A simulated robot behind topics of ROS 2: ``odom``, a topic for each beam, ``cmd_vel`` and
``/clock``.
"""

import math
import time
from typing import IO, Any, NamedTuple

import numpy as np

from limslam_agent.live.emulator.emulator import ANSWER_WITHIN, LONELY_POLL, Body, SimulatedRobot
from limslam_agent.live.ros2.node import check_installed, make, message_type
from limslam_agent.output.formats.ros_builder import MessageBuilder
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import arc, compose, wheels_to_arc

_FRAMES = ("odom", "base_link")


class Measured(NamedTuple):
    """What the robot has measured: the time, s, its odometry (3,), its speeds (3,), and its ranges,
    m.
    """

    time: float
    odometry: FloatArray
    speeds: FloatArray
    ranges: list[float]


class RosRobot(SimulatedRobot):
    """A simulated robot that is driven by speeds, and integrates its own odometry. Its watchdog
    stops the wheels without new speeds.
    """

    begins = 1.0  # a time of zero means that there is none

    def __init__(self, body: Body) -> None:
        super().__init__(body)
        self._watchdog = 1e-3 * body.watchdog_ms
        self._odometry = np.zeros(3)
        self._wheels = (0.0, 0.0)
        self._obeyed = 0.0

    def obey(self, speed: float, turn_rate: float) -> None:
        """Take speeds, m/s and rad/s."""
        half = 0.5 * turn_rate * self.robot.axle
        self._wheels = speed - half, speed + half
        self._obeyed = self.time

    def step(self) -> Measured:
        """Drive for a control period, and measure."""
        if self.time - self._obeyed > self._watchdog:
            self._wheels = 0.0, 0.0
        self.drive(*self._wheels)
        moved = arc(*wheels_to_arc(self.readings.wheels[0], self.robot.axle))
        self._odometry = compose(self._odometry, moved)
        return Measured(
            self.time,
            self._odometry,
            moved / self.robot.control_period,
            self.readings.ranges[0].tolist(),
        )


def serve(robot: RosRobot, pace: float, truth: IO[str] | None) -> None:
    """Emulate for ever. A control period takes ``pace`` s, or with 0 as long as the host needs to
    answer. Raises a ValueError if ROS 2 is not installed.
    """
    check_installed()
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        Served(robot, rclpy.create_node("limslam_emulator"), pace, truth).run()
    finally:
        rclpy.shutdown()


class Served:
    """The topics of an emulated robot."""

    def __init__(self, robot: RosRobot, node: Any, pace: float, truth: IO[str] | None) -> None:
        from rclpy.qos import qos_profile_sensor_data

        self._robot = robot
        self._node = node
        self._pace = pace
        self._truth = truth
        self._build = MessageBuilder(make)
        self._answers = 0
        self._answered = -math.inf
        node.create_subscription(message_type("geometry_msgs/msg/Twist"), "cmd_vel", self._obey, 1)

        def publisher(kind: str, topic: str) -> Any:
            return node.create_publisher(message_type(kind), topic, qos_profile_sensor_data)

        self._clock = publisher("rosgraph_msgs/msg/Clock", "/clock")
        self._odometry = publisher("nav_msgs/msg/Odometry", "odom")
        count = len(robot.robot.beams)
        self._sensors = [
            publisher("sensor_msgs/msg/Range", f"beam_{number}") for number in range(count)
        ]

    def run(self) -> None:
        """Emulate for ever. The robot stands still until somebody listens."""
        import rclpy

        due = time.monotonic()
        while True:
            if not self._odometry.get_subscription_count():
                rclpy.spin_once(self._node, timeout_sec=0.05)
                due = time.monotonic()
                continue
            before = self._answers
            self._publish(self._robot.step())
            if self._truth is not None:
                self._truth.write(self._robot.truth)
            due = max(due + self._pace, time.monotonic() - self._pace)  # no attempt to catch up
            self._listen_until(before, due)

    def _listen_until(self, before: int, due: float) -> None:
        """Listen to speeds until a time, or without a fixed speed until there is an answer."""
        import rclpy

        now = time.monotonic()
        if not self._pace:
            due = now + (
                ANSWER_WITHIN if now - self._answered < ANSWER_WITHIN + 1.0 else LONELY_POLL
            )
        while (left := due - time.monotonic()) > 0.0 and (self._pace or self._answers == before):
            rclpy.spin_once(self._node, timeout_sec=left)

    def _obey(self, twist: Any) -> None:
        self._robot.obey(float(twist.linear.x), float(twist.angular.z))
        self._answers = self._answers + 1
        self._answered = time.monotonic()

    def _publish(self, measured: Measured) -> None:
        build = self._build
        at = measured.time
        self._clock.publish(build.make("rosgraph_msgs/msg/Clock", clock=build.stamp(at)))
        self._odometry.publish(build.odometry(at, _FRAMES, measured.odometry, measured.speeds))
        beams = zip(self._robot.robot.beams, measured.ranges, self._sensors, strict=True)
        for number, (beam, reading, sensor) in enumerate(beams):
            limits = beam.min_range, beam.max_range
            sensor.publish(build.range(at, f"beam_{number}", limits, reading))
