"""What the beams saw in the last seconds keeps the body off: between six beams there is room for a corner."""

import math

import numpy as np

from limslam_env.geometry import FloatArray
from limslam_env.geometry.se2 import transform_points
from limslam_env.interface import RobotSpec

# Steps for which a place is remembered, and a beam that was too near to measure one.
_MEMORY, _TOUCH = 40, 3
# Such a beam's thing is taken to be at this share of its least range.
_TOUCHING = 0.4
_LOOK_AHEAD = 0.3
_MARGIN = 0.025
# A point deeper inside the body was never there: noise, or the pose has been corrected since.
_GHOST = 0.02
_SHARES = (1.0, 0.5, 0.25)


class Bumper:
    """Slows wheels down that would take the body too near to something seen of late.

    It works by what the pose changed by since, not by the map, which may be wrong.
    """

    def __init__(self, robot: RobotSpec) -> None:
        self._robot = robot
        self._seen: list[FloatArray] = []
        self._touched: list[FloatArray] = []

    def note(self, pose: FloatArray, ranges: FloatArray) -> None:
        """Take in readings (n_beams,), m, from a believed pose (3,)."""
        robot = self._robot
        reading, near = np.where(np.isfinite(ranges), ranges, robot.max_ranges), robot.too_near
        hit, touched = (reading > near) & (reading < robot.too_far), reading <= near
        ends = robot.beam_origins + np.where(touched, _TOUCHING * near, reading)[:, None] * robot.beam_directions
        points = transform_points(pose, ends)
        self._seen = [*self._seen[1 - _MEMORY :], points[hit]]
        self._touched = [*self._touched[1 - _TOUCH :], points[touched]]

    def soften(self, pose: FloatArray, wheels: FloatArray) -> FloatArray:
        """Wheel speeds (2,), fractions of the maximum: the turn as it is, and no more speed than there is room for."""
        robot = self._robot
        left, right = wheels * robot.max_wheel_speed
        speed, turn = 0.5 * (left + right), (right - left) / robot.axle
        points = np.vstack(self._seen + self._touched) - pose[:2]
        before = np.hypot(*points.T)
        points, before = points[before > robot.radius - _GHOST], before[before > robot.radius - _GHOST]
        heading = float(pose[2]) + 0.5 * turn * _LOOK_AHEAD
        way = speed * _LOOK_AHEAD * np.array([math.cos(heading), math.sin(heading)])
        least = np.minimum(before, robot.radius + _MARGIN)
        for share in _SHARES:
            if (np.hypot(*(points - share * way).T) >= least).all():
                return np.asarray(wheels - (1.0 - share) * wheels.mean())
        return np.asarray(wheels - wheels.mean())
