"""The parameters of the node, as users of ROS set them: ``-p NAME:=VALUE``."""

import math
from array import array
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from limslam_agent.config.bounds import Bounded, Bounds
from limslam_agent.config.tables import updated
from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

_Time = Annotated[float, Bounds(0.0, 60.0)]


@dataclass(frozen=True)
class Parameters(Bounded):
    """Parameters of the node.

    Attributes
    ----------
    range_topics
        A topic of Range messages for each beam of the robot, in the order of the beams. None: the topic ``scan`` has
        LaserScans.
    scan_mount
        Pose of the laser on the robot: x (m), y (m), heading (deg).
    period
        Time between two measurements that are used, s. Faster sensors are thinned out.
    watchdog
        Time after the latest decision after which the wheels are stopped, s.
    map_period
        Time between two publications of the map, s.
    map_frame, odom_frame
        Names of the frames. Without a name, the frame is that of the odometry's messages.
    transform_tolerance
        By how much the transform from ``map_frame`` to ``odom_frame`` is dated ahead, s.
    publish_tf
        Whether to publish this transform on ``/tf``.
    explore
        Whether to explore from the start. If not, the robot maps until ``explore/resume`` says true.
    return_to_init
        Whether to drive back to the start when everything is explored.
    enable_stamped_cmd_vel
        Whether ``cmd_vel`` has TwistStamped messages.
    """

    range_topics: tuple[str, ...] = ()
    scan_mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    period: _Time = 0.1
    watchdog: Annotated[float, Bounds(0.05, 60.0)] = 0.5
    map_period: _Time = 1.0
    map_frame: str = "map"
    odom_frame: str = ""
    transform_tolerance: _Time = 0.5
    publish_tf: bool = True
    explore: bool = True
    return_to_init: bool = False
    enable_stamped_cmd_vel: bool = False

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> "Parameters":
        """The parameters from the values of a node. Names that are missing keep their defaults. Raises a ValueError if
        there is no such parameter, or a value cannot be used.
        """
        # ROS has arrays of numbers where a file of settings has lists.
        told = {name: list(value) if isinstance(value, array) else value for name, value in values.items()}
        return updated(cls(), told, "the parameters of the node")

    @property
    def mount(self) -> FloatArray:
        """Pose (3,) of the laser on the robot, m, m, rad."""
        x, y, degrees = self.scan_mount
        return np.array([x, y, math.radians(degrees)])

    def check(self, robot: RobotSpec) -> None:
        """Raise a ValueError if there is not one topic of ranges for each beam."""
        if self.range_topics and len(self.range_topics) != len(robot.beams):
            raise ValueError(
                f"range_topics has {len(self.range_topics)} topics, but the robot has {len(robot.beams)} beams"
            )
