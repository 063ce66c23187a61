"""Connects a session with the node: the connection, the policy, and what is published."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from limslam_agent.config.presets import AgentConfig
from limslam_agent.live.ros2.link import RosLink
from limslam_agent.live.ros2.node import check_installed, ros_node
from limslam_agent.live.ros2.outputs import Outputs
from limslam_agent.live.session import Wired
from limslam_agent.policies.policy import Policy
from limslam_agent.policies.wall_policy import explorer
from limslam_agent.policies.way_home import WayHome
from limslam_env.interface import RobotSpec


@contextmanager
def wired_by_ros(described: RobotSpec | None, arguments: Sequence[str]) -> Iterator[Wired]:
    """A robot of ROS 2, until the context ends.

    After the policy that was asked for, it drives home, where the parameters or an order say so. Raises a ValueError if
    ROS 2 is not installed, the robot is not described, or an argument or a parameter cannot be used.
    """
    check_installed()
    if described is None:
        raise ValueError("--ros2 needs --robot, the description of body, wheels and beams: messages do not hold it")
    with ros_node(arguments) as node:
        node.parameters.check(described)
        link = RosLink(node, described, node.parameters)
        outputs = Outputs(node, link)

        def policy(asked: Policy | None, config: AgentConfig, robot: RobotSpec) -> WayHome:
            always = node.parameters.return_to_init
            return WayHome(asked or explorer(robot, config), robot, config.policy, always=always)

        yield Wired(link, "of ROS 2", lambda _: link.robot, policy, outputs.watch, outputs.obey)
