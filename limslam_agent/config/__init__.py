"""Settings: one module for each estimator, and the presets with exploration and ablations.

This file imports nothing, so that the command line starts quickly.
"""

DEFAULT_PRESET = "graph"
"""Name of the preset that is used where none is named, for runs and replays alike."""
