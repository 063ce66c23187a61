"""Settings of the published method: the estimator of the paper, which the preset ``paper`` selects.

The preset ``odometry`` is the same estimator with its corrections switched off. "Published" names the method and its
code, and "paper" names only that preset. The paper gives hardly any numbers. The word "ours" marks a choice of this
project, tuned on seeds that are not reported. Lengths are in metres, and angles are in radians.
"""

import math
from dataclasses import dataclass, field

from limslam_agent.config.bounds import Angle, Bounded, Count, CountOrNone, NonNegative
from limslam_agent.config.shared import HoughConfig


@dataclass(frozen=True)
class BufferConfig(Bounded):
    """The scan buffers, which turn a few beams into a pseudo-dense scan.

    Attributes
    ----------
    size
        Number of points at which a buffer is full and its lines are extracted. Ours.
    min_distance, min_turn
        A side takes no new points before the robot has driven or turned this far, m and rad: points that are
        measured while the robot stands still add nothing to a line. Ours.
    max_gap
        Distance driven without a measurement after which the wall has ended, m. The lines of the buffer are then
        extracted, and the next measurement begins a new wall. Ours.
    """

    size: Count = 30
    min_distance: NonNegative = 0.01
    min_turn: NonNegative = math.radians(1.0)
    max_gap: NonNegative = 0.25


@dataclass(frozen=True)
class AssociationConfig(Bounded):
    """When an observed line is a known landmark.

    Attributes
    ----------
    gate
        Largest squared Mahalanobis distance. Ours: it is wider than the quantile of chi-square, because the
        covariance of the published filter is too small.
    max_end_gap
        Largest distance along the wall between the observation and the end points of the landmark, m. Ours: a little
        more than the gap that ends a wall in the buffer. An ablation removes this gate.
    max_angle, max_distance
        Largest difference of direction, rad, and largest distance of the observation's middle from the line, m. Ours.
    range_slack
        A landmark counts as visible up to this far past the range of the sensors, m. Ours.
    min_new_length
        An observation of no known landmark becomes a new landmark if it is at least this long, m. Ours: the direction
        of a short segment is poorly known, and later observations are associated with it.
    min_new_share
        The same length as a share of the sensors' reach, because points are farther apart at long range. The larger
        of the two lengths applies. Ours.
    """

    gate: NonNegative = 16.0
    max_end_gap: NonNegative = 0.35
    max_angle: Angle = math.radians(15.0)
    max_distance: NonNegative = 0.35
    range_slack: NonNegative = 0.25
    min_new_length: NonNegative = 0.30
    min_new_share: NonNegative = 0.14


@dataclass(frozen=True)
class LoopClosingConfig(Bounded):
    """When the two landmarks nearest to an observation are one wall.

    Attributes
    ----------
    enabled
        False is the ablation without loop closing.
    gate
        Largest squared Mahalanobis distance between the two landmarks. Ours.
    min_overlap
        Least length of wall that both landmarks cover, m. Ours: two walls on one line with a door between them
        have no overlap.
    max_angle, max_distance
        Largest difference of direction, rad, and largest distance of the newer landmark's middle from the older
        landmark's line, m. Ours.
    floor_distance, floor_angle
        Least standard deviations of the difference of two landmarks, m and rad. Ours.
    """

    enabled: bool = True
    gate: NonNegative = 12.0
    min_overlap: NonNegative = 0.20
    max_angle: Angle = math.radians(15.0)
    max_distance: NonNegative = 0.35
    floor_distance: NonNegative = 0.01
    floor_angle: Angle = math.radians(0.5)


@dataclass(frozen=True)
class MapConfig(Bounded):
    """When a landmark is a wall of the map. Until then it is provisional: the filter uses it, but no map shows it.

    Attributes
    ----------
    min_observations
        Least number of observed lines of the landmark. Ours.
    min_length
        Least length of the landmark, m. Ours.
    """

    min_observations: CountOrNone = 2
    min_length: NonNegative = 0.30


@dataclass(frozen=True)
class FilterConfig(Bounded):
    """The extended Kalman filter.

    Attributes
    ----------
    drift_share
        The angle variance of an observed line is that of its fit plus this share of the variance that the
        odometry's heading has accumulated since the points were measured. Ours; 0 uses the fit alone.
    correct
        False is the ablation without a filter: lines are drawn at the odometry's poses.
    """

    drift_share: NonNegative = 1.0
    correct: bool = True


@dataclass(frozen=True)
class PublishedConfig:
    """Settings of the published method, one group for each stage.

    Attributes
    ----------
    buffer
        The scan buffers.
    hough
        Extraction of lines from a full buffer.
    association
        When an observed line is a known landmark.
    closing
        Loop closing.
    map
        When a landmark is drawn.
    filter
        The extended Kalman filter.
    """

    buffer: BufferConfig = field(default_factory=BufferConfig)
    hough: HoughConfig = field(default_factory=HoughConfig)
    association: AssociationConfig = field(default_factory=AssociationConfig)
    closing: LoopClosingConfig = field(default_factory=LoopClosingConfig)
    map: MapConfig = field(default_factory=MapConfig)
    filter: FilterConfig = field(default_factory=FilterConfig)
