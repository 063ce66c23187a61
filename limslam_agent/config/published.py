"""Settings of the published method: the estimator of the paper, which the preset ``paper`` selects.

The preset ``odometry`` is the same estimator with its corrections switched off. "Published" names
the method and its code, and "paper" names only that preset. The paper gives hardly any numbers: all
of these are choices of this project, tuned on seeds that are not reported. Lengths are in metres,
and angles are in radians.
"""

import math
from dataclasses import dataclass

import numpy as np

from limslam_agent.config.bounds import Angle, Bounded, Count, CountOrNone, NonNegative
from limslam_agent.config.gates import gate
from limslam_agent.config.shared import HoughConfig
from limslam_env.geometry import FloatArray

_MOST_UNSEEN = 0.35
"""A landmark may continue this far beyond its known ends, m, besides the effect of noise."""


@dataclass(frozen=True)
class BufferConfig(Bounded):
    """The scan buffers, which turn a few beams into a pseudo-dense scan."""

    size: Count = 30  # Number of points at which a buffer is full and its lines are extracted
    # A side takes no new points before the robot has driven or turned this far, m and rad: points
    # that are measured while the robot stands still add nothing to a line
    min_distance: NonNegative = 0.01
    min_turn: NonNegative = math.radians(1.0)
    # Distance driven without a measurement after which the wall has ended, m. The lines of the
    # buffer are then extracted, and the next measurement begins a new wall
    max_gap: NonNegative = 0.25


@dataclass(frozen=True)
class AssociationConfig(Bounded):
    """When an observed line is a known landmark."""

    # Largest squared Mahalanobis distance. It is wider than the quantile of chi-square, because the
    # covariance of the published filter is too small.
    gate: NonNegative = gate(2, 0.99966)
    # Largest distance along the wall between the observation and the end points of the landmark, m:
    # a little more than the gap that ends a wall in the buffer. An ablation removes this gate.
    max_end_gap: NonNegative = 0.35
    # Largest difference of direction, rad, and largest distance of the observation's middle from
    # the line, m
    max_angle: Angle = math.radians(15.0)
    max_distance: NonNegative = 0.35
    # A landmark counts as visible up to this far past the range of the sensors, m
    range_slack: NonNegative = 0.25
    # An observation of no known landmark becomes a new landmark if it is at least this long, m: the
    # direction of a short segment is poorly known, and later observations are associated with it.
    min_new_length: NonNegative = 0.30
    # The same length as a share of the sensors' reach, because points are farther apart at long
    # range. The larger of the two lengths applies
    min_new_share: NonNegative = 0.14

    @property
    def slack(self) -> float:
        """How far a landmark may continue beyond its known ends by noise, and unseen, m."""
        # Beams must meet the landmark even where the test of the ends is disabled.
        return min(self.max_end_gap, _MOST_UNSEEN) + self.range_slack

    def least_new_length(self, reach: float) -> float:
        """Least length of a new landmark, m, for sensors that measure up to ``reach``, m."""
        return max(self.min_new_length, self.min_new_share * reach)


@dataclass(frozen=True)
class LoopClosingConfig(Bounded):
    """When the two landmarks nearest to an observation are one wall."""

    enabled: bool = True  # False is the ablation without loop closing
    # Largest squared Mahalanobis distance between the two landmarks
    gate: NonNegative = gate(2, 0.9975)
    # Least length of wall that both landmarks cover, m: two walls on one line with a door between
    # them have no overlap.
    min_overlap: NonNegative = 0.20
    # Largest difference of direction, rad, and largest distance of the newer landmark's middle from
    # the older landmark's line, m
    max_angle: Angle = math.radians(15.0)
    max_distance: NonNegative = 0.35
    # Least standard deviations of the difference of two landmarks, m and rad
    floor_distance: NonNegative = 0.01
    floor_angle: Angle = math.radians(0.5)

    @property
    def floor(self) -> FloatArray:
        """Least covariance (2, 2) of that difference: the landmarks' own would be more exact than
        any wall is straight, if they were always seen together.
        """
        return np.diag([self.floor_distance**2, self.floor_angle**2])


@dataclass(frozen=True)
class MapConfig(Bounded):
    """When a landmark is a wall of the map. Until then it is provisional: the filter uses it, but
    no map shows it.
    """

    min_observations: CountOrNone = 2  # Least number of observed lines of the landmark
    min_length: NonNegative = 0.30  # Least length of the landmark, m


@dataclass(frozen=True)
class FilterConfig(Bounded):
    """The extended Kalman filter."""

    # The angle variance of an observed line is that of its fit plus this share of the variance that
    # the odometry's heading has accumulated since the points were measured. 0 uses the fit alone.
    drift_share: NonNegative = 1.0
    correct: bool = (
        True  # False is the ablation without a filter: lines are drawn at the odometry's poses
    )


@dataclass(frozen=True)
class PublishedConfig:
    """Settings of the published method, one group for each stage."""

    buffer: BufferConfig = BufferConfig()
    hough: HoughConfig = HoughConfig()
    association: AssociationConfig = AssociationConfig()
    closing: LoopClosingConfig = LoopClosingConfig()
    map: MapConfig = MapConfig()
    filter: FilterConfig = FilterConfig()

    @property
    def limits(self) -> dict[str, float]:
        """The limits that decide about associations and loops, for diagnostics to show."""
        return {
            "gate": self.association.gate,
            "angle": self.association.max_angle,
            "offset": self.association.max_distance,
            "gap": self.association.max_end_gap,
            "loop_gate": self.closing.gate,
            "loop_overlap": self.closing.min_overlap,
            "loop_offset": self.closing.max_distance,
        }
