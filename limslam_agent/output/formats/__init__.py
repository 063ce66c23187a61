"""A finished run in the formats of other programs: tables and ROS 2 bags."""
