"""A finished run in the formats of other programs: tables, maps for CAD and GIS, ROS 2 bags and MCAP."""
