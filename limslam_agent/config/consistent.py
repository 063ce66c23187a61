"""Settings of the consistent estimator. All are ours, tuned on seeds that are not reported; m and rad."""

import math
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from limslam_agent.config.published import HoughConfig
from limslam_env.geometry import FloatArray

_NOISY = 0.01  # m, std of a range


@dataclass(frozen=True)
class StraightConfig:
    """When readings about one line are no straight wall (consistent estimator). All ours.

    Attributes
    ----------
    kink_gate, min_kink
        Chi-square (one degree of freedom) gained by a kink, and the least angle of one, rad.
    curve_gate
        Chi-square (three degrees of freedom) gained by a smooth curve.
    end_zone, end_gate
        Points within this far of an end, m, are another wall's if it gains so much chi-square to have them aside.
    """

    kink_gate: float = 12.0
    min_kink: float = math.radians(8.0)
    curve_gate: float = 14.0
    end_zone: float = 0.10
    end_gate: float = 6.0


@dataclass(frozen=True)
class SelfCalibrationConfig:
    """What is known of the odometry's constant errors before they are estimated (consistent estimator). All ours.

    Attributes
    ----------
    enabled
        Whether the sizes of wheels and axle are part of the state.
    size_std
        Of both wheels together, as a share.
    uneven_std
        Of the right wheel beside the left, as a share.
    axle_std
        Of the axle, as a share.
    """

    enabled: bool = False
    size_std: float = 0.03
    uneven_std: float = 0.01
    axle_std: float = 0.03

    def __post_init__(self) -> None:
        for name in ("size_std", "uneven_std", "axle_std"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise ValueError(f"{name} must be a share from 0 to 1, not {getattr(self, name)}")

    @property
    def covariance(self) -> FloatArray:
        """Of the left and right wheel's and the axle's factors (3, 3)."""
        both, half = self.size_std**2, 0.25 * self.uneven_std**2
        covariance = np.diag([both + half, both + half, self.axle_std**2])
        covariance[[0, 1], [1, 0]] = both - half
        return covariance


@dataclass(frozen=True)
class CloneConfig:
    """The consistent estimator: readings wait until it is clear which wall they show. All ours.

    Attributes
    ----------
    batch
        New readings of a side after which it looks for lines.
    max_age
        Readings that have waited for this long, m driven, are given up.
    max_clones
        More are not kept.
    wall_end
        Distance driven without a hit after which a wall has ended.
    passed
        A piece of wall of which nothing was seen for this far, m driven, is complete.
    new_length, new_length_noisy
        Least length of a new landmark, for exact ranges and for noisy ones (std of 1 cm or more), m.
    new_length_complete
        The same for a complete piece.
    new_readings
        Least number of readings of a new landmark for each metre of the ranges' standard deviation.
    max_angle_std
        Of a new landmark, rad.
    gate
        Largest chi-square (two degrees of freedom) by which readings may disagree with a landmark.
    far_gate
        Readings between the two gates are neither of the landmark nor of a new one.
    left_sigmas
        Of what is left unexplained, in standard deviations of its chi-square.
    ambiguity
        Readings that a second landmark explains as well but for this chi-square are left out.
    min_length
        Shorter pieces are not used, m.
    end_slack, beyond_length, beyond_gate, beyond_angle_std
        Readings mostly more than ``end_slack`` beyond a landmark's known ends must be so long a piece, fit this well,
        and have a direction known this well.
    max_end_gap, max_angle, max_offset
        Limits for readings and a landmark, and for two landmarks, before anything is computed: m, rad, m.
    huber
        Standard deviations beyond which a reading counts less.
    iterations, first_iterations
        Of the iterated update, for a known landmark and a new one.
    one_wall_gate, min_overlap
        Two landmarks are one wall below this chi-square, if they share so much of it, m.
    through_sigmas, through_slack
        A beam has gone through a wall if it went on for so many standard deviations and so far beyond it.
    max_gap, through_tolerance
        What is drawn as one piece: holes that nobody looked at, m, and beams that passed for each one that hit.
    shown_readings, shown_length
        A landmark is a wall of the map if it was read this often and is so long, m.
    beams
        At most so many beams of a side are used in a step.
    gap_ahead
        Hole between points of the beams ahead that may be one wall, m.
    """

    batch: int = 12
    max_age: float = 1.5
    max_clones: int = 70
    wall_end: float = 0.25
    passed: float = 0.15
    new_length: float = 0.7
    new_length_noisy: float = 1.0
    new_length_complete: float = 0.25
    new_readings: float = 500.0
    max_angle_std: float = math.radians(3.0)
    gate: float = 9.0
    far_gate: float = 25.0
    left_sigmas: float = 3.0
    ambiguity: float = 9.0
    min_length: float = 0.15
    end_slack: float = 0.05
    beyond_length: float = 0.20
    beyond_gate: float = 9.0
    beyond_angle_std: float = math.radians(4.0)
    max_end_gap: float = 0.35
    max_angle: float = math.radians(20.0)
    max_offset: float = 0.5
    huber: float = 1.5
    iterations: int = 2
    first_iterations: int = 4
    one_wall_gate: float = 16.0
    min_overlap: float = 0.15
    through_sigmas: float = 3.0
    through_slack: float = 0.05
    max_gap: float = 0.30
    through_tolerance: float = 1.0
    shown_readings: int = 10
    shown_length: float = 0.20
    beams: int = 8
    gap_ahead: float = 0.9
    hough: HoughConfig = field(default_factory=lambda: HoughConfig(min_length=0.15))
    straight: StraightConfig = field(default_factory=StraightConfig)

    def for_ranges(self, std: float) -> Self:
        """These settings with the length that ranges of a standard deviation (m) ask for."""
        return self if std < _NOISY else replace(self, new_length=self.new_length_noisy)
