"""Mapping from a recorded log, with its options and the calibration of its odometry."""
