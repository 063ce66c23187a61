"""The simulation of one world: physics, sensors, odometry, coverage, starts and the task."""
