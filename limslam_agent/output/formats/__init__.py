"""A finished run in the formats of other programs: tables, drawings for CAD and ROS 2 bags."""
