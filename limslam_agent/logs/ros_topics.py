"""Chooses the topics of a bag that a log is made of, by their types or as given, and plans how to
read them.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, NamedTuple

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
    stamp_of,
    yaw_of,
)
from limslam_agent.logs.wording import listed
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
_DRONE = ("state_ranger_qxyzw", "state_xyzv")
_CRAZYFLIE_BEAMS_DEG = (-90.0, 0.0, 90.0, 180.0)
_QUATERNION = slice(5, 9)


Topics = Mapping[str, float | None]
"""Topics chosen by the user: of LaserScans, which are combined, or Ranges, and of one Odometry or
pose. A Range may have the direction of its beam, deg, left positive. What is not chosen is found by
its type.
"""


class Reader(NamedTuple):
    """Extracts the wanted numbers from each message of a topic, after the stamp of the message, s.
    None of a message that lacks them.
    """

    topic: str
    read: Callable[[Any], Sequence[float] | FloatArray | None]


class Plan(NamedTuple):
    """How a bag becomes a log: its beams; the readers of ranges, each with the places of its
    columns among the beams; and the readers whose columns side by side are x, y and heading.
    """

    beams: list[SensorSpec]
    scans: list[tuple[Reader, list[int]]]
    moves: list[Reader]


class Sensor(NamedTuple):
    """A topic with ranges: its beams on the body, and a function that reads some beams (m) from a
    message.
    """

    topic: str
    beams: list[SensorSpec]
    read: Callable[[Any, IntArray], Sequence[float] | FloatArray]

    def reader(self, columns: Sequence[int]) -> Reader:
        """The reader of some beams."""
        indices = np.array(columns)
        return Reader(self.topic, lambda each: [stamp_of(each), *self.read(each, indices)])


def plan_for(bag: Bag, topics: Topics, beams_deg: Sequence[float] | None, max_range: float) -> Plan:
    """Choose topics and beams. Raises a ValueError if there are too few or too many candidates, or
    a requested topic is missing, empty or of another type.
    """
    drone = [[each for each in bag.types if each.rpartition("/")[2] == name] for name in _DRONE]
    if not topics and [len(names) for names in drone] == [1, 1]:
        (ranger,), (position,) = drone
        sensors, moves = _crazyflie(ranger, position, max_range)
    else:
        sensors, moves = _by_type(bag, topics, max_range)
    offers = [(sensor, column) for sensor in sensors for column in range(len(sensor.beams))]
    beams = [sensor.beams[column] for sensor, column in offers]
    chosen = choose_beams(np.degrees([each.angle for each in beams]), beams_deg)
    scans = []
    for sensor in sensors:
        places = [place for place, index in enumerate(chosen) if offers[index][0] is sensor]
        if places:
            reader = sensor.reader([offers[chosen[place]][1] for place in places])
            scans.append((reader, places))
    return Plan([beams[index] for index in chosen], scans, moves)


def _crazyflie(ranger: str, position: str, max_range: float) -> tuple[list[Sensor], list[Reader]]:
    """The sensors and the odometry of a Crazyflie drone. Its fifth beam, up, is left out."""
    beams = [beam(np.radians(degrees), max_range) for degrees in _CRAZYFLIE_BEAMS_DEG]
    moves = [
        Reader(position, lambda each: [stamp_of(each), *each.raw[:2]]),
        Reader(ranger, lambda each: [stamp_of(each), yaw_of(each.raw[_QUATERNION])]),
    ]
    return [Sensor(ranger, beams, lambda each, columns: each.raw[columns])], moves


def _by_type(bag: Bag, topics: Topics, max_range: float) -> tuple[list[Sensor], list[Reader]]:
    """The sensors and the odometry of the chosen topics, or else of those of a fitting type."""
    chosen = {_full_name(bag, topic): degrees for topic, degrees in topics.items()}
    for topic, degrees in chosen.items():
        if degrees is not None and bag.types[topic] != RANGE:
            raise ValueError(
                f"{topic} holds {bag.types[topic]}: only a Range has a direction to choose"
            )
    scans, ranges = _sensor_topics(bag, chosen)
    moves, mounts = _odometry(bag, chosen)
    sensors = [_laser(bag, topic, mounts, max_range) for topic in scans]
    for topic in ranges:
        sensors += _range_sensor(bag, topic, chosen.get(topic), mounts, max_range)
    if not sensors:
        raise ValueError(f"all of {', '.join(ranges)} look up or down: no beam is left")
    return sensors, moves


def _sensor_topics(bag: Bag, chosen: Topics) -> tuple[list[str], list[str]]:
    """Topics of LaserScans, and topics of Ranges."""
    scans = _of_type(bag, [LASER_SCAN], chosen)
    ranges = _of_type(bag, [RANGE], chosen)
    if scans or ranges:
        return scans, ranges
    scans = _of_type(bag, [LASER_SCAN])
    ranges = [topic for topic in _of_type(bag, [RANGE]) if not is_vertical(topic)]
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


def _odometry(bag: Bag, chosen: Topics) -> tuple[list[Reader], Mounts]:
    """The reader of the odometry, and the mounts of the sensors on the body. Odometry is preferred
    to poses: they are often goals or estimates of other programs.
    """
    for topics in (
        _of_type(bag, _MOVES, chosen),
        _of_type(bag, [ODOMETRY]),
        _of_type(bag, POSES),
    ):
        if len(topics) > 1:
            raise ValueError(
                f"has {len(topics)} topics with poses, {', '.join(topics)}: choose one with "
                "--topics"
            )
        if topics:
            base = getattr(bag.first(topics[0]), "child_frame_id", None)
            return [Reader(topics[0], _stamped_pose)], _mounts(bag, base)
    return _moves_in_transforms(bag)


def _moves_in_transforms(bag: Bag) -> tuple[list[Reader], Mounts]:
    """The reader of the transform from a frame of odometry to the body, and the mounts on the body.

    Other transforms that are sent again and again are taken to be fixed, as that from the body's
    place on the floor to its middle.
    """
    found = {
        _ends(each): (message.topic, each)
        for message in bag.messages(_transform_topics(bag, is_fixed=False))
        for each in message.content.transforms
    }
    choices = (
        [each for each in found if word in each[0].rpartition("/")[2] and each[0] != each[1]]
        for word in _ODOMETRY_FRAMES
    )
    ends = next(filter(None, choices), [])
    if not ends:
        raise ValueError(
            f"has no Odometry, no pose and no transform from odom to the body; {_contents(bag)}"
        )
    if len(ends) > 1:
        names = ", ".join(f"{parent} to {child}" for parent, child in ends)
        raise ValueError(f"has {len(ends)} transforms from a frame of odometry, {names}")
    topic, _ = found.pop(ends[0])

    def read(message: Any) -> Sequence[float] | None:
        poses = (_stamped_pose(each) for each in message.transforms if _ends(each) == ends[0])
        return next(poses, None)

    return [Reader(topic, read)], _mounts(bag, ends[0][1], [each for _, each in found.values()])


def _stamped_pose(message: Any) -> Sequence[float]:
    return stamp_of(message), *pose_of(message)


def _ends(transform: Any) -> tuple[str, str]:
    """The frames of a transform."""
    return bare(transform.header.frame_id), bare(transform.child_frame_id)


def _mounts(bag: Bag, base: str | None, others: Sequence[Any] = ()) -> Mounts:
    """The mounts on the body, by the transforms that never change, and by others."""
    mounts = Mounts(base)
    mounts.add(others)
    for message in bag.messages(_transform_topics(bag, is_fixed=True)):
        mounts.add(message.content.transforms)
    return mounts


def _transform_topics(bag: Bag, *, is_fixed: bool) -> list[str]:
    """The topics of transforms that never change, or of the others."""
    return [
        topic
        for topic, kind in bag.types.items()
        if kind in TRANSFORMS and topic.endswith("tf_static") == is_fixed
    ]


def _of_type(bag: Bag, wanted: Sequence[str], among: Collection[str] | None = None) -> list[str]:
    """The topics of some types, in the order of ``among`` if only those are asked for."""
    topics = sorted(topic for topic in bag.types if bag.counts[topic]) if among is None else among
    return [topic for kind in wanted for topic in topics if bag.types[topic] == kind]


def _full_name(bag: Bag, topic: str) -> str:
    """The full name of a topic that can be used."""
    name = topic if topic in bag.types else f"/{topic}"
    if name not in bag.types:
        raise ValueError(f"has no topic {topic}; {_contents(bag)}")
    usable = (LASER_SCAN, RANGE, *_MOVES)
    if bag.types[name] not in usable:
        wanted = ", ".join(each.rpartition("/")[2] for each in usable)
        raise ValueError(f"{name} holds {bag.types[name]}, where one of {wanted} is needed")
    if not bag.counts[name]:
        raise ValueError(f"the topic {name} is empty")
    return name


def _contents(bag: Bag) -> str:
    names = [
        f"{topic} ({kind}{'' if bag.counts[topic] else ', empty'})"
        for topic, kind in sorted(bag.types.items())
    ]
    return f"it has {listed(names, _MOST_NAMED) or 'no topics at all'}"


def _laser(bag: Bag, topic: str, mounts: Mounts, max_range: float) -> Sensor:
    first = bag.first(topic)
    check_beams(len(first.ranges))
    angles = scan_angles(first)
    mount = mounts.find(first.header.frame_id) or _AT_ORIGIN
    limits = sensor_limits(float(first.range_min), float(first.range_max), max_range)
    found = [(angle, beam_on_body(mount, float(angle), limits)) for angle in angles]
    level = np.array([angle for angle, each in found if each is not None])
    if not len(level):
        raise ValueError(f"all beams of {topic} look up or down")
    beams = [each for _, each in found if each is not None]
    return Sensor(topic, beams, lambda message, columns: scan_readings(message, level[columns]))


def _range_sensor(
    bag: Bag, topic: str, degrees: float | None, mounts: Mounts, max_range: float
) -> list[Sensor]:
    """The single beam of a Range. Nothing if the beam looks up or down."""
    first = bag.first(topic)
    frame = first.header.frame_id
    mount = mounts.find(frame)
    limits = sensor_limits(float(first.min_range), float(first.max_range), max_range)
    if degrees is None and mount is None:
        if is_vertical(frame):
            return []
        degrees = _guess(topic, frame)
    if degrees is None:
        found = beam_on_body(mount or _AT_ORIGIN, 0.0, limits)
    else:
        x, y = (0.0, 0.0) if mount is None else map(float, mount[1][:2])
        found = beam(np.radians(degrees), limits[1], x=x, y=y, min_range=limits[0])
    if found is None:
        return []
    return [Sensor(topic, [found], lambda message, _: [float(message.range)])]


def _guess(topic: str, frame: str) -> float:
    """The direction in the names of a frame or a topic, deg."""
    for name in (frame, topic.rpartition("/")[2], topic):
        if (degrees := direction_of(name)) is not None:
            return degrees
    raise ValueError(f"where {topic} points is unknown: set it with --topics {topic}:DEGREES,...")
