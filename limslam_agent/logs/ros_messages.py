"""Extracts poses, ranges, times and sensor mounts from ROS messages."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from limslam_agent.logs.pose_log import beam
from limslam_env.geometry import FloatArray
from limslam_env.interface import SensorSpec

LASER_SCAN = "sensor_msgs/msg/LaserScan"
RANGE = "sensor_msgs/msg/Range"
ODOMETRY = "nav_msgs/msg/Odometry"
POSES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
)
TRANSFORMS = {"tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"}

# Largest vertical component of a beam's unit direction. A steeper beam is not used for a map of
# walls.
_STEEPEST = 0.5
# A driver may renumber the beams. A beam that is off by more than this (deg, or half a step) is
# another beam.
_BEAM_DRIFT_DEG = 1.0


def stamp_of(message: Any) -> float:
    """Time of measurement in a message's header, s. 0 if the header has none."""
    stamp = message.header.stamp
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def pose_of(message: Any) -> tuple[float, float, float]:
    """Pose (m, m, rad) in an Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped.
    Raises a ValueError if the pose is not finite, or its quaternion has length zero.
    """
    if hasattr(message, "transform"):
        place = message.transform.translation
        turn = message.transform.rotation
    else:
        # A pose with covariance is one level deeper.
        pose = getattr(message.pose, "pose", message.pose)
        place = pose.position
        turn = pose.orientation
    x = float(place.x)
    y = float(place.y)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"the position is {x:g}, {y:g}: not finite")
    return x, y, yaw_of((turn.x, turn.y, turn.z, turn.w))


def yaw_of(quaternion: Sequence[float]) -> float:
    """Heading (rad) of a quaternion x, y, z, w, which need not have length one. Raises a ValueError
    if the quaternion is not finite or has length zero.
    """
    rotation = rotation_of(quaternion)
    return math.atan2(rotation[1, 0], rotation[0, 0])


def rotation_of(quaternion: Sequence[float]) -> FloatArray:
    """Rotation matrix (3, 3) of a quaternion x, y, z, w, which need not have length one. Raises a
    ValueError if the quaternion is not finite or has length zero.
    """
    parts = [float(part) for part in quaternion]
    length = math.hypot(*parts)
    if not 1e-6 < length < 1e6:
        raise ValueError(
            f"the quaternion is not a rotation: {', '.join(f'{part:g}' for part in parts)}"
        )
    x, y, z, w = (part / length for part in parts)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def scan_angles(message: Any) -> FloatArray:
    """Directions of a LaserScan's beams (n,), rad, in the frame of the laser. Raises a ValueError
    if the scan has no beams, or their directions are not finite.
    """
    count = len(message.ranges)
    first = float(message.angle_min)
    step = float(message.angle_increment)
    if not count:
        raise ValueError("the scan has no ranges")
    if not (math.isfinite(first) and math.isfinite(step) and (step != 0.0 or count == 1)):
        raise ValueError(f"the scan's angles are invalid: {first:g} in steps of {step:g}")
    return first + step * np.arange(count, dtype=np.float64)


def scan_readings(message: Any, angles: FloatArray) -> FloatArray:
    """Ranges of a LaserScan (k,), m, in given directions (k,), rad. Raises a ValueError if the scan
    has no beam in one of the directions.
    """
    there = scan_angles(message)
    step = float(message.angle_increment) or 1.0
    index = np.clip(np.round((angles - there[0]) / step), 0, len(there) - 1).astype(np.int64)
    off = np.degrees(np.abs(there[index] - angles)).max()
    if off > max(_BEAM_DRIFT_DEG, 0.5 * abs(math.degrees(step))) + 1e-6:
        first, last = np.degrees(there[[0, -1]])
        raise ValueError(
            f"the scan's beams have changed: they now go from {first:.1f} to {last:.1f} deg"
        )
    readings: FloatArray = np.asarray(message.ranges, dtype=np.float64)[index]
    return readings


def sensor_limits(least: float, largest: float, max_range: float) -> tuple[float, float]:
    """Shortest and longest usable range of a sensor, m, from its messages and from the wanted
    longest range.

    Limits that a driver leaves out, or that are not finite, do not count.
    """
    # Messages hold float32 numbers, so 0.0500000007 means 0.05.
    least = round(least, 6) if math.isfinite(least) and least > 0.0 else 0.0
    return least, min(max_range, round(largest, 6)) if least < largest < math.inf else max_range


class Mounts:
    """Poses of the sensors on the body, from the messages of ``tf_static``.

    A chain of frames is followed up to ``base`` if it contains ``base``, and otherwise up to its
    root.
    """

    def __init__(self, base: str | None = None) -> None:
        self._base = bare(base or "")
        self._parents: dict[str, tuple[str, FloatArray, FloatArray]] = {}

    def add(self, transforms: Sequence[Any]) -> None:
        """Add the transforms of a TFMessage. Raises a ValueError if a rotation is invalid."""
        for each in transforms:
            shift = each.transform.translation
            turn = each.transform.rotation
            rotation = rotation_of((turn.x, turn.y, turn.z, turn.w))
            place = np.array([float(shift.x), float(shift.y), float(shift.z)])
            if not np.isfinite(place).all():
                raise ValueError(f"the place of {each.child_frame_id!r} is not finite")
            parent = bare(each.header.frame_id)
            self._parents[bare(each.child_frame_id)] = (parent, rotation, place)

    def find(self, frame: str) -> tuple[FloatArray, FloatArray] | None:
        """Rotation (3, 3) and position (3,), m, of a frame on the body. None if the frame is
        unknown.
        """
        frame = bare(frame)
        rotation = np.eye(3)
        place = np.zeros(3)
        passed: set[str] = set()
        while frame in self._parents and frame != self._base:
            if frame in passed:
                return None
            passed.add(frame)
            frame, turn, shift = self._parents[frame]
            rotation = turn @ rotation
            place = shift + turn @ place
        return (rotation, place) if passed or frame == self._base else None


def beam_on_body(
    mount: tuple[FloatArray, FloatArray], angle: float, limits: tuple[float, float]
) -> SensorSpec | None:
    """A beam at ``angle`` (rad) of a mounted sensor, projected to the floor. None if the beam looks
    up or down.

    ``limits`` are the shortest and the longest range, m.
    """
    rotation, place = mount
    direction = rotation @ np.array([math.cos(angle), math.sin(angle), 0.0])
    if abs(direction[2]) > _STEEPEST:
        return None
    towards = math.atan2(direction[1], direction[0])
    return beam(towards, limits[1], x=float(place[0]), y=float(place[1]), min_range=limits[0])


def bare(frame: str) -> str:
    """A frame without the leading slash of some ROS 1 names."""
    return frame.removeprefix("/")
