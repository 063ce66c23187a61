"""Explores with a robot of ROS 2: ros2 launch limslam.launch.py robot:=my_robot.toml out:=my_room.

Remap topics and set parameters in the list below. docs/robot/ros2.md lists them all.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration

ARGUMENTS = {
    "robot": "paper",
    "out": "my_room",
    "noise": "0.02",
    "scan": "scan",
    "cmd_vel": "cmd_vel",
}


def generate_launch_description() -> LaunchDescription:
    """The launch description, which ROS 2 asks for."""
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    node = ExecuteProcess(
        cmd=[
            *(
                "limslam",
                "live",
                "--ros2",
                "--robot",
                given["robot"],
                "--noise",
                given["noise"],
                "--out",
                given["out"],
            ),
            *("--", "--ros-args"),
            *("-r", ["scan:=", given["scan"]], "-r", ["cmd_vel:=", given["cmd_vel"]]),
            *("-p", "return_to_init:=true"),
        ],
        output="screen",
        # The host gets time to write the folder after Ctrl-C.
        sigterm_timeout="60",
        sigkill_timeout="60",
    )
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value)
                for name, value in ARGUMENTS.items()
            ),
            node,
        ]
    )
