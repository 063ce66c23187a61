"""Limits that decide what the consistent estimator does with readings, plain or in a batch. Nothing
sets them.

All values are choices of this project, tuned on seeds that are not reported. Lengths are in metres,
angles in radians.
"""

import math

from limslam_agent.config.gates import gate

WALL_END = 0.25
"""A wall has ended when the robot has driven so far without a hit on it."""

COMPLETE_AFTER = 0.15
"""A piece of wall is complete when the robot has driven so far since the piece's last reading."""

GAP_AHEAD = 0.9
"""Largest hole between the points of the beams ahead that still belong to one wall.

It replaces ``HoughConfig.max_gap`` for these beams, which meet a wall at places far apart.
"""

# Association. A landmark is considered if it is not farther away than this: the gap along the wall,
# the difference of direction, and the offset across the wall. The angle and the offset also limit
# the merging of two landmarks.
MAX_END_GAP = 0.35
MAX_ANGLE = math.radians(20.0)
MAX_OFFSET = 0.5

FAR_GATE = gate(2, 0.9999963)
"""Readings with a chi-square between ``WallAssociationConfig.gate`` and this one create no
landmark.

They update the landmark if every other one has this chi-square or more, and if they would be good
enough for a new landmark but for their length. Otherwise they stay pending.
"""

# Updates of a landmark by a piece of wall.
HUBER = 1.5
"""Residuals of more standard deviations than this are weighted down (Huber's weights)."""

ITERATIONS = 2
"""Iterations of an update, and of the merging of two landmarks."""

# New landmarks.
LINE_PRIOR = (10.0**2, 3.0**2)
"""Variances of a new line's d and theta, m^2 and rad^2: large, so that the readings alone determine
the line.
"""

LENGTH_IF_COMPLETE = 0.25
"""Least length of a piece that is complete: no more readings of it will come."""

MAX_ANGLE_STD = math.radians(3.0)
"""Largest standard deviation of the piece's direction."""

# Two landmarks are one wall, and are merged.
ONE_WALL_GATE = gate(2, 0.99966)
"""Largest chi-square of the difference of two landmarks, or of the poses of a loop: four standard
deviations.
"""

MIN_OVERLAP = 0.15
"""Least length of wall that both landmarks cover."""

STRAIGHTNESS = (1e-3**2, 1e-4**2)
"""Variances, m^2 and rad^2, by which one real wall deviates from a line.

They bound the difference of two landmarks from below, because landmarks that were always seen
together may have a difference that is known more exactly than any wall is straight.
"""

EQUALITY_NOISE = (1e-4**2, 1e-5**2)
"""Variances, m^2 and rad^2, of the constraint that two merged lines are equal: small, but P stays
regular.
"""

KNOWN_PLACE = 0.01**2
"""Variance of the offset of two lines by the place of its anchor, m^2, below which the place counts
as known.
"""

# Extents of landmarks.
MAX_GAP = 0.30
"""Longest stretch without readings that is drawn as wall."""

THROUGH_TOLERANCE = 1.0
"""Largest number of beams that passed for each beam that hit, where a wall is drawn."""

RESTART_WITHIN = 1800
"""Number of first steps within which a mapper begins again when the SLAM finds errors of odometry
or sensor.
"""
