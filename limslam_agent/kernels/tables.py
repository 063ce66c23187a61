"""Constants that plain and compiled functions share."""

FROM_X, FROM_Y, TOWARDS_X, TOWARDS_Y, TOO_NEAR, TOO_FAR, ANGLE, FARTHEST = range(8)
"""Columns of ``RobotSpec.beam_table``."""

RAY_X, RAY_Y, RAY_TO_X, RAY_TO_Y, RAY_LENGTH, RAY_REACH = range(6)
"""Columns of a table of rays: origin, m, direction, reading, m, and longest reading, m. A reading of a beam that saw
nothing is its longest one."""

STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2.0**0.5), (1, -1, 2.0**0.5))
"""Steps from a cell to those that come after it: rows, columns, and the length in cells."""
