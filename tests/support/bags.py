"""Writes small bags of all kinds, with rosbags' own writers, for the tests of those who read
them.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("ros1", "sqlite", "mcap")
# What a drone's driver sends that has no type of its own: a header and numbers.
RAW_DATA = "infrastructure/msg/RawData"


def _stores() -> dict[int, Any]:
    stores = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
    missing = {
        "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms",
        RAW_DATA: "std_msgs/Header header\nfloat32[] raw",
    }
    for store in stores.values():
        for kind, text in missing.items():
            if kind not in store.fielddefs:
                store.register(get_types_from_msg(text, kind))
    return stores


_STORES = _stores()


@dataclass(frozen=True)
class Message:
    """A message to be written: its topic and type, when the bag gets it (s), and its fields."""

    topic: str
    kind: str
    at: float
    fields: dict[str, Any]


def write_bag(
    folder: Path, messages: list[Message], kind: str = "ros1", name: str = "some"
) -> Path:
    """A bag with the messages in the order given; the path that a user would name."""
    if kind == "ros1":
        path = folder / f"{name}.bag"
        with Writer1(path) as writer:
            _fill(writer, messages, 1)
        return path
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    path = folder / name
    with Writer2(path, version=9, storage_plugin=plugin) as writer:
        _fill(writer, messages, 2)
    return path


def storage_of(bag: Path) -> Path:
    """The one file in a ROS 2 bag's folder that holds the messages."""
    (file,) = (each for each in bag.iterdir() if each.suffix in {".db3", ".mcap"})
    return file


def _fill(writer: Any, messages: list[Message], version: int) -> None:
    store = _STORES[version]
    connections: dict[str, Any] = {}
    for message in messages:
        if message.topic not in connections:
            connections[message.topic] = writer.add_connection(
                message.topic, message.kind, typestore=store
            )
        content = build(store, message.kind, message.fields, version)
        pack = store.serialize_ros1 if version == 1 else store.serialize_cdr
        writer.write(
            connections[message.topic], round(1e9 * message.at), pack(content, message.kind)
        )


def build(store: Any, kind: str, fields: dict[str, Any], version: int) -> Any:
    """A message of a type; what is not named is zero."""
    values = {
        name: _value(store, node, fields.get(name), version)
        for name, node in store.fielddefs[kind][1]
    }
    return store.types[kind](**values)


def _value(store: Any, node: Any, given: Any, version: int) -> Any:
    sort, inner = node
    if sort.name == "NAME":
        return build(store, inner, given or {}, version)
    if sort.name == "BASE":
        return given if given is not None else ("" if inner[0] == "string" else 0)
    (element_sort, element), length = inner
    if element_sort.name == "NAME":
        return [build(store, element, each, version) for each in given or []]
    return np.array(given if given is not None else [0] * length, dtype=element[0])


def header(at: float, frame: str = "") -> dict[str, Any]:
    nanoseconds = round(1e9 * at)
    return {
        "stamp": {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9},
        "frame_id": frame,
    }


def rotation(yaw: float, roll: float = 0.0) -> dict[str, float]:
    """A quaternion: first roll about x, then yaw about z."""
    return {
        "x": math.sin(roll / 2) * math.cos(yaw / 2),
        "y": math.sin(roll / 2) * math.sin(yaw / 2),
        "z": math.cos(roll / 2) * math.sin(yaw / 2),
        "w": math.cos(roll / 2) * math.cos(yaw / 2),
    }


def pose(x: float, y: float, yaw: float) -> dict[str, Any]:
    return {"position": {"x": x, "y": y}, "orientation": rotation(yaw)}


def odometry(
    at: float,
    x: float,
    y: float = 0.0,
    yaw: float = 0.0,
    topic: str = "/odom",
    stamp: float | None = None,
) -> Message:
    fields = {"header": header(at if stamp is None else stamp), "child_frame_id": "base_link"}
    return Message(
        topic, "nav_msgs/msg/Odometry", at, {**fields, "pose": {"pose": pose(x, y, yaw)}}
    )


def scan(
    at: float, ranges: list[float], topic: str = "/scan", stamp: float | None = None, **fields: Any
) -> Message:
    """A LaserScan over half a turn, from the right, unless its fields say otherwise."""
    frame = fields.pop("frame", "laser")
    step = math.pi / max(len(ranges) - 1, 1)
    layout = {
        "angle_min": -math.pi / 2,
        "angle_increment": step,
        "range_min": 0.05,
        "range_max": 8.0,
        **fields,
    }
    content = {"header": header(at if stamp is None else stamp, frame), "ranges": ranges, **layout}
    return Message(topic, "sensor_msgs/msg/LaserScan", at, content)


def distance(
    at: float, value: float, topic: str, frame: str = "", stamp: float | None = None
) -> Message:
    """A Range."""
    content = {
        "header": header(at if stamp is None else stamp, frame),
        "min_range": 0.04,
        "max_range": 4.0,
    }
    return Message(topic, "sensor_msgs/msg/Range", at, {**content, "range": value})


def fixed(*mounts: tuple[str, str, float, float, float, float]) -> Message:
    """tf_static, out of (parent, child, x, y, yaw, roll)."""
    return transforms("/tf_static", 1.0, *mounts)


def transforms(
    topic: str, at: float, *frames: tuple[str, str, float, float, float, float]
) -> Message:
    """Transforms, out of (parent, child, x, y, yaw, roll)."""
    content = [
        {
            "header": header(at, parent),
            "child_frame_id": child,
            "transform": {"translation": {"x": x, "y": y}, "rotation": rotation(yaw, roll)},
        }
        for parent, child, x, y, yaw, roll in frames
    ]
    return Message(topic, "tf2_msgs/msg/TFMessage", at, {"transforms": content})
