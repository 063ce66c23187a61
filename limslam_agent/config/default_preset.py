"""The preset that is used where none is named."""

DEFAULT_PRESET = "graph"
"""Its name, for runs and replays alike. This module imports nothing, so that the command line starts quickly."""
