"""The node of rclpy: its parameters, its topics, a thread that listens, and a watchdog that stops
the wheels.
"""

import importlib
import math
import queue
import threading
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from importlib.util import find_spec
from typing import Annotated, Any, NamedTuple

import numpy as np

from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.tables import updated
from limslam_agent.live.orders import Orders
from limslam_agent.logs.ros_messages import stamp_of
from limslam_agent.output.formats.ros_builder import MessageBuilder
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

PACKAGES = (
    "rclpy",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "sensor_msgs",
    "std_msgs",
    "visualization_msgs",
)
"""What a node needs of ROS 2. ``tf2_msgs`` is used where it is installed."""

BEGIN = "--ros-args"
"""What arguments for ROS begin with."""

STOPPED = "stopped: a message on explore/stop"

_OF_RCLPY = ("use_sim_time", "start_type_description_service", "qos_overrides.")
_DEPTH = 50  # number of messages that wait for a busy host


_Time = Annotated[float, Bounds(0.0, 60.0)]

ODOMETRY = -1
IMU = -2
"""Numbers that stand for the odometry and the Imu where others stand for the topics of the ranges.
"""


@dataclass(frozen=True)
class Parameters(Bounded):
    """Parameters of the node, as users of ROS set them: ``-p NAME:=VALUE``."""

    # A topic of Range messages for each beam of the robot, in the order of the beams. None: the
    # topic ``scan`` has LaserScans.
    range_topics: tuple[str, ...] = ()
    # Pose of the laser on the robot: x (m), y (m), heading (deg)
    scan_mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    imu_topic: str = ""  # Topic of Imu messages, for the heading. None without a name.
    period: _Time = (
        0.1  # Time between two measurements that are used, s. Faster sensors are thinned out.
    )
    # Time after the latest decision after which the wheels are stopped, s
    watchdog: Annotated[float, Bounds(0.05, 60.0)] = 0.5
    map_period: _Time = 1.0  # Time between two publications of the map, s
    # Names of the frames. Without a name, the frame is that of the odometry's messages.
    map_frame: str = "map"
    odom_frame: str = ""
    transform_tolerance: _Time = (
        0.5  # By how much the transform from ``map_frame`` to ``odom_frame`` is dated ahead, s
    )
    publish_tf: bool = True  # Whether to publish this transform on ``/tf``
    # Whether to explore from the start. If not, the robot maps until ``explore/resume`` says true.
    explore: bool = True
    return_to_init: bool = False  # Whether to drive back to the start when everything is explored
    enable_stamped_cmd_vel: bool = False  # Whether ``cmd_vel`` has TwistStamped messages

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "Parameters":
        """The parameters from the values of a node. Names that are missing keep their defaults.
        Raises a ValueError if there is no such parameter, or a value cannot be used.
        """
        # ROS has arrays of numbers where a file of settings has lists.
        lists = {
            name: list(value) if isinstance(value, array) else value
            for name, value in values.items()
        }
        return updated(cls(), lists, "the parameters of the node")

    @property
    def mount(self) -> FloatArray:
        """Pose (3,) of the laser on the robot, m, m, rad."""
        x, y, degrees = self.scan_mount
        return np.array([x, y, math.radians(degrees)])

    def check(self, robot: RobotSpec) -> None:
        """Raise a ValueError if there is not one topic of ranges for each beam."""
        if self.range_topics and len(self.range_topics) != len(robot.beams):
            raise ValueError(
                f"range_topics has {len(self.range_topics)} topics, but the robot has "
                f"{len(robot.beams)} beams"
            )


class Event(NamedTuple):
    """A message of the topic with a number, and its time, s."""

    number: int
    time: float
    message: Any


