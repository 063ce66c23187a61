"""The command line `limslam`."""
