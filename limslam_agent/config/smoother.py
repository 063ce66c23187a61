"""Settings of the line smoother, which estimates all poses of a run. Most of its numbers are constants beside the code.

All values are choices of this project, tuned on seeds that are not reported. Lengths are in metres, angles in radians.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from limslam_agent.config.bounds import Angle, Bounded, Bounds, CountOrNone, NonNegative
from limslam_env.geometry import FloatArray

_StdShare = Annotated[float, Bounds(1e-6, 0.999)]


@dataclass(frozen=True)
class CalibrationPrior(Bounded):
    """The prior of the constant errors of wheels and beams.

    Attributes
    ----------
    size_std
        Standard deviation of the common relative size error of both wheels.
    uneven_std
        Standard deviation of the right wheel's relative size error with respect to the left wheel.
    axle_std
        Standard deviation of the axle's relative size error.
    bias_std
        Standard deviation of the bias of all ranges, m.
    """

    size_std: _StdShare = 0.03
    uneven_std: _StdShare = 0.03
    axle_std: _StdShare = 0.03
    bias_std: _StdShare = 0.02

    @property
    def information(self) -> FloatArray:
        """Inverse covariance (4, 4) of the calibration: left wheel, right wheel, axle, bias."""
        both, half = self.size_std**2, 0.25 * self.uneven_std**2
        covariance = np.diag([both + half, both + half, self.axle_std**2, self.bias_std**2])
        covariance[[0, 1], [1, 0]] = both - half
        return np.asarray(np.linalg.inv(covariance))


@dataclass(frozen=True)
class SensorConfig(Bounded):
    """Errors of the range sensors that were not specified.

    Attributes
    ----------
    rounds
        Largest number of times that they are estimated, each time with a new solution; 0 takes sensors to be as
        specified.
    noise_ratio
        The noise is as specified if the standard deviation of the residuals differs from it by at most this factor.
    turn_gate, turn_std
        Beams are turned if twice the logarithm of the Bayes factor for turned beams exceeds the gate; and the standard
        deviation of the direction of a beam, rad.
    width_gate
        The beams have an opening angle if chi-square falls by more than this.
    max_width
        Largest half of the opening angle, rad.
    """

    rounds: CountOrNone = 4
    noise_ratio: Annotated[float, Bounds(1.0, 100.0)] = 1.25
    turn_gate: NonNegative = 40.0
    turn_std: Annotated[float, Bounds(1e-6, 1.0)] = 0.05
    width_gate: NonNegative = 40.0
    max_width: Angle = math.radians(10.0)


@dataclass(frozen=True)
class SmootherConfig(Bounded):
    """All settings of the line smoother.

    Attributes
    ----------
    sensor
        Errors of the range sensors.
    calibrate, calibration
        Whether constant errors of wheels, axle and ranges are estimated (``always``, ``never``, or ``if_needed``), and
        the prior of these errors.
    """

    sensor: SensorConfig = field(default_factory=SensorConfig)
    calibrate: Literal["always", "if_needed", "never"] = "if_needed"
    calibration: CalibrationPrior = field(default_factory=CalibrationPrior)


@dataclass(frozen=True)
class RenewalConfig(Bounded):
    """When the last minutes of a drive are smoothed while the robot drives on, and the online estimate is renewed.

    Attributes
    ----------
    period
        Longest time between two renewals, s.
    least
        Least time between two renewals, s, if the robot is lost and does not go on in a local frame.
    end_noise
        By how much the position of each end of a known wall becomes less certain at each renewal, in standard
        deviations of a range. It stands for errors that a wall has in each stretch again.
    """

    period: NonNegative = 900.0
    least: NonNegative = 30.0
    end_noise: NonNegative = 1.0
