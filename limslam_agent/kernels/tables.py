"""Constants that plain and compiled functions share."""

FROM_X, FROM_Y, TOWARDS_X, TOWARDS_Y, TOO_NEAR, TOO_FAR, ANGLE, FARTHEST = range(8)
"""Columns of ``RobotSpec.beam_table``."""

STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2.0**0.5), (1, -1, 2.0**0.5))
"""Steps from a cell to those that come after it: rows, columns, and the length in cells."""
