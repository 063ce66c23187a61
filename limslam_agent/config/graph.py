"""Settings of the graph of local maps, one frozen dataclass for each stage. One setting serves all logs; m and rad.

Numbers that nothing sets are constants beside the code (:mod:`limslam_agent.slam.graph`).
"""

import math
from dataclasses import dataclass, field

from limslam_agent.config.bounds import Angle, Bounded, Count, NonNegative, Positive

_DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class PointConfig(Bounded):
    """The choice of the points of a log that are used.

    Attributes
    ----------
    points_per_metre
        Largest number of points for each metre driven. Of more points, those of every k-th beam are used, of other
        beams in each scan.
    """

    points_per_metre: Positive = 140.0


@dataclass(frozen=True)
class OdometryErrorConfig(Bounded):
    """The prior of the constant errors of odometry.

    Attributes
    ----------
    bias_std
        Prior standard deviation of the missing heading of odometry per metre, rad/m.
    scale_std, turn_gain_std
        Prior standard deviations of the relative errors of distances and turns.
    delay_std
        Prior standard deviation of the time by which ranges are older than odometry, s.
    direction_std
        Prior standard deviation of the angle between the direction of driving and ahead in the frame of the beams, rad.
    """

    bias_std: Positive = 1.5 * _DEGREE
    scale_std: Positive = 0.03
    turn_gain_std: Positive = 0.03
    delay_std: Positive = 0.1
    direction_std: Angle = 2.0 * _DEGREE

    @property
    def stds(self) -> tuple[float, float, float, float, float]:
        """The standard deviations in the order of the errors in ``Trajectory.bias``."""
        return self.bias_std, self.scale_std, self.turn_gain_std, self.delay_std, self.direction_std


@dataclass(frozen=True)
class WallLineConfig(Bounded):
    """Straight walls, found by a Hough transform in windows of distance driven.

    Attributes
    ----------
    window
        Length of a window, m; windows overlap by half.
    tolerance
        Largest distance of a point from its line, m.
    angle_bin
        Bin of the Hough space, rad.
    min_points, min_length, max_gap
        Fewest points, least length and largest gap along the line, m.
    """

    window: Positive = 10.0
    tolerance: NonNegative = 0.12
    angle_bin: Positive = 3.0 * _DEGREE
    min_points: Count = 10
    min_length: NonNegative = 0.8
    max_gap: NonNegative = 1.5


@dataclass(frozen=True)
class SmoothingConfig(Bounded):
    """Number of iterations of the local smoothing with links alone, and with links and lines."""

    link_iterations: Count = 5
    line_iterations: Count = 10


@dataclass(frozen=True)
class LocalMapConfig(Bounded):
    """Local maps: chunks of driving drawn into small grids.

    Attributes
    ----------
    half
        Distance driven on either side of a chunk's middle, m.
    hop
        Distance driven between the middles of successive chunks, m.
    cell, hit_radius
        Side of a cell, and radius around a point in which cells are occupied, m.
    """

    half: Positive = 3.5
    hop: Positive = 2.5
    cell: Positive = 0.1
    hit_radius: NonNegative = 0.15


@dataclass(frozen=True)
class ReversingConfig(Bounded):
    """The search for stretches that were driven backwards although odometry never says so.

    Attributes
    ----------
    contradicted, fewest
        Odometry has no sign if at least ``fewest`` stretches contradict that they were driven ahead: at least
        this share of their points would lie where only free space was seen before.
    """

    contradicted: NonNegative = 0.03
    fewest: Count = 2


@dataclass(frozen=True)
class GraphConfig(Bounded):
    """All settings of the graph of local maps."""

    reversing: ReversingConfig = field(default_factory=ReversingConfig)
    keys: PointConfig = field(default_factory=PointConfig)
    motion: OdometryErrorConfig = field(default_factory=OdometryErrorConfig)
    lines: WallLineConfig = field(default_factory=WallLineConfig)
    smoothing: SmoothingConfig = field(default_factory=SmoothingConfig)
    maps: LocalMapConfig = field(default_factory=LocalMapConfig)
