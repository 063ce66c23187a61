"""A simulated robot behind topics of ROS 2: ``odom``, a topic for each beam, ``cmd_vel`` and
``/clock``.
"""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from limslam_agent.live.emulator.emulator import ANSWER_WITHIN, Body, SimulatedRobot
from limslam_agent.live.ros2.node import check_installed, make, message_type
from limslam_agent.output.formats.ros_builder import MessageBuilder
from limslam_env.geometry.se2 import arc, compose, wheels_to_arc

_FRAMES = ("odom", "base_link")


class RosRobot(SimulatedRobot):
    """A simulated robot that is driven by speeds, and integrates its own odometry. Its watchdog
    stops the wheels without new speeds.
    """

    begins = 1.0  # a time of zero means that there is none

    def __init__(self, body: Body, node: Any) -> None:
        from rclpy.qos import qos_profile_sensor_data

        super().__init__(body)
        self._node = node
        self._watchdog = 1e-3 * body.watchdog_ms
        self._pose = np.zeros(3)
        self._wheels = (0.0, 0.0)
        self._obeyed = 0.0
        self._has_answer = True
        self._answered = -math.inf
        node.create_subscription(message_type("geometry_msgs/msg/Twist"), "cmd_vel", self._obey, 1)

        def publisher(kind: str, topic: str) -> Any:
            return node.create_publisher(message_type(kind), topic, qos_profile_sensor_data)

        self._clock = publisher("rosgraph_msgs/msg/Clock", "/clock")
        self._odometry = publisher("nav_msgs/msg/Odometry", "odom")
        self._sensors = [
            publisher("sensor_msgs/msg/Range", f"beam_{number}")
            for number in range(len(body.robot.beams))
        ]

    @property
    def awaits_answer(self) -> bool:
        """Whether the host, if there is one, has not yet answered."""
        return not self._has_answer and time.monotonic() - self._answered < ANSWER_WITHIN + 1.0

    def step(self) -> None:
        """Drive for a control period, and publish what was measured. The robot stands still until
        somebody listens.
        """
        while not self._odometry.get_subscription_count():
            self.listen(0.05)
        if self.time - self._obeyed > self._watchdog:
            self._wheels = 0.0, 0.0
        self.drive(*self._wheels)
        moved = arc(*wheels_to_arc(self.readings.wheels[0], self.robot.axle))
        self._pose = compose(self._pose, moved)
        self._has_answer = False
        self._publish(moved / self.robot.control_period)

    def listen(self, timeout: float) -> None:
        """Obey speeds. Waits for the first ones, at most ``timeout`` s."""
        import rclpy

        rclpy.spin_once(self._node, timeout_sec=timeout)

    def _obey(self, twist: Any) -> None:
        speed = float(twist.linear.x)
        half = 0.5 * float(twist.angular.z) * self.robot.axle
        self._wheels = speed - half, speed + half
        self._obeyed = self.time
        self._has_answer = True
        self._answered = time.monotonic()

    def _publish(self, speeds: Any) -> None:
        build = MessageBuilder(make)
        now = self.time
        self._clock.publish(build.make("rosgraph_msgs/msg/Clock", clock=build.stamp(now)))
        self._odometry.publish(build.odometry(now, _FRAMES, self._pose, speeds))
        ranges = self.readings.ranges[0].tolist()
        beams = zip(self.robot.beams, ranges, self._sensors, strict=True)
        for number, (beam, reading, sensor) in enumerate(beams):
            limits = beam.min_range, beam.max_range
            sensor.publish(build.range(now, f"beam_{number}", limits, reading))


@contextmanager
def ros_robot(body: Body) -> Iterator[RosRobot]:
    """An emulated robot of ROS 2. Raises a ValueError if ROS 2 is not installed."""
    check_installed()
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield RosRobot(body, rclpy.create_node("limslam_emulator"))
    finally:
        rclpy.shutdown()
