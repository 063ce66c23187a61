"""Settings of the stages that the paper has: one frozen dataclass a stage.

The paper gives hardly a number; where a comment says "ours", the choice is this project's, tuned on seeds that are not
reported. Lengths are in metres, angles in radians unless a name says degrees.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class OdometryConfig:
    """The motion of a log that holds odometry poses instead of wheel travel.

    Attributes
    ----------
    distance_variance
        Variance of the travelled distance, m^2 per metre.
    turn_variance_per_metre
        Variance of the heading, rad^2 per metre driven.
    turn_variance_per_radian
        Variance of the heading, rad^2 per radian turned.
    turn_bias
        True minus reported heading for each metre driven, rad per metre.
    distance_scale
        True distance over reported distance.
    """

    distance_variance: float = 0.05**2
    turn_variance_per_metre: float = math.radians(0.8) ** 2
    turn_variance_per_radian: float = math.radians(4.0) ** 2
    turn_bias: float = 0.0
    distance_scale: float = 1.0


@dataclass(frozen=True)
class BufferConfig:
    """The pseudo-dense scans.

    Attributes
    ----------
    size
        Points at which a buffer is handed on. Ours.
    min_distance, min_turn
        A side takes no new points before the robot has driven or turned this far. Ours: points
        measured while standing still say nothing new about a line.
    max_gap
        Distance driven without a measurement after which the wall has ended: what is in the
        buffer is handed on and the next measurement begins a new wall. Ours.
    """

    size: int = 30
    min_distance: float = 0.01
    min_turn: float = math.radians(1.0)
    max_gap: float = 0.25


@dataclass(frozen=True)
class HoughConfig:
    """Lines in a buffer of points.

    Attributes
    ----------
    theta_step
        Angle bins. Ours.
    r_step
        Distance bins; never finer than three standard deviations of the ranges, because the
        votes of one wall would split. Ours.
    min_votes
        The threshold: *every* line with this many votes is taken, not only the best. Ours.
    max_offset
        Points this far from a line belong to it, or 2.5 standard deviations if that is more. Ours.
    max_gap
        A hole in a line's points that makes two pieces of it. Ours.
    min_length
        Shorter pieces are no walls. Ours.
    only_best
        Ablation: take only the line with the most votes.
    """

    theta_step: float = math.radians(2.0)
    r_step: float = 0.02
    min_votes: int = 8
    max_offset: float = 0.03
    max_gap: float = 0.30
    min_length: float = 0.25
    only_best: bool = False


@dataclass(frozen=True)
class AssociationConfig:
    """When an observed line is a landmark that is known already.

    Attributes
    ----------
    gate
        Largest squared Mahalanobis distance. Ours: wider than chi-square's, because the published filter is
        surer of itself than it should be.
    max_end_gap
        Largest distance along the wall between the observation and the landmark's end points. Ours: a little
        more than the gap that ends a wall in the buffer. `ablations` leaves this gate out.
    max_angle, max_distance
        Largest difference of direction, and distance of the observation's middle from the line. Ours.
    range_slack
        How far past its sensors' range a landmark may lie and still count as seen. Ours.
    min_new_length
        An observation that is no known landmark becomes a new one when it is at least this long. Ours:
        the direction of a short stretch is poorly known, and everything later leans on it.
    min_new_share
        The same as a share of the sensors' reach: those who see farther take their points farther apart. Ours.
    """

    gate: float = 16.0
    max_end_gap: float = 0.35
    max_angle: float = math.radians(15.0)
    max_distance: float = 0.35
    range_slack: float = 0.25
    min_new_length: float = 0.30
    min_new_share: float = 0.14


@dataclass(frozen=True)
class LoopClosingConfig:
    """When the two landmarks nearest to an observation are one wall.

    Attributes
    ----------
    enabled
        False is the ablation without loop closing.
    gate
        Largest squared Mahalanobis distance between the two. Ours.
    min_overlap
        They must share at least this length of wall. Ours: two walls on one line with a door between them
        share none.
    max_angle, max_distance
        Largest difference of direction, and distance of the younger's middle from the older's line. Ours.
    floor_distance, floor_angle
        Least standard deviations that the difference of two landmarks is credited with, m and rad. Ours.
    """

    enabled: bool = True
    gate: float = 12.0
    min_overlap: float = 0.20
    max_angle: float = math.radians(15.0)
    max_distance: float = 0.35
    floor_distance: float = 0.01
    floor_angle: float = math.radians(0.5)


@dataclass(frozen=True)
class MapConfig:
    """When a landmark is a wall of the map. Until then it is provisional: used, but not shown.

    Attributes
    ----------
    min_observations
        Observed lines that it must be made of. Ours.
    min_length
        Its least length. Ours.
    """

    min_observations: int = 2
    min_length: float = 0.30


@dataclass(frozen=True)
class FilterConfig:
    """The extended Kalman filter.

    Attributes
    ----------
    min_range_std
        Least standard deviation that a range is credited with, m; quantities are never exact.
    drift_share
        Besides its fit's covariance, an observed line is credited in angle with this share of the variance that
        odometry's heading has gathered since its points were measured. Ours; 0 is the fit alone.
    correct
        False is the ablation without a filter: lines are drawn at the odometry's poses.
    """

    min_range_std: float = 0.005
    drift_share: float = 1.0
    correct: bool = True
