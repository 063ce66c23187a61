"""What is taken out of ROS messages: poses, ranges, times, and where sensors are mounted."""

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

# Of a direction's length, what may point up or down before a beam is none for a map of walls.
_STEEPEST = 0.5
# A scan's beams may be counted anew by its driver; beyond this (deg, or half a step) a beam is another one.
_BEAM_DRIFT_DEG = 1.0


def stamp_of(message: Any) -> float:
    """When a message says that it was measured, s; 0 if it does not say."""
    stamp = message.header.stamp
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def pose_of(message: Any) -> tuple[float, float, float]:
    """The pose (m, m, rad) in an Odometry, PoseStamped, PoseWithCovarianceStamped or TransformStamped.

    Raises
    ------
    ValueError
        If it is not finite, or its quaternion has no length.
    """
    if hasattr(message, "transform"):
        place, turn = message.transform.translation, message.transform.rotation
    else:
        # With a covariance the pose stands one level deeper.
        pose = message.pose.pose if hasattr(message.pose, "pose") else message.pose
        place, turn = pose.position, pose.orientation
    x, y = float(place.x), float(place.y)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"the position is {x:g}, {y:g}: not finite")
    return x, y, yaw_of((turn.x, turn.y, turn.z, turn.w))


def yaw_of(quaternion: Sequence[float]) -> float:
    """Heading (rad) of a quaternion x, y, z, w, which need not have length one.

    Raises
    ------
    ValueError
        If it is not finite, or has no length.
    """
    rotation = rotation_of(quaternion)
    return math.atan2(rotation[1, 0], rotation[0, 0])


def rotation_of(quaternion: Sequence[float]) -> FloatArray:
    """Rotation matrix (3, 3) of a quaternion x, y, z, w, which need not have length one.

    Raises
    ------
    ValueError
        If it is not finite, or has no length.
    """
    parts = [float(part) for part in quaternion]
    length = math.hypot(*parts)
    if not 1e-6 < length < 1e6:
        raise ValueError(f"the quaternion is no rotation: {', '.join(f'{part:g}' for part in parts)}")
    x, y, z, w = (part / length for part in parts)
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def scan_angles(message: Any) -> FloatArray:
    """Directions (n,) in rad of a LaserScan's beams, in the laser's own frame.

    Raises
    ------
    ValueError
        If it has none, or they are not finite.
    """
    count, first, step = len(message.ranges), float(message.angle_min), float(message.angle_increment)
    if not count:
        raise ValueError("the scan has no ranges")
    if not (math.isfinite(first) and math.isfinite(step) and (step != 0.0 or count == 1)):
        raise ValueError(f"the scan's angles are no angles: {first:g} in steps of {step:g}")
    return first + step * np.arange(count, dtype=np.float64)


def scan_readings(message: Any, angles: FloatArray) -> FloatArray:
    """A LaserScan's ranges (k,), m, in directions (k,), rad, as the driver gives them.

    Raises
    ------
    ValueError
        If the scan has no beam there (any more).
    """
    there = scan_angles(message)
    step = float(message.angle_increment) or 1.0
    index = np.clip(np.round((angles - there[0]) / step), 0, len(there) - 1).astype(np.int64)
    off = np.degrees(np.abs(there[index] - angles)).max()
    if off > max(_BEAM_DRIFT_DEG, 0.5 * abs(math.degrees(step))) + 1e-6:
        first, last = np.degrees(there[[0, -1]])
        raise ValueError(f"the scan's beams have changed: they now go from {first:.1f} to {last:.1f} deg")
    readings: FloatArray = np.asarray(message.ranges, dtype=np.float64)[index]
    return readings


def sensor_limits(least: float, largest: float, max_range: float) -> tuple[float, float]:
    """A sensor's shortest and longest usable range (m) out of what its messages say and what is wanted.

    Drivers that leave the limits out, or hold them not finite, set none.
    """
    # Messages hold float32: what is said is 0.05, not 0.0500000007.
    least = round(least, 6) if math.isfinite(least) and least > 0.0 else 0.0
    return least, min(max_range, round(largest, 6)) if least < largest < math.inf else max_range


class Mounts:
    """Where sensors are fixed on the body, as ``tf_static`` tells it.

    A frame is followed up to ``base`` where its chain comes past it, otherwise to the top of the chain.
    """

    def __init__(self, base: str | None = None) -> None:
        self._base = _bare(base or "")
        self._parents: dict[str, tuple[str, FloatArray, FloatArray]] = {}

    def add(self, message: Any) -> None:
        """Take in one TFMessage.

        Raises
        ------
        ValueError
            If a rotation is none.
        """
        for each in message.transforms:
            shift, turn = each.transform.translation, each.transform.rotation
            rotation = rotation_of((turn.x, turn.y, turn.z, turn.w))
            place = np.array([float(shift.x), float(shift.y), float(shift.z)])
            if not np.isfinite(place).all():
                raise ValueError(f"the place of {each.child_frame_id!r} is not finite")
            self._parents[_bare(each.child_frame_id)] = (_bare(each.header.frame_id), rotation, place)

    def find(self, frame: str) -> tuple[FloatArray, FloatArray] | None:
        """Rotation (3, 3) and place (3,), m, of a frame on the body; None if nothing is known of it."""
        frame, rotation, place = _bare(frame), np.eye(3), np.zeros(3)
        if frame == self._base:
            return rotation, place
        passed: set[str] = set()
        while frame in self._parents and frame != self._base:
            if frame in passed:
                return None
            passed.add(frame)
            frame, turn, shift = self._parents[frame]
            rotation, place = turn @ rotation, shift + turn @ place
        return (rotation, place) if passed else None


def beam_on_body(mount: tuple[FloatArray, FloatArray], angle: float, limits: tuple[float, float]) -> SensorSpec | None:
    """A beam at ``angle`` (rad) of a mounted sensor, seen from above; None if it looks up or down.

    ``limits`` are its shortest and longest range, m.
    """
    rotation, place = mount
    direction = rotation @ np.array([math.cos(angle), math.sin(angle), 0.0])
    if abs(direction[2]) > _STEEPEST:
        return None
    towards = math.atan2(direction[1], direction[0])
    return beam(towards, limits[1], x=float(place[0]), y=float(place[1]), min_range=limits[0])


def _bare(frame: str) -> str:
    """ROS 1 wrote some frames with a slash in front."""
    return frame.removeprefix("/")
