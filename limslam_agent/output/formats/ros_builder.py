"""Builds messages of ROS 2 that have the same fields in every library: for bags, and for a node."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from limslam_agent.grid.occupancy import GridView
from limslam_env.geometry import FloatArray

BEAM_WIDTH = math.radians(2.0)
"""Width of a beam, rad: a Range has to state one."""

LINE_LIST = 5
"""Type of a Marker whose points are the ends of lines, two by two."""


def cells_of(grid: GridView) -> NDArray[np.int8]:
    """The cells of a grid as ROS has them: 0 is free, 100 is occupied, -1 is unknown."""
    return np.select([grid.free, grid.occupied], [0, 100], -1).astype(np.int8)


class MessageBuilder:
    """Builds messages from numbers. ``make`` makes one from its type, like ``std_msgs/msg/Header``,
    and its fields.
    """

    def __init__(self, make: Callable[..., Any]) -> None:
        self.make = make

    def stamp(self, time: float) -> Any:
        """A time, s."""
        seconds, rest = divmod(round(time * 1e9), 1_000_000_000)
        return self.make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)

    def header(self, time: float, frame: str) -> Any:
        """A header."""
        return self.make("std_msgs/msg/Header", stamp=self.stamp(time), frame_id=frame)

    def vector(self, x: float, y: float = 0.0, z: float = 0.0) -> Any:
        """A Vector3."""
        return self.make("geometry_msgs/msg/Vector3", x=float(x), y=float(y), z=float(z))

    def twist(self, x: float, y: float, turn: float) -> Any:
        """A Twist: speeds ahead and to the left, m/s, and rate of turn, rad/s."""
        return self.make(
            "geometry_msgs/msg/Twist", linear=self.vector(x, y), angular=self.vector(0.0, z=turn)
        )

    def pose(self, pose: FloatArray) -> Any:
        """A Pose from (3,), m, m, rad."""
        place = self.make("geometry_msgs/msg/Point", x=float(pose[0]), y=float(pose[1]), z=0.0)
        return self.make(
            "geometry_msgs/msg/Pose", position=place, orientation=self._turn(float(pose[2]))
        )

    def uncertain(self, pose: FloatArray, covariance: FloatArray) -> Any:
        """A PoseWithCovariance from (3,) and (3, 3)."""
        # ROS has six rows: three of the place and three of the orientation, of which the last is
        # the heading.
        spread = np.zeros((6, 6))
        spread[np.ix_((0, 1, 5), (0, 1, 5))] = covariance
        kind = "geometry_msgs/msg/PoseWithCovariance"
        return self.make(kind, pose=self.pose(pose), covariance=spread.ravel())

    def uncertain_pose(
        self, time: float, frame: str, pose: FloatArray, covariance: FloatArray
    ) -> Any:
        """A PoseWithCovarianceStamped."""
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        return self.make(
            kind, header=self.header(time, frame), pose=self.uncertain(pose, covariance)
        )

    def transform(self, time: float, parent: str, child: str, pose: FloatArray) -> Any:
        """A TransformStamped from the pose (3,) of the child in the parent's frame."""
        shift = self.vector(pose[0], pose[1])
        turned = self.make(
            "geometry_msgs/msg/Transform", translation=shift, rotation=self._turn(float(pose[2]))
        )
        kind = "geometry_msgs/msg/TransformStamped"
        return self.make(
            kind, header=self.header(time, parent), child_frame_id=child, transform=turned
        )

    def odometry(
        self, time: float, frames: tuple[str, str], pose: FloatArray, speeds: FloatArray
    ) -> Any:
        """An Odometry: the pose (3,) of the second frame in the first one, and its speeds (3,),
        m/s, m/s, rad/s.
        """
        twist = self.twist(*speeds.tolist())
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(time, frames[0]),
            child_frame_id=frames[1],
            pose=self.uncertain(pose, np.zeros((3, 3))),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)
            ),
        )

    def range(self, time: float, frame: str, limits: tuple[float, float], reading: float) -> Any:
        """A Range of an infrared sensor with its limits, m, and its reading.

        A reading at or beyond the longest range becomes infinity, as REP 117 asks.
        """
        seen = reading if reading < np.float32(limits[1]) or math.isnan(reading) else math.inf
        return self.make(
            "sensor_msgs/msg/Range",
            header=self.header(time, frame),
            radiation_type=1,  # infrared
            field_of_view=BEAM_WIDTH,
            min_range=limits[0],
            max_range=limits[1],
            range=seen,
        )

    def grid(self, time: float, frame: str, view: GridView) -> Any:
        """An OccupancyGrid: 0 is free, 100 is occupied, -1 is unknown."""
        cells = cells_of(view)
        rows, columns = cells.shape
        information = self.make(
            "nav_msgs/msg/MapMetaData",
            map_load_time=self.stamp(time),
            resolution=view.cell,
            width=columns,
            height=rows,
            origin=self.pose(np.array([*view.low, 0.0])),
        )
        return self.make(
            "nav_msgs/msg/OccupancyGrid",
            header=self.header(time, frame),
            info=information,
            data=cells.ravel(),
        )

    def walls(self, time: float, frame: str, segments: FloatArray) -> Any:
        """A MarkerArray with one Marker, whose lines are the segments (n, 4), m."""
        point = "geometry_msgs/msg/Point"
        ends = [self.make(point, x=x, y=y, z=0.0) for x, y in segments.reshape(-1, 2).tolist()]
        nothing = np.zeros(0, dtype=np.uint8)
        file = self.make("visualization_msgs/msg/MeshFile", filename="", data=nothing)
        texture = self.make(
            "sensor_msgs/msg/CompressedImage", header=self.header(time, ""), format="", data=nothing
        )
        marker = self.make(
            "visualization_msgs/msg/Marker",
            header=self.header(time, frame),
            ns="walls",
            id=0,
            type=LINE_LIST,
            action=0,
            pose=self.pose(np.zeros(3)),
            scale=self.vector(0.03),
            color=self.make("std_msgs/msg/ColorRGBA", r=0.75, g=0.22, b=0.17, a=1.0),
            lifetime=self.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
            frame_locked=False,
            points=ends,
            colors=[],
            texture_resource="",
            texture=texture,
            uv_coordinates=[],
            text="",
            mesh_resource="",
            mesh_file=file,
            mesh_use_embedded_materials=False,
        )
        return self.make("visualization_msgs/msg/MarkerArray", markers=[marker])

    def _turn(self, heading: float) -> Any:
        half = 0.5 * heading
        return self.make(
            "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half)
        )
