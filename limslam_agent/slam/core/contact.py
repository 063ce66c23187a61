"""Contact with a wall, as the readings show it, and the slip of the wheels that it allows.

A robot that touches a wall is held back, while its wheels go on turning. Its motion is then less
certain than the noise of the encoders says. No bumper is needed to notice most contacts: a beam
reads its minimum, and by the wheels the robot goes on towards what the beam sees.

Let a be the distance that a robot should have driven along a beam since that beam first read its
minimum m. The surface was u away then, between 0 and m, and what exceeds u is slip. The mean square
of max(a - u, 0) is (a^3 - max(a - m, 0)^3) / (3 m).

Contact with an edge that no beam sees, as behind the robot, remains unnoticed. Beams whose minimum
exceeds three quarters of the body's radius say nothing about contact. The row "bumping" of the
scoreboard feels the numbers below.
"""

import math
from dataclasses import replace

import numpy as np

from limslam_agent.kernels.tables import LEAST_DIVISOR
from limslam_agent.slam.core.motion import Motion
from limslam_env.geometry import BoolArray, FloatArray
from limslam_env.interface import RobotSpec

NEAR = 0.75
"""A beam shows contact if its minimum is at most this share of the body's radius."""

LEAST_SLIP = 0.005
"""Slip counts from this root mean square on, m. Less than that follows from noise of the readings
near a wall.
"""

LASTING = 2.0
"""A contact lasts until the beam reads more than its minimum by this number of standard
deviations.
"""

LONGEST = 1.0
"""No contact holds a robot back for longer than this distance by the wheels, m. A beam that still
reads its minimum then is broken or covered, or its driver reports 0 where it sees nothing.
"""

ALONG = 0.8
ACROSS = 0.2
"""Shares of the slip's variance along the beam and across it: the surface's normal is within some
45 degrees of it.
"""

TURN = 0.5
"""Standard deviation of the heading's slip for each metre of slip, rad/m."""


def slip(
    memory: FloatArray,
    ranges: FloatArray,
    measured: BoolArray,
    ahead: float,
    angles: FloatArray,
    too_near: FloatArray,
    radius: float,
    std: float,
) -> tuple[float, float]:
    """How much of the wheels' travel may have been slip by contact: a variance, m^2, and the angle
    of the beam, rad.

    Plain numbers and loops, because the batch compiles the same function. The variance is 0 without
    contact.

    Parameters
    ----------
    memory
        Is changed: for each beam the distance along it since it first read its minimum, m, -1 where
        it does not.
    ranges, measured, angles, too_near
        Readings (n_beams,), m, which of them are new, directions of the beams, rad, and readings up
        to which something is near, m.
    ahead
        Distance by the wheels in this step, m; negative backwards.
    radius, std
        Radius of the body, m, and standard deviation of a range, m.
    """
    most = 0.0
    angle = 0.0
    for beam in range(len(ranges)):
        least = max(too_near[beam], LEAST_DIVISOR)
        old = memory[beam]
        if least > NEAR * radius or (old < 0.0 and not (measured[beam] and ranges[beam] <= least)):
            continue
        driven = ahead * math.cos(angles[beam])
        gained = 0.0
        if old < 0.0:
            memory[beam] = 0.0
        elif measured[beam] and ranges[beam] > least + LASTING * std:
            memory[beam] = -1.0
        else:
            # A robot that has driven back has to come near again.
            memory[beam] = new = 0.0 if driven < 0.0 else min(old + driven, LONGEST)
            gained = (new**3 - max(new - least, 0.0) ** 3) / (3.0 * least)
            counted = (old**3 - max(old - least, 0.0) ** 3) / (3.0 * least)
            if gained < LEAST_SLIP**2:
                gained = 0.0
            elif counted >= LEAST_SLIP**2:
                gained -= counted
        if gained > most:
            most = gained
            angle = angles[beam]
    return most, angle


def slip_covariance(variance: float, angle: float) -> FloatArray:
    """Covariance (3, 3) of a pose increment, m and rad, by slip of this variance, m^2, at a beam's
    angle, rad.
    """
    cos = math.cos(angle)
    sin = math.sin(angle)
    covariance = np.zeros((3, 3))
    covariance[0, 0] = variance * (ALONG * cos * cos + ACROSS * sin * sin)
    covariance[1, 1] = variance * (ALONG * sin * sin + ACROSS * cos * cos)
    covariance[0, 1] = covariance[1, 0] = variance * (ALONG - ACROSS) * cos * sin
    covariance[2, 2] = variance * TURN * TURN
    return covariance


class Contacts:
    """Follows the readings and the wheels of one robot, and makes motions in contact less certain.

    Ranges have the standard deviation ``std``, m.
    """

    def __init__(self, robot: RobotSpec, std: float) -> None:
        self._robot = robot
        self._std = std
        self._memory = np.full(len(robot.beams), -1.0)

    def slip(self, ahead: float, ranges: FloatArray, measured: BoolArray) -> tuple[float, float]:
        """:func:`slip` in the next step."""
        robot = self._robot
        return slip(
            self._memory,
            ranges,
            measured,
            ahead,
            robot.beam_angles,
            robot.too_near,
            robot.radius,
            self._std,
        )

    def loosened(self, motion: Motion, ranges: FloatArray, measured: BoolArray) -> Motion:
        """The motion of the next step, with the slip that its readings allow in its covariance."""
        variance, angle = self.slip(float(motion.increment[0]), ranges, measured)
        if not variance:
            return motion
        return replace(motion, covariance=motion.covariance + slip_covariance(variance, angle))


def slip_covariances(
    robot: RobotSpec, std: float, wheels: FloatArray, ranges: FloatArray, measured: BoolArray
) -> FloatArray:
    """Covariances (n, t, 3, 3) of the slip by contact in the motions of a drive of n robots, m and
    rad.

    They are of the motion ahead and aside and of the turn. The wheels travel (n, t, 2), m. The
    readings (t + 1, n, n_beams), m, of which some were ``measured``, begin before the first
    motion, and ``std`` is the standard deviation of a range, m.
    """
    found = np.zeros((*wheels.shape[:2], 3, 3))
    for number in np.flatnonzero((measured & (ranges <= robot.too_near)).any(axis=(0, 2))).tolist():
        contacts = Contacts(robot, std)
        contacts.slip(0.0, ranges[0, number], measured[0, number])
        for motion, ahead in enumerate(wheels[number].mean(axis=1).tolist()):
            variance, angle = contacts.slip(
                ahead, ranges[motion + 1, number], measured[motion + 1, number]
            )
            if variance:
                found[number, motion] = slip_covariance(variance, angle)
    return found
