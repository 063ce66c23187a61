"""Settings of the graph of local maps, one frozen dataclass for each stage. One setting serves all
logs; m and rad.

Numbers that nothing sets are constants beside the code (:mod:`limslam_agent.slam.map_graph`).
"""

import math
from dataclasses import dataclass

from limslam_agent.config.bounds import Angle, Bounded, Count, NonNegative, Positive

_DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class PointConfig(Bounded):
    """The choice of the points of a log that are used."""

    # Largest number of points for each metre driven. Of more points, those of every k-th beam are
    # used, of other beams in each scan.
    points_per_metre: Positive = 140.0


@dataclass(frozen=True)
class OdometryErrorConfig(Bounded):
    """The prior of the constant errors of odometry."""

    bias_std: Positive = (
        1.5 * _DEGREE
    )  # Prior standard deviation of the missing heading of odometry per metre, rad/m
    # Prior standard deviations of the relative errors of distances and turns
    scale_std: Positive = 0.03
    turn_gain_std: Positive = 0.03
    delay_std: Positive = (
        0.1  # Prior standard deviation of the time by which ranges are older than odometry, s
    )
    # Prior standard deviation of the angle between the direction of driving and ahead in the frame
    # of the beams, rad
    direction_std: Angle = 2.0 * _DEGREE

    @property
    def stds(self) -> tuple[float, float, float, float, float]:
        """The standard deviations in the order of the errors in ``Trajectory.bias``."""
        return self.bias_std, self.scale_std, self.turn_gain_std, self.delay_std, self.direction_std


@dataclass(frozen=True)
class WallLineConfig(Bounded):
    """Straight walls, found by a Hough transform in windows of distance driven."""

    window: Positive = 10.0  # Length of a window, m; windows overlap by half
    tolerance: NonNegative = 0.12  # Largest distance of a point from its line, m
    angle_bin: Positive = 3.0 * _DEGREE  # Bin of the Hough space, rad
    # Fewest points, least length and largest gap along the line, m
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
    """Local maps: chunks of driving drawn into small grids."""

    half: Positive = 3.5  # Distance driven on either side of a chunk's middle, m
    hop: Positive = 2.5  # Distance driven between the middles of successive chunks, m
    # Side of a cell, and radius around a point in which cells are occupied, m
    cell: Positive = 0.1
    hit_radius: NonNegative = 0.15

    @property
    def length(self) -> float:
        """Distance driven in a chunk, m."""
        return 2.0 * self.half

    @property
    def another_visit(self) -> float:
        """After this distance driven, m, what is seen again is another visit of its place: two
        chunks show nothing that was seen in between.
        """
        return 2.0 * self.length - 0.5


@dataclass(frozen=True)
class ReversingConfig(Bounded):
    """The search for stretches that were driven backwards although odometry never says so."""

    # Odometry has no sign if at least ``fewest`` stretches contradict that they were driven ahead:
    # at least this share of their points would lie where only free space was seen before
    contradicted: NonNegative = 0.03
    fewest: Count = 2


@dataclass(frozen=True)
class GraphConfig(Bounded):
    """All settings of the graph of local maps."""

    reversing: ReversingConfig = ReversingConfig()
    keys: PointConfig = PointConfig()
    motion: OdometryErrorConfig = OdometryErrorConfig()
    lines: WallLineConfig = WallLineConfig()
    smoothing: SmoothingConfig = SmoothingConfig()
    maps: LocalMapConfig = LocalMapConfig()
