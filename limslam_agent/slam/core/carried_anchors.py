"""Two lines are compared at a place that moves with the world.

The offset of two lines that are not exactly parallel depends on where along them it is measured. That is the anchor of
one of them, a fixed point of the map. A robot whose place is uncertain by metres does not know where along its walls
this point is. If the filter took the point as known, moving the whole world along a wall by some metres would explain
an offset of some centimetres, and two walls that are merged would move the robot by metres. So the anchor is carried
along with the robot's pose. A common motion of robot and world then changes nothing in the difference of two lines, as
it must be (G. Huang, A. Mourikis and S. Roumeliotis, "Observability-based rules for designing consistent EKF SLAM
estimators", 2010).

The functions are scalar and use nothing but :mod:`math`, so that kernels can compile them.
"""

import math

KNOWN_PLACE = 0.01**2
"""Variance of the offset of two lines by the anchor's place, m^2, below which the place counts as known."""


def by_carried_anchor(x: float, y: float, theta: float, other: float, sign: float) -> tuple[float, float, float]:
    """Derivative of the offset of two lines by the robot's pose, with which the anchor moves.

    Parameters
    ----------
    x, y
        From the robot's position to the anchor, m.
    theta, other
        Directions of the normals of the two lines, rad. The anchor is that of the other line.
    sign
        -1 if the two normals point to opposite sides, otherwise 1.
    """
    across = math.cos(other) - sign * math.cos(theta)
    along = math.sin(other) - sign * math.sin(theta)
    return across, along, x * along - y * across
