"""What is possible at best: the offline optimum of a log, and tours by a driver that knows the map."""
