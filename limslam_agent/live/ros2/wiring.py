"""Connects a session with the node: the connection, the policy, and what is published."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from limslam_agent.config.presets import AgentConfig
from limslam_agent.live.protocol import Hello
from limslam_agent.live.ros2.link import RosLink
from limslam_agent.live.ros2.node import RosNode, check_installed, ros_node
from limslam_agent.live.ros2.outputs import Outputs
from limslam_agent.live.session import Session
from limslam_agent.policies.policy import Policy
from limslam_agent.policies.wall_policy import explorer
from limslam_agent.policies.way_home import WayHome
from limslam_env.interface import RobotSpec


class WiredByRos:
    """A robot of ROS 2.

    Parameters
    ----------
    node
        The node.
    described
        Description of the robot.

    Attributes
    ----------
    link
        The connection.
    place
        Where the robot is, in words.
    """

    def __init__(self, node: RosNode, described: RobotSpec) -> None:
        self._node = node
        self.link = RosLink(node, node.parameters.robot(described), node.parameters)
        self.place = "of ROS 2"
        self._outputs: Outputs | None = None

    def robot(self, hello: Hello) -> RobotSpec:
        """The robot, with the beams as its messages describe them."""
        del hello
        return self.link.robot

    def policy(self, policy: Policy | None, config: AgentConfig, robot: RobotSpec) -> WayHome:
        """The policy that was asked for, and after it the way home."""
        always = self._node.parameters.return_to_init
        way_home = WayHome(policy or explorer(robot, config), robot, config.policy, always=always)
        self._outputs = Outputs(self._node, self.link, way_home)
        return way_home

    def watch(self, session: Session) -> None:
        """Publish what the session believes."""
        if self._outputs is not None:
            self._outputs.watch(session)

    def obey(self, session: Session) -> None:
        """Pass orders on to the session."""
        if self._outputs is not None:
            self._outputs.obey(session)


@contextmanager
def wired_by_ros(described: RobotSpec | None, arguments: Sequence[str]) -> Iterator[WiredByRos]:
    """A robot of ROS 2, until the context ends.

    Raises
    ------
    ValueError
        If ROS 2 is not installed, the robot is not described, or an argument or a parameter cannot be used.
    """
    check_installed()
    if described is None:
        raise ValueError("--ros2 needs --robot, the description of body, wheels and beams: messages do not hold it")
    with ros_node(arguments) as node:
        yield WiredByRos(node, described)
