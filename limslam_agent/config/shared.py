"""Settings of the stages that all estimators share: lines in points, and the motion of recorded
odometry.

The paper gives hardly any numbers: these are choices of this project, tuned on seeds that are not
reported. Lengths are in metres, and angles are in radians.
"""

import math
from dataclasses import dataclass
from typing import Annotated

from limslam_agent.config.bounds import Bounded, Bounds, Count, NonNegative, Number, Positive


@dataclass(frozen=True)
class OdometryConfig(Bounded):
    """The motion of a log that holds odometry poses instead of wheel travel."""

    distance_variance: NonNegative = 0.05**2  # Variance of the travelled distance, m^2 per metre
    turn_variance_per_metre: NonNegative = (
        math.radians(0.8) ** 2
    )  # Variance of the heading, rad^2 per metre driven
    turn_variance_per_radian: NonNegative = (
        math.radians(4.0) ** 2
    )  # Variance of the heading, rad^2 per radian turned
    turn_bias: Number = 0.0  # True minus reported heading for each metre driven, rad per metre
    distance_scale: Annotated[float, Bounds(0.01, 100.0)] = (
        1.0  # True distance over reported distance
    )


@dataclass(frozen=True)
class HoughConfig(Bounded):
    """Extraction of lines from a set of points by the Hough transform."""

    # Width of an angle bin, rad.
    theta_step: Annotated[float, Bounds(math.radians(0.1), 0.5 * math.pi)] = math.radians(2.0)
    # Width of a distance bin, m. It is never finer than three standard deviations of the ranges,
    # because the votes of one wall would be split between bins.
    r_step: Positive = 0.02
    # Threshold of the transform: *every* line with at least this many votes is taken, not only the
    # best.
    min_votes: Count = 8
    # Points within this distance of a line belong to it, m; within 2.5 standard deviations if that
    # is more.
    max_offset: NonNegative = 0.03
    # A hole in a line's points that is longer than this cuts the line into two pieces, m.
    max_gap: NonNegative = 0.30
    min_length: NonNegative = 0.25  # Shorter pieces are discarded, m.
    only_best: bool = False  # Take only the line with the most votes. True is an ablation.
