"""Settings of the consistent estimator, one frozen dataclass for each stage.

All values are choices of this project, tuned on seeds that are not reported. Lengths are in metres,
angles in radians. Numbers that nothing sets are constants beside the code
(:mod:`limslam_agent.slam.consistent.limits`).
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal, Self

import numpy as np

from limslam_agent.config.bounds import Bounded, Bounds, Count, CountOrNone, NonNegative
from limslam_agent.config.gates import gate
from limslam_agent.config.shared import HoughConfig
from limslam_env.geometry import FloatArray

_NOISY_STD = 0.01  # m, standard deviation of a range

MOST_TURNED = 16
"""Robots with more beams have laser scanners, whose beams have the right directions."""

WhenToCalibrate = Literal["always", "if_needed", "never"]
_StdShare = Annotated[float, Bounds(0.0, 0.999)]


@dataclass(frozen=True)
class PendingReadingsConfig(Bounded):
    """Which readings are collected, and how long each of them waits for an association.

    A pending reading is kept beside a clone of the pose that it was measured from.
    """

    # No new readings are collected before the robot has driven or turned this far, m and rad
    min_distance: NonNegative = 0.01
    min_turn: NonNegative = math.radians(1.0)
    beams: Count = 8  # At most this many beams of a side are used in a step
    # Number of new readings of a side at which lines are extracted from its pending readings
    batch: Annotated[int, Bounds(1, 1000, is_whole=True)] = 12
    max_age: NonNegative = (
        1.5  # A reading that has been pending for this long, m driven, is discarded
    )
    max_clones: Count = 70  # Largest number of cloned poses in the filter's state


@dataclass(frozen=True)
class WallAssociationConfig(Bounded):
    """When the readings of one straight piece of wall belong to a known landmark."""

    # Largest chi-square (two degrees of freedom) of the difference between the readings and a
    # landmark
    gate: NonNegative = gate(2, 0.9889)


@dataclass(frozen=True)
class CreationConfig(Bounded):
    """When the readings of a piece of wall create a landmark."""

    # Least length of the piece, m, for ranges with a standard deviation below 1 cm, and for other
    # ranges
    min_length: NonNegative = 0.7
    min_length_noisy: NonNegative = 1.0
    readings_per_std: NonNegative = (
        500.0  # Least number of readings for each metre of the ranges' standard deviation
    )


@dataclass(frozen=True)
class ExtentConfig(Bounded):
    """When a landmark is drawn."""

    # A landmark is drawn if it has this many readings and its piece of wall is this long, m
    min_readings: CountOrNone = 10
    min_length: NonNegative = 0.20


@dataclass(frozen=True)
class MergingConfig(Bounded):
    """When two landmarks are one wall and are merged, which closes a loop."""

    enabled: bool = True  # False is the ablation without loop closing


@dataclass(frozen=True)
class SelfCalibrationConfig(Bounded):
    """Estimation of the constant errors of the odometry: the sizes of the wheels and of the axle,
    or the errors of a heading.
    """

    # When these sizes are part of the filter's state: ``always``, ``never``, or ``if_needed``,
    # which is from the moment on at which the data show that the robot is not as specified
    calibrate: WhenToCalibrate = "if_needed"
    size_std: _StdShare = 0.01  # Standard deviation of the size of both wheels together, as a share
    uneven_std: _StdShare = (
        0.02  # Standard deviation of the difference between the two wheels, as a share
    )
    axle_std: _StdShare = 0.03  # Standard deviation of the length of the axle, as a share
    # Of a heading sensor: standard deviations of its scale, as a share, and of its drift, rad/s.
    # They and the size of the wheels are part of the state from the first heading on.
    yaw_scale_std: _StdShare = 0.01
    yaw_drift_std: NonNegative = math.radians(0.5)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the scale errors of left wheel, right wheel and axle (3, 3)."""
        both = self.size_std**2
        half = 0.25 * self.uneven_std**2
        covariance = np.diag([both + half, both + half, self.axle_std**2])
        covariance[[0, 1], [1, 0]] = both - half
        return covariance

    @property
    def heading_covariance(self) -> FloatArray:
        """Covariance of the size of the wheels, and of scale and drift of a heading (3, 3)."""
        return np.diag(np.square([self.size_std, self.yaw_scale_std, self.yaw_drift_std]))


@dataclass(frozen=True)
class RangeErrorConfig(Bounded):
    """Estimation of the sensor's noise, its bias and the opening angle of its beams, where the data
    require it.
    """

    enabled: bool = True  # False takes the sensor to be as specified
    # Twice the logarithm of the Bayes factor for another bias, opening angle or directions of the
    # beams from which on it is used
    gate: NonNegative = 12.0
    # Twice the logarithm of the likelihood ratio for another noise from which on it is used
    noise_gate: NonNegative = 20.0
    # Standard deviations of a bias of all ranges, m, and of half the opening angle, rad
    bias_std: NonNegative = 0.02
    cone_std: NonNegative = 0.05
    scale_std: NonNegative = 0.02  # Standard deviation of the share by which all ranges are longer
    delay_std: NonNegative = 0.1  # Standard deviation of a delay of all ranges, s
    turn_std: NonNegative = 0.05  # Standard deviation of the direction of a beam, rad
    least_std: NonNegative = 0.005  # Smaller noise is not estimated, m
    least_ratio: Annotated[float, Bounds(1.01, 10.0)] = (
        1.25  # Noise that differs by a smaller factor is as specified
    )
    # The two gates and the factor for a sensor that has already been found to differ from the
    # specified one
    further_gate: NonNegative = 8.0
    further_ratio: Annotated[float, Bounds(1.01, 10.0)] = 1.1

    def stds(self, beams: int, period: float) -> tuple[float, ...]:
        """Standard deviations of a bias, m, an opening angle, rad, a delay, and the directions of a
        robot's beams, rad.

        The delay is in steps of ``period`` seconds.
        """
        return (
            self.bias_std,
            self.cone_std,
            self.delay_std / period,
            *(self.turn_std,) * (beams if beams <= MOST_TURNED else 0),
        )


@dataclass(frozen=True)
class ConsistentConfig:
    """Settings of the consistent estimator, one group for each stage."""

    pending: PendingReadingsConfig = PendingReadingsConfig()
    hough: HoughConfig = HoughConfig(min_length=0.15)
    association: WallAssociationConfig = WallAssociationConfig()
    creation: CreationConfig = CreationConfig()
    extents: ExtentConfig = ExtentConfig()
    merging: MergingConfig = MergingConfig()
    self_calibration: SelfCalibrationConfig = SelfCalibrationConfig()
    range_errors: RangeErrorConfig = RangeErrorConfig()

    def for_ranges(self, std: float) -> Self:
        """These settings with the least length of a new landmark for ranges of a standard deviation
        (m).
        """
        if std < _NOISY_STD:
            return self
        return replace(
            self, creation=replace(self.creation, min_length=self.creation.min_length_noisy)
        )
