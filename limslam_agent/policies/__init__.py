"""Policies: from what the robot believes to its wheel speeds."""
