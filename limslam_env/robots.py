"""Robots that come with the package: the paper's and common real ones. A ``RobotSpec`` describes
any other robot.

Each is a function, so that its numbers can be changed: ``ring(64, max_range=3.0)``.
"""

import math
from collections.abc import Callable

from limslam_env.interface import RobotSpec, SensorSpec, beams_on_rim, degrees_around


def paper() -> RobotSpec:
    """The paper's robot: six infrared beams at +90, +45, +15, -15, -45 and -90 deg. All numbers are
    our choice.
    """
    return RobotSpec()


def e_puck(max_range: float = 0.06) -> RobotSpec:
    """An e-puck: 7 cm wide, eight infrared sensors that see a few centimetres (``max_range``, m).

    Angles and sizes of the e-puck's data sheet (Mondada et al., "The e-puck, a robot designed for
    education in engineering", 2009).
    """
    degrees = (17.0, 49.0, 90.0, 150.0, -150.0, -90.0, -49.0, -17.0)
    return RobotSpec(
        radius=0.035,
        axle=0.053,
        max_wheel_speed=0.129,
        beams=beams_on_rim(degrees, 0.035, min_range=0.005, max_range=max_range),
    )


def four_beam_drone(max_range: float = 2.0) -> RobotSpec:
    """A small drone with four time-of-flight beams ahead, left, behind and right, as far as a plane
    can hold one.

    It is driven like a robot on two wheels. The beams start at its middle and are useful to
    ``max_range`` (m).
    """
    beams = tuple(
        SensorSpec(0.0, 0.0, math.radians(degree), 0.05, max_range)
        for degree in (0.0, 90.0, 180.0, -90.0)
    )
    return RobotSpec(radius=0.06, axle=0.09, max_wheel_speed=0.30, beams=beams)


def ring(num_beams: int = 36, max_range: float = 1.5) -> RobotSpec:
    """The paper's body with ``num_beams`` all around it, the first ahead, counter-clockwise;
    ``max_range`` in m.
    """
    return RobotSpec(
        beams=beams_on_rim(degrees_around(num_beams), RobotSpec().radius, max_range=max_range)
    )


ROBOTS: dict[str, Callable[[], RobotSpec]] = {
    "paper": paper,
    "e-puck": e_puck,
    "four-beam-drone": four_beam_drone,
    "ring": ring,
    "lidar": RobotSpec.lidar,
}
"""The robots by name."""
