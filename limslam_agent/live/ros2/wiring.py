"""Connects a session with the node: the connection, what is published, and the orders that it
gets.
"""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

from limslam_agent.live.ros2.link import RosLink
from limslam_agent.live.ros2.node import RosNode, check_installed, ros_node
from limslam_agent.live.ros2.odometer import map_to_odom
from limslam_agent.live.session import Session, Wired
from limslam_env.interface import RobotSpec

_LEVELS = {
    "ok": b"\x00",
    "unsure": b"\x01",
    "lost": b"\x02",
}  # of DiagnosticStatus: OK, WARN, ERROR


class Outputs:
    """Publishes pose, transform, map, walls and status of a session."""

    def __init__(self, node: RosNode, link: RosLink) -> None:
        self._node = node
        self._link = link
        self._next_map = 0.0
        self._published = ("", "")
        self._pose = node.publisher("geometry_msgs/msg/PoseWithCovarianceStamped", "pose")
        self._transform = node.publisher("geometry_msgs/msg/TransformStamped", "map_to_odom")
        self._map = node.publisher("nav_msgs/msg/OccupancyGrid", "map", depth=1, is_kept=True)
        self._walls = node.publisher(
            "visualization_msgs/msg/MarkerArray", "walls", depth=1, is_kept=True
        )
        self._status = node.publisher("diagnostic_msgs/msg/DiagnosticArray", "status")
        has_tf = node.parameters.publish_tf and find_spec("tf2_msgs") is not None
        self._tf = node.publisher("tf2_msgs/msg/TFMessage", "/tf", depth=100) if has_tf else None

    def watch(self, session: Session) -> None:
        """Publish what the session believes after a decision."""
        self._publish_pose(session)
        state = session.state, session.agent.status
        if time.monotonic() >= self._next_map or state != self._published:
            self._published = state
            self._next_map = time.monotonic() + self._node.parameters.map_period
            self._publish_map(session)

    def _publish_pose(self, session: Session) -> None:
        sample = self._link.newest
        mapper = session.agent.mapper
        names = self._node.parameters
        assert sample is not None  # noqa: S101 (a session has decided)
        build = self._node.build
        pose = mapper.poses[0]
        self._pose(build.uncertain_pose(sample.time, names.map_frame, pose, mapper.covariances[0]))
        shift = map_to_odom(pose, sample.pose)
        frame = names.odom_frame or self._link.frames[0]
        # Other nodes look for a transform at times after the measurement.
        transform = build.transform(
            sample.time + names.transform_tolerance, names.map_frame, frame, shift
        )
        self._transform(transform)
        if self._tf is not None:
            self._tf(build.make("tf2_msgs/msg/TFMessage", transforms=[transform]))

    def _publish_map(self, session: Session) -> None:
        sample = self._link.newest
        frame = self._node.parameters.map_frame
        build = self._node.build
        assert sample is not None  # noqa: S101 (a session has decided)
        self._map(build.grid(sample.time, frame, session.agent.mapper.grid))
        self._walls(build.walls(sample.time, frame, session.agent.slam.segments))
        self._status(self._diagnosis(session, sample.time))

    def _diagnosis(self, session: Session, at: float) -> Any:
        make = self._node.build.make
        agent = session.agent
        figures = {
            "state": session.state,
            "walls": len(agent.slam.segments),
            **session.figures,
            "odometry_jumps": self._link.jumps,
        }
        values = [
            make("diagnostic_msgs/msg/KeyValue", key=key, value=str(value))
            for key, value in figures.items()
        ]
        status = make(
            "diagnostic_msgs/msg/DiagnosticStatus",
            level=_LEVELS[agent.status],
            name="limslam",
            hardware_id="",
            message=f"{agent.status}: {agent.status_reason}"
            if agent.status_reason
            else agent.status,
            values=values,
        )
        header = self._node.build.header(at, self._node.parameters.map_frame)
        return make("diagnostic_msgs/msg/DiagnosticArray", header=header, status=[status])


@contextmanager
def wired_by_ros(described: RobotSpec | None, arguments: Sequence[str]) -> Iterator[Wired]:
    """A robot of ROS 2, until the context ends.

    Raises a ValueError if ROS 2 is not installed, the robot is not described, or an argument or a
    parameter cannot be used.
    """
    check_installed()
    if described is None:
        raise ValueError(
            "--ros2 needs --robot, the description of body, wheels and beams: messages do not "
            "hold it"
        )
    with ros_node(arguments) as node:
        node.parameters.check(described)
        link = RosLink(node, described, node.parameters)
        yield Wired(link, "of ROS 2", lambda _: link.robot, Outputs(node, link).watch, node.orders)
