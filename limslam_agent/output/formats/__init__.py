"""A finished run in the formats of other programs: tables, drawings for CAD, ROS 2 bags and MCAP."""
