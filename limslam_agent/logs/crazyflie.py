"""Reads bags of a Crazyflie drone whose log blocks were recorded as plain arrays, without a ROS message type.

The names of the topics describe their content. ``state_ranger_qxyzw`` holds the right, front, left, back and up range
(m) and the quaternion of the attitude. ``state_xyzv`` holds the position (m) by dead reckoning and the velocity.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from limslam_agent.logs.pose_log import beam
from limslam_agent.logs.ros_messages import yaw_of
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import SensorSpec

RANGER, POSITION = "state_ranger_qxyzw", "state_xyzv"
# In the order of the array. The fifth beam looks up.
_BEAMS_DEG = (-90.0, 0.0, 90.0, 180.0)
_QUATERNION = slice(5, 9)


def find_topics(types: Mapping[str, str]) -> tuple[str, str] | None:
    """The topics of ranges and of positions among the topics of a bag. None unless there is exactly one drone."""
    found = [sorted(topic for topic in types if topic.rpartition("/")[2] == name) for name in (RANGER, POSITION)]
    if [len(topics) for topics in found] != [1, 1]:
        return None
    return found[0][0], found[1][0]


def beams(max_range: float) -> list[SensorSpec]:
    """The four horizontal beams, usable up to ``max_range``, m."""
    return [beam(math.radians(degrees), max_range) for degrees in _BEAMS_DEG]


def ranges_of(message: Any, columns: IntArray) -> FloatArray:
    """Readings of some beams (k,), m."""
    readings: FloatArray = message.raw[columns].astype(float)
    return readings


def position_of(message: Any) -> Sequence[float]:
    """Position x, y, m."""
    return [float(message.raw[0]), float(message.raw[1])]


def heading_of(message: Any) -> Sequence[float]:
    """Heading, rad."""
    return [yaw_of(message.raw[_QUATERNION])]
