"""ROS 2 for tests: a domain of their own, processes in it, and a player of bags that runs as a
program.
"""

import contextlib
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

PACE = 2.5
"""How much faster than real time a bag is played."""


def environment():
    """The environment of processes on this computer that find each other, in a domain of their
    own.
    """
    domain = str(1 + os.getpid() % 100)
    return {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": domain}


def start(*words):
    """A Python program in a process of its own."""
    command = [sys.executable, *map(str, words)]
    return subprocess.Popen(
        command, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )


class Listener:
    """A node in this process that keeps the messages of topics."""

    def __init__(self, topics, *, is_kept=()):
        import rclpy
        from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
        from rclpy.qos import DurabilityPolicy, QoSProfile

        from limslam_agent.live.ros2.node import message_type

        os.environ.update(environment())
        self._context = rclpy.Context()
        rclpy.init(args=[], context=self._context)
        self.node = rclpy.create_node("listener", context=self._context)
        self.heard = {topic: [] for topic in topics}
        for topic, kind in topics.items():
            durability = (
                DurabilityPolicy.TRANSIENT_LOCAL if topic in is_kept else DurabilityPolicy.VOLATILE
            )
            quality = QoSProfile(depth=100, durability=durability)
            self.node.create_subscription(
                message_type(kind), topic, self.heard[topic].append, quality
            )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

        def spin():
            with contextlib.suppress(ExternalShutdownException):
                self._executor.spin()

        self._thread = threading.Thread(target=spin, daemon=True)
        self._thread.start()

    def publisher(self, kind, topic):
        from limslam_agent.live.ros2.node import message_type

        return self.node.create_publisher(message_type(kind), topic, 10)

    def close(self):
        self._executor.shutdown()
        self._thread.join(5.0)
        self.node.destroy_node()
        self._context.try_shutdown()


def wait_for(condition, process=None, seconds=60.0):
    """Wait until a condition holds, or fail; at once if a process that it needs has ended."""
    give_up = time.monotonic() + seconds
    while not condition():
        assert process is None or process.poll() is None, process.stdout.read()
        assert time.monotonic() < give_up, "what was waited for has not happened"
        time.sleep(0.02)


def converted(content, kind):
    """A message of a bag as one of rclpy, whose types may have more fields than those that the bag
    was written with.
    """
    message = kind()
    for name in kind.get_fields_and_field_types():
        value = getattr(content, name, None)
        if hasattr(value, "__msgtype__"):
            value = converted(value, type(getattr(message, name)))
        if value is not None:
            setattr(message, name, value)
    return message


def play(bag, pace):
    """Publish the ranges and the odometry of a bag, as soon as somebody listens to all of them."""
    import rclpy
    from rosbags.highlevel import AnyReader

    from limslam_agent.live.ros2.node import message_type

    rclpy.init(args=[])
    node = rclpy.create_node("player")
    publishers = {}
    with AnyReader([Path(bag)]) as reader:
        connections = [
            each for each in reader.connections if each.topic == "/odom" or "/beam" in each.topic
        ]
        for each in connections:
            publishers[each.topic] = node.create_publisher(
                message_type(each.msgtype), each.topic, 10
            )
        while not all(publisher.get_subscription_count() for publisher in publishers.values()):
            time.sleep(0.05)
        time.sleep(0.5)  # the subscribers find the publishers, too
        begin = time.monotonic()
        first = None
        for connection, nanoseconds, raw in reader.messages(connections):
            first = nanoseconds if first is None else first
            time.sleep(max(0.0, 1e-9 * (nanoseconds - first) / pace - (time.monotonic() - begin)))
            content = reader.deserialize(raw, connection.msgtype)
            publishers[connection.topic].publish(
                converted(content, message_type(connection.msgtype))
            )
    time.sleep(0.5)  # what has been published leaves the process
    rclpy.shutdown()


if __name__ == "__main__":
    play(sys.argv[1], float(sys.argv[2]))
