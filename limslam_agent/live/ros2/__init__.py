"""A live robot of ROS 2: a node that listens to its sensors, and publishes map, pose and speeds."""
