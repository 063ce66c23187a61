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
    """Parameters of the node."""

    # A topic of Range messages for each beam of the robot, in the order of the beams. None: the topic ``scan`` has
    # LaserScans.
    range_topics: tuple[str, ...] = ()
    # Pose of the laser on the robot: x (m), y (m), heading (deg)
    scan_mount: tuple[float, float, float] = (0.0, 0.0, 0.0)
    period: _Time = 0.1  # Time between two measurements that are used, s. Faster sensors are thinned out.
    # Time after the latest decision after which the wheels are stopped, s
    watchdog: Annotated[float, Bounds(0.05, 60.0)] = 0.5
    map_period: _Time = 1.0  # Time between two publications of the map, s
    # Names of the frames. Without a name, the frame is that of the odometry's messages.
    map_frame: str = "map"
    odom_frame: str = ""
    transform_tolerance: _Time = 0.5  # By how much the transform from ``map_frame`` to ``odom_frame`` is dated ahead, s
    publish_tf: bool = True  # Whether to publish this transform on ``/tf``
    # Whether to explore from the start. If not, the robot maps until ``explore/resume`` says true.
    explore: bool = True
    return_to_init: bool = False  # Whether to drive back to the start when everything is explored
    enable_stamped_cmd_vel: bool = False  # Whether ``cmd_vel`` has TwistStamped messages

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
