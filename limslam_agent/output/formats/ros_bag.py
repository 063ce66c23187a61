"""Writes a run as messages of ROS 2: a bag, whose file Foxglove opens, too. rosbags is an extra;
ROS is not needed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from limslam_agent.output.formats.content import ExportedRun
from limslam_agent.output.formats.ros_builder import MessageBuilder
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import between, compose, inverse
from limslam_env.interface import RobotSpec, SensorSpec

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


@dataclass(frozen=True)
class _Told:
    """A message with its topic and time."""

    time: float
    topic: str
    content: Any


def write_bag(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write the folder ``bag``, a ROS 2 bag in the format MCAP, whose file has the schemas of its
    messages. Raises a ValueError if rosbags is not installed.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ValueError("bags are written with rosbags: pip install 'limslam[ros]'") from error
    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for told in sorted(_Messages(types, exported).all(), key=lambda told: told.time):
            kind = told.content.__msgtype__
            if told.topic not in connections:
                connections[told.topic] = writer.add_connection(told.topic, kind, typestore=types)
            stamp = round(told.time * 1e9)
            writer.write(connections[told.topic], stamp, types.serialize_cdr(told.content, kind))
    return [folder / "bag"]


class _Messages:
    """Makes the messages of a run.

    Frames: ``map`` is the frame of the map, ``odom`` the frame of odometry, ``base_link`` the
    robot, and ``beam_0`` and so on the beams. Several robots put ``robot_0/`` and so on before all
    frames but ``map``, and before all topics but those of the map.
    """

    def __init__(self, types: "Typestore", exported: ExportedRun) -> None:
        self._build = MessageBuilder(lambda kind, **fields: types.types[kind](**fields))
        self._exported = exported
        self._end = float(exported.run.time[-1])

    def all(self) -> Iterator[_Told]:
        """All messages, in no order."""
        run = self._exported.run
        if self._exported.grid is not None:
            yield _Told(self._end, "/map", self._build.grid(self._end, "map", self._exported.grid))
        yield _Told(self._end, "/walls", self._build.walls(self._end, "map", run.segments))
        for number in range(len(run.estimated)):
            yield from self._of_robot(number, f"robot_{number}/" if len(run.estimated) > 1 else "")

    def _of_robot(self, number: int, prefix: str) -> Iterator[_Told]:
        run = self._exported.run
        readings = self._exported.readings
        base = f"{prefix}base_link"
        odom = f"{prefix}odom"
        estimated = run.estimated[number]
        covariances = (
            run.covariances[number] if run.covariances else np.zeros((len(run.time), 3, 3))
        )
        if readings is not None:
            mounts = [
                self._mount(base, f"{prefix}beam_{i}", beam)
                for i, beam in enumerate(readings.robot.beams)
            ]
            yield _Told(
                float(run.time[0]),
                "/tf_static",
                self._build.make("tf2_msgs/msg/TFMessage", transforms=mounts),
            )
        if run.odometry:
            yield from self._odometry(run.odometry[number], estimated, prefix, odom, base)
        for row, time in enumerate(run.time.tolist()):
            pose = self._build.uncertain_pose(time, "map", estimated[row], covariances[row])
            yield _Told(time, f"/{prefix}pose", pose)
            if readings is not None:
                yield from self._ranges(time, readings.ranges[row, number], readings.robot, prefix)
        for kind, poses in self._exported.paths().items():
            yield _Told(self._end, f"/{prefix}path/{kind}", self._path(poses[number]))

    def _odometry(
        self, poses: FloatArray, estimated: FloatArray, prefix: str, odom: str, base: str
    ) -> Iterator[_Told]:
        time = self._exported.run.time
        build = self._build
        moves = between(poses[:-1], poses[1:]) / np.maximum(np.diff(time), 1e-6)[:, None]
        speeds = np.vstack((np.zeros((1, 3)), moves))
        corrections = compose(estimated, inverse(poses))
        for row, stamp in enumerate(time.tolist()):
            yield _Told(
                stamp,
                f"/{prefix}odom",
                build.odometry(stamp, (odom, base), poses[row], speeds[row]),
            )
            frames = [
                build.transform(stamp, "map", odom, corrections[row]),
                build.transform(stamp, odom, base, poses[row]),
            ]
            yield _Told(stamp, "/tf", build.make("tf2_msgs/msg/TFMessage", transforms=frames))

    def _ranges(self, time: float, ranges: Any, robot: RobotSpec, prefix: str) -> Iterator[_Told]:
        for number, (beam, reading) in enumerate(zip(robot.beams, ranges.tolist(), strict=True)):
            name = f"{prefix}beam_{number}"
            limits = (beam.min_range, beam.max_range)
            yield _Told(time, f"/{name}", self._build.range(time, name, limits, reading))

    def _path(self, poses: FloatArray) -> Any:
        build = self._build
        stamped = [
            build.make(
                "geometry_msgs/msg/PoseStamped",
                header=build.header(time, "map"),
                pose=build.pose(pose),
            )
            for time, pose in zip(self._exported.run.time.tolist(), poses, strict=True)
        ]
        return build.make("nav_msgs/msg/Path", header=build.header(self._end, "map"), poses=stamped)

    def _mount(self, base: str, frame: str, beam: SensorSpec) -> Any:
        start = float(self._exported.run.time[0])
        return self._build.transform(start, base, frame, np.array([beam.x, beam.y, beam.angle]))
