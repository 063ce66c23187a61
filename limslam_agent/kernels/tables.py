"""Constants that plain and compiled functions share."""

import math

FROM_X, FROM_Y, TOWARDS_X, TOWARDS_Y, TOO_NEAR, TOO_FAR, ANGLE, FARTHEST = range(8)
"""Columns of ``RobotSpec.beam_table``."""

RAY_X, RAY_Y, RAY_TO_X, RAY_TO_Y, RAY_LENGTH, RAY_REACH, RAY_BEAM = range(7)
"""Columns of a table of rays: origin, m, direction, reading, m, longest reading, m, and number of the beam. A reading
of a beam that saw nothing is its longest one."""

STEPS = ((0, 1, 1.0), (1, 0, 1.0), (1, 1, 2.0**0.5), (1, -1, 2.0**0.5))
"""Steps from a cell to those that come after it: rows, columns, and the length in cells."""

POSE = 3
"""Length of a pose in the filter's state."""

GRAZING = 0.2
"""Least cosine between a beam and a line's normal. A reading at a flatter angle says too little about the line."""

FLATTEST = math.acos(GRAZING)
"""Largest angle between a line's normal and the middle of a beam that does not graze the line, rad."""

LEAST_COSINE = 1e-9
"""Least cosine that a range is divided by. A beam parallel to a line meets it very far away, at a finite range."""

FEWEST_TO_COMPARE = 4
"""Least number of readings that are compared with a line."""

LEAST_RESIDUAL = 1e-9
"""Least residual that the Huber weight divides by, m."""

FEWEST = 6
"""Least number of readings of a wall segment."""

FEWEST_FOR_SHAPE = 10
"""Least number of readings that are tested for a kink or a curve."""

KINKS_AT = (0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
"""Quantiles of the readings' positions at which a kink is tested for."""

KINK_GATE, MIN_KINK = 12.0, math.radians(8.0)
"""Least gain in chi-square (one degree of freedom) of a model with a kink, and least angle of that kink, rad."""

CURVE_GATE = 14.0
"""Least gain in chi-square (three degrees of freedom) of a smooth curve."""

END_ZONE, END_GATE = 0.10, 6.0
"""Points within this distance of an end, m, belong to another wall if chi-square falls by more than this without them.
"""

TURN_SIGMAS = 2.0
"""A piece of wall that is turned against a landmark by more than ``MIN_KINK``, and by more than this many standard
deviations of the piece's direction, does not update the landmark."""

LEAST_SPREAD = 1e-6
"""Least root of the summed squared distances of readings from their middle, m, that the angle's error is based on."""

LEAST_GAIN = 1e-9
"""Least squared norm of a shape that is divided by."""

NOTHING = 0.5
"""Likelihood that a beam sees nothing at a random place."""
