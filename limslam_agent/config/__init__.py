"""Settings: one module for each estimator, one for exploration, and the presets.

This file imports nothing, so that the command line starts quickly.
"""

DEFAULT_PRESET = "graph"
"""Name of the preset that is used where none is named, for runs and replays alike."""
