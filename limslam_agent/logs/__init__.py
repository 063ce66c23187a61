"""Recorded logs: CARMEN, CSV, npz and ROS bags, and known relations between poses."""