class RosNode:
    """A node of rclpy with the topics of a live robot. Its messages are taken by another thread
    than the one that listens. ``watchdog_stops`` is the number of times that the watchdog has
    stopped the wheels.
    """

    def __init__(self, node: Any) -> None:
        self._node = node
        self.build = MessageBuilder(make)
        self.parameters = Parameters.of(_set_parameters(node))
        self.orders = Orders(
            is_paused=not self.parameters.explore,
            when_explored="home" if self.parameters.return_to_init else "end",
        )
        self.watchdog_stops = 0
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._decided = 0.0
        self._is_moving = False
        self._latest: Any = None
        self._subscribe()
        stamped = self.parameters.enable_stamped_cmd_vel
        self._speeds = self.publisher(
            f"geometry_msgs/msg/Twist{'Stamped' if stamped else ''}", "cmd_vel", depth=1
        )
        from rclpy.clock import Clock, ClockType

        # The time of ROS may stand still. The watchdog's does not.
        node.create_timer(
            0.2 * self.parameters.watchdog,
            self._watch,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def take(self, timeout: float) -> list[Event]:
        """The messages that have arrived. Waits for the first one, at most ``timeout`` s."""
        events = list[Event]()
        try:
            events.append(
                self._events.get(timeout=timeout) if timeout > 0.0 else self._events.get_nowait()
            )
            while True:
                events.append(self._events.get_nowait())
        except queue.Empty:
            return events

    def now(self) -> float:
        """The time of ROS, s."""
        return 1e-9 * float(self._node.get_clock().now().nanoseconds)

    def drive(self, speed: float, turn_rate: float) -> None:
        """Publish speeds, m/s and rad/s. While paused, and after the order to stop, they are
        zero.
        """
        if self.orders.shall_stand:
            speed = turn_rate = 0.0
        with self._lock:
            self._decided = time.monotonic()
            self._is_moving = bool(speed or turn_rate)
            self._publish_speeds(self.build.twist(speed, 0.0, turn_rate))

    def hold(self) -> None:
        """Publish the latest speeds again, unless the watchdog has stopped the wheels; or zero
        once, if so ordered.
        """
        with self._lock:
            if self._is_moving:
                self._is_moving = not self.orders.shall_stand
                self._publish_speeds(
                    self._latest if self._is_moving else self.build.twist(0.0, 0.0, 0.0)
                )

    def publisher(
        self, kind: str, topic: str, *, depth: int = 10, is_kept: bool = False
    ) -> Callable[[Any], None]:
        """What publishes messages of a type on a topic, reliably. ``is_kept``: also to those who
        subscribe later.
        """
        from rclpy.qos import DurabilityPolicy, QoSProfile

        durability = DurabilityPolicy.TRANSIENT_LOCAL if is_kept else DurabilityPolicy.VOLATILE
        publish: Callable[[Any], None] = self._node.create_publisher(
            message_type(kind), topic, QoSProfile(depth=depth, durability=durability)
        ).publish
        return publish

    def _subscribe(self) -> None:
        """Listen to sensors as they come, and to orders reliably."""
        from rclpy.qos import QoSProfile, ReliabilityPolicy

        # This also fits publishers that are reliable.
        quality = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        ranges = [("sensor_msgs/msg/Range", topic) for topic in self.parameters.range_topics]
        sensors = dict(enumerate(ranges or [("sensor_msgs/msg/LaserScan", "scan")]))
        sensors[ODOMETRY] = ("nav_msgs/msg/Odometry", "odom")
        if self.parameters.imu_topic:
            sensors[IMU] = ("sensor_msgs/msg/Imu", self.parameters.imu_topic)
        for number, (kind, topic) in sensors.items():
            self._node.create_subscription(
                message_type(kind), topic, self._listener(number), quality
            )
        for topic, obey in (
            ("resume", self._resume),
            ("stop", self._stop),
            ("return_home", self._return_home),
        ):
            self._node.create_subscription(
                message_type("std_msgs/msg/Bool"), f"explore/{topic}", obey, 10
            )

    def _listener(self, number: int) -> Callable[[Any], None]:
        def hear(message: Any) -> None:
            # Some drivers leave the stamp out.
            self._events.put(Event(number, stamp_of(message) or self.now(), message))

        return hear

    def _resume(self, message: Any) -> None:
        (self.orders.go_on if message.data else self.orders.pause)()

    def _stop(self, message: Any) -> None:
        if message.data:
            self.orders.end = STOPPED

    def _return_home(self, message: Any) -> None:
        if message.data:
            self.orders.go_home()

    def _publish_speeds(self, twist: Any) -> None:
        self._latest = twist
        if self.parameters.enable_stamped_cmd_vel:
            header = self.build.header(self.now(), "")
            twist = self.build.make("geometry_msgs/msg/TwistStamped", header=header, twist=twist)
        self._speeds(twist)

    def _watch(self) -> None:
        """Stop the wheels if the latest decision is too old: a sensor is silent, or the host is
        busy.
        """
        with self._lock:
            if self._is_moving and time.monotonic() - self._decided > self.parameters.watchdog:
                self._is_moving = False
                self.watchdog_stops += 1
                self._publish_speeds(self.build.twist(0.0, 0.0, 0.0))


@contextmanager
def ros_node(arguments: Sequence[str]) -> Iterator[RosNode]:
    """A node that listens in a thread of its own. The arguments begin with ``--ros-args`` if there
    are any. Raises a ValueError if ROS 2 is not installed, or an argument cannot be used.
    """
    if arguments and arguments[0] != BEGIN:
        raise ValueError(
            f"what follows -- is for ROS 2 and begins with {BEGIN}, not with {arguments[0]}"
        )
    check_installed()
    try:
        import rclpy
        from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
        from rclpy.signals import SignalHandlerOptions

        context = rclpy.Context()
        # Ctrl-C stops the wheels first, as for every robot.
        rclpy.init(
            args=list(arguments), context=context, signal_handler_options=SignalHandlerOptions.NO
        )
    except (ImportError, RuntimeError) as error:
        raise ValueError(f"ROS 2 cannot be started: {error}") from error
    handle = rclpy.create_node(
        "limslam", context=context, automatically_declare_parameters_from_overrides=True
    )
    try:
        node = RosNode(handle)
    except BaseException:
        context.try_shutdown()
        raise
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(handle)

    def listen() -> None:
        with suppress(ExternalShutdownException):
            executor.spin()

    thread = threading.Thread(target=listen, name="ros2", daemon=True)
    thread.start()
    try:
        yield node
    finally:
        executor.shutdown()
        thread.join(5.0)
        handle.destroy_node()
        context.try_shutdown()


def check_installed() -> None:
    """Raise a ValueError, which says how they are installed, if packages of ROS 2 are missing."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise ValueError(
            f"ROS 2 needs {', '.join(missing)}: source the setup file of a ROS 2 installation, "
            'or on Linux and x86-64: pip install "limslam[ros2]"'
        )


def make(kind: str, **values: Any) -> Any:
    """A message of rclpy from its type, like ``std_msgs/msg/Header``, and its fields."""
    return message_type(kind)(**{name: _plain(value) for name, value in values.items()})


def message_type(kind: str) -> Any:
    """The class of a type of messages."""
    package, _, name = kind.partition("/msg/")
    return getattr(importlib.import_module(f"{package}.msg"), name)


def _plain(value: Any) -> Any:
    """An array of bytes as rclpy takes it."""
    is_bytes = isinstance(value, np.ndarray) and value.dtype.itemsize == 1
    return array("b" if value.dtype == np.int8 else "B", value.tobytes()) if is_bytes else value


def _set_parameters(node: Any) -> dict[str, Any]:
    """The parameters that were set, without those of rclpy itself. The others are declared with
    their defaults.
    """
    found = {name: each.value for name, each in node.get_parameters_by_prefix("").items()}
    for field in fields(Parameters):
        default: Any = field.default
        if field.name not in found and default != ():  # an empty list has no type
            node.declare_parameter(
                field.name, list(default) if isinstance(default, tuple) else default
            )
    return {name: value for name, value in found.items() if not name.startswith(_OF_RCLPY)}
