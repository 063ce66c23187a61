"""Chooses the topics of a bag that a log is made of, by their types or as given, and plans how to
read them.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from limslam_agent.logs.directions import direction_of, is_vertical
from limslam_agent.logs.pose_log import beam, choose_beams
from limslam_agent.logs.recorded_log import check_beams
from limslam_agent.logs.ros_bag import Bag
from limslam_agent.logs.ros_messages import (
    LASER_SCAN,
    ODOMETRY,
    POSES,
    RANGE,
    TRANSFORMS,
    Mounts,
    bare,
    beam_on_body,
    pose_of,
    scan_angles,
    scan_readings,
    sensor_limits,
    yaw_of,
)
from limslam_env.geometry import FloatArray, IntArray
from limslam_env.interface import SensorSpec

_MOST_NAMED = 8
_MOVES = (ODOMETRY, *POSES)
# Names of the frames from which a transform to the body is odometry, or else a pose
_ODOMETRY_FRAMES = "odom", "map", "world"
_AT_ORIGIN = (np.eye(3), np.zeros(3))

# A Crazyflie drone records its log blocks as plain arrays, and the topics' names describe their
# content. One holds the right, front, left, back and up range (m) and the quaternion of the
# attitude, the other one the position (m) by dead reckoning and the velocity.
_RANGER = "state_ranger_qxyzw"
_POSITION = "state_xyzv"
_CRAZYFLIE_BEAMS_DEG = (-90.0, 0.0, 90.0, 180.0)
_QUATERNION = slice(5, 9)


Topics = Mapping[str, float | None]
"""Topics chosen by the user: of LaserScans, which are combined, or Ranges, and of one Odometry or
pose. A Range may have the direction of its beam, deg, left positive. What is not chosen is found by
its type.
"""


@dataclass(frozen=True, eq=False)
class Reader:
    """Extracts the wanted numbers from each message of a topic, or from the part of it with a
    header. A message may lack this part.
    """

    topic: str
    read: Callable[[Any], Sequence[float] | FloatArray]
    part: Callable[[Any], Any | None] = lambda message: message


@dataclass(frozen=True, eq=False)
class Plan:
    """How a bag becomes a log."""

    beams: list[SensorSpec]
    scans: list[
        Reader
        # Readers of ranges. Their columns side by side, in the order ``columns``, belong to the
        # beams.
    ]
    columns: IntArray  # (n_beams,)
    moves: list[Reader]  # Readers whose columns side by side are x, y and heading


@dataclass(frozen=True, eq=False)
class Sensor:
    """A topic with ranges: its beams on the body, and a function that reads some beams (m) from a
    message.
    """

    topic: str
    beams: list[SensorSpec]
    read: Callable[[Any, IntArray], Sequence[float] | FloatArray]


def plan_for(bag: Bag, topics: Topics, beams_deg: Sequence[float] | None, max_range: float) -> Plan:
    """Choose topics and beams. Raises a ValueError if there are too few or too many candidates, or
    a requested topic is missing, empty or of another type.
    """
    if not topics and (plan := _crazyflie(bag.types, beams_deg, max_range)) is not None:
        return plan
    chosen = {name: degrees for topic, degrees in topics.items() for name in [_given(bag, topic)]}
    directed = [
        topic
        for topic, degrees in chosen.items()
        if degrees is not None and bag.types[topic] != RANGE
    ]
    if directed:
        raise ValueError(
            f"{directed[0]} holds {bag.types[directed[0]]}: only a Range has a direction to choose"
        )
    scans, ranges = _sensor_topics(bag, chosen)
    odometry = _odometry_topic(bag, chosen)
    if odometry is None:
        moves, mounts = _moves_in_transforms(bag)
    else:
        moves = Reader(odometry, pose_of)
        mounts = _mounts(bag, odometry)
    sensors = [_laser(bag, topic, mounts, max_range) for topic in scans]
    given = [_range_sensor(bag, topic, chosen.get(topic), mounts, max_range) for topic in ranges]
    sensors += [sensor for sensor in given if sensor is not None]
    if not sensors:
        raise ValueError(f"all of {', '.join(ranges)} look up or down: no beam is left")
    return _choose(sensors, [moves], beams_deg)


def _crazyflie(
    types: Mapping[str, str], beams_deg: Sequence[float] | None, max_range: float
) -> Plan | None:
    """How to read the bag of a Crazyflie drone. None unless there is exactly one. Its fifth beam,
    up, is left out.
    """
    found = [
        [topic for topic in types if topic.rpartition("/")[2] == name]
        for name in (_RANGER, _POSITION)
    ]
    if [len(topics) for topics in found] != [1, 1]:
        return None
    (ranger,), (position,) = found
    moves = [
        Reader(position, lambda message: message.raw[:2]),
        Reader(ranger, lambda message: [yaw_of(message.raw[_QUATERNION])]),
    ]
    beams = [beam(np.radians(degrees), max_range) for degrees in _CRAZYFLIE_BEAMS_DEG]
    return _choose(
        [Sensor(ranger, beams, lambda message, columns: message.raw[columns])], moves, beams_deg
    )


def _choose(sensors: list[Sensor], moves: list[Reader], beams_deg: Sequence[float] | None) -> Plan:
    offers = [(sensor, column) for sensor in sensors for column in range(len(sensor.beams))]
    beams = [sensor.beams[column] for sensor, column in offers]
    chosen = choose_beams(np.degrees([each.angle for each in beams]), beams_deg)
    readers = []
    read_order = []
    for sensor in sensors:
        indices = [index for index in chosen if offers[index][0] is sensor]
        if indices:
            readers.append(_reader(sensor, np.array([offers[index][1] for index in indices])))
            read_order += indices
    columns = np.array([read_order.index(index) for index in chosen])
    return Plan([beams[index] for index in chosen], readers, columns, moves)


def _reader(sensor: Sensor, columns: IntArray) -> Reader:
    return Reader(sensor.topic, lambda message: sensor.read(message, columns))


def _sensor_topics(bag: Bag, chosen: Topics) -> tuple[list[str], list[str]]:
    """Topics of LaserScans, and topics of Ranges."""
    scans, ranges = (_of_type(bag, kind, chosen) for kind in (LASER_SCAN, RANGE))
    if scans or ranges:
        return scans, ranges
    scans = _of_type(bag, LASER_SCAN)
    ranges = _of_type(bag, RANGE)
    ranges = [topic for topic in ranges if not is_vertical(topic)]
    if scans and ranges:
        both = f"LaserScan ({', '.join(scans)}) and Range topics ({', '.join(ranges)})"
        raise ValueError(f"has {both}: choose with --topics")
    if len(scans) > 1:
        raise ValueError(
            f"has {len(scans)} LaserScan topics, {', '.join(scans)}: choose with --topics"
        )
    if not scans and not ranges:
        raise ValueError(f"has no LaserScan and no Range; {_contents(bag)}")
    return scans, ranges


def _odometry_topic(bag: Bag, chosen: Topics) -> str | None:
    """The topic of odometry, which is preferred to poses: they are often goals or estimates of
    other programs. None if the bag has neither.
    """
    wanted = [topic for kind in _MOVES for topic in _of_type(bag, kind, chosen)]
    for found in (
        wanted,
        _of_type(bag, ODOMETRY),
        [topic for kind in POSES for topic in _of_type(bag, kind)],
    ):
        if len(found) > 1:
            raise ValueError(
                f"has {len(found)} topics with poses, {', '.join(found)}: choose one with --topics"
            )
        if found:
            return found[0]
    return None


def _moves_in_transforms(bag: Bag) -> tuple[Reader, Mounts]:
    """The reader of the transform from a frame of odometry to the body, and the mounts on the body.

    Other transforms that are sent again and again are taken to be fixed, as that from the body's
    place on the floor to its middle.
    """
    moving = _transform_topics(bag, is_fixed=False)
    fixed = _transform_topics(bag, is_fixed=True)
    found = {
        (bare(each.header.frame_id), bare(each.child_frame_id)): (message.topic, each)
        for message in bag.messages(moving)
        for each in message.content.transforms
    }
    for word in _ODOMETRY_FRAMES:
        ends = [each for each in found if word in each[0].rpartition("/")[2] and each[0] != each[1]]
        if not ends:
            continue
        if len(ends) > 1:
            names = ", ".join(f"{parent} to {child}" for parent, child in ends)
            raise ValueError(f"has {len(ends)} transforms from a frame of odometry, {names}")
        parent, child = ends[0]
        mounts = Mounts(child)
        mounts.add([found[other][1] for other in found if other != ends[0]])
        for message in bag.messages(fixed):
            mounts.add(message.content.transforms)
        return Reader(found[ends[0]][0], pose_of, _between(parent, child)), mounts
    raise ValueError(
        f"has no Odometry, no pose and no transform from odom to the body; {_contents(bag)}"
    )


def _between(parent: str, child: str) -> Callable[[Any], Any | None]:
    """A function that finds the transform between two frames in a TFMessage."""

    def part(message: Any) -> Any | None:
        for each in message.transforms:
            if (bare(each.header.frame_id), bare(each.child_frame_id)) == (parent, child):
                return each
        return None

    return part


def _transform_topics(bag: Bag, *, is_fixed: bool) -> list[str]:
    """The topics of transforms that never change, or of the others."""
    return [
        topic
        for topic, kind in bag.types.items()
        if kind in TRANSFORMS and topic.endswith("tf_static") == is_fixed
    ]


def _of_type(bag: Bag, wanted: str, among: Collection[str] | None = None) -> list[str]:
    """The topics of a type, in the order of ``among`` if only those are asked for."""
    topics = sorted(topic for topic in bag.types if bag.counts[topic]) if among is None else among
    return [topic for topic in topics if bag.types[topic] == wanted]


def _given(bag: Bag, topic: str) -> str:
    """The full name of a topic that can be used."""
    name = topic if topic in bag.types else f"/{topic}"
    if name not in bag.types:
        raise ValueError(f"has no topic {topic}; {_contents(bag)}")
    if bag.types[name] not in (LASER_SCAN, RANGE, *_MOVES):
        wanted = ", ".join(each.rpartition("/")[2] for each in (LASER_SCAN, RANGE, *_MOVES))
        raise ValueError(f"{name} holds {bag.types[name]}, where one of {wanted} is needed")
    if not bag.counts[name]:
        raise ValueError(f"the topic {name} is empty")
    return name


def _contents(bag: Bag) -> str:
    names = [
        f"{topic} ({kind}{'' if bag.counts[topic] else ', empty'})"
        for topic, kind in sorted(bag.types.items())
    ]
    if not names:
        return "it has no topics at all"
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return f"it has {', '.join(names[:_MOST_NAMED])}{more}"


def _mounts(bag: Bag, odometry: str) -> Mounts:
    mounts = Mounts(getattr(bag.first(odometry), "child_frame_id", None))
    for message in bag.messages(_transform_topics(bag, is_fixed=True)):
        mounts.add(message.content.transforms)
    return mounts


def _laser(bag: Bag, topic: str, mounts: Mounts, max_range: float) -> Sensor:
    first = bag.first(topic)
    check_beams(len(first.ranges))
    angles = scan_angles(first)
    mount = mounts.find(first.header.frame_id) or _AT_ORIGIN
    limits = sensor_limits(float(first.range_min), float(first.range_max), max_range)
    seen = [beam_on_body(mount, float(angle), limits) for angle in angles]
    level = np.array([index for index, each in enumerate(seen) if each is not None], dtype=np.int64)
    if not len(level):
        raise ValueError(f"all beams of {topic} look up or down")
    flat = [each for each in seen if each is not None]
    return Sensor(
        topic, flat, lambda message, columns: scan_readings(message, angles[level[columns]])
    )


def _range_sensor(
    bag: Bag, topic: str, degrees: float | None, mounts: Mounts, max_range: float
) -> Sensor | None:
    """The single beam of a Range. None if the beam looks up or down."""
    first = bag.first(topic)
    mount = mounts.find(first.header.frame_id)
    limits = sensor_limits(float(first.min_range), float(first.max_range), max_range)
    if degrees is not None:
        x, y = (0.0, 0.0) if mount is None else map(float, mount[1][:2])
        found: SensorSpec | None = beam(
            np.radians(degrees), limits[1], x=x, y=y, min_range=limits[0]
        )
    elif mount is not None:
        found = beam_on_body(mount, 0.0, limits)
    elif is_vertical(first.header.frame_id):
        found = None
    else:
        found = beam(
            np.radians(_guess(topic, first.header.frame_id)), limits[1], min_range=limits[0]
        )
    if found is None:
        return None
    return Sensor(topic, [found], lambda message, columns: [float(message.range)] * len(columns))


def _guess(topic: str, frame: str) -> float:
    for name in (frame, topic.rpartition("/")[2], topic):
        if (degrees := direction_of(name)) is not None:
            return degrees
    raise ValueError(f"where {topic} points is unknown: set it with --topics {topic}:DEGREES,...")
