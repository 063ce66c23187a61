"""Settings of the line smoother, which estimates all poses of a run. Its numbers are constants
beside the code.
"""

from dataclasses import dataclass

from limslam_agent.config.bounds import Bounded, NonNegative
from limslam_agent.config.consistent import WhenToCalibrate


@dataclass(frozen=True)
class SmootherConfig(Bounded):
    """All settings of the line smoother."""

    # Whether constant errors of wheels, axle and ranges are estimated: ``always``, ``never``, or
    # ``if_needed``
    calibrate: WhenToCalibrate = "if_needed"


@dataclass(frozen=True)
class RenewalConfig(Bounded):
    """When the last minutes of a drive are smoothed while the robot drives on, and the online
    estimate is renewed.
    """

    period: NonNegative = 900.0  # Longest time between two renewals, s
