"""Writes a run as messages of ROS 2: a bag, or an MCAP file for Foxglove. rosbags is an extra; ROS is not needed."""

import math
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limslam_agent.output.formats.content import ExportedRun, Grid
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import between, compose, inverse
from limslam_env.interface import RobotSpec, SensorSpec

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_BEAM_WIDTH = math.radians(2.0)  # rad; a Range has to state one
_INFRARED, _LINE_LIST = 1, 5


@dataclass(frozen=True)
class _Told:
    """A message with its topic and time."""

    time: float
    topic: str
    content: Any


def write_bag(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write the folder ``bag``, a ROS 2 bag with SQLite.

    Raises
    ------
    ValueError
        If rosbags is not installed.
    """
    _write(folder / "bag", exported, mcap=False)
    return [folder / "bag"]


def write_mcap(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write ``run.mcap`` with the same messages and their schemas.

    Raises
    ------
    ValueError
        If rosbags is not installed.
    """
    target, beside = folder / "run.mcap", folder / "mcap"
    _write(beside, exported, mcap=True)
    next(beside.glob("*.mcap")).replace(target)
    shutil.rmtree(beside)
    return [target]


def _write(folder: Path, exported: ExportedRun, *, mcap: bool) -> None:
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ValueError("bags are written with rosbags: pip install 'limslam[ros]'") from error
    types = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for told in sorted(_Messages(types, exported).all(), key=lambda told: told.time):
            kind = told.content.__msgtype__
            if told.topic not in connections:
                connections[told.topic] = writer.add_connection(told.topic, kind, typestore=types)
            stamp = round(told.time * 1e9)
            writer.write(connections[told.topic], stamp, types.serialize_cdr(told.content, kind))


class _Messages:
    """Makes the messages of a run.

    Frames: ``map`` is the frame of the map, ``odom`` the frame of odometry, ``base_link`` the robot, and ``beam_0`` and
    so on the beams. Several robots put ``robot_0/`` and so on before all frames but ``map``, and before all topics but
    those of the map.
    """

    def __init__(self, types: "Typestore", exported: ExportedRun) -> None:
        self._types, self._exported = types.types, exported
        self._end = float(exported.run.time[-1])

    def all(self) -> Iterator[_Told]:
        """All messages, in no order."""
        run = self._exported.run
        if self._exported.grid is not None:
            yield _Told(self._end, "/map", self._grid(self._exported.grid))
        yield _Told(self._end, "/walls", self._walls(run.segments))
        for number in range(len(run.estimated)):
            yield from self._of_robot(number, f"robot_{number}/" if len(run.estimated) > 1 else "")

    def _of_robot(self, number: int, prefix: str) -> Iterator[_Told]:
        run, readings = self._exported.run, self._exported.readings
        base, odom = f"{prefix}base_link", f"{prefix}odom"
        estimated = run.estimated[number]
        covariances = run.covariances[number] if run.covariances else np.zeros((len(run.time), 3, 3))
        if readings is not None:
            mounts = [self._mount(base, f"{prefix}beam_{i}", beam) for i, beam in enumerate(readings.robot.beams)]
            yield _Told(float(run.time[0]), "/tf_static", self._make("tf2_msgs/msg/TFMessage", transforms=mounts))
        if run.odometry:
            yield from self._odometry(run.odometry[number], estimated, prefix, odom, base)
        for row, time in enumerate(run.time.tolist()):
            pose = self._uncertain(estimated[row], covariances[row])
            kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
            yield _Told(time, f"/{prefix}pose", self._make(kind, header=self._header(time, "map"), pose=pose))
            if readings is not None:
                yield from self._ranges(time, readings.ranges[row, number], readings.robot, prefix)
        for kind, poses in self._exported.paths().items():
            yield _Told(self._end, f"/{prefix}path/{kind}", self._path(poses[number]))

    def _odometry(self, poses: FloatArray, estimated: FloatArray, prefix: str, odom: str, base: str) -> Iterator[_Told]:
        time = self._exported.run.time
        moves = between(poses[:-1], poses[1:]) / np.maximum(np.diff(time), 1e-6)[:, None]
        speeds = np.vstack((np.zeros((1, 3)), moves))
        corrections = compose(estimated, inverse(poses))
        vector = "geometry_msgs/msg/Vector3"
        for row, stamp in enumerate(time.tolist()):
            twist = self._make(
                "geometry_msgs/msg/Twist", linear=self._make(vector, x=speeds[row, 0], y=speeds[row, 1], z=0.0),
                angular=self._make(vector, x=0.0, y=0.0, z=speeds[row, 2]),
            )  # fmt: skip
            yield _Told(stamp, f"/{prefix}odom", self._make(
                "nav_msgs/msg/Odometry", header=self._header(stamp, odom), child_frame_id=base,
                pose=self._uncertain(poses[row], np.zeros((3, 3))),
                twist=self._make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
            ))  # fmt: skip
            frames = [
                self._transform(stamp, "map", odom, corrections[row]), self._transform(stamp, odom, base, poses[row])
            ]  # fmt: skip
            yield _Told(stamp, "/tf", self._make("tf2_msgs/msg/TFMessage", transforms=frames))

    def _ranges(self, time: float, ranges: Any, robot: RobotSpec, prefix: str) -> Iterator[_Told]:
        for number, (beam, reading) in enumerate(zip(robot.beams, ranges.tolist(), strict=True)):
            # REP 117: infinity where nothing was seen.
            seen = reading if reading < np.float32(beam.max_range) or math.isnan(reading) else math.inf
            yield _Told(time, f"/{prefix}beam_{number}", self._make(
                "sensor_msgs/msg/Range", header=self._header(time, f"{prefix}beam_{number}"), radiation_type=_INFRARED,
                field_of_view=_BEAM_WIDTH, min_range=beam.min_range, max_range=beam.max_range, range=seen,
            ))  # fmt: skip

    def _grid(self, grid: Grid) -> Any:
        rows, columns = grid.cells.shape
        information = self._make(
            "nav_msgs/msg/MapMetaData", map_load_time=self._stamp(self._end), resolution=grid.resolution, width=columns,
            height=rows, origin=self._pose(np.array([*grid.origin, 0.0])),
        )  # fmt: skip
        header = self._header(self._end, "map")
        return self._make("nav_msgs/msg/OccupancyGrid", header=header, info=information, data=grid.cells.ravel())

    def _walls(self, segments: FloatArray) -> Any:
        point = "geometry_msgs/msg/Point"
        ends = [self._make(point, x=x, y=y, z=0.0) for x, y in segments.reshape(-1, 2).tolist()]
        time = self._make("builtin_interfaces/msg/Duration", sec=0, nanosec=0)
        file = self._make("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, dtype=np.uint8))
        texture = self._make(
            "sensor_msgs/msg/CompressedImage", header=self._header(self._end, ""), format="",
            data=np.zeros(0, dtype=np.uint8),
        )  # fmt: skip
        marker = self._make(
            "visualization_msgs/msg/Marker", header=self._header(self._end, "map"), ns="walls", id=0, type=_LINE_LIST,
            action=0, pose=self._pose(np.zeros(3)), scale=self._make("geometry_msgs/msg/Vector3", x=0.03, y=0.0, z=0.0),
            color=self._make("std_msgs/msg/ColorRGBA", r=0.75, g=0.22, b=0.17, a=1.0), lifetime=time,
            frame_locked=False, points=ends, colors=[], texture_resource="", texture=texture, uv_coordinates=[],
            text="", mesh_resource="", mesh_file=file, mesh_use_embedded_materials=False,
        )  # fmt: skip
        return self._make("visualization_msgs/msg/MarkerArray", markers=[marker])

    def _path(self, poses: FloatArray) -> Any:
        stamped = [
            self._make("geometry_msgs/msg/PoseStamped", header=self._header(time, "map"), pose=self._pose(pose))
            for time, pose in zip(self._exported.run.time.tolist(), poses, strict=True)
        ]
        return self._make("nav_msgs/msg/Path", header=self._header(self._end, "map"), poses=stamped)

    def _mount(self, base: str, frame: str, beam: SensorSpec) -> Any:
        start = float(self._exported.run.time[0])
        return self._transform(start, base, frame, np.array([beam.x, beam.y, beam.angle]))

    def _transform(self, time: float, parent: str, child: str, pose: FloatArray) -> Any:
        shift = self._make("geometry_msgs/msg/Vector3", x=pose[0], y=pose[1], z=0.0)
        transform = self._make("geometry_msgs/msg/Transform", translation=shift, rotation=self._turn(pose[2]))
        kind = "geometry_msgs/msg/TransformStamped"
        return self._make(kind, header=self._header(time, parent), child_frame_id=child, transform=transform)

    def _uncertain(self, pose: FloatArray, covariance: FloatArray) -> Any:
        # ROS has six rows: three of the place and three of the orientation, of which the last is the heading.
        spread = np.zeros((6, 6))
        spread[np.ix_((0, 1, 5), (0, 1, 5))] = covariance
        kind = "geometry_msgs/msg/PoseWithCovariance"
        return self._make(kind, pose=self._pose(pose), covariance=spread.ravel())

    def _pose(self, pose: FloatArray) -> Any:
        place = self._make("geometry_msgs/msg/Point", x=float(pose[0]), y=float(pose[1]), z=0.0)
        return self._make("geometry_msgs/msg/Pose", position=place, orientation=self._turn(float(pose[2])))

    def _turn(self, heading: float) -> Any:
        half = 0.5 * heading
        return self._make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))

    def _header(self, time: float, frame: str) -> Any:
        return self._make("std_msgs/msg/Header", stamp=self._stamp(time), frame_id=frame)

    def _stamp(self, time: float) -> Any:
        seconds, rest = divmod(round(time * 1e9), 1_000_000_000)
        return self._make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)

    def _make(self, kind: str, **fields: Any) -> Any:
        return self._types[kind](**fields)
