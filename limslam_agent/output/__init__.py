"""Files and pictures of runs and replays, written and read."""
