"""A guard that slows the wheels down before the body touches anything that the beams saw in the last seconds.

A few beams leave gaps, and a corner fits between two of them. The guard therefore remembers recent readings.
"""

import math

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.interface import RobotSpec

# Number of steps for which a measured point is remembered, and a point of a beam that reads its minimum range.
MEMORY, TOUCH = 40, 3
# A beam at its minimum range is assumed to have hit something at this share of the minimum range.
TOUCHING = 0.4
LOOK_AHEAD = 0.3  # s
MARGIN = 0.025  # m
# A point that lies deeper (m) inside the body is wrong: it is noise, or the pose has been corrected since.
GHOST = 0.02
SHARES = np.array([1.0, 0.5, 0.25])


class CollisionGuard:
    """Reduces the forward speed when the body would come too close to a recently measured point.

    The guard places points by the change of the estimated pose since they were measured. It does not use the map, which
    may be wrong.

    Parameters
    ----------
    robot
        Body and beams.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self._seen = np.full((MEMORY, len(robot.beams), 2), np.nan)
        self._touched = np.full((TOUCH, len(robot.beams), 2), np.nan)
        self._steps = 0

    def add_readings(self, pose: FloatArray, ranges: FloatArray) -> None:
        """Remember the readings (n_beams,), m, that were taken at an estimated pose (3,)."""
        from limslam_agent.kernels.nearness import place_readings

        # The oldest readings are replaced.
        seen, touched = self._seen[self._steps % MEMORY], self._touched[self._steps % TOUCH]
        place_readings(pose, np.asarray(ranges, dtype=float), self._robot.beam_table, TOUCHING, seen, touched)
        self._steps += 1

    def limit_speed(self, pose: FloatArray, wheels: FloatArray) -> FloatArray:
        """Reduce wheel speeds (2,), fractions of the maximum, until the next 0.3 s are free of contact.

        The rate of turn stays the same. The forward speed is scaled by 1, 1/2, 1/4 or 0, whichever is the largest that
        keeps the body away from all remembered points.
        """
        from limslam_agent.kernels.nearness import safe_share

        robot = self._robot
        left, right = (each * robot.max_wheel_speed for each in wheels.tolist())
        speed, turn = 0.5 * (left + right), (right - left) / robot.axle
        heading = float(pose[2]) + 0.5 * turn * LOOK_AHEAD
        way = speed * LOOK_AHEAD * np.array([math.cos(heading), math.sin(heading)])
        nearest = robot.radius - GHOST, robot.radius + MARGIN
        share = safe_share(pose, way, self._seen, self._touched, *nearest, SHARES)
        return np.asarray(wheels - (1.0 - share) * (0.5 * float(wheels[0] + wheels[1])))
