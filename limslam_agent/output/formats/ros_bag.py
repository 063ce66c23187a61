"""Writes a run as messages of ROS 2: a bag, whose file Foxglove opens, too. rosbags is an extra;
ROS is not needed.
"""

from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from limslam_agent.output.formats.content import ExportedRun, Readings
from limslam_agent.output.formats.ros_builder import MessageBuilder
from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import between, compose, inverse

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


_Told: TypeAlias = tuple[float, str, Any]
"""The time of a message, its topic, and the message."""


def write_bag(folder: Path, exported: ExportedRun) -> list[Path]:
    """Write the folder ``bag``, a ROS 2 bag in the format MCAP, whose file has the schemas of its
    messages. Raises a ValueError if rosbags is not installed.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise ValueError('bags are written with rosbags: pip install "limslam[ros]"') from error
    types = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connections: dict[str, Any] = {}
        for time, topic, content in sorted(_Messages(types, exported).all(), key=itemgetter(0)):
            kind = content.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], round(time * 1e9), types.serialize_cdr(content, kind))
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

    def all(self) -> Iterator[_Told]:
        """All messages, in no order."""
        run = self._exported.run
        build = self._build
        end = float(run.time[-1])
        if self._exported.grid is not None:
            yield end, "/map", build.grid(end, "map", self._exported.grid)
        yield end, "/walls", build.walls(end, "map", run.segments)
        for number in range(len(run.estimated)):
            yield from self._of_robot(number, f"robot_{number}/" if len(run.estimated) > 1 else "")

    def _of_robot(self, number: int, prefix: str) -> Iterator[_Told]:
        run = self._exported.run
        build = self._build
        frames = (f"{prefix}odom", f"{prefix}base_link")
        times = run.time.tolist()
        unknown = np.zeros((len(times), 3, 3))
        covariances = run.covariances[number] if run.covariances else unknown
        if self._exported.readings is not None:
            yield from self._readings(self._exported.readings, number, prefix)
        if run.odometry:
            yield from self._odometry(run.odometry[number], run.estimated[number], prefix, frames)
        for time, pose, covariance in zip(times, run.estimated[number], covariances, strict=True):
            yield time, f"/{prefix}pose", build.uncertain_pose(time, "map", pose, covariance)
        for kind, paths in self._exported.paths().items():
            poses = [
                build.make(
                    "geometry_msgs/msg/PoseStamped",
                    header=build.header(time, "map"),
                    pose=build.pose(pose),
                )
                for time, pose in zip(times, paths[number], strict=True)
            ]
            header = build.header(times[-1], "map")
            path = build.make("nav_msgs/msg/Path", header=header, poses=poses)
            yield times[-1], f"/{prefix}path/{kind}", path

    def _odometry(
        self, poses: FloatArray, estimated: FloatArray, prefix: str, frames: tuple[str, str]
    ) -> Iterator[_Told]:
        time = self._exported.run.time
        build = self._build
        moves = between(poses[:-1], poses[1:]) / np.maximum(np.diff(time), 1e-6)[:, None]
        speeds = np.vstack((np.zeros((1, 3)), moves))
        corrections = compose(estimated, inverse(poses))
        for row, stamp in enumerate(time.tolist()):
            odometry = build.odometry(stamp, frames, poses[row], speeds[row])
            yield stamp, f"/{prefix}odom", odometry
            transforms = [
                build.transform(stamp, "map", frames[0], corrections[row]),
                build.transform(stamp, *frames, poses[row]),
            ]
            yield stamp, "/tf", build.make("tf2_msgs/msg/TFMessage", transforms=transforms)

    def _readings(self, readings: Readings, number: int, prefix: str) -> Iterator[_Told]:
        """Where the beams of a robot are mounted, and what they have measured."""
        build = self._build
        times = self._exported.run.time.tolist()
        beams = [(f"{prefix}beam_{i}", beam) for i, beam in enumerate(readings.robot.beams)]
        mounts = [
            build.transform(
                times[0], f"{prefix}base_link", name, np.array([beam.x, beam.y, beam.angle])
            )
            for name, beam in beams
        ]
        yield times[0], "/tf_static", build.make("tf2_msgs/msg/TFMessage", transforms=mounts)
        for time, ranges in zip(times, readings.ranges[:, number].tolist(), strict=True):
            for (name, beam), reading in zip(beams, ranges, strict=True):
                limits = (beam.min_range, beam.max_range)
                yield time, f"/{name}", build.range(time, name, limits, reading)
